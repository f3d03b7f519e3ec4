"""Different work at the same time, where there are cores for it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from msal_cli.kernels.parallel import threads

SMALLEST = 100_000
"""Items to work on below which starting a thread costs more than it saves."""


def is_worth_it(count: int) -> bool:
    """Whether work on ``count`` items should be shared between threads."""
    return count >= SMALLEST and threads() > 1


def at_once(count: int, *tasks: Callable[[], Any]) -> list[Any]:
    """What the tasks return, which work on some ``count`` items and not on each other's results.

    The first exception, in the order of the tasks, is raised here.
    """
    if not is_worth_it(count):
        return [task() for task in tasks]
    results: list[Any] = [None] * len(tasks)
    failures: list[BaseException | None] = [None] * len(tasks)

    def run(at: int) -> None:
        try:
            results[at] = tasks[at]()
        except BaseException as failure:
            failures[at] = failure

    others = [threading.Thread(target=run, args=(at,), daemon=True) for at in range(1, len(tasks))]
    for other in others:
        other.start()
    run(0)
    for other in others:
        other.join()
    for failure in failures:
        if failure is not None:
            raise failure
    return results
