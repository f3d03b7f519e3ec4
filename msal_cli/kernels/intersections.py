"""The pairs of faces of a mesh that intersect.

Overlapping boxes give candidates, which are decided by exact signs of determinants
(``space_signs``).  For faces with a common vertex a cheaper test comes first, for a plane through
the vertex that separates them by more than rounding errors: in flat regions exact signs are
expensive.  Two faces intersect if they have a point in common that is not on a shared vertex or
edge:

- without a common vertex, if any edge of one meets the other (this holds for coplanar faces too,
  since a triangle within another has edges that meet it);
- with one, if the edge opposite to it of either meets the other: a segment from the vertex to
  another common point, prolonged, leaves one of the two triangles through that edge;
- with two, if they are folded onto each other: coplanar, on the same side of their edge.

Triangles are closed, so touching counts.

Boxes also have bounds along the diagonals of the faces of a cube, because long oblique triangles
fill such boxes better.  They are ordered so that neighbours are near each other: by size, in
classes of eight, so that a few large ones do not widen the nodes of all small ones, and within a
class along a Morton curve.  A binary tree over this order is traversed by levels, many pairs of
nodes at once.

Determinants are computed in double precision first.  If one is smaller than its rounding error may
be (Shewchuk 1997, "Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric
Predicates", section 4: the bound of the first stage), its sign is found with integers of any
length, because all doubles are integer multiples of a power of two.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Flags, Floats, Ints, Longs
from msal_cli.kernels.spatial_order import order_in_space

Bounds = tuple[Floats, Floats]

NODE_PAIRS_AT_ONCE = 1 << 18
"""Pairs of nodes that are expanded at once, which bounds the memory."""

_SIZES_PER_CLASS = 3  # powers of two


def near_pairs(triangles: Floats) -> Iterator[tuple[Longs, Longs]]:
    """The pairs of ``triangles`` (n, 3, 3) whose boxes have a point in common.

    Yields arrays i, j of the same length, each pair once, in an order that is always the same.
    """
    if len(triangles) < 2:
        return
    low, high = _bounds(triangles)
    order = _spatial_order(low[:3], high[:3])
    levels = _levels(low[:, order], high[:, order])
    for level in range(1, len(levels)):
        left = np.arange(0, levels[level][0].shape[1], 2, dtype=np.int64)
        siblings = _overlapping(levels[level], left, left + 1)
        for i, j in _leaf_pairs(levels, level, *siblings):
            yield order[i], order[j]


def _bounds(triangles: Floats) -> Bounds:
    """Bounds along nine directions, (9, n) each.

    Sums of two coordinates are rounded, but monotonically, so boxes with a point in common overlap.
    """
    x, y, z = triangles.transpose(2, 1, 0)
    low, high = np.empty((9, len(triangles))), np.empty((9, len(triangles)))
    for k, along in enumerate((x, y, z, x + y, x - y, y + z, y - z, z + x, z - x)):
        low[k], high[k] = along.min(axis=0), along.max(axis=0)
    return low, high


def _spatial_order(low: Floats, high: Floats) -> Longs:
    centres = np.ascontiguousarray((0.5 * low + 0.5 * high).T)
    order = order_in_space(centres)
    # A box of size 0 has the exponent 0, like one of size 1.
    sizes = np.frexp((high - low).max(axis=0))[1] // _SIZES_PER_CLASS
    return order[np.argsort(-sizes[order], kind="stable")]


def _levels(low: Floats, high: Floats) -> list[Bounds]:
    """Bounds (9, nodes) of all nodes by level, the root first; padded with empty nodes."""
    n_axes, n = low.shape
    size = 1 << (n - 1).bit_length()
    lows, highs = np.full((n_axes, size), np.inf), np.full((n_axes, size), -np.inf)
    lows[:, :n], highs[:, :n] = low, high
    levels = [(lows, highs)]
    while size > 1:
        size //= 2
        lows = lows.reshape(n_axes, size, 2).min(axis=2)
        highs = highs.reshape(n_axes, size, 2).max(axis=2)
        levels.append((lows, highs))
    return levels[::-1]


def _leaf_pairs(
    levels: list[Bounds], level: int, i: Longs, j: Longs
) -> Iterator[tuple[Longs, Longs]]:
    """The pairs of overlapping boxes below pairs of nodes i, j of a level."""
    for start in range(0, len(i), NODE_PAIRS_AT_ONCE):
        first, second = i[start : start + NODE_PAIRS_AT_ONCE], j[start : start + NODE_PAIRS_AT_ONCE]
        if level == len(levels) - 1:
            yield first, second
            continue
        children = [(2 * first + a, 2 * second + b) for a in (0, 1) for b in (0, 1)]
        below = _overlapping(
            levels[level + 1],
            np.concatenate([i for i, _ in children]),
            np.concatenate([j for _, j in children]),
        )
        yield from _leaf_pairs(levels, level + 1, *below)


def _overlapping(bounds: Bounds, i: Longs, j: Longs) -> tuple[Longs, Longs]:
    """The pairs of nodes that overlap."""
    for low, high in zip(*bounds, strict=True):
        keep = (low[i] <= high[j]) & (low[j] <= high[i])
        i, j = i[keep], j[keep]
    return i, j


Vectors = tuple[Floats, Floats, Floats]
"""x, y and z of many vectors."""

AT_ONCE = 1 << 16
"""Pairs in a block, whose data fit the cache."""

# Relative to the largest product in a projection: far more than its rounding error.
_MARGIN = 1e-13
# Smaller products may have underflowed.
_TINY = 1e-290


def intersecting_pairs(vertices: Floats, faces: Ints) -> Longs:
    """The pairs (k, 2) of faces that intersect, the lower index first, in order.

    Parameters
    ----------
    vertices : (n, 3), no two of them at one position.
    faces : (m, 3), each with three different vertices, none degenerate.
    """
    found = [np.empty((0, 2), dtype=np.int64)]
    for i, j in near_pairs(vertices[faces]):
        for start in range(0, len(i), AT_ONCE):
            pairs = np.stack((i[start : start + AT_ONCE], j[start : start + AT_ONCE]), axis=1)
            found += (pairs[chosen] for chosen in _intersecting(vertices, faces, pairs))
    pairs = np.sort(np.concatenate(found), axis=1)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def _intersecting(vertices: Floats, faces: Ints, pairs: Longs) -> Iterator[Longs]:
    """Indices into ``pairs`` (k, 2) of those that intersect."""
    first, second = faces[pairs[:, 0]], faces[pairs[:, 1]]
    # Whether each corner (k, 3) of one is a corner of the other.
    in_second = np.zeros(first.shape, dtype=np.bool_)
    in_first = np.zeros(first.shape, dtype=np.bool_)
    for a in range(3):
        for b in range(3):
            same = first[:, a] == second[:, b]
            in_second[:, a] |= same
            in_first[:, b] |= same
    shared = in_second.sum(axis=1)
    for count, decide in ((0, _apart), (1, _at_a_vertex), (2, _at_an_edge)):
        which = np.flatnonzero(shared == count)
        if not len(which):
            continue
        turned = _turn(first[which], in_second[which], count)
        other = _turn(second[which], in_first[which], count)
        yield which[decide(vertices, turned, other)]
    # Faces with three common vertices coincide.
    yield np.flatnonzero(shared == 3)


def _turn(corners: Ints, is_shared: Flags, count: int) -> Ints:
    """Triangles (k, 3) rotated so that a single shared corner is the first one, or the only corner
    that is not shared the last one."""
    if count == 0:
        return corners
    start = np.argmax(is_shared, axis=1) if count == 1 else np.argmin(is_shared, axis=1) + 1
    return np.take_along_axis(corners, (start[:, None] + np.arange(3)) % 3, axis=1)


def _apart(vertices: Floats, first: Ints, second: Ints) -> Flags:
    """Whether triangles without a common vertex meet."""
    edges = (0, 1), (1, 2), (2, 0)
    return _edges_meet(_points(vertices, first), _points(vertices, second), edges)


def _at_a_vertex(vertices: Floats, first: Ints, second: Ints) -> Longs:
    """Indices of the triangles with the same first corner that meet elsewhere too."""
    kept = np.flatnonzero(~_separated_at_a_vertex(vertices, first, second))
    a, b = _points(vertices, first[kept]), _points(vertices, second[kept])
    return kept[_edges_meet(a, b, ((1, 2),))]


def _at_an_edge(vertices: Floats, first: Ints, second: Ints) -> Longs:
    """Indices of the triangles with the same first two corners, in any order, that are folded
    together."""
    p, q, a = _points(vertices, first)
    b = vertices[second[:, 2]]
    # Nearly all open by more than a right angle; the others are decided exactly.
    edge, to_a, to_b = (q - p).T, (a - p).T, (b - p).T
    opening = _dot(to_a, to_b) * _dot(edge, edge) - _dot(to_a, edge) * _dot(to_b, edge)
    size = np.abs([edge, to_a, to_b]).max(axis=(0, 1))
    kept = np.flatnonzero(~(opening < -_MARGIN * size**4))
    kept = kept[space_signs(p[kept], q[kept], a[kept], b[kept]) == 0]
    p, q, a, b = (_flatten(points[kept], _drop(p, q, a, kept)) for points in (p, q, a, b))
    folded: Longs = kept[plane_signs(p, q, a) == plane_signs(p, q, b)]
    return folded


def _edges_meet(a: list[Floats], b: list[Floats], edges: Sequence[tuple[int, int]]) -> Flags:
    """Whether any of the ``edges``, given by corners, of a triangle of either list meets the
    other."""
    meets = np.zeros(len(a[0]), dtype=np.bool_)
    for moving, other in ((a, b), (b, a)):
        for start, end in edges:
            rest = np.flatnonzero(~meets)
            triangle = [corner[rest] for corner in other]
            meets[rest] = _segments_meet(moving[start][rest], moving[end][rest], triangle)
    return meets


def _segments_meet(p: Floats, q: Floats, triangle: list[Floats]) -> Flags:
    """Whether segments pq, points (n, 3), have a point in common with their triangles."""
    a, b, c = triangle
    at_p, at_q = space_signs(a, b, c, p), space_signs(a, b, c, q)
    meets = np.zeros(len(p), dtype=np.bool_)
    is_within = (at_p == 0) & (at_q == 0)
    through = np.flatnonzero((at_p * at_q <= 0) & ~is_within)
    if len(through):
        line = p[through], q[through]
        sides = [space_signs(*line, s[through], e[through]) for s, e in ((a, b), (b, c), (c, a))]
        meets[through] = _have_one_sign(sides)
    within = np.flatnonzero(is_within)
    if len(within):
        axes = _drop(a, b, c, within)
        flat = [_flatten(points[within], axes) for points in (p, q, a, b, c)]
        meets[within] = _flat_segments_meet(flat[0], flat[1], flat[2:])
    return meets


def _flat_segments_meet(p: Floats, q: Floats, triangle: list[Floats]) -> Flags:
    """As ``_segments_meet`` in a plane, points (n, 2): p is inside, or pq meets an edge."""
    edges = [(triangle[k], triangle[(k + 1) % 3]) for k in range(3)]
    meets = _have_one_sign([plane_signs(a, b, p) for a, b in edges])
    for a, b in edges:
        sides = (plane_signs(p, q, a) * plane_signs(p, q, b)) <= 0
        ends = (plane_signs(a, b, p) * plane_signs(a, b, q)) <= 0
        # Both hold for collinear segments, which meet if their boxes do.
        low = np.maximum(np.minimum(p, q), np.minimum(a, b))
        high = np.minimum(np.maximum(p, q), np.maximum(a, b))
        meets |= sides & ends & (low <= high).all(axis=1)
    return meets


def _have_one_sign(signs: list[NDArray[np.int8]]) -> Flags:
    """Whether no two signs are opposite."""
    least, most = np.minimum.reduce(signs), np.maximum.reduce(signs)
    have_one: Flags = (least >= 0) | (most <= 0)
    return have_one


def _drop(a: Floats, b: Floats, c: Floats, which: Longs) -> Longs:
    """The axis (k,) along which the projection of a triangle is largest, and so not degenerate."""
    normals = np.cross(b[which] - a[which], c[which] - a[which])
    axes: Longs = np.argmax(np.abs(normals), axis=1)
    return axes


def _flatten(points: Floats, axes: Longs) -> Floats:
    """Points (n, 3) without the coordinate of their axis (n,)."""
    kept = (axes[:, None] + np.array([1, 2])) % 3
    return np.take_along_axis(points, kept, axis=1)


def _points(vertices: Floats, corners: Ints) -> list[Floats]:
    return [vertices[corners[:, k]] for k in range(3)]


def _dot(u: Any, v: Any) -> Floats:
    products: Floats = u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
    return products


def _cross(u: Vectors, v: Vectors) -> Vectors:
    return (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])


def _separated_at_a_vertex(vertices: Floats, first: Ints, second: Ints) -> Flags:
    """Whether triangles with the same first corner surely have nothing else in common.

    A plane through the corner either has one triangle on one side and contains the other, or
    contains an edge of each and has the rest of the two on opposite sides.
    """
    origin = vertices[first[:, 0]].T
    left, right = (
        [tuple(vertices[corners[:, k]].T - origin) for k in (1, 2)] for corners in (first, second)
    )
    size = np.abs([*left, *right]).max(axis=(0, 1))
    apart = np.zeros(len(first), dtype=np.bool_)
    for (u, v), (s, t) in ((left, right), (right, left)):
        normal = _cross(u, v)
        margin = _margin(size, 3)
        low, high = np.sort((_dot(normal, s), _dot(normal, t)), axis=0)
        apart |= (low > margin) | (high < -margin)
        margin = _margin(size, 4)
        for axis, sign in ((_cross(normal, u), 1.0), (_cross(normal, v), -1.0)):
            # The triangle itself is where sign times the projection is not negative.
            apart |= (sign * _dot(axis, s) < -margin) & (sign * _dot(axis, t) < -margin)
    margin = _margin(size, 3)
    for u, v in (left, left[::-1]):
        for s, t in (right, right[::-1]):
            axis = _cross(u, s)
            here, there = _dot(axis, v), _dot(axis, t)
            apart |= (here > margin) & (there < -margin) | (here < -margin) & (there > margin)
    return apart


def _margin(size: Floats, power: int) -> Floats:
    return _MARGIN * size**power + _TINY


Signs = NDArray[np.int8]

# Relative to the permanent; somewhat more than the 7.8e-16 and 3.4e-16 of the paper.
_SPACE_ERROR = 1e-15
_PLANE_ERROR = 5e-16


def space_signs(a: Floats, b: Floats, c: Floats, d: Floats) -> Signs:
    """The sign of (b - a) x (c - a) . (d - a) for points (n, 3): 1 where d is on the side of the
    plane abc from which a, b, c run counter-clockwise, 0 where it is in the plane."""
    return _signs(_space_determinants, _SPACE_ERROR, a, b, c, d)


def plane_signs(a: Floats, b: Floats, c: Floats) -> Signs:
    """The sign of the area of triangles abc for points (n, 2): 1 counter-clockwise, 0 collinear."""
    return _signs(_plane_determinants, _PLANE_ERROR, a, b, c)


def _signs(determinants: Callable[..., tuple[Any, Any]], error: float, *points: Floats) -> Signs:
    """The exact signs of the ``determinants`` of vectors from the first points to the others."""
    origin, *others = points
    det, permanent = determinants(*(point - origin for point in others))
    signs: Signs = np.sign(det).astype(np.int8)
    unsure = np.flatnonzero(~(np.abs(det) > error * permanent + _TINY))
    if len(unsure):
        origin, *others = _whole_numbers(*(point[unsure] for point in points))
        exact, _ = determinants(*(point - origin for point in others))
        signs[unsure] = (exact > 0).astype(np.int8) - (exact < 0).astype(np.int8)
    return signs


def _space_determinants(u: Any, v: Any, w: Any) -> tuple[Any, Any]:
    """The determinants of rows u, v, w (n, 3), and their permanents, the sums of absolute terms."""
    ux, uy, uz = u.T
    vx, vy, vz = v.T
    wx, wy, wz = w.T
    yz, zy, zx, xz, xy, yx = uy * vz, uz * vy, uz * vx, ux * vz, ux * vy, uy * vx
    det = (yz - zy) * wx + (zx - xz) * wy + (xy - yx) * wz
    permanent = (
        (abs(yz) + abs(zy)) * abs(wx)
        + (abs(zx) + abs(xz)) * abs(wy)
        + (abs(xy) + abs(yx)) * abs(wz)
    )
    return det, permanent


def _plane_determinants(u: Any, v: Any) -> tuple[Any, Any]:
    left, right = u[:, 0] * v[:, 1], u[:, 1] * v[:, 0]
    return left - right, abs(left) + abs(right)


def _whole_numbers(*points: Floats) -> NDArray[Any]:
    """The points times a common power of two, as Python integers."""
    coordinates = np.stack(points)
    mantissas, exponents = np.frexp(coordinates)
    numbers = np.ldexp(mantissas, 53).astype(np.int64)
    exponents = np.where(numbers == 0, exponents.max(), exponents)
    shifts = exponents - exponents.min()
    whole: NDArray[Any] = np.left_shift(numbers.astype(object), shifts.astype(object))
    return whole
