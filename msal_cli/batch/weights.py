"""How much memory the files of a run will take, and how much there is for them."""

from __future__ import annotations

import os
from collections.abc import Mapping

from msal_cli.batch.memory import available_bytes
from msal_cli.dataclass import dataclass
from msal_cli.pipeline import (
    Limits,
    Settings,
    Task,
    forecast,
    least_memory_bytes,
    method_bytes_per_face,
)

LARGE_BYTES = 4 << 20
"""Files from this size on are looked into and go first; the rest differ too little to matter."""

_SHARE = 0.8

# Bytes of memory per byte of a file that is not looked into: what most formats stay below.
_PER_BYTE = 14.0
_BYTES_PER_FACE = 24.0


@dataclass(frozen=True)
class Weights:
    """``large`` are the bytes foreseen for each large file, ``light`` for any other, and
    ``budget`` is what all files in hand may take together (None: nobody knows)."""

    large: Mapping[int, int]
    light: int
    budget: int | None


def weighed(tasks: Mapping[int, Task], settings: Settings, limits: Limits) -> Weights:
    """The weights of all tasks; 10,000 small files cost a question after the size of each."""
    large: dict[int, int] = {}
    largest_light = 0
    for index, task in tasks.items():
        try:
            # A store told the size when the object was found.
            size = task.input_mark.size if task.input_mark else os.stat(task.input).st_size
        except (OSError, ValueError):
            # It is gone; whoever reads it will know.
            continue
        if size < LARGE_BYTES:
            largest_light = max(largest_light, size)
        else:
            large[index] = _held_to(limits, forecast(task, settings).memory_bytes or 0)
    per_byte = _PER_BYTE + method_bytes_per_face(settings) / _BYTES_PER_FACE
    light = _held_to(limits, least_memory_bytes() + int(per_byte * largest_light))
    available = available_bytes()
    return Weights(large, light, None if available is None else int(_SHARE * available))


def _held_to(limits: Limits, n_bytes: int) -> int:
    """No worker takes more than its limit."""
    return n_bytes if limits.memory_bytes is None else min(n_bytes, limits.memory_bytes)
