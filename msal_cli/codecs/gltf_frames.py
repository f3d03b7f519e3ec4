"""Where the nodes of a glTF scene put its meshes."""

from __future__ import annotations

from typing import Any

import numpy as np

from msal_cli.arrays import Floats
from msal_cli.codecs.frames import can_be_undone, is_placed
from msal_cli.codecs.gltf_document import Document, Part, as_list
from msal_cli.errors import FormatError

_DEEPEST = 200


def placed(document: Document, parts: list[Part]) -> list[Floats]:
    """The frame (4, 4) of each part in the scene, by the first node that shows its mesh.

    Identities if there is one part, or if a frame cannot be undone or understood: then all parts
    stay in their own.
    """
    own = [np.eye(4) for _ in parts]
    if len(parts) == 1:
        return own
    frames = _frames(document, parts)
    try:
        with np.errstate(all="ignore"):
            return frames if all(map(can_be_undone, frames)) else own
    except np.linalg.LinAlgError:
        return own


def is_sole_part_placed(document: Document, parts: list[Part]) -> bool:
    """Whether there is one part only, and a node turns, scales or shifts it."""
    return len(parts) == 1 and is_placed(_frames(document, parts)[0])


def _frames(document: Document, parts: list[Part]) -> list[Floats]:
    """The frame of each part, whatever it does; identities if one is not understood."""
    count = len(as_list(document.content.get("nodes")))
    above: dict[int, int] = {}
    shows: dict[int, int] = {}
    try:
        for number in range(count):
            node = document.entry("nodes", number)
            for child in node.get("children", []):
                above.setdefault(int(child), number)
            if isinstance(node.get("mesh"), int):
                shows.setdefault(node["mesh"], number)
        with np.errstate(all="ignore"):
            known: dict[int, Floats] = {}
            return [_frame(document, above, known, shows.get(part.mesh)) for part in parts]
    except (TypeError, ValueError, OverflowError, FormatError):
        return [np.eye(4) for _ in parts]


def _frame(
    document: Document, above: dict[int, int], known: dict[int, Floats], node: int | None
) -> Floats:
    """The product of a node's transform and those above it; ``known`` remembers them."""
    path: list[int] = []
    while node is not None and node not in known and len(path) < _DEEPEST:
        path.append(node)
        node = above.get(node)
    frame = np.eye(4) if node is None else known.get(node, np.eye(4))
    for node in reversed(path):
        frame = frame @ _transform(document.entry("nodes", node))
        known[node] = frame
    return frame


def _transform(node: dict[str, Any]) -> Floats:
    """A node's own transform (4, 4): a matrix by columns, or translation, rotation and scale."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    frame = np.eye(4)
    x, y, z, w = np.array(node.get("rotation", (0, 0, 0, 1)), dtype=np.float64)
    frame[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    frame[:3, :3] *= np.array(node.get("scale", (1, 1, 1)), dtype=np.float64)
    frame[:3, 3] = node.get("translation", (0, 0, 0))
    return frame
