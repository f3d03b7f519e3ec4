"""What GLB and .gltf have in common: positions and normals replaced in binary data, and bounds in a
description.

All else is kept: materials, textures, animations, extras, the order of everything.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np

from msal_cli.arrays import Bytes, Floats, Ints
from msal_cli.codecs.frames import PLACEMENT, is_placed, moved_by
from msal_cli.codecs.gltf_json import find_entries, replace_spans, write_bound
from msal_cli.codecs.gltf_scene import Accessor, Scene, are_usable
from msal_cli.codecs.mesh_file import Buffer
from msal_cli.codecs.record_slots import Overwrite, Strided, check_overwritten, overwrite
from msal_cli.codecs.slots import require_range
from msal_cli.errors import ContentError, InternalError, UnsupportedError


class SceneFile:
    """An opened scene; see ``codecs.mesh_file.MeshFile``.

    ``vertices`` are those of every part, one behind the other.  With several parts they are in the
    frame of the scene, since two parts may coincide in their own; with one part, in its own.
    """

    format = ""
    encoding = "binary_little_endian"
    precision = "float32"
    merged_vertices = 0

    def __init__(self, data: Buffer, scene: Scene, text: bytes) -> None:
        self.data = data
        self.scene = scene
        self.text = text.decode("latin-1")
        self.parts, self.warnings = scene.parts()
        self._frames = scene.frames(self.parts)
        words = scene.properties()
        if len(self.parts) > 1:
            words = (f"{len(self.parts)} parts", *words)
        elif is_placed(self._frames[0]):
            words = (*words, PLACEMENT)
        if len(self.parts) == 1 or not are_usable(self._frames):
            self._frames = [np.eye(4) for _ in self.parts]
        self.properties, self.references = words, scene.references()
        self._positions = [_slots(scene.data, part.positions) for part in self.parts]
        self._ends = np.cumsum([0, *(slots.count for slots in self._positions)])
        self.vertices = np.concatenate(
            [
                moved_by(frame, _require_finite(slots.values, part.positions))
                for part, slots, frame in zip(
                    self.parts, self._positions, self._frames, strict=True
                )
            ]
        )
        pairs = zip(self.parts, self._ends.tolist(), strict=False)
        self.faces = np.concatenate([part.faces + first for part, first in pairs]).astype(np.int32)
        self.n_polygons = len(self.faces)

    def polygons(self) -> Ints:
        """The triangles (m, 3)."""
        return self.faces

    def forget_vertices(self) -> None:
        """Do nothing: to read them again takes long."""

    def _changes(self, vertices: Floats) -> Iterator[Overwrite]:
        """The new positions and normals of each part: of rows that moved, in its own frame."""
        from msal_cli.kernels.geometry import regrouped_normals

        for k, (part, slots) in enumerate(zip(self.parts, self._positions, strict=True)):
            rows, frame = slice(self._ends[k], self._ends[k + 1]), self._frames[k]
            old, new = self.vertices[rows], vertices[rows]
            is_moved = np.repeat((new != old).any(axis=1)[:, None], 3, axis=1)
            positions = moved_by(np.linalg.inv(frame).astype(np.float64), new)
            require_range(positions, is_moved, slots.codes)
            yield Overwrite(slots, positions, is_moved)
            if part.normals is None:
                continue
            linear = frame[:3, :3]
            faces = part.faces.astype(np.int32)
            slots = _slots(self.scene.data, part.normals)
            # A stored normal may be anything.
            with np.errstate(over="ignore", invalid="ignore"):
                stored = slots.values @ np.linalg.inv(linear)
                normals, is_changed = regrouped_normals(old, new, faces, faces, stored)
                normals = normals @ linear
                length = np.sqrt((normals * normals).sum(axis=1, keepdims=True))
                normals = np.divide(
                    normals, length, out=np.zeros_like(normals), where=length > 0.0
                )
            yield Overwrite(slots, normals, np.repeat(is_changed[:, None], 3, axis=1))

    def replace_data(self, vertices: Floats) -> memoryview:
        """The data of the scene with other positions (n, 3), and the normals of what moved.

        Raises
        ------
        ContentError
            with code ``E_RANGE`` if a position does not fit into float32.
        """
        return overwrite(self.scene.data, list(self._changes(vertices)))

    def check_data(self, data: Bytes, text: str, vertices: Floats) -> None:
        """Raise InternalError unless ``data`` and ``text`` are those of the scene with only
        ``vertices`` replaced, normals, and bounds in the text."""
        check_overwritten(self.scene.data, data, list(self._changes(vertices)))
        expected = json.loads(json.dumps(self.scene.content))
        for part in self.parts:
            entry = expected["accessors"][part.positions.index]
            for word, new in _bounds(data, part.positions).items():
                if word in entry:
                    entry[word] = json.loads(write_bound(json.dumps(entry[word]), new))
        # As text, because a number that is none, which Python reads, is not equal to itself.
        content = json.loads(text.encode("latin-1").decode().removeprefix("\ufeff"))
        is_right = json.dumps(content) == json.dumps(expected)
        if not is_right or text.rstrip(" ") != self.text_of(data).rstrip(" "):
            raise InternalError("the description of a scene is not what it should be")

    def text_of(self, data: Bytes) -> str:
        """The description with the bounds that positions have in ``data``."""
        spans = find_entries(self.text, "accessors")
        edits = []
        for part in self.parts:
            own = spans[part.positions.index]
            for word, new in _bounds(data, part.positions).items():
                if word in own:
                    start, stop = own[word]
                    edits.append((own[word], write_bound(self.text[start:stop], new)))
        return replace_spans(self.text, edits)

    def require_encoding(self, encoding: str, precision: str) -> None:
        """Raise UnsupportedError for another encoding or precision than the one that there is."""
        name = self.format.upper()
        if encoding == "ascii":
            raise UnsupportedError(f"{name} has no ascii encoding", hint="leave --encoding away")
        if precision == "float64":
            raise UnsupportedError(f"{name} has no float64", hint="use --to ply")


def _slots(data: Bytes, accessor: Accessor) -> Strided:
    return Strided(
        data, accessor.at, accessor.count, accessor.stride, (0, 4, 8), ("<f4",) * 3, whole_rows=True
    )


def _bounds(data: Bytes, accessor: Accessor) -> dict[str, list[float]]:
    """The least and the largest of each coordinate."""
    rows = accessor.rows(data)
    return {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}


def _require_finite(values: Floats, accessor: Accessor) -> Floats:
    is_finite = np.isfinite(values).all(axis=1)
    if not is_finite.all():
        raise ContentError(
            "a position is not finite",
            code="E_NONFINITE",
            where=f"accessor {accessor.index}, vertex {int(np.argmin(is_finite))}",
            hint="remove the vertex, or export the mesh again",
        )
    return values
