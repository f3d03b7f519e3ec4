"""A run over many files in a thread of its own, whose records are iterated as files finish.

Signals stay with the program that iterates: the run itself takes none, since Python gives them to
the main thread only, and files are done in worker processes that can be ended at any time.
"""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Generator
from typing import TYPE_CHECKING, Any

from msal_cli.batch.events import Event, Finished
from msal_cli.batch.interrupts import Cancellation
from msal_cli.batch.run import run
from msal_cli.job.records import MeshRecord

if TYPE_CHECKING:
    from msal_cli.batch.plan import Plan
    from msal_cli.job.settings import Settings

_Messages = queue.SimpleQueue[MeshRecord | BaseException | None]


def iterate_records(
    plan: Plan, settings: Settings, **options: Any
) -> Generator[MeshRecord, None, None]:
    """The records of ``batch.run.run(plan, settings, **options)`` in the order in which files
    finish; what it raises is raised here.

    Where the iteration is left early, by ``close`` or an exception such as Ctrl-C's, the run is
    ended first: its workers are gone, and finished files are whole and recorded.
    """
    cancellation = Cancellation()
    messages: _Messages = queue.SimpleQueue()

    def on_event(event: Event) -> None:
        cancellation.check()
        if isinstance(event, Finished):
            messages.put(event.record)

    def work() -> None:
        try:
            run(plan, settings, on_event=on_event, cancellation=cancellation, **options)
        except BaseException as error:
            messages.put(error)
        else:
            messages.put(None)

    thread = threading.Thread(target=work, name="msal", daemon=True)
    thread.start()
    try:
        while (message := _receive(messages)) is not None:
            if isinstance(message, BaseException):
                raise message
            yield message
    finally:
        cancellation.request()
        thread.join()


def _receive(messages: _Messages) -> MeshRecord | BaseException | None:
    """The next message; Ctrl-C ends the wait."""
    while True:
        try:
            # Windows delivers Ctrl-C to a waiting thread only between two waits.
            return messages.get(timeout=0.2 if os.name == "nt" else None)
        except queue.Empty:
            continue
