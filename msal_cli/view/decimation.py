"""A coarser mesh to look at, where the whole one would be too much for a page.

Short edges are contracted to one of their ends, many at a time, until few enough faces are left.
A vertex that stays keeps its place: a mean of places would take away noise, and the picture of a
noisy mesh would flatter it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints, Longs

_LEAST_COSINE = 0.25
"""Of the angle by which a face may turn when an edge beside it is contracted."""

_CHECKS = 3
"""Times that contractions are checked against one another; what still fails then is left."""

_STALLED = 0.12
"""Share of the faces that a round must take away; after a poorer one faces may turn over, which
happens only where the noise is larger than the edges and the surface is folded anyhow."""

_ROUNDS = 60

_PASSES = 3
"""Times that the vertices which are in no pair yet are paired in one round."""

_TAKEN = -2


@dataclass(frozen=True, eq=False)
class Coarse:
    """Faces between a selection of the vertices.

    Attributes
    ----------
    kept : (k,) the vertices of the full mesh that stay, in rising order.
    faces : (m, 3) int32, of places in ``kept``.
    """

    kept: Longs
    faces: Ints


def coarsen(vertices: Floats, faces: Ints, most_faces: int) -> Coarse:
    """The mesh with as many faces as it may have, at most ``most_faces`` where that can be reached.

    ``vertices`` (n, 3) finite, ``faces`` (m, 3).  Faces that contractions put on one another are
    left out but for the first.  What has few enough faces keeps all of them.
    """
    left = faces.astype(np.int64)
    if len(left) > most_faces:
        left = _with_area(left)
    is_checked = True
    for _ in range(_ROUNDS):
        excess = len(left) - most_faces
        if excess <= 0:
            break
        fewer = _round(vertices, left, excess, is_checked=is_checked)
        is_checked = is_checked and len(left) - len(fewer) >= min(excess, _STALLED * len(left))
        left = fewer
    if len(left) < len(faces):
        left = _distinct(left)
    kept, flat = np.unique(left, return_inverse=True)
    return Coarse(kept, flat.reshape(-1, 3).astype(np.int32))


def _round(vertices: Floats, faces: Longs, excess: int, *, is_checked: bool) -> Longs:
    """The faces after one round, which takes away not many more than ``excess``."""
    stays, goes = _pairs(vertices, faces)
    # Two faces to an edge inside; the last round stops where it should.
    few = (excess + 1) // 2
    stays, goes = stays[:few], goes[:few]
    # What is on a boundary does not move inwards: a scan would shrink at its holes.
    is_rim = _on_boundary(len(vertices), faces)
    outward = is_rim[goes] & ~is_rim[stays]
    stays[outward], goes[outward] = goes[outward], stays[outward].copy()
    moved = np.arange(len(vertices))
    moved[goes] = stays
    if is_checked:
        pair = np.full(len(vertices), -1)
        pair[goes] = np.arange(len(goes))
        for check in range(_CHECKS):
            failed = np.unique(pair[_turn(vertices, faces, moved)])
            failed = failed[failed >= 0]
            if not len(failed):
                break
            moved[goes[failed]] = goes[failed]
            pair[goes[failed]] = -1
            if check == 0:
                # What one end cannot do, the other may.
                failed = failed[is_rim[goes[failed]] == is_rim[stays[failed]]]
                goes[failed], stays[failed] = stays[failed], goes[failed].copy()
                moved[goes[failed]] = stays[failed]
                pair[goes[failed]] = failed
        else:
            bad = _turn(vertices, faces, moved)
            moved[bad] = bad
    return _with_area(moved[faces])


def _pairs(vertices: Floats, faces: Longs) -> tuple[Longs, Longs]:
    """Ends of short edges, each vertex in one pair at most; the shortest first, by and large."""
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    # An edge between two faces is met in both directions: once is enough.
    low, high = sides[sides[:, 0] < sides[:, 1]].T
    gaps = vertices[low] - vertices[high]
    order = np.argsort((gaps * gaps).sum(axis=1), kind="stable")
    low, high = low[order], high[order]
    stays, goes = [], []
    shortest = np.full(len(vertices), -1)
    for _ in range(_PASSES):
        # Written from the longest to the shortest, so that the shortest remains.
        ranks = np.arange(len(low))
        both = np.stack([low, high], axis=1)[::-1].reshape(-1)
        shortest[both] = np.repeat(ranks[::-1], 2)
        is_pair = (shortest[low] == ranks) & (shortest[high] == ranks)
        stays.append(low[is_pair])
        goes.append(high[is_pair])
        shortest[stays[-1]] = shortest[goes[-1]] = _TAKEN
        is_free = (shortest[low] != _TAKEN) & (shortest[high] != _TAKEN)
        low, high = low[is_free], high[is_free]
    return np.concatenate(stays), np.concatenate(goes)


def _on_boundary(n_vertices: int, faces: Longs) -> NDArray[np.bool_]:
    """Whether the faces around each vertex leave a gap.

    Numbers of the neighbours add up to nothing around a closed fan, where each is once the next
    and once the last corner, and to the last less the first one of an open fan.
    """
    sums = np.zeros(n_vertices)
    for k in range(3):
        steps = faces[:, (k + 1) % 3] - faces[:, (k + 2) % 3]
        sums += np.bincount(faces[:, k], weights=steps, minlength=n_vertices)
    is_open: NDArray[np.bool_] = sums != 0.0
    return is_open


def _turn(vertices: Floats, faces: Longs, moved: Longs) -> Longs:
    """Corners of the faces that would turn too far, or become needles."""
    after = moved[faces]
    changed = np.flatnonzero((after != faces).any(axis=1))
    a, b, c = after[changed].T
    changed = changed[(a != b) & (b != c) & (c != a)]
    was, now = _normals(vertices, faces[changed]), _normals(vertices, after[changed])
    along = (was * now).sum(axis=1)
    sizes = np.sqrt((was * was).sum(axis=1) * (now * now).sum(axis=1))
    return np.unique(faces[changed[along <= _LEAST_COSINE * sizes]])


def _normals(vertices: Floats, faces: Longs) -> Floats:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    u, w = b - a, c - a
    return np.stack(
        [
            u[:, 1] * w[:, 2] - u[:, 2] * w[:, 1],
            u[:, 2] * w[:, 0] - u[:, 0] * w[:, 2],
            u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0],
        ],
        axis=1,
    )


def _with_area(faces: Longs) -> Longs:
    """The faces with three different corners."""
    a, b, c = faces.T
    left: Longs = faces[(a != b) & (b != c) & (c != a)]
    return left


def _distinct(faces: Longs) -> Longs:
    """The faces (m, 3), each set of corners but once."""
    ordered = np.sort(faces, axis=1)
    order = np.lexsort(ordered.T)
    again = (ordered[order[1:]] == ordered[order[:-1]]).all(axis=1)
    is_first = np.ones(len(faces), dtype=bool)
    is_first[order[1:][again]] = False
    return faces[is_first]
