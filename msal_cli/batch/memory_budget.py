"""How much memory the files of a run will take, and how much there is for them."""

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
"""How many times too much may be foreseen where the counts are not told."""

_COUNTED = ("ply", "stl", "glb")
"""Formats whose files tell their counts, or are damaged, which the reader will say."""


@dataclass(frozen=True)
class Weights:
    """What the files of a run ask for, and what there is.

    Attributes
    ----------
    large : bytes foreseen for each large file.
    light : ... for any other.
    least : ... for each large file of which so much is certain.
    available : bytes that this process may take now; None where nobody tells.
    """

    large: Mapping[int, int]
    light: int
    least: Mapping[int, int]
    available: int | None

    @property
    def budget(self) -> int | None:
        """What all files in hand may take together; None where nobody tells."""
        return None if self.available is None else int(_SHARE * self.available)

    def beyond(self) -> dict[int, Failure]:
        """Why a file cannot be done here, for each that takes more than there is."""
        if self.available is None:
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


def weighed(tasks: Mapping[int, Task], settings: Settings, limits: Limits) -> Weights:
    """The weights of all tasks; 10,000 small files cost a question after the size of each."""
    large: dict[int, int] = {}
    least: dict[int, int] = {}
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
            told = forecast(task, settings)
            needed = told.memory_bytes or 0
            large[index] = _held_to(limits, needed)
            if told.faces is not None:
                least[index] = needed
            elif told.format not in _COUNTED:
                least[index] = needed // _GUESSED
    per_byte = _PER_BYTE + method_bytes_per_face(settings) / _BYTES_PER_FACE
    light = _held_to(limits, least_memory_bytes() + int(per_byte * largest_light))
    return Weights(large, light, least, available_bytes())


def _held_to(limits: Limits, n_bytes: int) -> int:
    """No worker takes more than its limit."""
    return n_bytes if limits.memory_bytes is None else min(n_bytes, limits.memory_bytes)
