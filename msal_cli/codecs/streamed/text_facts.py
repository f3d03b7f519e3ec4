"""What is known of a text mesh once it is converted: its numbers lie in files of a folder."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from msal_cli.arrays import Bytes, Floats
from msal_cli.codecs.decimals import decimals_for, usual_of_counts
from msal_cli.storage.atomic import write_whole

VERTICES, NORMALS, TRIANGLES = "vertices.f8", "normals.f8", "triangles.u4"
"""Positions (n, 3) and normals of vertices (n, 3) as float64, triangles (m, 3) as uint32."""

_FACTS = "facts.json"


@dataclass(frozen=True)
class ArrayFacts:
    """How new numbers of an array are written.

    Attributes
    ----------
    decimals : those of ``codecs.decimals.uniform_decimals``, for the whole file.
    is_statements : the numbers are ``codecs.text_slots.Statements``, none of them whole numbers.
    whole_rows : see ``codecs.slots.Slots``.
    """

    decimals: int
    is_statements: bool
    whole_rows: bool


@dataclass(frozen=True)
class TextFacts:
    """A converted text.

    Attributes
    ----------
    source : name, size and time of the file that was converted.
    text : path of the text: that of the file, or of what a compressed one expands to.
    blocks : first byte of a part of the text with vertices or normals, the one behind its last,
        number of its first vertex, how many vertices it has, and the same for normals; ascending.
    face_marks : number of a polygon, and of its first triangle, here and there; ascending.
    positions, normals : how they are written; the latter None where no vertex has a normal.
    n_turns : changes between positions and normals on the way through the file.
    details : what else the format needs.
    """

    source: list[Any]
    text: str
    format: str
    size: int
    n_vertices: int
    n_polygons: int
    n_triangles: int
    properties: Sequence[str]
    references: Sequence[str]
    warnings: Sequence[str]
    blocks: list[list[int]]
    face_marks: list[list[int]]
    positions: ArrayFacts
    normals: ArrayFacts | None
    n_turns: int
    details: dict[str, Any] = field(default_factory=dict)

    def save(self, folder: Path) -> None:
        """Write it into a folder whose arrays are complete."""
        write_whole(folder / _FACTS, json.dumps(asdict(self)).encode())

    @staticmethod
    def load(folder: Path, path: str) -> TextFacts | None:
        """What a folder has of the file ``path`` as it is now; None if nothing."""
        try:
            values = json.loads((folder / _FACTS).read_bytes())
        except (FileNotFoundError, NotADirectoryError):
            return None
        if values["source"] != identify(path):
            return None
        normals = values.pop("normals")
        return TextFacts(
            **values | {"positions": ArrayFacts(**values["positions"])},
            normals=ArrayFacts(**normals) if normals is not None else None,
        )


def identify(path: str) -> list[Any]:
    """What changes when a file does."""
    stat = os.stat(path)
    return [os.path.abspath(path), stat.st_size, stat.st_mtime_ns]


class DecimalCounts:
    """How often each number of decimals occurs in an array, and the extremes of its numbers."""

    def __init__(self) -> None:
        self.counts = np.zeros(256, dtype=np.int64)
        self.low, self.high = np.full(3, np.inf), np.full(3, -np.inf)

    def add(self, used: Bytes, values: Floats) -> None:
        """Some more numbers (n, 3), and decimals of rows or of numbers."""
        self.add_decimals(used)
        if len(values):
            self.low = np.minimum(self.low, values.min(axis=0))
            self.high = np.maximum(self.high, values.max(axis=0))

    def add_decimals(self, used: Bytes) -> None:
        """The decimals alone."""
        self.counts += np.bincount(used, minlength=256)

    @property
    def extremes(self) -> Floats:
        """The lowest and the highest corner (2, 3) of the numbers' box."""
        return np.stack([self.low, self.high])

    def choose(self, *, unit_length: bool, significant: int) -> int:
        """See ``codecs.decimals.uniform_decimals``."""
        usual = usual_of_counts(self.counts)
        return decimals_for(usual, self.extremes, unit_length=unit_length, significant=significant)


class ArrayFiles:
    """Files of arrays that are written from their beginning, some rows at a time."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._files: dict[str, BinaryIO] = {}
        self._open = contextlib.ExitStack()

    def __enter__(self) -> ArrayFiles:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def append(self, name: str, values: np.ndarray[Any, Any]) -> None:
        """Write some more rows; a file of that name is replaced by the first ones."""
        if name not in self._files:
            self._files[name] = self._open.enter_context((self.folder / name).open("wb"))
        self._files[name].write(np.ascontiguousarray(values).data)
