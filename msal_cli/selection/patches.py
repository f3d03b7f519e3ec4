"""A part of a large mesh that stands for the whole: some patches, spread over it evenly."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msal_cli.dataclass import dataclass
from msal_cli.mesh import Mesh, prepared

if TYPE_CHECKING:
    from msal_cli.core.connectivity import Connectivity

Flags = NDArray[np.bool_]
Ints = NDArray[np.int32]

PATCH = 2_500
"""Vertices of a patch, about: in smaller ones too much is near the cut."""

MARGIN = 2
"""Rings at the cut of a patch that are filtered with it, but not judged: what lies beyond is
missing there."""

CELLS = 1024
"""Steps along each axis of the order in which vertices are told apart by place."""


@dataclass(frozen=True, eq=False)
class Part:
    """What stands for a mesh.

    Attributes
    ----------
    mesh : the patches as one mesh, or the whole.
    judged : (m,) bool, vertices of it that count where results are compared.
    """

    mesh: Mesh
    judged: Flags


def representative(mesh: Mesh, most: int) -> Part:
    """Patches of about ``most`` vertices together; the whole mesh if it has hardly more.

    Vertices that the mesh holds are not judged.  The part itself neither holds nor trusts any.
    """
    links, n = mesh.links, len(mesh.vertices)
    judged = links.has_ring if mesh.held is None else links.has_ring & ~mesh.held
    if n <= most + most // 4:
        whole = mesh if mesh.held is None and mesh.trust is None else mesh.constrained(None, None)
        return Part(whole, judged)
    inside = np.zeros(n, dtype=np.bool_)
    count = max(most // PATCH, 1)
    for seed in _spread(mesh, count):
        _grow(int(seed), most // count, links, inside)
    faces = mesh.faces[inside[mesh.faces].all(axis=1)]
    used, corners = np.unique(faces, return_inverse=True)
    cut = inside & _next_to(~inside, links)
    for _ in range(MARGIN - 1):
        cut |= inside & _next_to(cut, links)
    part = prepared(mesh.vertices[used], corners.reshape(-1, 3).astype(np.int32))
    kept = judged[used] & ~cut[used]
    return Part(part.mesh, kept if kept.any() else judged[used])


def _spread(mesh: Mesh, count: int) -> Ints:
    """``count`` vertices at equal distances in an order in which neighbours in space are near."""
    low = mesh.vertices.min(axis=0)
    extent = max(float((mesh.vertices.max(axis=0) - low).max()), np.finfo(float).tiny)
    cell = np.minimum((mesh.vertices - low) * (CELLS / extent), CELLS - 1).astype(np.int64)
    key = np.zeros(len(cell), dtype=np.int64)
    for bit in range(CELLS.bit_length() - 1):
        for axis in range(3):
            key |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    order = np.argsort(key, kind="stable")
    order = order[mesh.links.has_ring[order]]
    places = ((np.arange(count) + 0.5) * len(order) / count).astype(np.int64)
    spread: Ints = order[places].astype(np.int32)
    return spread


def _grow(seed: int, size: int, links: Connectivity, inside: Flags) -> None:
    """Mark the ``size`` vertices nearest to ``seed`` along edges that are not marked yet."""
    if inside[seed]:
        return
    inside[seed] = True
    front = np.array([seed], dtype=np.int32)
    marked = 1
    while len(front) and marked < size:
        reached = np.unique(_rings_of(front, links))
        front = reached[~inside[reached]][: size - marked]
        inside[front] = True
        marked += len(front)


def _rings_of(vertices: Ints, links: Connectivity) -> Ints:
    """The neighbours of all ``vertices``, one ring after the other."""
    start, stop = links.ring_start[vertices], links.ring_start[vertices + 1]
    counts = (stop - start).astype(np.int64)
    ends = np.cumsum(counts)
    places = np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - counts - start, counts)
    neighbours: Ints = links.ring[places]
    return neighbours


def _next_to(flags: Flags, links: Connectivity) -> Flags:
    """Which vertices have a marked neighbour."""
    found = np.zeros_like(flags)
    found[_rings_of(np.flatnonzero(flags).astype(np.int32), links)] = True
    return found
