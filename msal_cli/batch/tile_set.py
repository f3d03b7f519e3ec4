"""A plan whose files are denoised as the one mesh that they are together."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from msal_cli.batch import interrupts, temporary_files
from msal_cli.batch.events import Progress
from msal_cli.batch.manifest_dirs import output_folders

if TYPE_CHECKING:
    from collections.abc import Mapping

    from msal_cli.batch.events import OnEvent
    from msal_cli.batch.manifest import Manifest
    from msal_cli.batch.plan import Plan
    from msal_cli.batch.set_tiles import SetTiles
    from msal_cli.batch.tile_options import TileJob
    from msal_cli.job.records import MeshRecord
    from msal_cli.job.settings import Settings
    from msal_cli.job.tile_records import TileSetPart
    from msal_cli.tiles.set_run import EarlierRuns


def denoise_set(
    plan: Plan,
    settings: Settings,
    on_event: OnEvent,
    most_failures: int | None,
    manifests: Mapping[str, Manifest],
    job: TileJob,
) -> dict[int, MeshRecord]:
    """The records of all files that were dealt with, by the numbers of their tasks.

    A set that does not fit into memory is denoised by tiles, as ``job`` says.

    Once ``most_failures`` files cannot be read, no other is written: their records are not there.
    """
    from msal_cli.tiles import set_run

    def on_step(index: int, stage: str, done: int, total: int) -> None:
        if job.cancellation is not None:
            job.cancellation.check()
        on_event(Progress(index, stage, done, total))

    def clean() -> None:
        for folder in output_folders(plan.tasks):
            temporary_files.sweep_after(os.getpid(), folder)

    with interrupts.noticed(interrupts.raise_for), interrupts.ended_late(clean):
        records = set_run.denoise_set(
            plan.tasks,
            settings,
            on_step,
            job.limits,
            most_failures,
            run_tiles=_build_tiles(plan, job),
            earlier=read_earlier(plan, manifests),
        )
    return {index: one for index, one in enumerate(records) if one.status != "planned"}


def survey_set(
    plan: Plan, settings: Settings, manifests: Mapping[str, Manifest]
) -> dict[int, MeshRecord]:
    """What would be denoised: records with counts and neighbours; the files are only read."""
    from msal_cli.tiles import set_run

    return dict(enumerate(set_run.survey_set(plan.tasks, settings, read_earlier(plan, manifests))))


def _build_tiles(plan: Plan, job: TileJob) -> SetTiles | None:
    """What denoises the set by tiles; None where that is no way."""
    if job.options is None:
        return None
    from msal_cli.batch.set_tiles import SetTiles

    home = plan.homes[0] or os.path.dirname(plan.tasks[0].output)
    return SetTiles(plan.tasks, home, job, job.options)


def read_earlier(plan: Plan, manifests: Mapping[str, Manifest]) -> EarlierRuns:
    """What the manifests say of the files of a set and, unless all is to be done afresh, of files
    that belonged to it and are gone."""
    from msal_cli.tiles.set_run import EarlierRuns

    parts: dict[int, TileSetPart] = {}
    absent: dict[str, TileSetPart] = {}
    keys: dict[str, set[str]] = {home: set() for home in manifests}
    for index, home in enumerate(plan.homes):
        if home is not None:
            key = plan.manifest_key(index)
            keys[home].add(key)
            record = _read_record(manifests[home], key)
            if record is not None and record.tile_set is not None:
                parts[index] = record.tile_set
    for home, manifest in manifests.items():
        for key in sorted(manifest.names() - keys[home]) if not plan.fresh else ():
            record = _read_record(manifest, key)
            if record is not None and record.tile_set is not None:
                absent[record.input] = record.tile_set
    return EarlierRuns(parts, absent)


def _read_record(manifest: Manifest, key: str) -> MeshRecord | None:
    entry = manifest.get(key)
    return None if entry is None else entry.record()
