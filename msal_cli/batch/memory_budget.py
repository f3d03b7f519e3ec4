"""How much memory the files of a run will need, and how much there is for them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass

from msal_cli.job.room import LARGE_BYTES
from msal_cli.job.settings import (
    Limits,
    Settings,
    Task,
    forecast,
    least_memory_bytes,
    method_bytes_per_face,
)
from msal_cli.machine import available_bytes

_SHARE = 0.8

# Bytes of memory per byte of a file that is not looked into: what most formats stay below.
_PER_BYTE = 14.0
_BYTES_PER_FACE = 24.0


@dataclass(frozen=True)
class MemoryBudget:
    """What the files of a run need, and what there is.

    Attributes
    ----------
    large : bytes expected for each large file.
    light : ... for any other.
    available : bytes that this process may take now; None where that is not known.
    """

    large: Mapping[int, int]
    light: int
    available: int | None

    @property
    def total(self) -> int | None:
        """What all current files together may need; None where that is not known."""
        return None if self.available is None else int(_SHARE * self.available)


def estimate_memory(tasks: Mapping[int, Task], settings: Settings, limits: Limits) -> MemoryBudget:
    """The needs of all tasks; for 10,000 small files that costs one stat each."""

    def limited(n_bytes: int) -> int:
        return n_bytes if limits.memory_bytes is None else min(n_bytes, limits.memory_bytes)

    large: dict[int, int] = {}
    largest_light = 0
    per_byte = _PER_BYTE + method_bytes_per_face(settings) / _BYTES_PER_FACE
    for index, task in tasks.items():
        try:
            # A listing of a store includes sizes.
            size = task.input_mark.size if task.input_mark else os.stat(task.input).st_size
        except (OSError, ValueError):
            # It is gone; the reader will report that.
            continue
        if size < LARGE_BYTES:
            largest_light = max(largest_light, size)
        else:
            large[index] = limited(forecast(task, settings).memory_bytes or 0)
    light = limited(least_memory_bytes() + int(per_byte * largest_light))
    return MemoryBudget(large, light, available_bytes())
