"""A plan whose files are denoised as the one mesh that they are together."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msal_cli.batch.events import Progress

if TYPE_CHECKING:
    from msal_cli.batch.events import OnEvent
    from msal_cli.batch.plan import Plan
    from msal_cli.job.records import MeshRecord
    from msal_cli.job.settings import Limits, Settings


def denoise_set(
    plan: Plan,
    settings: Settings,
    on_event: OnEvent,
    limits: Limits,
    most_failures: int | None,
) -> dict[int, MeshRecord]:
    """The records of all files that were dealt with, by the numbers of their tasks.

    Once ``most_failures`` files cannot be read, no other is written: their records are not there.
    """
    from msal_cli.tiles import set_run

    records = set_run.denoise_set(
        plan.tasks,
        settings,
        lambda index, stage, done, total: on_event(Progress(index, stage, done, total)),
        limits,
        most_failures,
    )
    return {index: one for index, one in enumerate(records) if one.status != "planned"}


def survey_set(plan: Plan, settings: Settings) -> dict[int, MeshRecord]:
    """What would be denoised: records with counts and neighbours; the files are only read."""
    from msal_cli.tiles import set_run

    return dict(enumerate(set_run.survey_set(plan.tasks, settings)))
