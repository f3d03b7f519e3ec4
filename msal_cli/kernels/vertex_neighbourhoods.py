"""What lies within a distance of a vertex, found along the surface.

A flood through the connectivity, not a ball in space: the other side of a thin wall is not found,
and no search tree is needed.  The kernels are called for one vertex at a time from other kernels.
"""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.ring_blocks import longest_row

MOST_FOUND = 2048
"""Items at which a flood stops: vertices within 23 mean edge lengths of one on an even mesh."""

MOST_LOOKS = 4 * MOST_FOUND
"""Neighbours that a flood looks at beyond the first row: those of a hub would be too many."""


@compiled
def room(start, stop, row_start):
    """Items that a flood from any of these vertices can find: first rows are taken whole."""
    return np.int64(max(MOST_FOUND, longest_row(start, stop, row_start)) + 1)


@compiled
def vertices_around(i, x, ring_start, ring, square_radius, mark, found, squares):
    """Vertices that edges join to i through vertices no farther from it than the radius.

    x positions.  ``mark`` (n,) must not hold i; ``found`` and ``squares`` have room for all.
    Returns their number: ``found`` begins with i itself, ``squares`` are squared distances.
    """
    mark[i] = i
    found[0] = i
    squares[0] = 0.0
    count = 1
    at = 0
    looks = MOST_LOOKS
    while at < count:
        j = found[at]
        row = ring_start[j]
        end = ring_start[j + 1]
        if at > 0:
            end = min(end, row + looks)
            looks -= end - row
        at += 1
        for entry in range(row, end):
            k = ring[entry]
            if mark[k] == i:
                continue
            mark[k] = i
            dx, dy, dz = x[k, 0] - x[i, 0], x[k, 1] - x[i, 1], x[k, 2] - x[i, 2]
            square = dx * dx + dy * dy + dz * dz
            if square <= square_radius:
                if at > 1 and count >= MOST_FOUND:
                    return count
                found[count] = k
                squares[count] = square
                count += 1
    return count


@compiled
def faces_around(
    i,
    x,
    centroids,
    faces,
    face_start,
    incident,
    square_radius,
    vertex_mark,
    face_mark,
    corners,
    found,
    squares,
):
    """Faces whose centroids are within the radius of i, and that such faces join to it.

    x positions.  Faces are joined where they share a vertex.  The marks (n,) and (m,) must not
    hold i; ``corners`` has room for three vertices a face.  Returns the number of faces
    ``found``, with the squared distances of their centroids in ``squares``.
    """
    vertex_mark[i] = i
    corners[0] = i
    waiting = 1
    count = 0
    at = 0
    looks = MOST_LOOKS
    while at < waiting:
        j = corners[at]
        row = face_start[j]
        end = face_start[j + 1]
        if at > 0:
            end = min(end, row + looks)
            looks -= end - row
        at += 1
        for entry in range(row, end):
            f = incident[entry]
            if face_mark[f] == i:
                continue
            face_mark[f] = i
            dx = centroids[f, 0] - x[i, 0]
            dy = centroids[f, 1] - x[i, 1]
            dz = centroids[f, 2] - x[i, 2]
            square = dx * dx + dy * dy + dz * dz
            if square > square_radius:
                continue
            if at > 1 and count >= MOST_FOUND:
                return count
            found[count] = f
            squares[count] = square
            count += 1
            for corner in range(3):
                k = faces[f, corner]
                if vertex_mark[k] != i:
                    vertex_mark[k] = i
                    corners[waiting] = k
                    waiting += 1
    return count
