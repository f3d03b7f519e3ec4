"""Vectors, triangles and rows, for kernels to call.

Kernels call those of vectors by the module, as in ``vec.dot``: these are inlined before all else.
"""

import numpy as np

from msal_cli.kernels.library import compiled

ZERO, ONE, TWO, THREE = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(3)


@compiled
def longest_row(start, stop, row_start):
    """The most items of a row in a range of rows; of the type of differences of ``row_start``."""
    longest = row_start[start] - row_start[start]
    for i in range(np.int64(start), np.int64(stop)):
        longest = max(longest, row_start[i + 1] - row_start[i])
    return longest


@compiled
def sort_few(values, count):
    """Sort ``values[:count]`` by Shell's method.

    A one-ring is sorted by insertion in effect; the gaps keep a hub of 50,000 affordable.
    """
    gap = 1
    while gap < count // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for at in range(gap, count):
            value = values[at]
            hole = at
            while hole >= gap and values[hole - gap] > value:
                values[hole] = values[hole - gap]
                hole -= gap
            values[hole] = value
        gap //= 3


ORIGIN = (0.0, 0.0, 0.0)
"""The zero vector; a vector is a tuple of three numbers, which the compiler keeps in registers."""


@compiled
def load(x, i):
    """Vector i of ``x``, (n, 3) or flat."""
    if x.ndim == 2:
        return x[i, 0], x[i, 1], x[i, 2]
    at = THREE * np.uint64(i)
    return x[at], x[at + ONE], x[at + TWO]


@compiled
def load_corners(faces, f):
    """The vertices of face f; unsigned, so that none is looked at for being negative."""
    a, b, c = load(faces, f)
    return np.uint64(a), np.uint64(b), np.uint64(c)


@compiled
def store(x, i, v):
    """Write vector i of ``x``, (n, 3) or flat."""
    if x.ndim == 2:
        x[i, 0], x[i, 1], x[i, 2] = v
    else:
        at = THREE * np.uint64(i)
        x[at], x[at + ONE], x[at + TWO] = v


@compiled
def add(u, v):
    """u + v."""
    return u[0] + v[0], u[1] + v[1], u[2] + v[2]


@compiled
def subtract(u, v):
    """u - v."""
    return u[0] - v[0], u[1] - v[1], u[2] - v[2]


@compiled
def offset(x, k, i):
    """x_k - x_i."""
    return subtract(load(x, k), load(x, i))


@compiled
def times(s, v):
    """s v."""
    return s * v[0], s * v[1], s * v[2]


@compiled
def divide(v, s):
    """v / s, which is not always (1 / s) v to the last bit."""
    return v[0] / s, v[1] / s, v[2] / s


@compiled
def add_scaled(u, s, v):
    """u + s v."""
    return u[0] + s * v[0], u[1] + s * v[1], u[2] + s * v[2]


@compiled
def dot(u, v):
    """u . v."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@compiled
def cross(u, v):
    """u x v."""
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@compiled
def norm(v):
    """|v|."""
    return np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


@compiled
def square_distance(u, v):
    """|u - v|^2."""
    difference = subtract(u, v)
    return dot(difference, difference)


@compiled
def is_zero(v):
    """Whether v is the zero vector; without branches."""
    return (v[0] == 0.0) & (v[1] == 0.0) & (v[2] == 0.0)


@compiled
def row_range(row_start, i):
    """The places of row i; unsigned, so that no index is looked at for being negative."""
    own = np.uint64(i)
    return range(np.uint64(row_start[own]), np.uint64(row_start[own + ONE]))


@compiled
def sum_row(x, row_start, row, i):
    """Sum of the vectors of ``x`` that row i names."""
    total = ORIGIN
    for at in row_range(row_start, i):
        total = add(total, load(x, np.uint64(row[at])))
    return total


@compiled
def sum_offsets(x, row_start, row, i):
    """Sum of x_k - x_i over the k that row i names."""
    own, total = load(x, i), ORIGIN
    for at in row_range(row_start, i):
        total = add(total, subtract(load(x, np.uint64(row[at])), own))
    return total


@compiled
def write_unit(v, least, kept, i, result):
    """Write the unit vector of v as vector i of ``result``; where v is no longer than ``least``,
    that of ``kept``."""
    size = norm(v)
    store(result, i, divide(v, size) if size > least else load(kept, i))


@compiled
def edges_and_normal(x, a, b, c):
    """Edges u = x_b - x_a and w = x_c - x_a of a triangle, and u x w: twice its area long."""
    origin = load(x, a)
    u, w = subtract(load(x, b), origin), subtract(load(x, c), origin)
    return u, w, cross(u, w)


@compiled
def longest_square(u, w):
    """The squared length of the longest edge of a triangle with edges u and w from one corner."""
    v = subtract(w, u)
    return max(dot(u, u), dot(w, w), dot(v, v))
