"""Polynomials fitted to the surface around single vertices, over patches of several sizes.

White noise leaves the same variance to every fit.  Noise that neighbours share looks like shape to
fits over few vertices, and leaves more to wider ones, up to the width over which it is shared.
"""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.local_fits import begin_equations, eliminate, fill_monomials
from msal_cli.kernels.parallel import over_ranges

REACHES = (1, 2, 3, 4, 6)
"""Rings that the fits are over."""

TERMS = (3, 6, 10, 10, 10)
"""Coefficients of the fits: a plane, degree 2, and degree 3."""

N_FITS, MOST_RINGS, PLANE_FITS, QUADRIC_FITS, FRAME_RINGS = 5, 6, 1, 2, 2
"""How many fits there are, the widest of them, those of degree 1 and of at most 2, and over which
rings the direction of the heights is an average."""

MOST_VERTICES = 200
"""Vertices of a patch at most: a fit that would need more is left out."""

SLOTS, EMPTY = 512, -1
"""Longs of the table in which a patch looks up its vertices, a power of two."""

FEWEST_PATCHES = 64
"""Patches for which a thread of its own is worth starting."""

PLANE_TERMS, QUADRIC_TERMS, CUBIC_TERMS, SEXTIC_TERMS = 3, 6, 10, 28
HEIGHT, WIDTH = 10, 12
"""As in ``local_fits``."""

ROUNDING = 1e-12
"""What is left of the heights' sum of squares, relative to all of it, at and below which it is
rounding; where the heights themselves are, 1e-22 of the patch's."""


@compiled
def _collect(i, ring_start, ring, found, ends, slots):
    """Collect vertex i and those up to six edges away, nearest first, in ``found``; ``ends`` are
    how many are within each ring, 0 where they are too many."""
    for slot in range(SLOTS):
        slots[slot] = EMPTY
    for rings in range(MOST_RINGS + 1):
        ends[rings] = 0
    slots[(i * 40503) & (SLOTS - 1)] = i
    found[0] = i
    ends[0] = 1
    first, count = 0, 1
    for rings in range(1, MOST_RINGS + 1):
        last = count
        for at in range(first, last):
            j = found[at]
            for place in range(ring_start[j], ring_start[j + 1]):
                k = ring[place]
                slot = (k * 40503) & (SLOTS - 1)
                while slots[slot] != EMPTY and slots[slot] != k:
                    slot = (slot + 1) & (SLOTS - 1)
                if slots[slot] == EMPTY:
                    if count == MOST_VERTICES:
                        return
                    slots[slot] = k
                    found[count] = k
                    count += 1
        ends[rings] = count
        first = last


@compiled
def _fit_scales(
    start, stop, chosen, vertices, normals, ring_start, ring, rests, rows, ranks, frames, offsets
):
    found = np.empty(MOST_VERTICES, dtype=np.int64)
    slots = np.empty(SLOTS, dtype=np.int64)
    ends = np.empty(MOST_RINGS + 1, dtype=np.int64)
    terms, first_terms = np.empty(SEXTIC_TERMS), np.empty(SEXTIC_TERMS)
    sums, along = np.empty(SEXTIC_TERMS), np.empty(CUBIC_TERMS)
    equations, own = np.empty((WIDTH, WIDTH)), np.empty(CUBIC_TERMS)
    for at in range(start, stop):
        for fit in range(N_FITS):
            rests[at, fit] = 0.0
            rows[at, fit] = 0
            ranks[at, fit] = 0
        for axis in range(3):
            frames[at, axis] = offsets[at, axis] = 0.0
        i = chosen[at]
        _collect(i, ring_start, ring, found, ends, slots)
        widest = MOST_RINGS
        while widest > 0 and ends[widest] == 0:
            widest -= 1
        count = ends[widest]
        inner = ends[min(FRAME_RINGS, widest)]
        nx = ny = nz = mx = my = mz = 0.0
        for a in range(inner):
            k = found[a]
            nx += normals[k, 0]
            ny += normals[k, 1]
            nz += normals[k, 2]
            mx += vertices[k, 0]
            my += vertices[k, 1]
            mz += vertices[k, 2]
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length <= 1e-10 * inner:
            continue
        nx, ny, nz = nx / length, ny / length, nz / length
        mx, my, mz = mx / inner, my / inner, mz / inner
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
        frames[at, 0], frames[at, 1], frames[at, 2] = nx, ny, nz
        scale = 1.0 / size
        for k in range(SEXTIC_TERMS):
            sums[k] = 0.0
        for k in range(CUBIC_TERMS):
            along[k] = 0.0
        valence = ends[1] - 1.0
        if valence > 0.0:
            weight = np.sqrt(valence / (valence + 1.0))
            for axis in range(3):
                middle = 0.0
                for a in range(1, ends[1]):
                    middle += vertices[found[a], axis]
                offsets[at, axis] = (vertices[i, axis] - middle / valence) * weight
        squares = first_height = 0.0
        added = fit = 0
        for rings in range(1, widest + 1):
            while added < ends[rings]:
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
            if rings == 5:
                continue
            last = CUBIC_TERMS
            if fit < PLANE_FITS:
                last = PLANE_TERMS
            elif fit < QUADRIC_FITS:
                last = QUADRIC_TERMS
            begin_equations(sums, along, squares, first_height, first_terms, equations)
            for m in range(CUBIC_TERMS):
                own[m] = equations[m, m]
            rank = eliminate(equations, own, 0, last)
            rest = equations[HEIGHT, HEIGHT]
            if rest <= ROUNDING * squares or rest <= 1e-22 * added:
                rest = 0.0
            rests[at, fit] = rest * size * size
            rows[at, fit] = added
            ranks[at, fit] = rank
            fit += 1


def fit_scales(
    chosen: Longs, vertices: Floats, normals: Floats, ring_start: Ints, ring: Ints
) -> tuple[Floats, Ints, Ints, Floats, Floats]:
    """What polynomials leave over of the heights around the vertices ``chosen`` (c,), by width.

    The fits are over the ``REACHES`` rings, with so many ``TERMS``.  Heights stand on the plane
    across the sum of the two-ring's ``normals`` (n, 3).

    Returns
    -------
    rests : (c, 5), sums of the squares left over; squared units.
    rows : (c, 5), vertices of the fit; 0 where they are too many.
    ranks : (c, 5), coefficients of the fit that the vertices tell apart.
    frames : (c, 3), unit vectors that the heights are along; 0 where there is no direction.
    offsets : (c, 3), from the middle of the one-ring to the vertex, times sqrt(v / (v + 1)) with v
        neighbours: of as much variance as the vertices, where their places are independent.
    """
    count = len(chosen)
    rests = np.empty((count, N_FITS))
    rows, ranks = np.empty((count, N_FITS), np.int32), np.empty((count, N_FITS), np.int32)
    frames, offsets = np.empty((count, 3)), np.empty((count, 3))
    over_ranges(
        _fit_scales,
        count,
        chosen,
        vertices,
        normals,
        ring_start,
        ring,
        rests,
        rows,
        ranks,
        frames,
        offsets,
        smallest=FEWEST_PATCHES,
    )
    return rests, rows, ranks, frames, offsets
