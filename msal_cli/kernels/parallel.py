"""Share a kernel's range of items between threads without changing a bit of its result."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from typing import Any

from msal_cli.machine import usable_cores

SMALLEST_RANGE = 32_768
"""Items per thread below which starting a thread costs more than it saves."""

MARKING_THREADS = 4
"""Threads for kernels of which each marks all items: of more the marks would take much memory."""


def threads() -> int:
    """Threads a kernel may use: ``MSAL_THREADS`` where it is a positive number, else all cores."""
    wanted = os.environ.get("MSAL_THREADS", "")
    if wanted.isascii() and wanted.isdigit() and int(wanted) > 0:
        return int(wanted)
    return usable_cores()


def over_ranges(
    kernel: Callable[..., Any],
    count: int,
    *arguments: object,
    smallest: int | None = None,
    most: int | None = None,
) -> list[Any]:
    """Call ``kernel(start, stop, *arguments)`` so that the ranges cover ``0 ... count``.

    Returns what the ranges returned, in their order.

    The kernel must release the interpreter lock and write only to items of its own range; then
    the result cannot depend on the number of threads.  No range has fewer than ``smallest`` items,
    by default ``SMALLEST_RANGE``; there are no more than ``most`` ranges.  An exception of any
    range is raised here.
    """
    least = SMALLEST_RANGE if smallest is None else smallest
    parts = min(count // least, count if most is None else most)
    # Small meshes call kernels by the thousand: they need not ask how many threads there are.
    parts = min(parts, threads()) if parts > 1 else 1
    if parts == 1:
        return [kernel(0, count, *arguments)]
    bounds = [count * part // parts for part in range(parts + 1)]
    results: list[Any] = [None] * parts
    failures: list[BaseException] = []

    def run(part: int) -> None:
        try:
            results[part] = kernel(bounds[part], bounds[part + 1], *arguments)
        except BaseException as failure:
            failures.append(failure)

    others = [threading.Thread(target=run, args=(part,), daemon=True) for part in range(1, parts)]
    for other in others:
        other.start()
    run(0)
    for other in others:
        other.join()
    if failures:
        raise failures[0]
    return results
