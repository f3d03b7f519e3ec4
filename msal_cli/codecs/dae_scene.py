"""Where the scene of a COLLADA file places its meshes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from msal_cli.arrays import Floats
from msal_cli.codecs.tokens import Words
from msal_cli.codecs.xml_offsets import Element
from msal_cli.errors import EXPORT_AGAIN, FormatError
from msal_cli.storage.buffers import Buffer

_SIZES = {"matrix": 16, "translate": 3, "rotate": 4, "scale": 3}


def frames_of(data: Buffer, root: Element, names: Sequence[str]) -> list[Floats]:
    """For each mesh the transform (4, 4) of its first place in the scene.

    The identity stands for a mesh that no scene places, and for a place that flattens it.
    """
    nodes: dict[str, Element] = {}
    skins: dict[str, str] = {}
    for one in root.inner():
        if one.name == "node":
            nodes.setdefault(one.attributes.get("id", ""), one)
        elif one.name == "controller" and (skin := one.find("skin")) is not None:
            skins[one.attributes.get("id", "")] = skin.attributes.get("source", "")[1:]
    places: dict[str, Floats] = {}
    library = root.find("library_visual_scenes")
    left = [
        (node, np.eye(4), 0)
        for scene in (library.all("visual_scene") if library is not None else ())
        for node in scene.all("node")
    ][::-1]
    # What a node holds has its first place where the node itself has: it is not visited again, and
    # nodes that name one another come to an end.
    visited: set[int] = set()
    while left:
        node, outer, depth = left.pop()
        if node.start in visited:
            continue
        visited.add(node.start)
        frame = outer @ _transform(data, node)
        inner = []
        for one in node.children:
            target = one.attributes.get("url", "").removeprefix("#")
            if one.name == "instance_geometry":
                places.setdefault(target, frame)
            elif one.name == "instance_controller":
                places.setdefault(skins.get(target, ""), frame)
            elif depth < 100 and one.name == "node":
                inner.append((one, frame, depth + 1))
            elif depth < 100 and one.name == "instance_node" and target in nodes:
                inner.append((nodes[target], frame, depth + 1))
        left += inner[::-1]
    return [_usable(places.get(name, np.eye(4))) for name in names]


def _usable(frame: Floats) -> Floats:
    if not np.isfinite(frame).all() or np.linalg.cond(frame[:3, :3]) > 1e6:
        return np.eye(4)
    return frame


def _transform(data: Buffer, node: Element) -> Floats:
    """The transform (4, 4) of a node, its steps from the first to the last."""
    frame = np.eye(4)
    for one in node.children:
        if one.name not in _SIZES:
            continue
        words = Words(data, one.inside, one.stop)
        if len(words) != _SIZES[one.name]:
            raise FormatError(
                f"a {one.name} has not {_SIZES[one.name]} numbers",
                where=f"byte {one.start}",
                hint=EXPORT_AGAIN,
            )
        values = words.floats()
        step = np.eye(4)
        if one.name == "matrix":
            step = values.reshape(4, 4)
        elif one.name == "translate":
            step[:3, 3] = values
        elif one.name == "scale":
            step[:3, :3] = np.diag(values)
        else:
            step[:3, :3] = _rotation(values[:3], math.radians(values[3]))
        frame = frame @ step
    return frame


def _rotation(axis: Floats, angle: float) -> Floats:
    """The rotation (3, 3) about an axis of any length (Rodrigues)."""
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        return np.eye(3)
    x, y, z = axis / length
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    result: Floats = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return result
