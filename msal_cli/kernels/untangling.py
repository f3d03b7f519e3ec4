"""Vertices whose faces cannot take their normals, evened out within the surface.

Noise within the surface leaves thin and folded triangles: a fit of the vertices to given normals
moves along these, and hardly changes the normal of a thin triangle.  So every vertex with a
*strained* face, one that is turned from its normal by more than 20 degrees, goes towards the mean
of its neighbours, at right angles to the mean of the wanted normals around it, and is fitted anew.
What fits stays where it is, with all its thin triangles.
"""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.geometry import face_normals
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.ring_blocks import ONE, THREE, TWO
from msal_cli.kernels.vertex_update import updated_vertices

ROUNDS = 3
"""Rounds of evening out and fitting."""

PASSES = 8
"""Passes that fit the vertices in each round."""

STEP = 0.7
"""Part of the way to the mean of the neighbours, for faces that are fully strained."""

STRAINED, FULLY_STRAINED = 0.93969262078590838, 0.64278760968653933
"""Cosines of 20 and 50 degrees, between which the strain grows from 0 to 1."""


@compiled
def _measure_strains(start, stop, normals, wanted, strains):
    """How strained each face is, 0 to 1; 0 where either normal is missing.  All arrays flat."""
    for f in range(np.uint64(start), np.uint64(stop)):
        at = THREE * f
        ax, ay, az = normals[at], normals[at + ONE], normals[at + TWO]
        bx, by, bz = wanted[at], wanted[at + ONE], wanted[at + TWO]
        has_both = ((ax != 0.0) | (ay != 0.0) | (az != 0.0)) & (
            (bx != 0.0) | (by != 0.0) | (bz != 0.0)
        )
        strain = (STRAINED - (ax * bx + ay * by + az * bz)) / (STRAINED - FULLY_STRAINED)
        strains[f] = min(max(strain, 0.0), 1.0) if has_both else 0.0


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
    """Positions after one step, flat as x, and which vertices have a strained face."""
    for i in range(np.uint64(start), np.uint64(stop)):
        strain = 0.0
        nx = ny = nz = 0.0
        for at in range(np.uint64(face_start[i]), np.uint64(face_start[i + ONE])):
            f = np.uint64(incident[at])
            strain = max(strain, strains[f])
            nx += wanted[THREE * f]
            ny += wanted[THREE * f + ONE]
            nz += wanted[THREE * f + TWO]
        own = THREE * i
        px, py, pz = x[own], x[own + ONE], x[own + TWO]
        chosen[i] = free[i] and strain > 0.0
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if chosen[i] and inner[i] and length > 0.0:
            nx, ny, nz = nx / length, ny / length, nz / length
            mx = my = mz = 0.0
            row, end = np.uint64(ring_start[i]), np.uint64(ring_start[i + ONE])
            for at in range(row, end):
                k = THREE * ring[at]
                mx += x[k] - px
                my += x[k + ONE] - py
                mz += x[k + TWO] - pz
            share = STEP * strain / np.float64(end - row)
            along = mx * nx + my * ny + mz * nz
            px += share * (mx - along * nx)
            py += share * (my - along * ny)
            pz += share * (mz - along * nz)
        moved[own], moved[own + ONE], moved[own + TWO] = px, py, pz


def untangle(
    vertices: Floats, wanted: Floats, faces: Ints, links: Connectivity, free: Flags
) -> Floats:
    """Positions (n, 3) whose faces are less strained; the same where none is.

    Parameters
    ----------
    vertices : (n, 3), fitted to the normals; not changed.
    wanted : (m, 3) unit normals that the faces should have; zero where there is none.
    faces, links : (m, 3) and its neighbourhoods.
    free : (n,) bool, False for vertices that must stay.  Boundary vertices are fitted only.
    """
    n, m = len(vertices), len(faces)
    inner = links.has_ring & ~links.boundary
    around = links.face_start.view(np.uint32), links.incident_faces.view(np.uint32)
    rings = links.ring_start.view(np.uint32), links.ring.view(np.uint32)
    strains, chosen = np.empty(m), np.empty(n, dtype=np.bool_)
    flat = wanted.reshape(-1)
    for _ in range(ROUNDS):
        over_ranges(_measure_strains, m, face_normals(vertices, faces).reshape(-1), flat, strains)
        if not strains.any():
            break
        moved = np.empty_like(vertices)
        of = vertices.reshape(-1), flat, strains, *around, *rings
        over_ranges(_even_out, n, *of, free, inner, moved.reshape(-1), chosen)
        vertices = updated_vertices(moved, wanted, faces, links, chosen, PASSES)
    return vertices
