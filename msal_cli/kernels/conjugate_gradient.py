"""Large symmetric positive definite systems A X = B with three right-hand sides.

Conjugate gradients with the diagonal as preconditioner.  The three columns are one system of 3 n
unknowns that share every step length, so that a solution turns with the axes whenever it is
stopped, and a column that is solved early divides by nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.library import compiled
from msal_cli.kernels.parallel import over_ranges

CHUNK = 4096
"""Rows that are summed up together: sums over chunks do not depend on how threads share them."""


@compiled
def _product(start, stop, diagonal, row_start, columns, values, x, product):
    for i in range(start, stop):
        total = vec.times(diagonal[i], vec.load(x, i))
        for at in range(row_start[i], row_start[i + 1]):
            # Unsigned, so that no index is looked at for being negative: a quarter of the time.
            total = vec.add_scaled(total, values[at], vec.load(x, np.uint64(columns[at])))
        vec.store(product, i, total)


@dataclass(frozen=True, eq=False)
class RowMatrix:
    """A sparse matrix in compressed rows, its diagonal apart, so that one-rings can be its rows."""

    diagonal: Floats  # (n,)
    # row_start, columns, values: the rest, (n + 1,), (e,) and (e,); row i has the ``values`` from
    # ``row_start[i]`` to ``row_start[i + 1]``.  An entry of the diagonal may be there as well; it
    # is added
    row_start: Ints
    columns: Ints
    values: Floats

    def times(self, x: Floats, product: Floats) -> None:
        """Write A x into ``product``; both (n, 3), not the same array."""
        rows = self.row_start, self.columns, self.values
        over_ranges(_product, len(self.diagonal), self.diagonal, *rows, x, product)


# A range of rows works on the chunks whose first row it holds, as a whole.


@compiled
def _dot(start, stop, a, b, sums):
    for chunk in range(-(-start // CHUNK), -(-stop // CHUNK)):
        total = 0.0
        for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(a))):
            total += vec.dot(vec.load(a, i), vec.load(b, i))
        sums[chunk] = total


@compiled
def _step(start, stop, length, p, q, inverse, x, r, sums):
    """x and r after a step of that length along p, q = A p; sums of r . r / diagonal."""
    for chunk in range(-(-start // CHUNK), -(-stop // CHUNK)):
        total = 0.0
        for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(x))):
            vec.store(x, i, vec.add_scaled(vec.load(x, i), length, vec.load(p, i)))
            rest = vec.add_scaled(vec.load(r, i), -length, vec.load(q, i))
            vec.store(r, i, rest)
            total += inverse[i] * vec.dot(rest, rest)
        sums[chunk] = total


@compiled
def _turn(start, stop, share, r, inverse, p):
    for i in range(start, stop):
        way = vec.times(inverse[i], vec.load(r, i))
        vec.store(p, i, vec.add_scaled(way, share, vec.load(p, i)))


def conjugate_gradients(
    diagonal: Floats,
    times: Callable[[Floats, Floats], None],
    right: Floats,
    start: Floats,
    *,
    tolerance: float,
    most_iterations: int,
    held: Flags | None = None,
    on_iteration: Callable[[], object] = lambda: None,
) -> Floats:
    """X (n, 3) of A X = ``right`` from ``start`` (both (n, 3), neither is changed).

    The residual R = ``right`` - A X is measured as sqrt(sum(R^2 / d) / sum(d)) with the diagonal
    d: the root mean square, weighted by d, of R / d, which is about how far the entries of X have
    yet to go.  It has the unit of X and does not depend on the scale of A.

    Parameters
    ----------
    diagonal, times : d (n,), and what writes A X into its second argument, both (n, 3) and not the
        same array.
    tolerance : the run ends when the residual is at most this; the unit of X.
    most_iterations : the run ends here at the latest.
    held : (n,) bool, True for rows whose X is given by ``start`` and stays: the other rows are
        solved with them as data.  Rows whose diagonal is not positive stay as well.
    on_iteration : called after every iteration; what it raises ends the run.
    """
    n = len(diagonal)
    usable = diagonal > 0.0
    if held is not None:
        usable &= ~held
    weights = np.where(usable, diagonal, 0.0)
    inverse = np.where(usable, 1.0 / np.where(usable, diagonal, 1.0), 0.0)
    sums = np.zeros(-(-n // CHUNK))
    total_weight = float(weights.sum())

    x = np.array(start, dtype=np.float64, order="C")
    q = np.empty_like(x)
    times(x, q)
    r = np.ascontiguousarray(right - q)
    p = np.zeros_like(x)

    # In one thread and over one array, numpy's pairwise sum has a fixed order.
    square = float((inverse * (r * r).sum(axis=1)).sum())
    previous = 0.0
    for done in range(most_iterations if total_weight > 0.0 else 0):
        if not np.sqrt(square / total_weight) > tolerance:
            break
        over_ranges(_turn, n, square / previous if done else 0.0, r, inverse, p)
        times(p, q)
        over_ranges(_dot, n, p, q, sums)
        curvature = float(sums.sum())
        if not curvature > 0.0:  # rounding, or A is not positive definite: no way down from here
            break
        previous = square
        over_ranges(_step, n, square / curvature, p, q, inverse, x, r, sums)
        square = float(sums.sum())
        on_iteration()
    return x
