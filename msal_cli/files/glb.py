"""Binary glTF (GLB): positions and normals replaced inside its binary chunk.

All else is kept: materials, textures, animations, extras, the order of everything.  Of the JSON
only the bounds change that the format demands of positions.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from msal_cli.dataclass import dataclass
from msal_cli.errors import InternalError, MsalError, UnsupportedError
from msal_cli.files.base import Buffer
from msal_cli.files.glb_scene import Accessor, Document, Part, parsed, placed
from msal_cli.files.stl import as_float32

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

_IDENTITY = np.eye(4)


def read(data: Buffer, name: str) -> GlbFile:
    """Read the surfaces of a GLB file.

    Raises
    ------
    FormatError, TruncatedError
        if the file is not what its format says.
    UnsupportedError
        for compressed or quantised positions, version 1, and data in other files.
    ContentError
        ``E_NO_FACES``, ``E_INDEX`` or ``E_NONFINITE``.
    """
    document = parsed(data)
    parts, warnings = document.parts()
    frames = placed(document, parts)
    return GlbFile(data, document, parts, frames, warnings)


@dataclass(eq=False)
class GlbFile:
    """An opened GLB file; see ``files.base.MeshFile``.

    ``vertices`` are those of every part, one behind the other.  With several parts they stand in
    the frame of the scene, since two parts may coincide in their own; with one part, in its own.
    """

    data: Buffer = field(repr=False)
    document: Document = field(repr=False)
    parts: list[Part] = field(repr=False)
    frames: list[Floats] = field(repr=False)
    warnings: tuple[str, ...]
    vertices: Floats = field(init=False)
    faces: Ints = field(init=False)
    n_polygons: int = field(init=False)
    properties: tuple[str, ...] = field(init=False)
    format: str = "glb"
    encoding: str = "binary_little_endian"
    precision: str = "float32"
    references: tuple[str, ...] = ()
    merged_vertices: int = 0

    def __post_init__(self) -> None:
        self.vertices = np.concatenate(
            [
                _moved_by(frame, part.positions.values(self.data))
                for part, frame in zip(self.parts, self.frames, strict=True)
            ]
        )
        self.faces = np.concatenate(
            [part.faces + first.start for part, first in zip(self.parts, self._rows(), strict=True)]
        ).astype(np.int32)
        self.n_polygons = len(self.faces)
        self.properties = self.document.properties(self.parts)

    def _rows(self) -> Iterator[slice]:
        """The rows of ``vertices`` that belong to each part."""
        start = 0
        for part in self.parts:
            yield slice(start, start + part.positions.count)
            start += part.positions.count

    def polygons(self) -> Ints:
        """The triangles (m, 3)."""
        return self.faces

    def forget_vertices(self) -> None:
        """Do nothing: to read them again takes long."""

    def replaced(self, vertices: Floats) -> Buffer:
        """The file with other positions (n, 3), and the normals of what moved recomputed.

        Raises
        ------
        ContentError
            with code ``E_RANGE`` if a position does not fit into float32.
        """
        if not (vertices != self.vertices).any():
            return self.data
        output = bytearray(self.data)
        for part, stored in zip(self.parts, self._positions(vertices), strict=True):
            part.positions.store(output, stored)
        for normals, stored in self._normals(vertices):
            normals.store(output, stored)
        return self.document.with_bounds(output, [part.positions for part in self.parts])

    def _positions(self, vertices: Floats) -> Iterator[NDArray[np.float32]]:
        """What each part is to store: unmoved vertices exactly what they have."""
        for part, frame, rows in zip(self.parts, self.frames, self._rows(), strict=True):
            back = np.linalg.inv(frame).astype(np.float64)
            own = _moved_by(back, vertices[rows])
            moved = (vertices[rows] != self.vertices[rows]).any(axis=1)
            stored = part.positions.stored(self.data)
            # Only rows that moved are rounded: the others would change in the last bit.
            result = stored.copy()
            result[moved] = as_float32(own[moved], rows.start)
            yield result

    def _normals(self, vertices: Floats) -> Iterator[tuple[Accessor, NDArray[np.float32]]]:
        """The normals to store, part by part, those of faces that did not move as they are."""
        from msal_cli.core.geometry import regrouped_normals

        for part, frame, rows in zip(self.parts, self.frames, self._rows(), strict=True):
            if part.normals is None:
                continue
            linear = frame[:3, :3]
            stored = part.normals.stored(self.data)
            with np.errstate(invalid="ignore"):
                old = stored.astype(np.float64) @ np.linalg.inv(linear)
            faces = part.faces.astype(np.int32)
            normals, changed = regrouped_normals(
                self.vertices[rows], vertices[rows], faces, faces, old
            )
            own = normals @ linear
            length = np.sqrt((own * own).sum(axis=1, keepdims=True))
            own = np.divide(own, length, out=np.zeros_like(own), where=length > 0.0)
            yield part.normals, np.where(changed[:, None], own.astype(np.float32), stored)

    def check(self, output: Buffer, vertices: Floats) -> None:
        """Raise InternalError unless ``output`` is this file with only ``vertices`` replaced."""
        try:
            there = parsed(output)
        except MsalError as failure:
            raise InternalError(f"the GLB file that was made cannot be read: {failure}") from None
        shift = there.binary_at - self.document.binary_at
        restored = bytearray(memoryview(output).cast("B")[there.binary_at :])
        rest = bytearray(memoryview(self.data).cast("B")[self.document.binary_at :])
        new = [part.positions.shifted(shift) for part in self.parts]
        for accessor, rows in zip(new, self._positions(vertices), strict=True):
            if accessor.stored(output).tobytes() != rows.tobytes():
                raise InternalError("a position of a GLB file was not written right")
        for part in self.parts:
            for own in (part.positions, part.normals):
                if own is not None:
                    place = own.shifted(-self.document.binary_at)
                    place.store(restored, own.stored(self.data))
        if restored != rest:
            raise InternalError("data other than positions and normals changed in a GLB file")
        for accessor, rows in self._normals(vertices):
            if accessor.shifted(shift).stored(output).tobytes() != rows.tobytes():
                raise InternalError("a normal of a GLB file was not written right")
        expected = json.loads(json.dumps(self.document.content))
        for accessor in new:
            for word in self.document.bounds(accessor.index):
                expected["accessors"][accessor.index][word] = accessor.bound(output, word)
        if there.content != expected:
            raise InternalError("the description in a GLB file is not what it should be")

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        """The file with ``vertices`` (n, 3); GLB has one encoding and one precision.

        Raises
        ------
        UnsupportedError
            for another encoding or precision.
        """
        if encoding == "ascii":
            raise UnsupportedError("GLB has no ascii encoding", hint="leave --encoding away")
        if precision == "float64":
            raise UnsupportedError("GLB has no float64", hint="use --to ply")
        return self.replaced(vertices)


def _moved_by(frame: Floats, points: Floats) -> Floats:
    """Points (n, 3) after a transform (4, 4); bit for bit the same for the identity."""
    if np.array_equal(frame, _IDENTITY):
        return points
    result: Floats = points @ frame[:3, :3].T + frame[:3, 3]
    return result
