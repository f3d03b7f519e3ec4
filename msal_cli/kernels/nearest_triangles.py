"""The triangle of a mesh nearest to a point, by a bounding volume hierarchy.

Triangles are sorted along a Morton curve, and each ``LEAF`` consecutive ones are a leaf.  The tree
is complete: node k has the children 2 k and 2 k + 1, and the root is 1.  Boxes that are farther
than the nearest triangle so far are skipped.  Of equally near triangles the first in the order of
the mesh is chosen, so that results do not depend on where a search begins.  Points are sorted along
the curve too: a search begins with the triangle of the previous point, whose data are in the cache.
"""

import numpy as np

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.library import compiled
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.spatial_order import gather_rows, order_in_space
from msal_cli.kernels.vectors import ONE, THREE, TWO, ZERO

LEAF = np.uint64(2)
"""Triangles in a leaf."""

MIN_POINTS = 4096
"""Points for which an additional thread is worth starting."""

_DEPTH = 64


@compiled
def _square_to_box(point, boxes, node):
    low = vec.subtract(vec.load(boxes, TWO * node), point)
    high = vec.subtract(point, vec.load(boxes, TWO * node + ONE))
    dx = max(max(low[0], high[0]), 0.0)
    dy = max(max(low[1], high[1]), 0.0)
    dz = max(max(low[2], high[2]), 0.0)
    return dx * dx + dy * dy + dz * dz


@compiled
def _square_to_edge(o, edge, normal):
    """The squared distance of a point o from the edge that begins at the origin, and whether o is
    on the inner side of the edge, seen along the normal."""
    length = vec.dot(edge, edge)
    share = min(max(vec.dot(o, edge) / length, 0.0), 1.0) if length > 0.0 else 0.0
    rest = vec.add_scaled(o, -share, edge)
    return vec.dot(rest, rest), vec.dot(vec.cross(edge, o), normal) >= 0.0


@compiled
def _square_to_triangle(point, corners, slot):
    """The squared distance to the triangle in a slot of ``corners``, nine numbers each.

    The nearest point is on an edge, or the projection on the plane if that is inside.  A degenerate
    triangle is its edges.
    """
    first = THREE * slot
    u, w, normal = vec.edges_and_normal(corners, first, first + ONE, first + TWO)
    p = vec.subtract(point, vec.load(corners, first))
    at_u, is_in = _square_to_edge(p, u, normal)
    beside, is_in_too = _square_to_edge(vec.subtract(p, u), vec.subtract(w, u), normal)
    at_w, is_in_three = _square_to_edge(vec.subtract(p, w), vec.times(-1.0, w), normal)
    least = min(at_u, beside, at_w)
    area = vec.dot(normal, normal)
    if area > 0.0 and is_in and is_in_too and is_in_three:
        height = vec.dot(p, normal)
        least = min(least, height * height / area)
    return least


@compiled
def _find_nearest(
    start, stop, points, order, corners, numbers, boxes, first_leaf, triangles, distances
):
    """The ``triangles`` and ``distances`` of points (n, 3), flat, visited in the ``order`` (n,);
    ``corners`` (m, 9), flat, are in the order of the tree, and ``numbers`` (m,) are their face
    numbers in the mesh."""
    nodes, squares = np.empty(_DEPTH, dtype=np.uint64), np.empty(_DEPTH)
    first_leaf, count, found = np.uint64(first_leaf), np.uint64(len(numbers)), ZERO
    for at in range(start, stop):
        i = np.uint64(order[at])
        point = vec.load(points, i)
        nearest = numbers[found]
        least = _square_to_triangle(point, corners, found)
        nodes[0], squares[0], waiting = ONE, 0.0, ONE
        while waiting > ZERO:
            waiting -= ONE
            node = nodes[waiting]
            if squares[waiting] > least:
                continue
            if node >= first_leaf:
                begin = LEAF * (node - first_leaf)
                for slot in range(begin, min(begin + LEAF, count)):
                    square = _square_to_triangle(point, corners, np.uint64(slot))
                    number = numbers[slot]
                    if square < least or (square == least and number < nearest):
                        nearest, least, found = number, square, np.uint64(slot)
                continue
            below = node + node
            left = _square_to_box(point, boxes, below)
            right = _square_to_box(point, boxes, below + ONE)
            # The nearer one is visited first.
            is_left = left <= right
            nodes[waiting], squares[waiting] = below + ONE if is_left else below, max(left, right)
            waiting += ONE
            nodes[waiting], squares[waiting] = below if is_left else below + ONE, min(left, right)
            waiting += ONE
        triangles[i] = nearest
        distances[i] = np.sqrt(least)


def find_nearest_triangles(points: Floats, vertices: Floats, faces: Ints) -> tuple[Ints, Floats]:
    """The triangle (n,) nearest to each of the points (n, 3), and its distance (n,), file units.

    ``vertices`` (k, 3) and ``faces`` (m, 3) are those of the mesh, m at least 1.
    """
    m = len(faces)
    corners = gather_rows(vertices, faces.reshape(-1)).reshape(m, 3, 3)
    numbers = order_in_space(corners.mean(axis=1)).astype(np.int32)
    corners = corners[numbers]
    n_leaves = -(-m // int(LEAF))
    first_leaf = 1 << (n_leaves - 1).bit_length()
    boxes = np.empty((2 * first_leaf, 6))
    for bound, pick, empty in (
        (boxes[:, :3], np.minimum, np.inf),
        (boxes[:, 3:], np.maximum, -np.inf),
    ):
        slots = np.full((first_leaf * int(LEAF), 3), empty)
        slots[:m] = pick(pick(corners[:, 0], corners[:, 1]), corners[:, 2])
        bound[first_leaf:] = pick.reduce(slots.reshape(first_leaf, -1, 3), axis=1)
        level = first_leaf
        while level > 1:
            below, level = bound[level : 2 * level], level // 2
            bound[level : 2 * level] = pick(below[::2], below[1::2])
    triangles, distances = np.empty(len(points), dtype=np.int32), np.empty(len(points))
    of = points.reshape(-1), order_in_space(points), corners.reshape(-1), numbers
    found = triangles, distances
    over_ranges(
        _find_nearest, len(points), *of, boxes.reshape(-1), first_leaf, *found, smallest=MIN_POINTS
    )
    return triangles, distances
