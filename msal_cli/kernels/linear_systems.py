"""Large sparse systems A X = B with three right-hand sides, A symmetric and positive definite.

They are solved by conjugate gradients with the diagonal as preconditioner.  The three columns are
one system of 3 n unknowns with common step lengths, so that an early stop does not depend on the
orientation of the axes, and a column that is solved early does not divide by zero.

In He and Schaefer's L0 minimisation, two quantities of each flap, an edge (p1, p3) with its faces
(p1, p2, p3) and (p1, p3, p4), are linear in the positions once their coefficients are fixed:

    D = c1 p1 + c2 p2 + c3 p3 + c4 p4      zero if the flap is flat
    R = p1 - p2 + p3 - p4                  zero if it is a parallelogram
"""

from collections.abc import Callable

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.connectivity import index_rows
from msal_cli.kernels.library import compiled
from msal_cli.kernels.parallel import over_ranges
from msal_cli.light_dataclass import dataclass

CHUNK = 4096
"""Rows in a chunk; sums over chunks do not depend on how threads share them."""


@compiled
def _product(start, stop, diagonal, row_start, columns, values, x, product):
    for i in range(start, stop):
        total = vec.times(diagonal[i], vec.load(x, i))
        for at in range(row_start[i], row_start[i + 1]):
            # Unsigned indices need no test for negative ones, which takes a quarter of the time.
            total = vec.add_scaled(total, values[at], vec.load(x, np.uint64(columns[at])))
        vec.store(product, i, total)


@dataclass(frozen=True, eq=False)
class RowMatrix:
    """A sparse matrix in CSR form with a separate diagonal, so that one-rings can be its rows."""

    diagonal: Floats  # (n,)
    # row_start, columns, values: the other entries, (n + 1,), (e,) and (e,).  Entries of the
    # diagonal among them are added to it
    row_start: Ints
    columns: Ints
    values: Floats

    def times(self, x: Floats, product: Floats) -> None:
        """Write A x into ``product``; both (n, 3), not the same array."""
        rows = self.row_start, self.columns, self.values
        over_ranges(_product, len(self.diagonal), self.diagonal, *rows, x, product)


# A range of rows processes the whole chunks whose first row it contains.


@compiled
def _dot(start, stop, a, b, sums):
    for chunk in range(-(-start // CHUNK), -(-stop // CHUNK)):
        total = 0.0
        for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(a))):
            total += vec.dot(vec.load(a, i), vec.load(b, i))
        sums[chunk] = total


@compiled
def _step(start, stop, length, p, q, inverse, x, r, sums):
    """Update x and r by a step of this length along p, q = A p; sums of r . r / diagonal."""
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
        direction = vec.times(inverse[i], vec.load(r, i))
        vec.store(p, i, vec.add_scaled(direction, share, vec.load(p, i)))


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

    The residual R = ``right`` - A X is measured as sqrt(sum(R^2 / d) / sum(d)) with the diagonal d:
    the root mean square, weighted by d, of R / d, which is about the error of X.  It has the unit
    of X and does not depend on the scale of A.

    Parameters
    ----------
    diagonal, times : d (n,), and a function that writes A X into its second argument, both (n, 3)
        and not the same array.
    tolerance : the residual at which the run ends; the unit of X.
    most_iterations : largest number of iterations.
    held : (n,) bool, True for rows whose X stays that of ``start``, which is data for the other
        rows.  Rows whose diagonal is not positive stay as well.
    on_iteration : called after each iteration; an exception that it raises ends the run.
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


# L0 minimisation of bent edges

MAX_COEFFICIENT = 100.0
"""Larger coefficients, of flaps with a needle, are scaled down, because they would dominate."""


@compiled
def _bends(start, stop, x, corners, threshold, coefficients, deltas):
    """c by areas as in He & Schaefer, section 3.2; s_one is twice S134, s_two is twice S123."""
    for e in range(start, stop):
        p1, p2, p3, p4 = corners[e, 0], corners[e, 1], corners[e, 2], corners[e, 3]
        b, edge, m = vec.edges_and_normal(x, p1, p2, p3)
        _, d, n = vec.edges_and_normal(x, p1, p3, p4)
        s_two, s_one = vec.norm(m), vec.norm(n)
        square = vec.dot(edge, edge)
        both = s_one + s_two
        if both == 0.0 or square == 0.0:
            continue
        # Projections of the opposite vertices on the edge, from 0 at p1 to 1 at p3.
        at_two = vec.dot(b, edge) / square
        at_four = vec.dot(d, edge) / square
        c2 = s_one / both
        c4 = s_two / both
        c3 = -(c2 * at_two + c4 * at_four)
        c1 = -1.0 - c3
        scale = MAX_COEFFICIENT / max(abs(c1), abs(c3), MAX_COEFFICIENT)
        c1, c2, c3, c4 = scale * c1, scale * c2, scale * c3, scale * c4
        coefficients[e, 0], coefficients[e, 1], coefficients[e, 2] = c1, c2, c3
        coefficients[e, 3] = c4
        # With p1 as origin the sum is as exact as the edges are.
        delta = vec.add_scaled(vec.add_scaled(vec.times(c3, edge), c2, b), c4, d)
        if vec.dot(delta, delta) >= threshold:
            vec.store(deltas, e, delta)


@compiled
def _pattern(corners, start, incident, row_start, columns, slots):
    """The columns of each row, and the index in it of each corner of each incident flap."""
    n = len(start) - 1
    slot = np.full(n, -1, dtype=np.int32)
    total = 0
    for i in range(n):
        row = total
        for at in range(start[i], start[i + 1]):
            e = incident[at] // 4
            for place in range(4):
                k = corners[e, place]
                if k == i:
                    slots[at, place] = -1
                    continue
                if slot[k] < row:
                    slot[k] = total
                    columns[total] = k
                    total += 1
                slots[at, place] = slot[k]
        row_start[i + 1] = total
    return total


@compiled
def _assemble(
    start,
    stop,
    coefficients,
    deltas,
    alpha,
    beta,
    flap_start,
    incident,
    slots,
    row_start,
    diagonal,
    values,
    pulls,
):
    for i in range(start, stop):
        for at in range(row_start[i], row_start[i + 1]):
            values[at] = 0.0
        own = 1.0
        pull = vec.ORIGIN
        for at in range(flap_start[i], flap_start[i + 1]):
            e = incident[at] // 4
            place = incident[at] % 4
            scaled = beta * coefficients[e, place]
            for other in range(4):
                sign = alpha if (place + other) % 2 == 0 else -alpha
                value = scaled * coefficients[e, other] + sign
                s = slots[at, other]
                if s < 0:
                    own += value
                else:
                    values[s] += value
            pull = vec.add_scaled(pull, scaled, vec.load(deltas, e))
        diagonal[i] = own
        vec.store(pulls, i, pull)


@dataclass(frozen=True, eq=False)
class EdgeSparsity:
    """The quadratic part |p - p*|^2 + alpha |R|^2 + beta |D - delta|^2 over the flaps of a mesh."""

    corners: Ints  # (e, 4), p1 to p4 of each flap
    # flap_start, incident: the flaps around each vertex in CSR form, (n + 1,) and (4 e,), as 4
    # times the number of the flap plus the position of the vertex in it
    flap_start: Ints
    incident: Ints
    row_start: Ints  # row_start, columns: pattern of the matrix, (n + 1,) and (k,)
    columns: Ints
    # (4 e, 4), for each entry of ``incident`` the indices into ``columns`` of the four corners of
    # the flap; -1 for the vertex itself
    slots: Ints

    def bent(self, positions: Floats, threshold: float) -> tuple[Floats, Floats]:
        """Coefficients c (e, 4) at ``positions`` (n, 3), and delta (e, 3).

        delta = D where |D|^2 is at least ``threshold``, in squared units, and zero elsewhere.  The
        coefficients of a flap without area or whose edge has no length are zero.
        """
        coefficients = np.zeros((len(self.corners), 4))
        deltas = np.zeros((len(self.corners), 3))
        results = coefficients, deltas
        over_ranges(_bends, len(self.corners), positions, self.corners, threshold, *results)
        return results

    def system(
        self, coefficients: Floats, deltas: Floats, alpha: float, beta: float
    ) -> tuple[RowMatrix, Floats]:
        """The matrix I + alpha R'R + beta D'D, and beta D' delta (n, 3)."""
        n = len(self.flap_start) - 1
        diagonal = np.empty(n)
        values = np.empty(len(self.columns))
        pulls = np.empty((n, 3))
        rows = self.flap_start, self.incident, self.slots, self.row_start
        results = diagonal, values, pulls
        over_ranges(_assemble, n, coefficients, deltas, alpha, beta, *rows, *results)
        return RowMatrix(diagonal, self.row_start, self.columns, values), pulls


def edge_sparsity(n_vertices: int, corners: Ints) -> EdgeSparsity:
    """Prepare the pattern for ``corners`` (e, 4), the flaps of a mesh with ``n_vertices``."""
    flap_start, incident = index_rows(n_vertices, corners, 4, 1)
    row_start = np.zeros(n_vertices + 1, dtype=np.int32)
    columns = np.empty(12 * len(corners), dtype=np.int32)
    slots = np.empty((4 * len(corners), 4), dtype=np.int32)
    total = _pattern(corners, flap_start, incident, row_start, columns, slots)
    return EdgeSparsity(corners, flap_start, incident, row_start, columns[:total].copy(), slots)
