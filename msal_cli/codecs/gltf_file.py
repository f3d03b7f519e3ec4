"""What GLB and .gltf have in common: positions and normals replaced in binary data, and bounds in a
description.

All else is kept: materials, textures, animations, extras, the order of everything.
"""

from __future__ import annotations

import json

import numpy as np

from msal_cli.arrays import Flags, Floats
from msal_cli.codecs.frames import PLACEMENT, is_placed, is_usable
from msal_cli.codecs.gltf_json import find_entries, replace_spans, write_bound
from msal_cli.codecs.gltf_scene import Part, Scene
from msal_cli.codecs.layout import Layout, require_finite
from msal_cli.codecs.slot_file import Change, SlotFile
from msal_cli.errors import InternalError, MsalError
from msal_cli.kernels.text import as_bytes
from msal_cli.storage.buffers import Buffer


class SceneFile(SlotFile):
    """An opened scene; see ``codecs.mesh_file.MeshFile``.

    ``vertices`` are those of every part, one behind the other.  With several parts they are in the
    frame of the scene, since two parts may coincide in their own; with one part, in its own.

    Its numbers lie in ``scene.data``; those who inherit put that into a file.
    """

    format = ""

    def __init__(self, data: Buffer, text: bytes, scene: Scene) -> None:
        self.data = data
        self.scene = scene
        self.text = text.decode("latin-1")
        parts, warnings = scene.parts()
        self._parts = parts
        super().__init__(scene.data.data, self.format, lambda _: _layout(scene, parts, warnings))

    @property
    def parts(self) -> tuple[Part, ...]:
        """The surfaces, in the order of their vertices."""
        return tuple(self._parts)

    def replaced(self, vertices: Floats) -> Buffer:
        """The file with other positions (n, 3), and the normals of what moved recomputed.

        Raises
        ------
        ContentError
            with code ``E_RANGE`` if a position does not fit into float32.
        """
        if np.array_equal(vertices, self.vertices):
            return self.data
        return self._pack(self.replace_data(vertices))

    def replace_data(self, vertices: Floats) -> memoryview:
        """The data of the scene with other positions (n, 3)."""
        return memoryview(super().replaced(vertices))

    def check(self, output: Buffer, vertices: Floats) -> None:
        """Raise InternalError unless ``output`` is this file with only ``vertices`` replaced."""
        try:
            text, data = self._unpack(output, vertices)
            content = json.loads(text.decode().removeprefix("\ufeff"))
        except (MsalError, ValueError) as failure:
            raise InternalError(
                f"the {self.format} file that was made cannot be read: {failure}"
            ) from None
        super().check(data, vertices)
        expected = json.loads(json.dumps(self.scene.content))
        for part in self._parts:
            bounds = part.bounds(as_bytes(data))
            for entry in (expected["accessors"][index] for index in part.accessors):
                for word, new in bounds.items():
                    if word in entry:
                        entry[word] = json.loads(write_bound(json.dumps(entry[word]), new))
        # As text, because a number that is none, which Python reads, is not equal to itself.
        is_right = json.dumps(content) == json.dumps(expected)
        if not is_right or text.rstrip(b" ") != self.text_of(data).rstrip(b" "):
            raise InternalError("the description of a scene is not what it should be")

    def _changes(self, vertices: Floats) -> list[Change]:
        """The arrays that change.

        Raises ContentError (``E_RANGE``), also when checked, where positions of the first part that
        moved cannot be stored.
        """
        changes = super()._changes(vertices)
        self._require_ranges(changes[:1])
        return changes

    def text_of(self, data: Buffer) -> bytes:
        """The description with the bounds that positions have in ``data``."""
        spans = find_entries(self.text, "accessors")
        edits = []
        for part in self._parts:
            bounds = part.bounds(as_bytes(data))
            for own in (spans[index] for index in part.accessors):
                for word, new in bounds.items():
                    if word in own:
                        start, stop = own[word]
                        edits.append((own[word], write_bound(self.text[start:stop], new)))
        return replace_spans(self.text, edits).encode("latin-1")

    def _pack(self, data: memoryview) -> Buffer:
        """The file with other data, and with a description that fits them."""
        raise NotImplementedError

    def _unpack(self, output: Buffer, vertices: Floats) -> tuple[bytes, Buffer]:
        """The description and the data of a file that was made."""
        raise NotImplementedError


def _layout(scene: Scene, parts: list[Part], warnings: tuple[str, ...]) -> Layout:
    properties = scene.properties()
    frames = scene.frames(parts)
    if len(parts) > 1:
        properties = (f"{len(parts)} parts", *properties)
    elif is_placed(frames[0]):
        properties = (*properties, PLACEMENT)
    is_framed = len(parts) > 1 and all(map(is_usable, frames))
    if not is_framed:
        frames = [np.eye(4) for _ in parts]
    positions = tuple(part.positions.slots(scene.data) for part in parts)
    for part, slots in zip(parts, positions, strict=True):
        require_finite(slots.values, f"accessor {part.positions.index}, vertex {{}}".format)
    starts = np.cumsum([0, *(slots.count for slots in positions)])
    faces = np.concatenate(
        [part.faces + first for part, first in zip(parts, starts.tolist(), strict=False)]
    ).astype(np.int32)
    normals = [
        (part, part.normals.slots(scene.data), frame, int(first))
        for part, frame, first in zip(parts, frames, starts, strict=False)
        if part.normals is not None
    ]
    return Layout(
        "binary_little_endian",
        "float32" if any(part.positions.code == "<f4" for part in parts) else "integer",
        positions,
        normals=tuple(slots for _, slots, _, _ in normals),
        renew_normals=lambda old, new: [
            _renew_normals(part, slots.values, frame[:3, :3], old[first:], new[first:])
            for part, slots, frame, first in normals
        ],
        frames=tuple(frames) if is_framed else (),
        properties=properties,
        warnings=warnings,
        references=scene.references(),
        faces=faces,
    )


def _renew_normals(
    part: Part, stored: Floats, linear: Floats, old: Floats, new: Floats
) -> tuple[Floats, Flags]:
    """The normals (n, 3) of a part, which ``linear`` (3, 3) takes into the scene, and which of them
    changed; ``old`` and ``new`` begin with its vertices."""
    from msal_cli.kernels.geometry import regrouped_normals

    count = len(stored)
    faces = part.faces.astype(np.int32)
    # A stored normal may be anything.
    with np.errstate(over="ignore", invalid="ignore"):
        normals, is_changed = regrouped_normals(
            old[:count], new[:count], faces, faces, stored @ np.linalg.inv(linear)
        )
        normals = normals @ linear
        length = np.sqrt((normals * normals).sum(axis=1, keepdims=True))
        normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0.0)
    return normals, is_changed
