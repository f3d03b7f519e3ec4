"""One mesh of a stream in a supervised worker, which can be ended: only for its limits."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from msal_cli.batch.events import Event, Progress
from msal_cli.batch.plan import Plan
from msal_cli.batch.run import run
from msal_cli.batch.worker_pool import WorkerPool
from msal_cli.errors import ResourceError
from msal_cli.job.pipeline import denoise_copy
from msal_cli.job.records import MeshRecord
from msal_cli.job.settings import Limits, Settings, Task

if TYPE_CHECKING:
    from msal_cli.job.pipeline import OnProgress


def denoise_in_pool(
    task: Task,
    settings: Settings,
    limits: Limits,
    left_s: float | None,
    on_progress: OnProgress,
) -> MeshRecord:
    """The record of ``pipeline.denoise_copy``; a failure with E_MEMORY or E_CRASH if the worker
    did not finish.  There is no manifest and no second try.

    Parameters
    ----------
    limits : what the mesh may use, ``timeout_s`` from its first byte on.
    left_s : what is left of ``timeout_s``.

    Raises
    ------
    ResourceError
        if no worker can be started, or no time is left (E_TIMEOUT).
    """

    def on_event(event: Event) -> None:
        if isinstance(event, Progress):
            on_progress(event.stage, event.done, event.total)

    record: MeshRecord | None = None
    if left_s is None or left_s > 0.0:
        (record,) = run(
            Plan((task,), (None,)),
            settings,
            jobs=1,
            on_event=on_event,
            limits=replace(limits, timeout_s=left_s),
            retries=0,
            denoise=denoise_copy,
            engine=WorkerPool,
        )
    if record is None or (record.error is not None and record.error.code == "E_TIMEOUT"):
        raise ResourceError(
            f"it was not done within {limits.timeout_s:g} s",
            code="E_TIMEOUT",
            hint="raise --timeout, or look at the file: it may be very large, or damaged",
        )
    return replace(record, input=task.relative)
