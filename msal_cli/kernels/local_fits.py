"""Polynomials fitted to the surface around single vertices, and what they leave over.

A smooth surface is nearly a polynomial over a few vertices, and noise is not: of white noise a fit
leaves the share that its degrees of freedom tell, however the vertices lie.
"""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.parallel import over_ranges

MOST_VERTICES = 40
"""Vertices of a patch at most; those further out are left out."""

FEWEST_PATCHES = 256
"""Patches for which a thread of its own is worth starting."""

PLANE_TERMS, QUADRIC_TERMS, CUBIC_TERMS, SEXTIC_TERMS = 3, 6, 10, 28
"""Monomials in two variables up to degree 1, 2, 3 and 6; products of two cubic ones have six."""

HEIGHT, VERTEX, WIDTH = 10, 11, 12
"""Rows and columns of the normal equations after the monomials', and how many there are: for the
heights, and for the value at the vertex that the patch is around."""

DEPENDENT = 1e-8
"""What is left of a monomial's sum of squares beside the others, relative to all of it, at and
below which the patch cannot tell them apart."""

ROUNDING = 1e-13
"""What is left of the heights' sum of squares, relative to all of it, at and below which it is
rounding; where the heights themselves are, 1e-22 of the patch's."""

FEWEST_FREEDOMS = 5
"""Degrees of freedom above which a single vertex can be held against the others."""

MOST_LEVERAGE = 0.95
"""Pull of a vertex on its own fit above which nothing is left of its noise to judge it by."""


@compiled
def _patch(i, rings, ring_start, ring, found):
    """Collect vertex i and those at most ``rings`` edges away, nearest first; how many they are."""
    found[0] = i
    count = 1
    first = 0
    for _ in range(rings):
        last = count
        for at in range(first, last):
            j = found[at]
            for place in range(ring_start[j], ring_start[j + 1]):
                k = ring[place]
                is_new = True
                for other in range(count):
                    if found[other] == k:
                        is_new = False
                        break
                if is_new:
                    if count == len(found):
                        return count
                    found[count] = k
                    count += 1
        first = last
    return count


@compiled
def fill_monomials(u, w, terms):
    """1, u, w, uu, uw, ww, uuu ... in ``terms``, up to degree 6."""
    terms[0] = 1.0
    before, at = 0, 1
    for degree in range(1, 7):
        terms[at] = terms[before] * u
        for k in range(degree):
            terms[at + 1 + k] = terms[before + k] * w
        before = at
        at += degree + 1


@compiled
def begin_equations(sums, along, squares, first, terms, equations):
    """Set up the normal equations: ``sums`` of monomials, of their products with the heights
    (``along``), and of those' ``squares``; the ``first`` height stands at the monomials ``terms``.
    """
    row = 0
    for degree in range(4):
        for k in range(degree + 1):
            column = 0
            for other in range(4):
                both = degree + other
                place = both * (both + 1) // 2 + k
                for m in range(other + 1):
                    equations[row, column] = sums[place + m]
                    column += 1
            equations[row, HEIGHT] = along[row]
            equations[row, VERTEX] = terms[row]
            row += 1
    equations[HEIGHT, HEIGHT] = squares
    equations[HEIGHT, VERTEX] = first
    equations[VERTEX, VERTEX] = 0.0


@compiled
def eliminate(equations, sums_of_squares, first, last):
    """Eliminate the monomials ``first`` ... ``last``, above the diagonal; how many of them the
    patch can tell apart.  What is left of the heights stands in their rows then."""
    rank = 0
    for pivot in range(first, last):
        if equations[pivot, pivot] <= DEPENDENT * sums_of_squares[pivot]:
            continue
        scale = 1.0 / equations[pivot, pivot]
        for row in range(pivot + 1, WIDTH):
            factor = equations[pivot, row] * scale
            for column in range(row, WIDTH):
                equations[row, column] -= factor * equations[pivot, column]
        rank += 1
    return rank


@compiled
def _fitted(
    start, stop, chosen, vertices, normals, ring_start, ring, variances, freedoms, gaps, ratios
):
    found = np.empty(MOST_VERTICES, dtype=np.int64)
    terms, first_terms = np.empty(SEXTIC_TERMS), np.empty(SEXTIC_TERMS)
    sums, along = np.empty(SEXTIC_TERMS), np.empty(CUBIC_TERMS)
    equations, own = np.empty((WIDTH, WIDTH)), np.empty(CUBIC_TERMS)
    for at in range(start, stop):
        for fit in range(4):
            variances[at, fit] = 0.0
            freedoms[at, fit] = 0
        gaps[at] = 0.0
        ratios[at] = -1.0
        i = chosen[at]
        near = 1 + ring_start[i + 1] - ring_start[i]
        count = _patch(i, 2, ring_start, ring, found)
        near = min(near, count)
        nx = ny = nz = mx = my = mz = 0.0
        for a in range(count):
            k = found[a]
            nx += normals[k, 0]
            ny += normals[k, 1]
            nz += normals[k, 2]
            mx += vertices[k, 0]
            my += vertices[k, 1]
            mz += vertices[k, 2]
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length <= 1e-10 * count:
            continue
        nx, ny, nz = nx / length, ny / length, nz / length
        mx, my, mz = mx / count, my / count, mz / count
        # Two directions across the normal, from the axis that it leans to least.
        if abs(nx) <= abs(ny) and abs(nx) <= abs(nz):
            ux, uy, uz = 0.0, nz, -ny
        elif abs(ny) <= abs(nz):
            ux, uy, uz = -nz, 0.0, nx
        else:
            ux, uy, uz = ny, -nx, 0.0
        length = np.sqrt(ux * ux + uy * uy + uz * uz)
        ux, uy, uz = ux / length, uy / length, uz / length
        wx, wy, wz = ny * uz - nz * uy, nz * ux - nx * uz, nx * uy - ny * ux
        size = 0.0
        for a in range(count):
            k = found[a]
            x, y, z = vertices[k, 0] - mx, vertices[k, 1] - my, vertices[k, 2] - mz
            size += x * x + y * y + z * z
        size = np.sqrt(size / count)
        if size == 0.0:
            continue
        scale = 1.0 / size
        for k in range(SEXTIC_TERMS):
            sums[k] = 0.0
        for k in range(CUBIC_TERMS):
            along[k] = 0.0
        squares = first_height = 0.0
        rank = added = 0
        for fit in range(4):
            # Over the one-ring a plane, then degree 2; over the two-ring degree 2, then degree 3.
            rows = near if fit < 2 else count
            while added < rows:
                k = found[added]
                x = (vertices[k, 0] - mx) * scale
                y = (vertices[k, 1] - my) * scale
                z = (vertices[k, 2] - mz) * scale
                height = x * nx + y * ny + z * nz
                fill_monomials(x * ux + y * uy + z * uz, x * wx + y * wy + z * wz, terms)
                if added == 0:
                    first_height = height
                    for m in range(CUBIC_TERMS):
                        first_terms[m] = terms[m]
                for m in range(SEXTIC_TERMS):
                    sums[m] += terms[m]
                for m in range(CUBIC_TERMS):
                    along[m] += height * terms[m]
                squares += height * height
                added += 1
            first = PLANE_TERMS if fit == 1 else (QUADRIC_TERMS if fit == 3 else 0)
            last = PLANE_TERMS if fit == 0 else (CUBIC_TERMS if fit == 3 else QUADRIC_TERMS)
            if first == 0:
                rank = 0
                begin_equations(sums, along, squares, first_height, first_terms, equations)
                for m in range(CUBIC_TERMS):
                    own[m] = equations[m, m]
            rank += eliminate(equations, own, first, last)
            if rows <= rank:
                continue
            rest = equations[HEIGHT, HEIGHT]
            if rest <= ROUNDING * squares or rest <= 1e-22 * rows:
                rest = 0.0
            freedoms[at, fit] = rows - rank
            variances[at, fit] = rest / (rows - rank) * size * size
            leverage = -equations[VERTEX, VERTEX]
            if fit == 2 and rows - rank > FEWEST_FREEDOMS and leverage < MOST_LEVERAGE:
                left = equations[HEIGHT, VERTEX]
                alone = left * left / (1.0 - leverage)
                gaps[at] = left / (1.0 - leverage) * size
                if rest > 0.0:
                    others = max(rest - alone, ROUNDING * rest)
                    ratios[at] = np.sqrt(alone * (rows - rank - 1) / others)


def fitted(
    chosen: Longs, vertices: Floats, normals: Floats, ring_start: Ints, ring: Ints
) -> tuple[Floats, Ints, Floats, Floats]:
    """What polynomials leave over of the heights around the vertices ``chosen`` (c,).

    The four fits are a plane and degree 2 over the one-ring, and degrees 2 and 3 over the two-ring.
    Heights stand on the plane across the sum of the patch's ``normals`` (n, 3).

    Returns
    -------
    variances : (c, 4), sum of the squares left over, by the degrees of freedom; squared units.
    freedoms : (c, 4), vertices of the patch less coefficients of the fit; 0 where none is left.
    gaps : (c,), from the degree 2 that all others of the two-ring give to the vertex, along the
        normal; 0 where they give none.
    ratios : (c,), Student's ratio of that gap, without sign: how far out the vertex is for what the
        others are around it; -1 where that is not known.
    """
    count = len(chosen)
    variances, freedoms = np.empty((count, 4)), np.empty((count, 4), dtype=np.int32)
    gaps, ratios = np.empty(count), np.empty(count)
    over_ranges(
        _fitted,
        count,
        chosen,
        vertices,
        normals,
        ring_start,
        ring,
        variances,
        freedoms,
        gaps,
        ratios,
        smallest=FEWEST_PATCHES,
    )
    return variances, freedoms, gaps, ratios
