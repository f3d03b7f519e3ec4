"""Polynomials fitted to the surface around single vertices, and their residuals.

A smooth surface is nearly a polynomial over a few vertices, and noise is not.  Of white noise a fit
leaves the share that its degrees of freedom give, wherever the vertices are, and the same residual
variance for patches of each size.  Correlated noise looks like shape to fits over few vertices, and
leaves more to wider ones, up to the width of the correlation.
"""

import numpy as np

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.library import compiled
from msal_cli.kernels.parallel import over_ranges

MAX_VERTICES, MAX_WIDE_VERTICES = 40, 200
"""Largest number of vertices of a two-ring patch, without those farther out; and of a wide patch,
beyond which there is no fit."""

SLOTS, WIDE_SLOTS, EMPTY = 128, 512, -1
"""Sizes of the hash tables of the vertices of a patch, powers of two; and the empty slot."""

MIN_PATCHES, MIN_WIDE_PATCHES = 256, 64
"""Patches for which an additional thread is worth starting."""

PLANE_TERMS, QUADRIC_TERMS, CUBIC_TERMS, SEXTIC_TERMS = 3, 6, 10, 28
"""Monomials in two variables up to degree 1, 2, 3 and 6; products of two cubic ones have six."""

HEIGHT, VERTEX, WIDTH = 10, 11, 12
"""Indices in the normal equations after those of the monomials, for the heights and for the value
at the central vertex; and the number of rows and columns."""

DEPENDENT = 1e-8
"""Share of a monomial's sum of squares that is independent of the other monomials, up to which the
patch cannot distinguish them."""

ROUNDING, WIDE_ROUNDING = 1e-13, 1e-12
"""Residual sum of squares of the heights, relative to all of it, up to which it is a rounding
error; so it is up to 1e-22 of the squared size of the patch."""

MIN_FREEDOMS = 5
"""Degrees of freedom above which a single vertex can be compared with the others."""

MAX_LEVERAGE = 0.95
"""Leverage of a vertex on its own fit from which its residual says nothing of its noise."""

REACHES = (1, 2, 3, 4, 6)
"""Numbers of rings of the fits of ``fit_scales``."""

TERMS = (3, 6, 10, 10, 10)
"""Their numbers of coefficients: a plane, a quadratic, and cubics."""

N_FITS, MAX_RINGS, FRAME_RINGS = 5, 6, 2
"""The number of fits, the rings of the widest one, and the rings over which heights' direction is
averaged."""


@compiled
def collect_patch(i, ring_start, ring, found, ends, slots):
    """Collect vertex i and those around it in breadth-first order in ``found``; their number.

    ``ends`` gets the numbers of vertices within each ring, for as many rings as it has items; 0 if
    there is no room for them, where the search ends.
    """
    last_slot = len(slots) - 1
    for slot in range(len(slots)):
        slots[slot] = EMPTY
    for rings in range(len(ends)):
        ends[rings] = 0
    slots[(i * 40503) & last_slot] = i
    found[0] = i
    ends[0] = 1
    first, count = 0, 1
    for rings in range(1, len(ends)):
        last = count
        for at in range(first, last):
            j = found[at]
            for entry in range(ring_start[j], ring_start[j + 1]):
                k = ring[entry]
                slot = (k * 40503) & last_slot
                while slots[slot] != EMPTY and slots[slot] != k:
                    slot = (slot + 1) & last_slot
                if slots[slot] == EMPTY:
                    if count == len(found):
                        return count
                    slots[slot] = k
                    found[count] = k
                    count += 1
        ends[rings] = count
        first = last
    return count


@compiled
def find_tangents(normal):
    """Two orthogonal unit vectors in the tangent plane of a unit normal, the first one orthogonal
    to the coordinate axis that is farthest from the normal."""
    x, y, z = normal
    if abs(x) <= abs(y) and abs(x) <= abs(z):
        u = 0.0, z, -y
    elif abs(y) <= abs(z):
        u = -z, 0.0, x
    else:
        u = y, -x, 0.0
    u = vec.divide(u, vec.norm(u))
    return u, vec.cross(normal, u)


@compiled
def _find_frame(found, inner, count, vertices, normals, frame):
    """Normal, tangents and mean of the first ``inner`` vertices found, in ``frame`` (4, 3).

    Returns the root mean square distance of all ``count`` from the mean; zero if there is no frame.
    """
    normal = middle = vec.ORIGIN
    for a in range(inner):
        normal = vec.add(normal, vec.load(normals, found[a]))
        middle = vec.add(middle, vec.load(vertices, found[a]))
    length = vec.norm(normal)
    if length <= 1e-10 * inner:
        return 0.0
    normal, middle = vec.divide(normal, length), vec.divide(middle, inner)
    u, w = find_tangents(normal)
    vec.store(frame, 0, normal)
    vec.store(frame, 1, u)
    vec.store(frame, 2, w)
    vec.store(frame, 3, middle)
    size = 0.0
    for a in range(count):
        size += vec.square_distance(vec.load(vertices, found[a]), middle)
    return np.sqrt(size / count)


@compiled
def _fill_monomials(u, w, terms):
    """Monomials 1, u, w, uu, uw, ww, uuu ... up to degree 6 in ``terms``."""
    terms[0] = 1.0
    before, at = 0, 1
    for degree in range(1, 7):
        terms[at] = terms[before] * u
        for k in range(degree):
            terms[at + 1 + k] = terms[before + k] * w
        before = at
        at += degree + 1


@compiled
def _add_vertices(found, added, stop, vertices, frame, scale, terms, own, sums, along):
    """Add the vertices ``found``[added:stop] to the ``sums`` of monomials and, ``along``, of their
    products with the heights, with the squared heights last.

    ``terms`` is for one vertex; ``own`` gets the monomials and the height of the first of all.
    """
    normal, middle = vec.load(frame, 0), vec.load(frame, 3)
    u, w = vec.load(frame, 1), vec.load(frame, 2)
    for at in range(added, stop):
        offset = vec.times(scale, vec.subtract(vec.load(vertices, found[at]), middle))
        height = vec.dot(offset, normal)
        _fill_monomials(vec.dot(offset, u), vec.dot(offset, w), terms)
        if at == 0:
            for m in range(CUBIC_TERMS):
                own[m] = terms[m]
            own[HEIGHT] = height
        for m in range(SEXTIC_TERMS):
            sums[m] += terms[m]
        for m in range(CUBIC_TERMS):
            along[m] += height * terms[m]
        along[HEIGHT] += height * height


@compiled
def _begin_equations(sums, along, own, equations, sums_of_squares):
    """Set up the normal equations from ``_add_vertices``, and note the diagonal."""
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
            sums_of_squares[row] = equations[row, row]
            equations[row, HEIGHT] = along[row]
            equations[row, VERTEX] = own[row]
            row += 1
    equations[HEIGHT, HEIGHT] = along[HEIGHT]
    equations[HEIGHT, VERTEX] = own[HEIGHT]
    equations[VERTEX, VERTEX] = 0.0


@compiled
def _eliminate(equations, sums_of_squares, first, last):
    """Eliminate the monomials ``first`` ... ``last``, in the upper triangle; returns the rank.  The
    rows of the heights then have their residuals."""
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
def _left_over(equations, along, rows, rounding):
    """Residual sum of squares of the heights; zero for a rounding error."""
    rest = equations[HEIGHT, HEIGHT]
    return 0.0 if rest <= rounding * along[HEIGHT] or rest <= 1e-22 * rows else rest


@compiled
def _fit_patches(
    start, stop, chosen, vertices, normals, ring_start, ring, variances, freedoms, gaps, ratios
):
    found, ends = np.empty(MAX_VERTICES, dtype=np.int64), np.empty(3, dtype=np.int64)
    slots, frame = np.empty(SLOTS, dtype=np.int64), np.empty((4, 3))
    terms, own = np.empty(SEXTIC_TERMS), np.empty(HEIGHT + 1)
    sums, along = np.empty(SEXTIC_TERMS), np.empty(HEIGHT + 1)
    equations, diagonal = np.empty((WIDTH, WIDTH)), np.empty(CUBIC_TERMS)
    for at in range(start, stop):
        i = chosen[at]
        count = collect_patch(i, ring_start, ring, found, ends, slots)
        near = min(1 + ring_start[i + 1] - ring_start[i], count)
        size = _find_frame(found, count, count, vertices, normals, frame)
        if size == 0.0:
            continue
        scale = 1.0 / size
        sums[:] = 0.0
        along[:] = 0.0
        rank = added = 0
        for fit in range(4):
            # Plane and quadratic over the one-ring, quadratic and cubic over the two-ring.
            rows = near if fit < 2 else count
            _add_vertices(found, added, rows, vertices, frame, scale, terms, own, sums, along)
            added = rows
            first = PLANE_TERMS if fit == 1 else (QUADRIC_TERMS if fit == 3 else 0)
            last = PLANE_TERMS if fit == 0 else (CUBIC_TERMS if fit == 3 else QUADRIC_TERMS)
            if first == 0:
                rank = 0
                _begin_equations(sums, along, own, equations, diagonal)
            rank += _eliminate(equations, diagonal, first, last)
            if rows <= rank:
                continue
            rest = _left_over(equations, along, rows, ROUNDING)
            freedoms[at, fit] = rows - rank
            variances[at, fit] = rest / (rows - rank) * size * size
            leverage = -equations[VERTEX, VERTEX]
            if fit == 2 and rows - rank > MIN_FREEDOMS and leverage < MAX_LEVERAGE:
                left = equations[HEIGHT, VERTEX]
                alone = left * left / (1.0 - leverage)
                gaps[at] = left / (1.0 - leverage) * size
                if rest > 0.0:
                    others = max(rest - alone, ROUNDING * rest)
                    ratios[at] = np.sqrt(alone * (rows - rank - 1) / others)


def fit_patches(
    chosen: Longs, vertices: Floats, normals: Floats, ring_start: Ints, ring: Ints
) -> tuple[Floats, Ints, Floats, Floats]:
    """Residuals of polynomials fitted to the heights around the vertices ``chosen`` (c,).

    The four fits are a plane and a quadratic over the one-ring, and a quadratic and a cubic over
    the two-ring.  Heights are along the mean of the patch's ``normals`` (n, 3).

    Returns
    -------
    variances : (c, 4), residual sum of squares per degree of freedom; squared file units.
    freedoms : (c, 4), vertices of the patch minus coefficients of the fit; 0 for no residual.
    gaps : (c,), distance along the normal from the quadratic that all others of the two-ring
        determine to the vertex; 0 if they determine none.
    ratios : (c,), absolute Student's ratio of that gap (the externally studentized residual);
        -1 if unknown.
    """
    count = len(chosen)
    variances, freedoms = np.zeros((count, 4)), np.zeros((count, 4), dtype=np.int32)
    gaps, ratios = np.zeros(count), np.full(count, -1.0)
    known = chosen, vertices, normals, ring_start, ring
    results = variances, freedoms, gaps, ratios
    over_ranges(_fit_patches, count, *known, *results, smallest=MIN_PATCHES)
    return results


@compiled
def _fit_scales(
    start, stop, chosen, vertices, normals, ring_start, ring, rests, rows, ranks, frames, offsets
):
    found = np.empty(MAX_WIDE_VERTICES, dtype=np.int64)
    ends = np.empty(MAX_RINGS + 1, dtype=np.int64)
    slots, frame = np.empty(WIDE_SLOTS, dtype=np.int64), np.empty((4, 3))
    terms, own = np.empty(SEXTIC_TERMS), np.empty(HEIGHT + 1)
    sums, along = np.empty(SEXTIC_TERMS), np.empty(HEIGHT + 1)
    equations, diagonal = np.empty((WIDTH, WIDTH)), np.empty(CUBIC_TERMS)
    for at in range(start, stop):
        i = chosen[at]
        collect_patch(i, ring_start, ring, found, ends, slots)
        widest = MAX_RINGS
        while widest > 0 and ends[widest] == 0:
            widest -= 1
        inner = ends[min(FRAME_RINGS, widest)]
        size = _find_frame(found, inner, ends[widest], vertices, normals, frame)
        if size == 0.0:
            continue
        vec.store(frames, at, vec.load(frame, 0))
        scale = 1.0 / size
        sums[:] = 0.0
        along[:] = 0.0
        valence = ends[1] - 1.0
        if valence > 0.0:
            weight = np.sqrt(valence / (valence + 1.0))
            total = vec.ORIGIN
            for a in range(1, ends[1]):
                total = vec.add(total, vec.load(vertices, found[a]))
            offset = vec.subtract(vec.load(vertices, i), vec.divide(total, valence))
            vec.store(offsets, at, vec.times(weight, offset))
        added = fit = 0
        for rings in range(1, widest + 1):
            stop_at = ends[rings]
            _add_vertices(found, added, stop_at, vertices, frame, scale, terms, own, sums, along)
            added = stop_at
            if rings == 5:
                continue
            _begin_equations(sums, along, own, equations, diagonal)
            ranks[at, fit] = _eliminate(equations, diagonal, 0, TERMS[fit])
            rests[at, fit] = _left_over(equations, along, added, WIDE_ROUNDING) * size * size
            rows[at, fit] = added
            fit += 1


def fit_scales(
    chosen: Longs, vertices: Floats, normals: Floats, ring_start: Ints, ring: Ints
) -> tuple[Floats, Ints, Ints, Floats, Floats]:
    """Residuals of polynomials fitted to the heights around the vertices ``chosen`` (c,), by width.

    The fits are over ``REACHES`` rings, with ``TERMS`` coefficients.  Heights are along the mean of
    the two-ring's ``normals`` (n, 3).

    Returns
    -------
    rests : (c, 5), residual sums of squares; squared file units.
    rows : (c, 5), vertices of the fit; 0 if they are too many.
    ranks : (c, 5), coefficients of the fit that the vertices determine.
    frames : (c, 3), unit vectors that the heights are along; 0 if there is no direction.
    offsets : (c, 3), from the mean of the one-ring to the vertex, times sqrt(v / (v + 1)) for
        valence v: the variance is that of the vertices if these are independent.
    """
    count = len(chosen)
    rests, (rows, ranks) = np.zeros((count, N_FITS)), np.zeros((2, count, N_FITS), np.int32)
    frames, offsets = np.zeros((2, count, 3))
    known = chosen, vertices, normals, ring_start, ring
    results = rests, rows, ranks, frames, offsets
    over_ranges(_fit_scales, count, *known, *results, smallest=MIN_WIDE_PATCHES)
    return results
