"""Share work between threads without changing a bit of its result."""

import functools
import os
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from msal_cli.arrays import Floats
from msal_cli.machine import in_background, usable_cores

Value = TypeVar("Value")

MIN_RANGE = 32_768
"""Items per thread below which starting a thread costs more than it saves."""

MIN_COUNT = 100_000
"""Items below which different work on them is not worth a thread each."""

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
    by default ``MIN_RANGE``; there are no more than ``most`` ranges.  An exception of any
    range is raised here.
    """
    least = MIN_RANGE if smallest is None else smallest
    parts = min(count // least, count if most is None else most)
    # Small meshes call kernels by the thousand: they need not ask how many threads there are.
    parts = min(parts, threads()) if parts > 1 else 1
    if parts == 1:
        return [kernel(0, count, *arguments)]
    bounds = [count * part // parts for part in range(parts + 1)]
    return _run(
        [functools.partial(kernel, *bounds[part : part + 2], *arguments) for part in range(parts)]
    )


def fill_array(
    kernel: Callable[..., Any], shape: int | tuple[int, ...], *arguments: object
) -> Floats:
    """A new array of this shape whose items ``kernel(start, stop, *arguments, array)`` computes.

    The ranges are those of ``over_ranges``.
    """
    array = np.empty(shape)
    over_ranges(kernel, len(array), *arguments, array)
    return array


def is_worth_it(count: int) -> bool:
    """Whether different work on ``count`` items should be shared between threads."""
    return count >= MIN_COUNT and threads() > 1


def at_once(count: int, *tasks: Callable[[], Any]) -> list[Any]:
    """What the tasks return, which work on some ``count`` items and not on each other's results.

    The first exception, in the order of the tasks, is raised here.
    """
    return _run(tasks) if is_worth_it(count) else [task() for task in tasks]


def _run(calls: Sequence[Callable[[], Value]]) -> list[Value]:
    """What the calls return; each in a thread, the first here."""
    results: list[Value] = []
    failures: list[BaseException] = []
    for wait in (calls[0], *[in_background(call) for call in calls[1:]]):
        try:
            results.append(wait())
        except BaseException as failure:
            failures.append(failure)
    if failures:
        raise failures[0]
    return results
