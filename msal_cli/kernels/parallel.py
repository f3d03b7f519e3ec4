"""Sharing of work between threads, without an effect on any bit of the result."""

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
"""Items below which different tasks on them are not worth a thread each."""

MARKING_THREADS = 4
"""Largest number of threads of kernels that need a mark for each item in each thread."""


def threads() -> int:
    """Threads that a kernel may use: ``MSAL_THREADS`` if it is positive, else all cores."""
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
    """Call ``kernel(start, stop, *arguments)`` for ranges that cover ``0 ... count``, in threads.

    Returns the results of the ranges, in their order.

    The kernel must release the interpreter lock and write only to items of its own range; then the
    result cannot depend on the number of threads.  No range has fewer than ``smallest`` items, by
    default ``MIN_RANGE``, and there are at most ``most`` ranges.  Exceptions are raised here.
    """
    least = MIN_RANGE if smallest is None else smallest
    parts = min(count // least, count if most is None else most)
    # For small meshes, which call kernels by the thousand, the number of threads is not needed.
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
    """A new array that ``kernel(start, stop, *arguments, array)`` fills, see ``over_ranges``."""
    array = np.empty(shape)
    over_ranges(kernel, len(array), *arguments, array)
    return array


def is_worth_it(count: int) -> bool:
    """Whether different tasks on ``count`` items should run in threads."""
    return count >= MIN_COUNT and threads() > 1


def at_once(count: int, *tasks: Callable[[], Any]) -> list[Any]:
    """The results of independent tasks on about ``count`` items, in threads if that is worth it.

    The first exception, in the order of the tasks, is raised here.
    """
    return _run(tasks) if is_worth_it(count) else [task() for task in tasks]


def _run(calls: Sequence[Callable[[], Value]]) -> list[Value]:
    """The results of the calls, each in a thread, the first in this one."""
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
