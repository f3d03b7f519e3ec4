"""Eight numbers of single precision that are worked on at a time: the lanes of vector code.

Loops over arrays become vector code as the compiler sees fit, and sums that are kept in arrays are
loaded and stored for every term.  Kernels that say ``Lanes`` of what they add keep it in registers.
``+``, ``-``, ``*`` and ``/`` go lane by lane; the functions here do the rest.  ``kernel_build``
puts machine code in their place; as Python, lanes are arrays (8,).

No number depends on another lane, so that no bit depends on how many lanes a processor has.
"""

from typing import Any

import numpy as np

LANES = np.uint64(8)

_COLUMNS = np.arange(4)


def fill_lanes(value: Any) -> Any:
    """The same number in all lanes."""
    return np.full(8, value, dtype=np.float32)


def load_lanes(array: Any, at: Any) -> Any:
    """The eight numbers of ``array``, flat, from the place ``at`` on."""
    return array[at : at + LANES].copy()


def store_lanes(array: Any, at: Any, lanes: Any) -> None:
    """Write ``lanes`` to ``array``, flat, from the place ``at`` on."""
    array[at : at + LANES] = lanes


def load_rows(numbers: Any, at: Any) -> Any:
    """The eight numbers of rows (uint32) from the place ``at`` on."""
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
"""The places of arguments that are written to."""
