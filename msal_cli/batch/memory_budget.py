"""How much memory the files of a run will need, and how much there is for them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass

from msal_cli.job.records import Failure
from msal_cli.job.settings import (
    FORECAST,
    Limits,
    Settings,
    Task,
    forecast,
    least_memory_bytes,
    method_bytes_per_face,
)
from msal_cli.machine import available_bytes, megabytes

LARGE_BYTES = 4 << 20
"""Files from this size on are looked into and go first; the rest differ too little to matter."""

_SHARE = 0.8

# Bytes of memory per byte of a file that is not looked into: what most formats stay below.
_PER_BYTE = 14.0
_BYTES_PER_FACE = 24.0

_GUESSED = 2
"""By what factor a forecast without counts may be too high."""

_COUNTED = ("ply", "stl", "glb")
"""Formats whose headers have counts, or are damaged, which the reader will report."""


@dataclass(frozen=True)
class MemoryBudget:
    """What the files of a run need, and what there is.

    Attributes
    ----------
    large : bytes expected for each large file.
    light : ... for any other.
    least : ... for each large file for which so much is certain.
    available : bytes that this process may take now; None where that is not known.
    limit : bytes that one file may take, which replaces what is available; None for none.
    """

    large: Mapping[int, int]
    light: int
    least: Mapping[int, int]
    available: int | None
    limit: int | None

    @property
    def total(self) -> int | None:
        """What all current files together may need; None where that is not known."""
        return None if self.available is None else int(_SHARE * self.available)

    def find_oversized(self) -> dict[int, Failure]:
        """Why a file is not loaded, for each that needs more memory than there is.

        A limit set by the user is held by the worker, see ``settings.refuse_oversized``.
        """
        if self.available is None or self.limit is not None:
            return {}
        return {
            index: Failure(
                "E_MEMORY",
                f"denoising this file takes {megabytes(least)}, and this machine has "
                f"{megabytes(self.available, rounded_up=False)} left",
                "use a machine with more memory, or cut the mesh into parts; a --memory-limit "
                "of as much tries it all the same",
                FORECAST,
            )
            for index, least in self.least.items()
            if least > self.available
        }


def estimate_memory(tasks: Mapping[int, Task], settings: Settings, limits: Limits) -> MemoryBudget:
    """The needs of all tasks; for 10,000 small files that costs one stat each."""

    def limited(n_bytes: int) -> int:
        return n_bytes if limits.memory_bytes is None else min(n_bytes, limits.memory_bytes)

    large: dict[int, int] = {}
    least: dict[int, int] = {}
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
            expected = forecast(task, settings)
            needed = expected.memory_bytes or 0
            large[index] = limited(needed)
            if expected.faces is not None:
                least[index] = needed
            elif expected.format not in _COUNTED:
                least[index] = needed // _GUESSED
    light = limited(least_memory_bytes() + int(per_byte * largest_light))
    return MemoryBudget(large, light, least, available_bytes(), limits.memory_bytes)
