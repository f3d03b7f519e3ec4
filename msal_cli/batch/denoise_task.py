"""The task that workers do in a run over many files."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from msal_cli.job.settings import FORECAST

if TYPE_CHECKING:
    from msal_cli.job.pipeline import OnProgress
    from msal_cli.job.records import MeshRecord
    from msal_cli.job.settings import Settings, Task

    Denoise = Callable[..., MeshRecord]
    """What does one file, such as ``pipeline.denoise_file``."""


def denoise_in_worker(
    task: Task, common: tuple[Denoise, Settings], on_progress: OnProgress
) -> MeshRecord:
    """One file, in a worker.  MemoryError is raised again, so that the file gets its second try
    alone and the worker, whose heap is fragmented, is replaced.  That there was not enough memory
    by forecast would come again."""
    denoise, settings = common
    record = denoise(task, settings, on_progress)
    error = record.error
    if error is not None and error.code == "E_MEMORY" and error.where != FORECAST:
        raise MemoryError(error.message)
    return record
