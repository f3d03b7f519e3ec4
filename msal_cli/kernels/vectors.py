"""Vectors, triangles, rows, exponentials and arctangents, called by kernels.

Kernels call functions of vectors through the module, as in ``vec.dot``; these are inlined first.
"""

import numpy as np

from msal_cli.kernels.library import compiled

ZERO, ONE, TWO, THREE = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(3)


@compiled
def longest_row(start, stop, row_start):
    """The length of the longest row in a range, of the type of differences of ``row_start``."""
    longest = row_start[start] - row_start[start]
    for i in range(np.int64(start), np.int64(stop)):
        longest = max(longest, row_start[i + 1] - row_start[i])
    return longest


@compiled
def sort_few(values, count):
    """Sort ``values[:count]`` by Shell's method.

    For a one-ring this is insertion sort; the gaps limit the cost for a valence of 50,000.
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
"""The zero vector; vectors are tuples of three numbers, which the compiler keeps in registers."""


@compiled
def load(x, i):
    """Vector i of ``x``, (n, 3) or flat."""
    if x.ndim == 2:
        return x[i, 0], x[i, 1], x[i, 2]
    at = THREE * np.uint64(i)
    return x[at], x[at + ONE], x[at + TWO]


@compiled
def load_corners(faces, f):
    """The vertices of face f, unsigned, so that they need no test for negative ones."""
    a, b, c = load(faces, f)
    return np.uint64(a), np.uint64(b), np.uint64(c)


@compiled
def after_and_before(faces, f, i):
    """The vertices that follow and precede vertex i in face f.

    Without branches, because which corner of a face a vertex is cannot be predicted.
    """
    a, b, c = load(faces, f)
    return (b if a == i else (c if b == i else a)), (c if a == i else (a if b == i else b))


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
    """v / s, which may differ from (1 / s) v in the last bit."""
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
    """The indices of row i, unsigned, so that they need no test for negative ones."""
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
    """Write the unit vector of v as vector i of ``result``; if v is no longer than ``least``, that
    of ``kept``."""
    size = norm(v)
    store(result, i, divide(v, size) if size > least else load(kept, i))


@compiled
def edges_and_normal(x, a, b, c):
    """Edges u = x_b - x_a and w = x_c - x_a of a triangle, and u x w: its length is twice the
    area."""
    origin = load(x, a)
    u, w = subtract(load(x, b), origin), subtract(load(x, c), origin)
    return u, w, cross(u, w)


@compiled
def longest_square(u, w):
    """The squared length of the longest edge of a triangle with edges u and w from one corner."""
    v = subtract(w, u)
    return max(dot(u, u), dot(w, w), dot(v, v))


# Exponentials and arctangents of many numbers, by arithmetic that becomes vector code.  Functions
# of the standard library are called once per number; loops over a block that stays in the
# first-level cache take a third of the time, and give the same bits on all machines.

# Adding it leaves the nearest integer in the lowest bits of the sum.
_ROUND = 6755399441055744.0  # 1.5 * 2^52

# Coefficients of r ... r^11 in 2^r - 1: the polynomial through zero and the function's values at
# Chebyshev's points of |r| <= 1/2.  It leaves 2^r a relative error of 2e-17.
_P1, _P2, _P3 = 0.6931471805599453, 0.24022650695910097, 0.0555041086648216
_P4, _P5, _P6 = 0.009618129107606888, 0.0013333558146416936, 0.0001540353044173605
_P7, _P8, _P9 = 1.525273382983612e-05, 1.321544258792169e-06, 1.0178062445845774e-07
_P10, _P11 = 7.072585949269223e-09, 4.4549605981865186e-10

LOG2_E = 1.4426950408889634
MIN_POWER = -1010.0
"""Smaller exponents count as this: 2^-1010 is 1e-304."""

_TO_EXPONENT = np.int64(52)


@compiled
def power_of_two(exponent):
    """2 to an exponent not above 1, within about 1 ulp.

    For loops over contiguous numbers, which become vector code.  There is no reduction by a rounded
    ln 2: for exp, multiply a factor of the exponent by ``LOG2_E``.
    """
    t = exponent if exponent > MIN_POWER else MIN_POWER
    rounded = t + _ROUND
    r = t - (rounded - _ROUND)
    # Independent short sums: in one long chain each step would wait for the previous one.
    q = r * r
    q2 = q * q
    p = (r * _P11 + _P10) * q + (r * _P9 + _P8)
    p = p * q2 + ((r * _P7 + _P6) * q + (r * _P5 + _P4))
    p = p * q2 + ((r * _P3 + _P2) * q + r * _P1)
    bits = np.float64(p + 1.0).view(np.int64)
    return np.int64(bits + (np.float64(rounded).view(np.int64) << _TO_EXPONENT)).view(np.float64)


@compiled
def exponentials(values, count):
    """Replace ``values[:count]``, none above zero, by their exponentials."""
    for at in range(count):
        values[at] = power_of_two(LOG2_E * values[at])


@compiled
def arctangents(numerators, denominators, count):
    """Replace ``numerators[:count]`` by the angles of (denominator, numerator), none below zero.

    Angles are in radians, 0 to pi / 2, within some 1e-15; 0 where both are zero.
    """
    for at in range(count):
        y = numerators[at]
        x = denominators[at]
        # The angle from the nearer axis, by a tangent of at most 1.
        low = min(y, x)
        high = max(y, x)
        t = low / (high if high > 0.0 else 1.0)
        # Halved twice, so that the series is short: tan(a / 2) = t / (1 + sqrt(1 + t t)).
        t = t / (1.0 + np.sqrt(1.0 + t * t))
        t = t / (1.0 + np.sqrt(1.0 + t * t))
        s = -t * t
        p = 1.0 / 21.0
        p = p * s + 1.0 / 19.0
        p = p * s + 1.0 / 17.0
        p = p * s + 1.0 / 15.0
        p = p * s + 1.0 / 13.0
        p = p * s + 1.0 / 11.0
        p = p * s + 1.0 / 9.0
        p = p * s + 1.0 / 7.0
        p = p * s + 1.0 / 5.0
        p = p * s + 1.0 / 3.0
        p = p * s + 1.0
        angle = 4.0 * t * p
        numerators[at] = angle if y <= x else 0.5 * np.pi - angle
