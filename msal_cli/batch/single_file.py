"""One mesh of a stream in a supervised worker, which can be ended: for its limits alone.

There is no folder to lock, no manifest and no second try.
"""

from __future__ import annotations

import functools
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING

from msal_cli import __version__
from msal_cli.batch.engine import Work, crew_for
from msal_cli.batch.run import LOSS_CODES, check_limits, do_one
from msal_cli.batch.worker_messages import Advanced, Lost, Returned
from msal_cli.errors import ResourceError
from msal_cli.job.pipeline import denoise_copy
from msal_cli.job.records import Failure, MeshRecord, MethodUsed
from msal_cli.job.settings import Limits, Settings, Task
from msal_cli.machine import usable_cores

if TYPE_CHECKING:
    from msal_cli.job.pipeline import OnProgress

__all__ = ["check_limits", "denoised"]


def denoised(
    task: Task,
    settings: Settings,
    limits: Limits,
    left_s: float | None,
    on_progress: OnProgress,
) -> MeshRecord:
    """The record of ``pipeline.denoise_copy``; a failure with E_TIMEOUT, E_MEMORY or E_CRASH if
    the worker did not come to its end.

    Parameters
    ----------
    limits : what the mesh may take, ``timeout_s`` from its first byte on.
    left_s : what is left of ``timeout_s``.

    Raises
    ------
    ResourceError
        if no worker can be started, or no time is left.
    """
    if left_s is not None and left_s <= 0.0:
        raise _overdue(limits)
    engine = crew_for(
        Work(
            {0: task},
            do_one,
            (functools.partial(denoise_copy, limits=limits), settings),
            jobs=1,
            cores=usable_cores(),
            limits=replace(limits, timeout_s=left_s),
            retries=0,
        )
    )
    record: MeshRecord | None = None
    with closing(engine.batches()) as batches:
        for messages in batches:
            for message in messages:
                if isinstance(message, Advanced):
                    on_progress(message.stage, message.done, message.total)
                elif isinstance(message, Returned):
                    record = message.result
                elif isinstance(message, Lost):
                    if message.cause == "timeout":
                        raise _overdue(limits)
                    record = _lost(task, settings, message)
    assert record is not None, "every task is returned or lost"
    return record


def _overdue(limits: Limits) -> ResourceError:
    return ResourceError(
        f"it was not done within {limits.timeout_s:g} s",
        code="E_TIMEOUT",
        hint="raise --timeout, or look at the file: it may be very large, or damaged",
    )


def _lost(task: Task, settings: Settings, message: Lost) -> MeshRecord:
    return MeshRecord(
        input=task.relative,
        status="failed",
        version=__version__,
        method=MethodUsed(settings.method, dict(settings.parameters)),
        error=Failure(LOSS_CODES[message.cause], message.reason, message.hint),
    )
