"""Groups of eight float32 numbers (lanes), for vector code.

Loops over arrays become vector code only if the compiler chooses so, and sums that are kept in
arrays are loaded and stored for each term.  Kernels that sum lanes keep them in registers.  ``+``,
``-``, ``*`` and ``/`` work lane by lane, as do the functions here.  ``kernel_build`` replaces them
by machine code; in Python, lanes are arrays (8,).

Lanes are independent of each other, so no bit depends on the width of a processor's vectors.
"""

from typing import Any

import numpy as np

from msal_cli.kernels import vectors as vec
from msal_cli.kernels.library import compiled

LANES = np.uint64(8)

_COLUMNS = np.arange(4)
_0, _1, _2, _MINUS = (np.float32(number) for number in (0.0, 1.0, 2.0, -1.0))
_TINY = np.float32(1e-30)


def fill_lanes(value: Any) -> Any:
    """The same number in all lanes."""
    return np.full(8, value, dtype=np.float32)


def load_lanes(array: Any, at: Any) -> Any:
    """The eight numbers of ``array``, flat, from index ``at`` on."""
    return array[at : at + LANES].copy()


def store_lanes(array: Any, at: Any, lanes: Any) -> None:
    """Write ``lanes`` to ``array``, flat, from index ``at`` on."""
    array[at : at + LANES] = lanes


def load_rows(numbers: Any, at: Any) -> Any:
    """Eight row numbers (uint32) from index ``at`` on."""
    return tuple(int(number) for number in numbers[at : at + LANES])


def load_columns(array: Any, rows: Any, width: Any, offset: Any) -> Any:
    """Four numbers of each of eight ``rows``, of ``load_rows``, as four lanes.

    ``array``, flat, has ``width`` numbers a row; the first number is at ``offset`` in it.
    """
    places = np.array(rows) * int(width) + int(offset)
    return tuple(array[places[:, None] + _COLUMNS].T)


def load_offsets(points: Any, rows: Any, others: Any, scales: Any) -> Any:
    """The vectors from the points ``rows`` to ``others`` times the ``scales`` (8,), as three lanes.

    ``points``, flat and in double precision, has three numbers a point and one more at its end.
    """
    places, columns = 3 * np.array((rows, others))[:, :, None], _COLUMNS[:3]
    own, other = points[places + columns]
    return tuple(((other - own) * scales[:8, None]).astype(np.float32).T)


def choose_greater(a: Any, b: Any, yes: Any, no: Any) -> Any:
    """``yes`` in the lanes where a > b, else ``no``."""
    return np.where(a > b, yes, no)


def has_greater(a: Any, b: Any) -> bool:
    """Whether a > b in any lane."""
    return bool((a > b).any())


def root(lanes: Any) -> Any:
    """Square roots."""
    return np.sqrt(lanes)


WRITTEN = {store_lanes: (0,)}
"""Functions by which arguments, at these positions, are written to."""


@compiled
def choose_vector(a, b, yes, no):
    """The vector ``yes`` in the lanes where a > b, else ``no``."""
    return (
        choose_greater(a, b, yes[0], no[0]),
        choose_greater(a, b, yes[1], no[1]),
        choose_greater(a, b, yes[2], no[2]),
    )


# Eigenvectors of eight symmetric 3 x 3 matrices at once, by Jacobi's rotations.

SWEEPS = 4
"""Rounds of three rotations, which leave off-diagonal entries below single precision."""


@compiled
def find_axes(tensor):
    """Unit eigenvectors and eigenvalues, largest first, of a ``tensor`` xx, xy, xz, yy, yz, zz."""
    xx, xy, xz, yy, yz, zz = tensor
    zero, one = fill_lanes(_0), fill_lanes(_1)
    a, b, c = (one, zero, zero), (zero, one, zero), (zero, zero, one)
    for _ in range(SWEEPS):
        xx, yy, xy, xz, yz, a, b = _rotate(xx, yy, xy, xz, yz, a, b)
        xx, zz, xz, xy, yz, a, c = _rotate(xx, zz, xz, xy, yz, a, c)
        yy, zz, yz, xy, xz, b, c = _rotate(yy, zz, yz, xy, xz, b, c)
    xx, yy, a, b = _sort(xx, yy, a, b)
    yy, zz, b, c = _sort(yy, zz, b, c)
    xx, yy, a, b = _sort(xx, yy, a, b)
    return a, b, c, xx, yy, zz


@compiled
def _rotate(p, q, off, rest_p, rest_q, first, second):
    """A Jacobi rotation of two axes, by the smaller angle that makes ``off`` zero.

    ``p`` and ``q`` are their diagonal entries, ``off`` is their off-diagonal entry, ``rest_p`` and
    ``rest_q`` are those with the third axis.
    """
    zero, one, minus = fill_lanes(_0), fill_lanes(_1), fill_lanes(_MINUS)
    gap = q - p
    size = choose_greater(zero, gap, gap * minus, gap)
    double = fill_lanes(_2) * off
    t = double / (size + root(gap * gap + double * double) + fill_lanes(_TINY))
    t = choose_greater(zero, gap, t * minus, t)
    c = one / root(one + t * t)
    s = t * c
    change = t * off
    rests = c * rest_p - s * rest_q, s * rest_p + c * rest_q
    turned = vec.subtract(vec.times(c, first), vec.times(s, second))
    second = vec.add(vec.times(s, first), vec.times(c, second))
    return p - change, q + change, zero, rests[0], rests[1], turned, second


@compiled
def _sort(p, q, first, second):
    """Two eigenvalues and their axes, the larger first."""
    greater, less = choose_greater(q, p, q, p), choose_greater(q, p, p, q)
    return greater, less, choose_vector(q, p, second, first), choose_vector(q, p, first, second)
