"""Area, volume and normals of a surface before and after its vertices moved, in one pass."""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.elementary import arctangents
from msal_cli.kernels.geometry import DEGENERATE
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.vectors import edges_and_normal, longest_square

BLOCK_FACES = 512
"""Faces that are worked on at a time; also the terms of one partial sum, so that sums do not
depend on the number of threads."""

(
    DOUBLED_AREA_BEFORE,
    DOUBLED_AREA_AFTER,
    SIXFOLD_VOLUME_BEFORE,
    SIXFOLD_VOLUME_AFTER,
    ANGLES,  # sum of the angles between a face's normals, radians
    LARGEST_ANGLE,
    FLIPPED,  # faces that turned by more than a right angle
    COMPARED,  # faces that have a normal before and after
    N_FIGURES,
) = range(9)


@compiled
def _cross(vertices, a, b, c):
    """Cross product of two edges of a triangle, sixfold volume, and its longest edge squared."""
    ux, uy, uz, wx, wy, wz, nx, ny, nz = edges_and_normal(vertices, a, b, c)
    volume = vertices[a, 0] * nx + vertices[a, 1] * ny + vertices[a, 2] * nz
    return nx, ny, nz, volume, longest_square(ux, uy, uz, wx, wy, wz)


@compiled
def _changes(start, stop, before, after, faces, figures):
    # Gathering cannot become vector code; what follows, in loops of its own, does.
    px, py, pz = np.empty(BLOCK_FACES), np.empty(BLOCK_FACES), np.empty(BLOCK_FACES)
    qx, qy, qz = np.empty(BLOCK_FACES), np.empty(BLOCK_FACES), np.empty(BLOCK_FACES)
    p_longest, q_longest = np.empty(BLOCK_FACES), np.empty(BLOCK_FACES)
    compares = np.empty(BLOCK_FACES)  # 1 where both normals are there, else 0
    apart = np.empty(BLOCK_FACES)  # of half the angle between them, the sine times something
    along = np.empty(BLOCK_FACES)  # and its cosine times the same
    for block in range(start, stop):
        first = block * BLOCK_FACES
        count = min(BLOCK_FACES, len(faces) - first)
        volume_before = volume_after = 0.0
        for at in range(count):
            f = first + at
            a, b, c = np.uint64(faces[f, 0]), np.uint64(faces[f, 1]), np.uint64(faces[f, 2])
            px[at], py[at], pz[at], volume, p_longest[at] = _cross(before, a, b, c)
            volume_before += volume
            qx[at], qy[at], qz[at], volume, q_longest[at] = _cross(after, a, b, c)
            volume_after += volume
        for at in range(count):
            p = np.sqrt(px[at] * px[at] + py[at] * py[at] + pz[at] * pz[at])
            q = np.sqrt(qx[at] * qx[at] + qy[at] * qy[at] + qz[at] * qz[at])
            is_compared = (p > DEGENERATE * p_longest[at]) & (q > DEGENERATE * q_longest[at])
            scale = 1.0 / p / q if is_compared else 0.0
            # Sine and cosine of the angle; the arccosine of the latter would lose tiny angles.
            x = (py[at] * qz[at] - pz[at] * qy[at]) * scale
            y = (pz[at] * qx[at] - px[at] * qz[at]) * scale
            z = (px[at] * qy[at] - py[at] * qx[at]) * scale
            sine = np.sqrt(x * x + y * y + z * z)
            cosine = (px[at] * qx[at] + py[at] * qy[at] + pz[at] * qz[at]) * scale
            # tan(a / 2) is sin a / (1 + cos a) and (1 - cos a) / sin a: the one without a
            # difference of near numbers.
            apart[at] = sine if cosine >= 0.0 else 1.0 - cosine
            along[at] = 1.0 + cosine if cosine >= 0.0 else sine
            compares[at] = 1.0 if is_compared else 0.0
            p_longest[at] = p
            q_longest[at] = q
        area_before = area_after = compared = flipped = 0.0
        for at in range(count):
            area_before += p_longest[at]
            area_after += q_longest[at]
            compared += compares[at]
            flipped += 1.0 if apart[at] > along[at] else 0.0
        arctangents(apart, along, count)
        total = largest = 0.0
        for at in range(count):
            total += apart[at]
            largest = max(largest, apart[at])
        figures[block, DOUBLED_AREA_BEFORE] = area_before
        figures[block, DOUBLED_AREA_AFTER] = area_after
        figures[block, SIXFOLD_VOLUME_BEFORE] = volume_before
        figures[block, SIXFOLD_VOLUME_AFTER] = volume_after
        figures[block, ANGLES] = 2.0 * total
        figures[block, LARGEST_ANGLE] = 2.0 * largest
        figures[block, FLIPPED] = flipped
        figures[block, COMPARED] = compared


def surface_figures(before: Floats, after: Floats, faces: Ints) -> Floats:
    """The figures (N_FIGURES,) of ``faces`` (m, 3) over two sets of vertices (n, 3).

    The places are named above; the largest angle is a maximum, all others are sums.
    """
    n_blocks = -(-len(faces) // BLOCK_FACES)
    figures = np.empty((n_blocks, N_FIGURES))
    over_ranges(_changes, n_blocks, before, after, faces, figures, smallest=64)
    total: Floats = figures.sum(axis=0)
    total[LARGEST_ANGLE] = figures[:, LARGEST_ANGLE].max(initial=0.0)
    return total
