"""One mesh of a stream in a supervised worker, which can be ended: only for its limits.

There is no folder to lock, no manifest and no second try.
"""

from __future__ import annotations

import functools
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING

from msal_cli.batch.engine import Work
from msal_cli.batch.events import Failed, Progress, Returned
from msal_cli.batch.run import denoise_in_worker, failure_of, unfinished_record
from msal_cli.batch.worker_pool import WorkerPool
from msal_cli.errors import ResourceError
from msal_cli.job.pipeline import denoise_copy
from msal_cli.job.records import MeshRecord
from msal_cli.job.settings import Limits, Settings, Task
from msal_cli.machine import usable_cores

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
    did not finish.

    Parameters
    ----------
    limits : what the mesh may use, ``timeout_s`` from its first byte on.
    left_s : what is left of ``timeout_s``.

    Raises
    ------
    ResourceError
        if no worker can be started, or no time is left (E_TIMEOUT).
    """
    overdue = ResourceError(
        f"it was not done within {limits.timeout_s or 0.0:g} s",
        code="E_TIMEOUT",
        hint="raise --timeout, or look at the file: it may be very large, or damaged",
    )
    if left_s is not None and left_s <= 0.0:
        raise overdue
    common = (functools.partial(denoise_copy, limits=limits), settings)
    limits = replace(limits, timeout_s=left_s)
    pool = WorkerPool(
        Work({0: task}, denoise_in_worker, common, cores=usable_cores(), limits=limits, retries=0)
    )
    record: MeshRecord | None = None
    with closing(pool.batches()) as batches:
        for message in (message for messages in batches for message in messages):
            if isinstance(message, Progress):
                on_progress(message.stage, message.done, message.total)
            elif isinstance(message, Returned):
                record = message.result
            elif isinstance(message, Failed):
                if message.cause == "timeout":
                    raise overdue
                record = unfinished_record(task.relative, settings, failure_of(message))
    assert record is not None, "every task returns or fails"
    return record
