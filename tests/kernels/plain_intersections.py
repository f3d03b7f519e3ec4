"""Which triangles intersect, by fractions, for all whose boxes overlap: slow, exact, plain."""

from fractions import Fraction

import numpy as np


def minus(a, b):
    return [x - y for x, y in zip(a, b, strict=True)]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def sign(x):
    return (x > 0) - (x < 0)


def in_space(a, b, c, d):
    return sign(dot(cross(minus(b, a), minus(c, a)), minus(d, a)))


def in_plane(a, b, c):
    return sign((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def segments_meet(p, q, a, b):
    """Segments in a plane."""
    signs = [in_plane(p, q, a), in_plane(p, q, b), in_plane(a, b, p), in_plane(a, b, q)]
    if signs == [0, 0, 0, 0]:
        return all(
            max(min(p[k], q[k]), min(a[k], b[k])) <= min(max(p[k], q[k]), max(a[k], b[k]))
            for k in (0, 1)
        )
    return signs[0] * signs[1] <= 0 and signs[2] * signs[3] <= 0


def meets(p, q, triangle):
    """Whether a segment has a point in common with a triangle."""
    a, b, c = triangle
    sides = in_space(a, b, c, p), in_space(a, b, c, q)
    if sides != (0, 0):
        around = {in_space(p, q, *edge) for edge in ((a, b), (b, c), (c, a))}
        return sides[0] * sides[1] <= 0 and not {1, -1} <= around
    normal = [abs(x) for x in cross(minus(b, a), minus(c, a))]
    kept = [k for k in range(3) if k != normal.index(max(normal))]
    p, q, a, b, c = ([point[k] for k in kept] for point in (p, q, a, b, c))
    edges = (a, b), (b, c), (c, a)
    is_inside = not {1, -1} <= {in_plane(*edge, p) for edge in edges}
    return is_inside or any(segments_meet(p, q, *edge) for edge in edges)


def intersect(points, first, second):
    shared = [corner for corner in first if corner in second]
    triangle, other = [points[k] for k in first], [points[k] for k in second]
    if len(shared) == 3:
        return True
    if len(shared) == 2:
        p, q = (points[k] for k in shared)
        (a,) = (points[k] for k in first if k not in shared)
        (b,) = (points[k] for k in second if k not in shared)
        sides = cross(minus(q, p), minus(a, p)), cross(minus(q, p), minus(b, p))
        return in_space(p, q, a, b) == 0 and dot(*sides) > 0
    if len(shared) == 1:
        across, beyond = (
            [points[k] for k in corners if k not in shared] for corners in (first, second)
        )
        return meets(*across, other) or meets(*beyond, triangle)
    pairs = ((triangle, other), (other, triangle))
    return any(meets(s[k - 1], s[k], t) for s, t in pairs for k in range(3))


def has_area(points, corners):
    a, b, c = (points[k] for k in corners)
    return any(cross(minus(b, a), minus(c, a)))


def exact(vertices):
    return [[Fraction(float(x)) for x in vertex] for vertex in vertices]


def near_pairs(vertices, faces):
    """Pairs whose boxes have a point in common, sorted."""
    corners = np.asarray(vertices, dtype=float)[np.asarray(faces)]
    low, high = corners.min(axis=1), corners.max(axis=1)
    near = ((low[:, None] <= high) & (low <= high[:, None])).all(axis=2)
    return [(int(i), int(j)) for i, j in np.argwhere(np.triu(near, 1))]


def intersecting_pairs(vertices, faces):
    """Sorted pairs of faces that intersect; all faces must have an area."""
    points = exact(vertices)
    corners = [[int(k) for k in face] for face in faces]
    near = near_pairs(vertices, corners)
    return [(i, j) for i, j in near if intersect(points, corners[i], corners[j])]
