"""Records of files that were not done, and the failures of those that were lost."""

from __future__ import annotations

from msal_cli.batch.events import Failed
from msal_cli.job.records import Failure, MeshRecord, MethodUsed
from msal_cli.job.settings import Settings
from msal_cli.version import __version__

LOSS_CODES = {
    "crash": "E_CRASH",
    "memory": "E_MEMORY",
    "timeout": "E_TIMEOUT",
    "exception": "E_INTERNAL",
    "changed": "E_CHANGED",
}
"""Codes of failures by what ended a task, see ``events.Failed``."""


def unfinished_record(name: str, settings: Settings, failure: Failure | None = None) -> MeshRecord:
    """The record of an input that failed outside of the pipeline, or that is not done yet."""
    return MeshRecord(
        input=name,
        status="planned" if failure is None else "failed",
        version=__version__,
        method=MethodUsed(settings.method, dict(settings.parameters)),
        error=failure,
    )


def failure_of(message: Failed) -> Failure:
    """The failure, with its code, of a task that was lost."""
    return Failure(LOSS_CODES[message.cause], message.reason, message.hint)
