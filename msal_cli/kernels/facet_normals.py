"""Normals of facets, as STL stores them, after vertices moved."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.geometry import DEGENERATE
from msal_cli.kernels.parallel import over_ranges

_BLOCK_FACETS = 64
_NEW, _OLD, _STORED = range(3)


@compiled
def _cross(vertices, a, b, c):  # type: ignore[no-untyped-def]
    """Cross product of two edges of a triangle, and its longest edge squared."""
    ux = vertices[b, 0] - vertices[a, 0]
    uy = vertices[b, 1] - vertices[a, 1]
    uz = vertices[b, 2] - vertices[a, 2]
    wx = vertices[c, 0] - vertices[a, 0]
    wy = vertices[c, 1] - vertices[a, 1]
    wz = vertices[c, 2] - vertices[a, 2]
    vx, vy, vz = wx - ux, wy - uy, wz - uz
    longest = max(
        ux * ux + uy * uy + uz * uz, wx * wx + wy * wy + wz * wz, vx * vx + vy * vy + vz * vz
    )
    return uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx, longest


@compiled
def _normalise(vectors, lengths):  # type: ignore[no-untyped-def]
    """Take the roots of the first two rows of lengths, and divide the vectors by their lengths."""
    for row in range(2):
        for at in range(_BLOCK_FACETS):
            lengths[row, at] = np.sqrt(lengths[row, at])
    for row in range(3):
        for axis in range(3):
            for at in range(_BLOCK_FACETS):
                vectors[row, axis, at] /= lengths[row, at]


@compiled
def replace_facets(start, stop, old, new, faces, normals, corners, changed):  # type: ignore[no-untyped-def]
    """Write the normals and corners that are others into facets.

    normals (m, 3) : as stored; those that ``renew_facet_normals`` says are replaced.
    corners (m, 9) : every coordinate that moved is replaced.  Without rows: none.
    changed (m,) bool : set for normals that are replaced.  Without rows: not filled.

    Roots and divisions are done for a block of facets at once, as vector code, which halves the
    time.  (As one body: called for every facet, its parts would not become one piece of code.)
    """
    # Three rows: the normal after and before the corners moved, and the stored one.
    vectors = np.empty((3, 3, _BLOCK_FACETS))
    lengths = np.empty((3, _BLOCK_FACETS))
    longest = np.empty((2, _BLOCK_FACETS))
    sums = np.empty(_BLOCK_FACETS)
    # What a block leaves over is divided too.
    for row in range(3):
        for at in range(_BLOCK_FACETS):
            lengths[row, at] = 1.0
            for axis in range(3):
                vectors[row, axis, at] = 1.0
    which = np.empty(_BLOCK_FACETS, dtype=np.int64)
    f = start
    while f < stop:
        count = 0
        while f < stop and count < _BLOCK_FACETS:
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            moved = False
            for k in range(3):
                moved = moved or (
                    old[a, k] != new[a, k] or old[b, k] != new[b, k] or old[c, k] != new[c, k]
                )
            if moved:
                x, y, z, longest[_NEW, count] = _cross(new, a, b, c)
                vectors[_NEW, 0, count] = x
                vectors[_NEW, 1, count] = y
                vectors[_NEW, 2, count] = z
                lengths[_NEW, count] = x * x + y * y + z * z
                x, y, z, longest[_OLD, count] = _cross(old, a, b, c)
                vectors[_OLD, 0, count] = x
                vectors[_OLD, 1, count] = y
                vectors[_OLD, 2, count] = z
                lengths[_OLD, count] = x * x + y * y + z * z
                x = np.float64(normals[f, 0])
                y = np.float64(normals[f, 1])
                z = np.float64(normals[f, 2])
                # Scaled by this, neither tiny nor huge stored normals spoil the sign.
                lengths[_STORED, count] = max(abs(x), abs(y), abs(z))
                vectors[_STORED, 0, count] = x
                vectors[_STORED, 1, count] = y
                vectors[_STORED, 2, count] = z
                # A sum, because NaN disappears in a maximum.
                sums[count] = abs(x) + abs(y) + abs(z)
                which[count] = f
                count += 1
                if len(corners):
                    for corner in range(3):
                        i = faces[f, corner]
                        for k in range(3):
                            if old[i, k] != new[i, k]:
                                corners[f, 3 * corner + k] = new[i, k]
            f += 1
        _normalise(vectors, lengths)
        for at in range(count):
            length = lengths[_NEW, at]
            if not (
                lengths[_STORED, at] > 0.0
                and sums[at] < np.inf
                and length > DEGENERATE * longest[_NEW, at]
                and length < np.inf
            ):
                continue
            sense = 1.0
            length = lengths[_OLD, at]
            if length > DEGENERATE * longest[_OLD, at] and length < np.inf:
                along = (
                    vectors[_STORED, 0, at] * vectors[_OLD, 0, at]
                    + vectors[_STORED, 1, at] * vectors[_OLD, 1, at]
                    + vectors[_STORED, 2, at] * vectors[_OLD, 2, at]
                )
                if along < 0.0:
                    sense = -1.0
            g = which[at]
            # The sum makes a plain zero of a negative one.
            normals[g, 0] = sense * vectors[_NEW, 0, at] + 0.0
            normals[g, 1] = sense * vectors[_NEW, 1, at] + 0.0
            normals[g, 2] = sense * vectors[_NEW, 2, at] + 0.0
            if len(changed):
                changed[g] = True


def renew_facet_normals(
    old: Floats, new: Floats, faces: Ints, normals: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Stored facet normals after vertices moved.

    Parameters
    ----------
    old, new : (n, 3), the vertices before and after, file units.
    faces : (m, 3), the corners of each facet.
    normals : (m, 3) as stored, of any length, not finite where the file has no number.

    Returns
    -------
    normals : (m, 3).  A facet with a corner that moved gets the unit normal of its new corners by
        the right-hand rule, reversed if the stored one opposed the old corners.  A facet whose
        stored normal is zero (exporters leave the choice to the reader) or not finite, and one
        that has no area any more, keeps what it has.
    changed : (m,) bool, which normals are new.
    """
    result = np.array(normals, dtype=np.float64)
    changed = np.zeros(len(result), dtype=np.bool_)
    over_ranges(replace_facets, len(result), old, new, faces, result, np.empty((0, 9)), changed)
    return result, changed
