"""Share a kernel's range of items between threads without changing a bit of its result."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable

SMALLEST_RANGE = 32_768
"""Items per thread below which starting a thread costs more than it saves."""


def usable_cores() -> int:
    """Cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return max(1, os.cpu_count() or 1)


def threads() -> int:
    """Threads a kernel may use: ``MSAL_THREADS`` where it is a positive number, else all cores."""
    wanted = os.environ.get("MSAL_THREADS", "")
    if wanted.isascii() and wanted.isdigit() and int(wanted) > 0:
        return int(wanted)
    return usable_cores()


def over_ranges(
    kernel: Callable[..., object], count: int, *arguments: object, smallest: int = SMALLEST_RANGE
) -> None:
    """Call ``kernel(start, stop, *arguments)`` so that the ranges cover ``0 ... count``.

    The kernel must release the interpreter lock and write only to items of its own range; then
    the result cannot depend on the number of threads.  No range has fewer than ``smallest`` items.
    An exception of any range is raised here.
    """
    parts = max(1, min(threads(), count // smallest))
    if parts == 1:
        kernel(0, count, *arguments)
        return
    bounds = [count * part // parts for part in range(parts + 1)]
    failures: list[BaseException] = []

    def run(start: int, stop: int) -> None:
        try:
            kernel(start, stop, *arguments)
        except BaseException as failure:
            failures.append(failure)

    others = [
        threading.Thread(target=run, args=(bounds[part], bounds[part + 1]), daemon=True)
        for part in range(1, parts)
    ]
    for other in others:
        other.start()
    run(bounds[0], bounds[1])
    for other in others:
        other.join()
    if failures:
        raise failures[0]
