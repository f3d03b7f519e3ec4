"""What GLB and .gltf have in common: positions and normals replaced in binary data, and bounds in a
description.

All else is kept: materials, textures, animations, extras, the order of everything.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints
from msal_cli.codecs.frames import PLACEMENT, moved_by
from msal_cli.codecs.gltf_document import Accessor, Document, Part
from msal_cli.codecs.gltf_frames import is_sole_part_placed
from msal_cli.codecs.slots import as_float32
from msal_cli.errors import InternalError, UnsupportedError
from msal_cli.storage.buffers import Buffer


@dataclass(eq=False)
class SceneFile:
    """An opened scene; see ``codecs.mesh_file.MeshFile``.

    GLB and .gltf differ in where its bytes lie.

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
    references: tuple[str, ...] = field(init=False)
    format: str = ""
    encoding: str = "binary_little_endian"
    precision: str = "float32"
    merged_vertices: int = 0

    def __post_init__(self) -> None:
        self.vertices = np.concatenate(
            [
                moved_by(frame, part.positions.values(self.document.data))
                for part, frame in zip(self.parts, self.frames, strict=True)
            ]
        )
        self.faces = np.concatenate(
            [part.faces + first.start for part, first in zip(self.parts, self._rows(), strict=True)]
        ).astype(np.int32)
        self.n_polygons = len(self.faces)
        own = (PLACEMENT,) if is_sole_part_placed(self.document, self.parts) else ()
        self.properties = self.document.properties(self.parts) + own
        self.references = self.document.references()

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

    def patched(self, vertices: Floats) -> bytearray:
        """The document's data with other positions (n, 3), and the normals of what moved.

        Raises
        ------
        ContentError
            with code ``E_RANGE`` if a position does not fit into float32.
        """
        output = bytearray(self.document.data)
        for part, stored in zip(self.parts, self._positions(vertices), strict=True):
            part.positions.store(output, stored)
        for normals, stored in self._normals(vertices):
            normals.store(output, stored)
        return output

    def _positions(self, vertices: Floats) -> Iterator[NDArray[np.float32]]:
        """What each part is to store: unmoved vertices exactly what they have."""
        for part, frame, rows in zip(self.parts, self.frames, self._rows(), strict=True):
            back = np.linalg.inv(frame).astype(np.float64)
            own = moved_by(back, vertices[rows])
            moved = (vertices[rows] != self.vertices[rows]).any(axis=1)
            stored = part.positions.stored(self.document.data)
            # Only rows that moved are rounded: the others would change in the last bit.
            result = stored.copy()
            result[moved] = as_float32(own[moved], rows.start)
            yield result

    def _normals(self, vertices: Floats) -> Iterator[tuple[Accessor, NDArray[np.float32]]]:
        """The normals to store, part by part, those of faces that did not move as they are."""
        from msal_cli.kernels.geometry import regrouped_normals

        for part, frame, rows in zip(self.parts, self.frames, self._rows(), strict=True):
            if part.normals is None:
                continue
            linear = frame[:3, :3]
            stored = part.normals.stored(self.document.data)
            faces = part.faces.astype(np.int32)
            # A stored normal may be anything.
            with np.errstate(over="ignore", invalid="ignore"):
                old = stored.astype(np.float64) @ np.linalg.inv(linear)
                normals, changed = regrouped_normals(
                    self.vertices[rows], vertices[rows], faces, faces, old
                )
                own = normals @ linear
                length = np.sqrt((own * own).sum(axis=1, keepdims=True))
                own = np.divide(own, length, out=np.zeros_like(own), where=length > 0.0)
                new = own.astype(np.float32)
            yield part.normals, np.where(changed[:, None], new, stored)

    def check_data(self, output: Buffer, shift: int, vertices: Floats) -> list[Accessor]:
        """Raise InternalError unless ``output``, whose rows lie ``shift`` bytes further on, is the
        document's data with only ``vertices`` replaced; returns the accessors of its positions."""
        begin = self.document.binary_at
        restored = bytearray(memoryview(output).cast("B")[begin + shift :])
        rest = bytearray(memoryview(self.document.data).cast("B")[begin:])
        new = [part.positions.shifted(shift) for part in self.parts]
        for accessor, rows in zip(new, self._positions(vertices), strict=True):
            if accessor.stored(output).tobytes() != rows.tobytes():
                raise InternalError("a position of a scene was not written right")
        for part in self.parts:
            for own in (part.positions, part.normals):
                if own is not None:
                    place = own.shifted(-begin)
                    place.store(restored, own.stored(self.document.data))
        if restored != rest:
            raise InternalError("data other than positions and normals changed in a scene")
        for accessor, rows in self._normals(vertices):
            if accessor.shifted(shift).stored(output).tobytes() != rows.tobytes():
                raise InternalError("a normal of a scene was not written right")
        return new

    def check_description(self, text: str, output: Buffer, accessors: list[Accessor]) -> None:
        """Raise InternalError unless ``text``, spaces at its end aside, is the description with the
        bounds that these accessors have in ``output``."""
        expected = self.document.bounded_content(output, accessors)
        # As text, because a number that is none, which Python reads, is not equal to itself.
        content = json.loads(text.removeprefix("\ufeff"))
        is_right = json.dumps(content) == json.dumps(expected)
        wanted = self.document.bounded(output, accessors)
        if not is_right or text.rstrip(" ") != wanted.rstrip(" "):
            raise InternalError("the description of a scene is not what it should be")

    def require_encoding(self, encoding: str, precision: str) -> None:
        """Raise UnsupportedError for another encoding or precision than the one that there is."""
        name = self.format.upper()
        if encoding == "ascii":
            raise UnsupportedError(f"{name} has no ascii encoding", hint="leave --encoding away")
        if precision == "float64":
            raise UnsupportedError(f"{name} has no float64", hint="use --to ply")
