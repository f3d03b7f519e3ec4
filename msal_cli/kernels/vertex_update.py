"""Vertices fitted to given face normals: the second stage of all filters of normals.

Sun, Rosin, Martin and Langbein 2007: with the normals n' that the faces should have, each pass
moves each vertex by the mean of its offsets to the planes through the centroids of its faces,

    x_i <- x_i + mean over f (n'_f . (c_f - x_i)) n'_f,

a step of gradient descent on the sum of squares of n'_f . (edges of f), which is zero if all faces
have their normals.  All vertices move at once, and the centroids c are updated in each pass.

Tangential noise leaves thin and folded triangles: a fit moves vertices along the given normals,
which hardly changes the normal of a thin triangle.  So each vertex with a *strained* face, whose
normal is more than 20 degrees from the wanted one, moves towards the mean of its neighbours,
orthogonally to the mean of the wanted normals around it, and is fitted again.  Other vertices do
not move, even beside thin triangles.
"""

from collections.abc import Callable

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.geometry import face_normals
from msal_cli.kernels.library import compiled
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.vectors import ONE

THIRD = 1.0 / 3.0


@compiled
def _shares(start, stop, n, face_start, incident, free, share):
    """One over the number of faces that have a normal; zero for fixed vertices."""
    for i in range(np.uint64(start), np.uint64(stop)):
        count = 0
        for at in vec.row_range(face_start, i):
            count += not vec.is_zero(vec.load(n, incident[at]))
        share[i] = 1.0 / max(count, 1) if free[i] and count else 0.0


@compiled
def _offsets(start, stop, x, faces, n, offsets):
    """n' . c of each face.  All arrays are flat; x positions, n wanted normals.

    Indices are unsigned, so that they need no test of their sign.
    """
    for f in range(np.uint64(start), np.uint64(stop)):
        a, b, c = vec.load(faces, f)
        origin = vec.load(x, a)
        # In this form the centroid of equal coordinates is exact.
        edges = vec.add(vec.subtract(vec.load(x, b), origin), vec.subtract(vec.load(x, c), origin))
        offsets[f] = vec.dot(vec.load(n, f), vec.add_scaled(origin, THIRD, edges))


@compiled
def _move(start, stop, n, face_start, incident, offsets, share, x):
    """x positions, flat like the normals; the sum of offsets to planes is scaled by ``share``."""
    for i in range(np.uint64(start), np.uint64(stop)):
        own, total = vec.load(x, i), vec.ORIGIN
        for at in vec.row_range(face_start, i):
            f = np.uint64(incident[at])
            normal = vec.load(n, f)
            total = vec.add_scaled(total, offsets[f] - vec.dot(normal, own), normal)
        vec.store(x, i, vec.add_scaled(own, share[i], total))


def update_vertices(
    vertices: Floats,
    normals: Floats,
    faces: Ints,
    links: Connectivity,
    free: Flags,
    passes: int,
    on_pass: Callable[[], object] | None = None,
) -> Floats:
    """Positions (n, 3) after ``passes`` passes from ``vertices`` (n, 3), which are not changed.

    Parameters
    ----------
    normals : (m, 3), the unit normals that the faces should have; faces whose normal is zero are
        left out.
    faces, links : (m, 3) and their connectivity.
    free : (n,) bool, False for vertices that must stay.  A vertex whose faces are all left out, or
        that has none, stays as well.
    on_pass : called after each pass; an exception that it raises ends the run.
    """
    n, m = len(vertices), len(faces)
    offsets, share = np.empty(m), np.empty(n)
    around = normals.reshape(-1), *[rows.view(np.uint32) for rows in links.incidence]
    over_ranges(_shares, n, *around, free, share)
    corners = faces.reshape(-1).view(np.uint32)
    x = vertices.copy()
    for _ in range(passes):
        over_ranges(_offsets, m, x.reshape(-1), corners, around[0], offsets)
        over_ranges(_move, n, *around, offsets, share, x.reshape(-1))
        if on_pass is not None:
            on_pass()
    return x


ROUNDS = 3
"""Rounds of relaxing and fitting."""

PASSES = 8
"""Passes that fit the vertices in each round."""

STEP = 0.7
"""Share of the way to the mean of the neighbours, for vertices of fully strained faces."""

STRAINED, FULLY_STRAINED = 0.93969262078590838, 0.64278760968653933
"""Cosines of 20 and 50 degrees, between which the strain grows from 0 to 1."""


@compiled
def _measure_strains(start, stop, normals, wanted, strains):
    """Strain of each face, 0 to 1; 0 if either normal is missing.  All arrays are flat."""
    for f in range(np.uint64(start), np.uint64(stop)):
        a, b = vec.load(normals, f), vec.load(wanted, f)
        strain = (STRAINED - vec.dot(a, b)) / (STRAINED - FULLY_STRAINED)
        strains[f] = 0.0 if vec.is_zero(a) | vec.is_zero(b) else min(max(strain, 0.0), 1.0)


@compiled
def _even_out(
    start,
    stop,
    x,
    wanted,
    strains,
    face_start,
    incident,
    ring_start,
    ring,
    free,
    inner,
    moved,
    chosen,
):
    """Positions after one step, flat like x, and whether each vertex has a strained face."""
    for i in range(np.uint64(start), np.uint64(stop)):
        strain = 0.0
        for at in vec.row_range(face_start, i):
            strain = max(strain, strains[np.uint64(incident[at])])
        normal = vec.sum_row(wanted, face_start, incident, i)
        own = vec.load(x, i)
        chosen[i] = free[i] and strain > 0.0
        length = vec.norm(normal)
        if chosen[i] and inner[i] and length > 0.0:
            normal = vec.divide(normal, length)
            offset = vec.sum_offsets(x, ring_start, ring, i)
            share = STEP * strain / np.float64(ring_start[i + ONE] - ring_start[i])
            own = vec.add_scaled(
                own, share, vec.add_scaled(offset, -vec.dot(offset, normal), normal)
            )
        vec.store(moved, i, own)


def untangle(
    vertices: Floats, wanted: Floats, faces: Ints, links: Connectivity, free: Flags
) -> Floats:
    """Positions (n, 3) with less strained faces; ``vertices`` if no face is strained.

    Parameters
    ----------
    vertices : (n, 3), fitted to the normals; not changed.
    wanted : (m, 3) unit normals that the faces should have; zero for none.
    faces, links : (m, 3) and their connectivity.
    free : (n,) bool, False for vertices that must stay.  Boundary vertices are fitted only.
    """
    n, m = len(vertices), len(faces)
    inner = links.has_ring & ~links.boundary
    rows = [part.view(np.uint32) for part in (*links.incidence, *links.one_ring)]
    strains, chosen = np.empty(m), np.empty(n, dtype=np.bool_)
    flat = wanted.reshape(-1)
    for _ in range(ROUNDS):
        over_ranges(_measure_strains, m, face_normals(vertices, faces).reshape(-1), flat, strains)
        if not strains.any():
            break
        moved = np.empty_like(vertices)
        of = vertices.reshape(-1), flat, strains, *rows
        over_ranges(_even_out, n, *of, free, inner, moved.reshape(-1), chosen)
        vertices = update_vertices(moved, wanted, faces, links, chosen, PASSES)
    return vertices
