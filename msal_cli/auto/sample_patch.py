"""The part of a mesh that candidates run on, and the kind of its surface."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Flags, Floats
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.faces import face_rings
from msal_cli.kernels.geometry import face_normals_and_areas
from msal_cli.kernels.quantiles import find_distinct, quantiles
from msal_cli.kernels.spatial_order import order_in_space
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh

Ints = NDArray[Any]

PATCH = 2_000
"""Vertices of a patch, about: in smaller ones too much is near the cut."""

SEEDS = 16_384
"""Places where patches of a large mesh may begin, evenly over the numbers of vertices: to order a
million by place takes longer than a short search can spend."""

MARGIN = 3
"""Rings at the cut of a patch that are filtered but not evaluated: their neighbours beyond the cut
are missing."""


@dataclass(frozen=True, eq=False)
class Part:
    """A sample of a mesh, or the whole."""

    mesh: Mesh  # the patches as one mesh, or the whole
    judged: Flags  # (m,) bool, vertices at which errors are evaluated
    numbers: Ints | None = None  # (m,) which vertices of the whole these are; None for all of them


def select_patch(mesh: Mesh, most: int) -> Part:
    """Patches of about ``most`` vertices together; the whole mesh if it has hardly more.

    Fixed vertices and those that no face uses are not evaluated.  The sample itself has no fixed
    vertices and no trust.
    """
    links, n = mesh.topology, len(mesh.vertices)
    judged = (
        links.has_ring if mesh.fixed_vertices is None else links.has_ring & ~mesh.fixed_vertices
    )
    if n <= most + most // 4:
        whole = (
            mesh
            if mesh.fixed_vertices is None and mesh.trust is None
            else mesh.with_constraints(None, None)
        )
        return Part(whole, judged)
    # Patches begin only at vertices that are evaluated.
    places = np.flatnonzero(judged if judged.any() else links.has_ring)
    if len(places) > 2 * SEEDS:
        places = places[:: len(places) // SEEDS]
    order = places[order_in_space(mesh.vertices[places])]
    inside = np.zeros(n, dtype=np.bool_)
    count = max(most // PATCH, 1)
    for patch in range(count):
        _grow(order, (2 * patch + 1) * len(order) // (2 * count), most // count, links, inside)
    # Few faces have their first vertex inside, and only those are looked at.
    chosen = np.flatnonzero(inside[mesh.faces[:, 0]])
    chosen = chosen[inside[mesh.faces[chosen]].all(axis=1)]
    if not len(chosen):
        # A vertex with more neighbours than a patch has room for may leave no face whole.
        chosen = np.flatnonzero(inside[mesh.faces].any(axis=1))[:most]
    used, corners = np.unique(mesh.faces[chosen], return_inverse=True)
    kept = judged[used] & ~_cut_rings(used, links)[used]
    part = Mesh(mesh.vertices[used], corners.reshape(-1, 3).astype(np.int32))
    return Part(part, kept if kept.any() else judged[used], used)


def _grow(
    order: NDArray[np.int64], start: int, size: int, links: Connectivity, inside: Flags
) -> None:
    """Mark ``size`` vertices that are not marked yet, the nearest along edges to the first such one
    from place ``start`` of ``order`` on; where its component ends before, to the next such one."""
    marked, place = 0, 0
    while marked < size:
        while place < len(order) and inside[order[(start + place) % len(order)]]:
            place += 1
        if place == len(order):
            return
        front = order[[(start + place) % len(order)]]
        while len(front):
            inside[front] = True
            marked += len(front)
            reached = find_distinct(_rings_of(front, links))
            front = reached[~inside[reached]][: size - marked]


def _cut_rings(used: Ints, links: Connectivity) -> Flags:
    """Which vertices (n,) are within ``MARGIN`` rings of one that is not ``used``."""
    near = np.ones(len(links.has_ring), dtype=np.bool_)
    near[used] = False
    ring = _rings_of(used, links)
    owner = np.repeat(used, links.ring_start[used + 1] - links.ring_start[used])
    for _ in range(MARGIN):
        near[owner[near[ring]]] = True
    return near


def _rings_of(vertices: Ints, links: Connectivity) -> Ints:
    """The neighbours of all ``vertices``, one ring after the other."""
    start, stop = links.ring_start[vertices], links.ring_start[vertices + 1]
    counts = (stop - start).astype(np.int64)
    ends = np.cumsum(counts)
    places = np.arange(counts.sum()) + np.repeat(start - (ends - counts), counts)
    neighbours: Ints = links.ring[places]
    return neighbours


# The kind of a surface, by the angles across its edges

MACHINED, TEXTURED, ORGANIC, CLEAN = "machined", "textured", "organic", "clean"

SHARP = 9.0
"""How many times the third quartile of the angles their 98th percentile is, from where on edges
are sharp ones between smooth parts.  On the models of benchmarks/ground_truth.py, after a first
blend: 9.3 and more on machined ones, 8.7 and less on others, 5 on most."""

ROUGH_DEG = 10.0
"""The 90th percentile of the angles, in degrees, from which on a surface is called textured."""

EVEN = 3.3
"""The same ratio up to which a rough surface is rough all over: 2.3 to 2.8 on texture, 3.9 and more
where noise is left on smooth parts between edges."""

AWAY = 0.02
"""Share of the area of a range scan that may face away from the scanner: by noise, at grazing
angles.  Scans by one view have 0.015 and less."""


def is_seen_from_one_side(mesh: Mesh) -> bool:
    """Whether the mesh is open and hardly any of its area faces away: a scan from one view."""
    if not mesh.topology.boundary.any():
        return False
    normals, areas = face_normals_and_areas(mesh.vertices, mesh.faces)
    axis = np.einsum("ij,i->j", normals, areas)
    away = areas[np.einsum("ij,j->i", normals, axis) < 0.0]
    return float(away.sum()) <= AWAY * float(areas.sum())


def surface_kind(mesh: Mesh) -> str:
    """``MACHINED``, ``TEXTURED`` or ``ORGANIC``, for a mesh without much noise."""
    angles = _angles_deg(mesh)
    if not len(angles):
        return ORGANIC
    usual, rough, sharp = quantiles(angles, (0.75, 0.9, 0.98))
    if sharp > SHARP * usual and sharp > ROUGH_DEG:
        return MACHINED
    return TEXTURED if rough >= ROUGH_DEG and sharp <= EVEN * usual else ORGANIC


def _angles_deg(mesh: Mesh) -> Floats:
    """Angles between the normals of faces that share an edge, degrees, each pair once."""
    normals, areas = face_normals_and_areas(mesh.vertices, mesh.faces)
    start, ring = face_rings(mesh.faces, mesh.topology, "edge")
    first = np.repeat(np.arange(len(start) - 1), np.diff(start))
    kept = (first < ring) & (areas[first] > 0.0) & (areas[ring] > 0.0)
    alike = np.einsum("ij,ij->i", normals[first[kept]], normals[ring[kept]])
    angles: Floats = np.degrees(np.arccos(np.clip(alike, -1.0, 1.0)))
    return angles
