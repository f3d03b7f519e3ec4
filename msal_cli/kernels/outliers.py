"""Scores of single vertices that are far off the surface of their neighbours.

A vertex is compared with a fit to its two-ring without itself, and its faces with those around
them.  Everything is local, in units of local edge lengths without the vertex itself.
"""

import numpy as np

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.library import compiled
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.patch_fits import MAX_VERTICES, SLOTS, collect_patch, find_tangents
from msal_cli.kernels.vectors import sort_few

MAX_FACES = 24
"""Vertices with more faces get no score: the poles of a sphere are no outliers."""

MIN_VERTICES = 10
"""Vertices of a patch, without the central one, that a quadratic needs."""

FITS = 4
"""Number of fits, each weighted by the residuals of the previous one."""

TERMS = 6
"""Monomials in two variables up to degree 2."""

STIFFNESS = 0.5
"""Penalty of curvature, in weights of vertices, so that few vertices do not bend the fit."""

WIDTH = 2.0
"""Width of the weights, over the median residual."""

MIN_WIDTH = 1e-3
"""Smallest width of the weights, local edge lengths, for coplanar neighbours."""

KEPT_WAY = 0.35
"""Distance from the mean of its neighbours, local edge lengths, up to which a vertex keeps its
tangential position; a larger one is part of the error."""

QUIET = 0.7
"""Quantile of the agreements in a patch that measures its texture: creases and other outliers are
rough in few places, noise everywhere."""

MIN_PER_THREAD = 256
"""Vertices to be scored for which an additional thread is worth starting."""

MIN_WAY = 0.75
"""Distance from its projection, local edge lengths, from which a vertex can be an outlier."""

EARLY_WAY = 0.65
"""The same after the first fit: later ones move the projection by much less than the difference."""

NEAR, NEAR_BY_SCORE = 0.43, 0.17
"""Distance from the mean of its neighbours, local edge lengths, below which a vertex needs no fit,
as its score is not above 0, and its increase for each 1 of the score.  Of 270,000 vertices with
scores above 0.5 the nearest was at 0.58, of 105,000 with scores above 1.3 at 0.73."""

MIN_EDGES = 0.65
"""The same as ``MIN_WAY`` in mean edge lengths of the mesh: folds of tiny faces are no outliers."""

MIN_GAIN = 0.05
"""Reduction of the roughness that the projection of an outlier brings at least."""

ALONG, ROUGH, SMOOTH, NOISE, TEXTURE = 1.2, 0.8, 1.4, 1.0, 2.2
"""Weights of a score: of the tangential distance, the roughness at the vertex and at its
projection, the residual at the others, and the texture around it; the distance along the normal has
1.  By logistic regression over outliers, noise and clean meshes; 1 more multiplies the odds by
about 300."""

FARTHEST, MARGIN = (1.0 + ALONG * ALONG) ** 0.5, 0.1
"""Largest weighted sum of the normal and tangential distances, over the distance from the mean of
the neighbours, if that is on the fit; and by how much a score may exceed its bounds by that
distance, or after the first fit.  Of 360,000 scores above 0.5 one exceeded the former by 0.0001,
and five the latter by more than 0.1, all of them above 2.9."""

MIN_SCORE = 0.4
"""Scores up to which no vertex is an outlier, so that tests for designs are skipped."""

FLAT = 1e-4
"""Largest distance of a face from the plane of the next one, mean edge lengths, if both are one
flat side of a design; 1 in 1,000 outliers has such faces by chance."""

STRAIGHT = 1e-3
"""Largest distance of the middle of three collinear neighbours from their chord, over its
length."""

TOUCHING = 0.15
"""Distance to its nearest neighbour, local edge lengths, below which a vertex is not off the
surface alone: tips of needle triangles, and 1 in 500 outliers."""

UNLIKE_EDGES = 6.0
"""Ratio of the 90 % to the 10 % quantile of the edges around above which no fit is reliable: scans
have 1.5 to 4, coarse CAD exports up to 1,000."""

MAX_LENGTHS = 512
"""Largest number of edges around a vertex that are compared."""

NOT_JUDGED = -np.inf
"""The score of a vertex that is never an outlier."""


@compiled
def _normal(point, x, b, c):
    """The unit normal of the face of a point and vertices b and c; zeros if degenerate."""
    normal = vec.cross(vec.subtract(vec.load(x, b), point), vec.subtract(vec.load(x, c), point))
    length = vec.norm(normal)
    return vec.times(1.0 / length if length > 0.0 else 0.0, normal)


@compiled
def _agreements(start, stop, x, faces, face_start, incident, chosen, agreements):
    for place in range(start, stop):
        i = chosen[place]
        total = vec.ORIGIN
        for at in range(face_start[i], face_start[i + 1]):
            a, b, c = vec.load(faces, incident[at])
            total = vec.add(total, _normal(vec.load(x, a), x, b, c))
        count = face_start[i + 1] - face_start[i]
        agreements[i] = vec.norm(total) / count if count else 1.0


@compiled
def _circle(i, n, faces, face_start, incident, after, before, following, outer):
    """For each of the n faces around vertex i the index of the next one, and the face across the
    edge opposite to i, or -1.  Returns whether the faces form a closed fan."""
    for k in range(n):
        following[k] = -1
        for other in range(n):
            if after[other] == before[k]:
                following[k] = other
        if following[k] < 0:
            return False
        outer[k] = -1
        for at in range(face_start[after[k]], face_start[after[k] + 1]):
            f = incident[at]
            a, b, c = vec.load(faces, f)
            has_edge = a == before[k] or b == before[k] or c == before[k]
            if has_edge and a != i and b != i and c != i:
                outer[k] = f
    return True


@compiled
def _roughness(point, n, x, fan):
    """Mean length of the differences of normals across the edges in and around the faces that a
    vertex would have at a point."""
    after, following, outer, normals, outer_normals = fan
    for k in range(n):
        vec.store(normals, k, _normal(point, x, after[k], after[following[k]]))
    total, count = 0.0, 0
    for k in range(n):
        total += vec.norm(vec.offset(normals, k, following[k]))
        count += 1
        if outer[k] >= 0:
            total += vec.norm(vec.subtract(vec.load(normals, k), vec.load(outer_normals, k)))
            count += 1
    return total / count


@compiled
def _solve(equations, coefficients):
    """Solve the normal equations, right sides in column ``TERMS``; undetermined terms get small."""
    for pivot in range(TERMS):
        scale = 1.0 / max(equations[pivot, pivot], 1e-9)
        for row in range(pivot + 1, TERMS):
            factor = equations[row, pivot] * scale
            for column in range(pivot, TERMS + 1):
                equations[row, column] -= factor * equations[pivot, column]
    for pivot in range(TERMS - 1, -1, -1):
        rest = equations[pivot, TERMS]
        for column in range(pivot + 1, TERMS):
            rest -= equations[pivot, column] * coefficients[column]
        coefficients[pivot] = rest / max(equations[pivot, pivot], 1e-9)


@compiled
def _rank(values, count, share, ranking):
    """The quantile ``share`` of values[1:count]; ``ranking`` is a buffer for sorting."""
    for at in range(1, count):
        ranking[at - 1] = values[at]
    sort_few(ranking, count - 1)
    return ranking[np.int64(share * (count - 1))]


@compiled
def _fit(count, local, memory, height, least):
    """Fit a quadratic to the points ``local``[:, 1:count] (u, w, height) by iteratively reweighted
    least squares; returns the median residual.

    Returns -1 after the first fit if its constant is closer to ``height`` than ``least``.
    """
    weights, rests, ranking, terms, equations, coefficients = memory
    for at in range(1, count):
        u, w = local[0, at], local[1, at]
        terms[at, 0], terms[at, 1], terms[at, 2] = 1.0, u, w
        terms[at, 3], terms[at, 4], terms[at, 5] = u * u, u * w, w * w
    median = 0.0
    for done in range(FITS):
        for row in range(TERMS):
            # Sums that are variables stay in registers.
            c0 = c1 = c2 = c3 = c4 = c5 = right = 0.0
            for at in range(1, count):
                weighted = weights[at] * terms[at, row]
                c0 += weighted
                c1 += weighted * terms[at, 1]
                c2 += weighted * terms[at, 2]
                c3 += weighted * terms[at, 3]
                c4 += weighted * terms[at, 4]
                c5 += weighted * terms[at, 5]
                right += weighted * local[2, at]
            equations[row, 0], equations[row, 1], equations[row, 2] = c0, c1, c2
            equations[row, 3], equations[row, 4], equations[row, 5] = c3, c4, c5
            equations[row, TERMS] = right
        for row in range(3, TERMS):
            equations[row, row] += STIFFNESS
        _solve(equations, coefficients)
        if done == 0 and abs(height - coefficients[0]) < least:
            return -1.0
        for at in range(1, count):
            rests[at] = abs(local[2, at] - _height(local[0, at], local[1, at], coefficients))
        median = _rank(rests, count, 0.5, ranking)
        width = WIDTH * median + MIN_WIDTH
        for at in range(1, count):
            share = width * width / (width * width + rests[at] * rests[at])
            weights[at] = share * share
    return median


@compiled
def _height(u, w, c):
    return c[0] + c[1] * u + c[2] * w + c[3] * u * u + c[4] * u * w + c[5] * w * w


@compiled
def _has_flat_side(point, n, x, faces, fan, flat):
    """Whether two of the faces around a vertex and next to those are coplanar.

    Two with collinear outer vertices are coplanar wherever the vertex is, so they do not count.
    """
    after, following, outer, normals, outer_normals = fan
    for k in range(n):
        j = following[k]
        a, b, c = after[k], after[j], after[following[j]]
        normal = vec.load(normals, k)
        if abs(vec.dot(normal, vec.subtract(vec.load(x, c), point))) < flat:
            _, chord, area = vec.edges_and_normal(x, a, b, c)
            if vec.dot(area, area) > (STRAIGHT * vec.dot(chord, chord)) ** 2:
                return True
        f = outer[k]
        if f >= 0:
            rise = vec.dot(vec.load(outer_normals, k), vec.subtract(point, vec.load(x, a)))
            most = 0.0
            for corner in range(3):
                height = vec.dot(normal, vec.subtract(vec.load(x, faces[f, corner]), point))
                most = max(most, abs(height))
            if abs(rise) < flat or most < flat:
                return True
    return False


@compiled
def _spread(i, x, found, count, ring_start, ring, lengths, ranking):
    """The ratio of the 90 % to the 10 % quantile of edges at found[1:count] except those to i."""
    n = 1
    for near in range(1, count):
        k = found[near]
        for slot in range(ring_start[k], ring_start[k + 1]):
            j = ring[slot]
            if j != i and n < MAX_LENGTHS:
                lengths[n] = vec.norm(vec.offset(x, j, k))
                n += 1
    shortest = _rank(lengths, n, 0.1, ranking)
    return ranking[np.int64(0.9 * (n - 1))] / max(shortest, 1e-300)


@compiled
def _judge(
    start,
    stop,
    chosen,
    places,
    x,
    faces,
    face_start,
    incident,
    ring_start,
    ring,
    agreements,
    edge,
    is_known,
    floor,
    scores,
    targets,
):
    found, ends = np.empty(MAX_VERTICES, dtype=np.int64), np.empty(3, dtype=np.int64)
    slots = np.empty(SLOTS, dtype=np.int64)
    after, before = np.empty(MAX_FACES, dtype=np.int64), np.empty(MAX_FACES, dtype=np.int64)
    following, outer = np.empty(MAX_FACES, dtype=np.int64), np.empty(MAX_FACES, dtype=np.int64)
    normals, outer_normals = np.empty((MAX_FACES, 3)), np.empty((MAX_FACES, 3))
    fan = after, following, outer, normals, outer_normals
    local = np.empty((3, MAX_VERTICES))
    weights, rests = np.empty(MAX_VERTICES), np.empty(MAX_VERTICES)
    ranking, lengths = np.empty(MAX_LENGTHS), np.empty(MAX_LENGTHS)
    terms, equations = np.empty((MAX_VERTICES, TERMS)), np.empty((TERMS, TERMS + 1))
    coefficients = np.empty(TERMS)
    memory = weights, rests, ranking, terms, equations, coefficients
    for at in range(start, stop):
        i = chosen[at]
        scores[at] = NOT_JUDGED
        point = vec.load(places, at)
        vec.store(targets, at, point)
        n = face_start[i + 1] - face_start[i]
        if n < 3 or n > MAX_FACES:
            continue
        for k in range(n):
            f = incident[face_start[i] + k]
            after[k], before[k] = vec.after_and_before(faces, f, i)
        # The local edge length, and the mean of the neighbours; rough ones count little.
        middle = vec.ORIGIN
        size = total = 0.0
        for k in range(n):
            a = after[k]
            size += vec.norm(vec.offset(x, a, before[k]))
            weight = agreements[a] ** 4 + 1e-6
            middle = vec.add_scaled(middle, weight, vec.load(x, a))
            total += weight
        size /= n
        if size <= 0.0:
            continue
        scale = 1.0 / size
        middle = vec.divide(middle, total)
        shift = vec.times(scale, vec.subtract(point, middle))
        square = vec.dot(shift, shift)
        if square < (NEAR + NEAR_BY_SCORE * floor) ** 2 and not is_known:
            continue
        if not _circle(i, n, faces, face_start, incident, after, before, following, outer):
            continue
        count = collect_patch(i, ring_start, ring, found, ends, slots)
        if count <= MIN_VERTICES:
            continue
        for k in range(n):
            f = outer[k]
            if f >= 0:
                p, q, r = vec.load(faces, f)
                vec.store(outer_normals, k, _normal(vec.load(x, p), x, q, r))
        now = _roughness(point, n, x, fan)
        for near in range(1, count):
            rests[near] = agreements[found[near]]
        quiet = _rank(rests, count, QUIET, ranking)
        texture = np.sqrt(max(1.0 - quiet, 0.0))
        most = FARTHEST * np.sqrt(square) + ROUGH * now - TEXTURE * texture + MARGIN
        if most <= floor and not is_known:
            continue
        # The mean normal of the neighbours' other faces.
        normal = vec.ORIGIN
        for k in range(n):
            a = after[k]
            weight = agreements[a] ** 4
            for place in range(face_start[a], face_start[a + 1]):
                p, q, r = vec.load(faces, incident[place])
                if p != i and q != i and r != i:
                    normal = vec.add_scaled(normal, weight, _normal(vec.load(x, p), x, q, r))
        length = vec.norm(normal)
        if length <= 1e-10:
            continue
        normal = vec.divide(normal, length)
        u_axis, w_axis = find_tangents(normal)
        for near in range(count):
            k = found[near]
            offset = vec.times(scale, vec.subtract(vec.load(x, k), middle))
            local[0, near], local[1, near] = vec.dot(offset, u_axis), vec.dot(offset, w_axis)
            local[2, near] = vec.dot(offset, normal)
            weights[near] = agreements[k] ** 4
        u, w, rise = vec.dot(shift, u_axis), vec.dot(shift, w_axis), vec.dot(shift, normal)
        along = np.sqrt(u * u + w * w)
        least = 0.0
        if not is_known:
            least = np.sqrt(max(EARLY_WAY**2 - along * along, 0.0))
            least = max(least, floor - MARGIN - ALONG * along - ROUGH * now + TEXTURE * texture)
        noise = _fit(count, local, memory, rise, least)
        if noise < 0.0:
            continue
        across = abs(rise - coefficients[0])
        if along > KEPT_WAY:
            u = w = 0.0
        height = _height(u, w, coefficients)
        offset = vec.add_scaled(vec.add_scaled(vec.times(u, u_axis), w, w_axis), height, normal)
        target = vec.add_scaled(middle, size, offset)
        vec.store(targets, at, target)
        off = np.sqrt(across * across + along * along)
        if off < MIN_WAY or off * size < MIN_EDGES * edge:
            continue
        then = _roughness(target, n, x, fan)
        if now - then < MIN_GAIN:
            continue
        score = across + ALONG * along + ROUGH * now
        score -= SMOOTH * then + NOISE * noise + TEXTURE * texture
        if score <= floor:
            continue
        nearest = np.inf
        for k in range(n):
            nearest = min(nearest, vec.square_distance(vec.load(x, after[k]), point))
        if nearest < (TOUCHING * size) ** 2:
            continue
        # Restores the normals of the actual faces, overwritten by those of the projection.
        _roughness(point, n, x, fan)
        if _has_flat_side(point, n, x, faces, fan, FLAT * edge):
            continue
        if _spread(i, x, found, count, ring_start, ring, lengths, ranking) > UNLIKE_EDGES:
            continue
        scores[at] = score


def measure_agreement(
    x: Floats, faces: Ints, links: Connectivity, chosen: Longs, agreements: Floats
) -> None:
    """Set ``agreements`` (n,) of the vertices ``chosen`` (c,): the length of the mean of their
    faces' unit normals, 1 if these are equal and 0 if they cancel."""
    around = links.incidence
    over_ranges(_agreements, len(chosen), x, faces, *around, chosen, agreements)


def judge(
    chosen: Longs,
    places: Floats,
    x: Floats,
    faces: Ints,
    links: Connectivity,
    agreements: Floats,
    edge: float,
    is_known: bool,
    floor: float,
) -> tuple[Floats, Floats]:
    """Scores of the vertices ``chosen`` (c,) at ``places`` (c, 3), with all others at ``x``.

    Vertices that cannot have a score above ``floor`` are skipped unless ``is_known``.

    Returns
    -------
    scores : (c,), greater is farther out; ``NOT_JUDGED`` if a vertex cannot be an outlier: on the
        boundary, with too few others around it, or too near to its projection.
    targets : (c, 3), their projections on the fit.
    """
    scores, targets = np.empty(len(chosen)), np.empty((len(chosen), 3))
    around = faces, *links.incidence, *links.one_ring
    known = chosen, places, x, *around, agreements, edge, is_known, floor, scores, targets
    over_ranges(_judge, len(chosen), *known, smallest=MIN_PER_THREAD)
    return scores, targets


def pick(scores: Floats, bound: float, links: Connectivity) -> Longs:
    """The vertices whose score (n,) is above ``bound`` and the maximum of their one-ring."""
    chosen = np.flatnonzero(scores > bound)
    rows, near, _ = links.rings_of(chosen)
    own, is_largest = chosen[rows], np.ones(len(chosen), dtype=np.bool_)
    is_beaten = (scores[near] > scores[own]) | ((scores[near] == scores[own]) & (near < own))
    is_largest[rows[is_beaten]] = False
    return chosen[is_largest]


def find_two_rings(chosen: Longs, links: Connectivity) -> Longs:
    """The vertices ``chosen`` (c,) and those at most two edges from one, ascending."""
    marks = np.zeros(len(links.has_ring), dtype=np.bool_)
    marks[chosen] = True
    for _ in range(2):
        marks[links.rings_of(np.flatnonzero(marks))[1]] = True
    return np.flatnonzero(marks)
