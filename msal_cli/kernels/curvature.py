"""Cotangent weights, vertex areas, and mean curvature flow, isotropic and anisotropic.

Sums run over the corners of faces, so that boundary and non-manifold edges need no special case: an
edge has one cotangent for each of its faces.
"""

import functools
from collections.abc import Callable

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.connectivity import Connectivity, index_rows
from msal_cli.kernels.geometry import DEGENERATE, ring_areas
from msal_cli.kernels.library import compiled
from msal_cli.kernels.linear_systems import RowMatrix, conjugate_gradients
from msal_cli.kernels.operators import Step
from msal_cli.kernels.parallel import fill_array, over_ranges
from msal_cli.kernels.quantiles import PER_MEDIAN, median
from msal_cli.light_dataclass import dataclass

FLATTEST = 0.05
"""Ratio of height to longest edge below which a face has the cotangents of a less flat one.

This is about three degrees in the smallest angle of an isosceles face; no cotangent exceeds 20.
"""


@compiled
def _corner_dots(vertices, a, b, c):
    """Dot products of the edges at each corner, doubled area, longest edge squared."""
    u, w, normal = vec.edges_and_normal(vertices, a, b, c)
    v = vec.subtract(w, u)
    return vec.dot(u, w), -vec.dot(u, v), vec.dot(w, v), vec.norm(normal), vec.longest_square(u, w)


@compiled
def _corner_cotangents(start, stop, vertices, faces, cotangents):
    for f in range(start, stop):
        a, b, c = vec.load(faces, f)
        at_a, at_b, at_c, doubled, longest = _corner_dots(vertices, a, b, c)
        # A common divisor scales the face's part of the stiffness matrix by a number below one, so
        # that the matrix stays positive semidefinite.
        divisor = max(doubled, FLATTEST * longest)
        inverse = 1.0 / divisor if divisor > 0.0 else 0.0
        vec.store(cotangents, f, vec.times(inverse, (at_a, at_b, at_c)))


@compiled
def _cotangent_weights(
    start, stop, cotangents, faces, face_start, incident, ring_start, ring, weights
):
    # Slots in ``ring`` only grow, so one at or above a row's start belongs to that row.
    slot = np.full(len(ring_start) - 1, -1, dtype=np.int32)
    for i in range(start, stop):
        row = ring_start[i]
        for at in range(row, ring_start[i + 1]):
            slot[ring[at]] = at
            weights[at] = 0.0
        for at in range(face_start[i], face_start[i + 1]):
            f = incident[at]
            own = 0
            while faces[f, own] != i:
                own += 1
            after, before = (own + 1) % 3, (own + 2) % 3
            weights[slot[faces[f, after]]] += cotangents[f, before]
            weights[slot[faces[f, before]]] += cotangents[f, after]


def cotangent_weights(vertices: Floats, faces: Ints, links: Connectivity) -> Floats:
    """cot alpha + cot beta of each edge, (e,), one for each entry of ``links.ring``.

    alpha and beta are the angles opposite to the edge; a boundary edge has one, a non-manifold edge
    one for each face.  For a face whose height is less than 1/20 of its longest edge the three
    cotangents are reduced by a common factor, to at most 20.  Except for such faces the gradient of
    the surface's area with respect to vertex i is sum(w_ik (x_i - x_k)) / 2.  The matrix with -w
    off its diagonal and sum(w) on it is positive semidefinite for any vertices.

    Parameters
    ----------
    vertices : (n, 3).
    faces : (m, 3), the faces that ``links`` were made from, of any winding.
    """
    weights = np.empty(len(links.ring))
    cotangents = fill_array(_corner_cotangents, (len(faces), 3), vertices, faces)
    rows = *links.incidence, *links.one_ring
    over_ranges(_cotangent_weights, len(vertices), cotangents, faces, *rows, weights)
    return weights


@compiled
def _corner_areas(start, stop, vertices, faces, areas):
    for f in range(start, stop):
        a, b, c = vec.load(faces, f)
        at_a, at_b, at_c, doubled, _ = _corner_dots(vertices, a, b, c)
        lowest = min(at_a, at_b, at_c)
        if doubled == 0.0:
            vec.store(areas, f, vec.ORIGIN)
        elif lowest < 0.0:
            areas[f, 0] = doubled / (4.0 if at_a == lowest else 8.0)
            areas[f, 1] = doubled / (4.0 if at_b == lowest else 8.0)
            areas[f, 2] = doubled / (4.0 if at_c == lowest else 8.0)
        else:
            # Squared length of an edge times the cotangent of the opposite corner.
            scale = 1.0 / (8.0 * doubled)
            of_bc = (at_b + at_c) * (at_a * scale)
            of_ca = (at_c + at_a) * (at_b * scale)
            of_ab = (at_a + at_b) * (at_c * scale)
            vec.store(areas, f, (of_ca + of_ab, of_ab + of_bc, of_bc + of_ca))


def mixed_areas(vertices: Floats, faces: Ints) -> Floats:
    """Mixed Voronoi area of each vertex, (n,), squared file units; Meyer et al. 2002.

    In a face without an obtuse angle each corner has the part that is nearest to it; in an obtuse
    face the obtuse corner has half of the area, the others a quarter each.  The sum over all
    vertices is the area of the surface.
    """
    corner_areas = fill_array(_corner_areas, (len(faces), 3), vertices, faces)
    sums = np.bincount(faces.reshape(-1), corner_areas.reshape(-1), len(vertices))
    return np.asarray(sums, dtype=np.float64)


# Mean curvature flow, x' = -grad(area) / area of the vertex, by explicit and implicit steps.

AREAS = ("mixed", "ring")

TOLERANCE = 1e-8
"""Accuracy of the solution of an implicit step, mean edge lengths, below the rounding of scans."""

MAX_ITERATIONS = 10_000
"""Largest number of conjugate gradient iterations, for steps too long to be solved well."""


def vertex_areas(vertices: Floats, faces: Ints, links: Connectivity, areas: str) -> Floats:
    """Area of each vertex, (n,), squared file units.

    ``areas`` is ``"mixed"``: the mixed Voronoi area; or ``"ring"``: a third of the one-ring's area.
    """
    if areas == "mixed":
        return mixed_areas(vertices, faces)
    return ring_areas(vertices, faces, links) / 3.0


@compiled
def _curvature_step(start, stop, x, weights, areas, ring_start, ring, free, time_step, moves):
    for i in range(start, stop):
        total_offset = vec.ORIGIN
        total = 0.0
        for at in range(ring_start[i], ring_start[i + 1]):
            total_offset = vec.add_scaled(total_offset, weights[at], vec.offset(x, ring[at], i))
            total += abs(weights[at])
        share = 0.0
        if free[i] and total > 0.0:
            share = 1.0 / total
            if time_step * total < 2.0 * areas[i]:
                share = time_step / (2.0 * areas[i])
        vec.store(moves, i, vec.times(share, total_offset))


@dataclass(frozen=True, eq=False)
class MeanCurvature:
    """min(tau, limit_i) / (2 A_i) sum(w (x_k - x_i)), w = cot alpha + cot beta, A vertex areas.

    limit_i = 2 A_i / sum|w| is the time step with which a vertex with positive weights moves to the
    weighted mean of its neighbours; larger explicit steps would overshoot.
    """

    faces: Ints  # (m, 3), the faces that ``links`` were made from
    links: Connectivity
    free: Flags  # (n,) bool, False for vertices that must stay
    time_step: float  # tau, in squared file units
    areas: str = "mixed"  # ``"mixed"`` or ``"ring"``
    normals: None = None

    def __call__(self, positions: Floats) -> Step:
        faces, links = self.faces, self.links
        weights = cotangent_weights(positions, faces, links)
        areas = vertex_areas(positions, faces, links, self.areas)
        rows = positions, weights, areas, *links.one_ring
        return Step(fill_array(_curvature_step, positions.shape, *rows, self.free, self.time_step))


@dataclass(frozen=True, eq=False)
class ImplicitMeanCurvature:
    """X' - X of one implicit step, (M + tau L) X' = M X, with L the cotangent stiffness matrix.

    L = grad(area) keeps the weights w / 2 of the input: that flow has no singularities, while the
    one that updates them pinches off thin parts (Kazhdan, Solomon and Ben-Chen 2012).  M has the
    vertex areas, updated at each call.
    """

    faces: Ints  # (m, 3), the faces that ``links`` were made from
    links: Connectivity
    weights: Floats  # (e,), one for each entry of ``links.ring``
    free: Flags  # (n,) bool, False for vertices that must stay
    time_step: float  # tau, in squared file units
    mean_edge_length: float  # file units; sets the accuracy of the solution
    areas: str  # ``"mixed"`` or ``"ring"``
    # called after each iteration of the solver; an exception that it raises ends the run
    on_iteration: Callable[[], object]
    normals: None = None

    def __call__(self, positions: Floats) -> Step:
        links = self.links
        areas = vertex_areas(positions, self.faces, links, self.areas)
        values = -0.5 * self.weights
        sums = np.zeros(len(positions))
        filled = np.diff(links.ring_start) > 0
        sums[filled] = np.add.reduceat(values, links.ring_start[:-1][filled])
        # (M / tau + L) (X' - X) = -L X.  Displacements have smaller rounding errors than positions,
        # and the matrix has no unit, so that tiny meshes cannot underflow.
        matrix = RowMatrix(areas / self.time_step - sums, *links.one_ring, values)
        right = np.empty_like(positions)
        RowMatrix(sums, *links.one_ring, -values).times(positions, right)
        moves = conjugate_gradients(
            matrix.diagonal,
            matrix.times,
            right,
            np.zeros_like(positions),
            tolerance=TOLERANCE * self.mean_edge_length,
            most_iterations=MAX_ITERATIONS,
            held=~self.free,
            on_iteration=self.on_iteration,
        )
        return Step(moves)


# Mean curvature by edges, with reduced weights of edges with a curvature above a threshold.
#
# The curvature vector of an edge e between faces with unit normals m and n is H(e) = e x (n - m),
# of length 2 |e| sin(phi / 2) for the angle phi between m and n.  Half the sum of H(e) around a
# vertex is the gradient of the surface's area.  Symbols as in Hildebrandt and Polthier 2004.

MAX_SHARE = 0.5
"""Largest displacement in a step, as a share of the distance at which H_A would vanish."""

MIN_SLOPE = 0.25
"""Smallest slope, for flaps bent beyond a right angle, where that of the flat flap may be 0."""


@compiled
def _edge_curvatures(start, stop, x, corners, threshold, falloff, curvatures, slopes, bent):
    """w H(e), the derivatives of its length by the heights of both ends, and whether |H| > lambda.

    H of a flat flap grows with the height of p1 by the cotangents of the two angles at p3, and vice
    versa.  All are zero beside a degenerate face.
    """
    for e in range(start, stop):
        # Unsigned indices need no test for negative ones.
        p1, p2 = np.uint64(corners[e, 0]), np.uint64(corners[e, 1])
        p3, p4 = np.uint64(corners[e, 2]), np.uint64(corners[e, 3])
        b, edge, m_normal = vec.edges_and_normal(x, p1, p2, p3)
        _, d, n_normal = vec.edges_and_normal(x, p1, p3, p4)
        m, n = vec.norm(m_normal), vec.norm(n_normal)
        ee, bb, dd = vec.dot(edge, edge), vec.dot(b, b), vec.dot(d, d)
        be, de = vec.dot(b, edge), vec.dot(d, edge)
        h = vec.ORIGIN
        slope_1 = slope_3 = 0.0
        if m > DEGENERATE * max(ee, bb) and n > DEGENERATE * max(ee, dd):
            # Not by reciprocals, so that equal normals cancel exactly.
            h = vec.cross(edge, vec.subtract(vec.divide(n_normal, n), vec.divide(m_normal, m)))
            m, n = 1.0 / m, 1.0 / n
            slope_1 = max(abs(ee - be) * m, MIN_SLOPE) + max(abs(ee - de) * n, MIN_SLOPE)
            slope_3 = max(abs(be) * m, MIN_SLOPE) + max(abs(de) * n, MIN_SLOPE)
        size = vec.norm(h)
        bent[e] = size > threshold
        if bent[e]:
            # w = lambda^2 / (r (lambda - |H|)^2 + lambda^2), without squares of lengths.
            ratio = threshold / size
            weight = ratio * ratio / (falloff * (1.0 - ratio) ** 2 + ratio * ratio)
            h = vec.times(weight, h)
            slope_1, slope_3 = weight * slope_1, weight * slope_3
        vec.store(curvatures, e, h)
        slopes[e, 0] = slope_1
        slopes[e, 1] = slope_3


def edge_curvatures(
    vertices: Floats, corners: Ints, threshold: float = np.inf, falloff: float = 1.0
) -> tuple[Floats, Floats, Flags]:
    """Curvature vectors w H(e) (e, 3) of ``flaps`` (e, 4), file units, pointing outwards on ridges;
    zero beside a degenerate face.

    Also the derivatives of their lengths by the heights of both ends (e, 2), and whether they are
    longer than the threshold (e,).
    """
    count = len(corners)
    results = np.empty((count, 3)), np.empty((count, 2)), np.empty(count, dtype=bool)
    over_ranges(_edge_curvatures, count, vertices, corners, threshold, falloff, *results)
    return results


def curvature_threshold(vertices: Floats, corners: Ints, deviations: float) -> float:
    """Median length of H(e) plus ``deviations`` times its standard deviation, file units.

    The standard deviation is 1.4826 times the median absolute deviation.  Zero without ``flaps``
    (e, 4).
    """
    lengths: Floats = np.sqrt((edge_curvatures(vertices, corners)[0] ** 2).sum(axis=1))
    if not len(lengths):
        return 0.0
    middle = median(lengths)
    if not deviations:
        return middle
    return float(middle + deviations * PER_MEDIAN * median(np.abs(lengths - middle)))


@compiled
def _area_vectors(start, stop, x, faces, vectors):
    """Twice the area vector and twice the area of each face."""
    for f in range(start, stop):
        a, b, c = vec.load(faces, f)
        _, _, normal = vec.edges_and_normal(x, a, b, c)
        vec.store(vectors, f, normal)
        vectors[f, 3] = vec.norm(normal)


@compiled
def _gather(
    start,
    stop,
    curvatures,
    slopes,
    bent,
    edge_start,
    ends,
    vectors,
    face_start,
    incident,
    free,
    time_step,
    total,
    outward,
    rate,
    feature,
):
    """H_A, the gradient of the volume, time step over mass, and whether an edge is bent."""
    for i in range(start, stop):
        h, stiffness = vec.ORIGIN, 0.0
        feature[i] = False
        for at in range(edge_start[i], edge_start[i + 1]):
            e, end = np.uint64(ends[at] >> 1), np.uint64(ends[at] & 1)
            h = vec.add(h, vec.load(curvatures, e))
            stiffness += slopes[e, end]
            feature[i] |= bent[e]
        vec.store(total, i, vec.times(0.5, h))
        area = 0.0
        for at in range(face_start[i], face_start[i + 1]):
            area += vectors[np.uint64(incident[at]), 3]
        vec.store(outward, i, vec.divide(vec.sum_row(vectors, face_start, incident, i), 6.0))
        # The mass is area / 6, the derivative of H_A by the height of the vertex stiffness / 2.
        rate[i] = 0.0
        if free[i] and stiffness > 0.0:
            rate[i] = 2.0 * MAX_SHARE / stiffness
            if 6.0 * time_step < rate[i] * area:
                rate[i] = 6.0 * time_step / area


@compiled
def _directions(start, stop, edge_start, beside, total, outward, feature, along, products):
    """V_A of length |grad volume|, the product H_A . V_A / |V_A|, and |V_A|."""
    for i in range(start, stop):
        v = vec.load(outward, i)
        length = vec.norm(v)
        if feature[i]:
            m = edge_start[i + 1] - edge_start[i]
            mean = vec.divide(vec.sum_row(total, edge_start, beside, i), m)
            s = vec.add(vec.load(total, i), mean)
            size = vec.norm(s)
            if size > 0.0:
                scale = length / size
                v = vec.times(-scale if vec.dot(s, v) < 0.0 else scale, s)
        vec.store(along, i, v)
        product = vec.dot(vec.load(total, i), v)
        products[i, 0] = product / length if length > 0.0 else 0.0
        products[i, 1] = length


@compiled
def _prescribe(start, stop, edge_start, beside, along, products, feature, total):
    """Take f V_A from H_A."""
    for i in range(start, stop):
        product = length = 0.0
        for at in range(edge_start[i], edge_start[i + 1]):
            k = np.uint64(beside[at])
            if feature[k] or not feature[i]:
                product += products[k, 0]
                length += products[k, 1]
        f = product / length if length > 0.0 else 0.0
        vec.store(total, i, vec.add_scaled(vec.load(total, i), -f, vec.load(along, i)))


@dataclass(frozen=True, eq=False)
class AnisotropicCurvature:
    """One step of anisotropic, or of prescribed, mean curvature flow: -tau / M (H_A - f V_A).

    H_A is half the sum of w H(e) over the edges around a vertex, w = 1 where |H(e)| <= lambda and
    lambda^2 / (r (lambda - |H|)^2 + lambda^2) beyond; M is a third of the area around it.

    Without ``prescribed`` f is zero.  With it V_A is the gradient of the volume; at a feature, a
    vertex with an edge beyond lambda, it keeps its length but has the direction of H_A plus the
    mean H_A of the neighbours.  f = sum(H_A . V_A / |V_A|) / sum |V_A| over the neighbours; for a
    feature over those that are features.

    A vertex for which tau / M would overshoot takes a shorter step.
    """

    faces: Ints  # (m, 3), the faces that ``links`` were made from
    links: Connectivity
    corners: Ints  # (e, 4), their ``flaps``; other edges do not count
    free: Flags  # (n,) bool, False for vertices that must stay
    threshold: float  # lambda, in file units
    falloff: float  # r, above zero
    time_step: float  # tau, in squared file units
    prescribed: bool
    normals: None = None

    @functools.cached_property
    def _rows(self) -> tuple[Ints, Ints, Ints]:
        """The flaps e whose edge ends at each vertex in CSR form, 2 e for p1 and 2 e + 1 for p3,
        and the vertices at the other ends."""
        edges = self.corners[:, ::2]
        edge_start, ends = index_rows(len(self.free), edges, 2, 1)
        beside = edges.reshape(-1)[ends ^ 1]
        return edge_start, ends, beside

    def __call__(self, positions: Floats) -> Step:
        n = len(positions)
        edge_start, ends, beside = self._rows
        vectors = fill_array(_area_vectors, (len(self.faces), 4), positions, self.faces)
        bends = edge_curvatures(positions, self.corners, self.threshold, self.falloff)
        around = edge_start, ends, vectors, *self.links.incidence
        total, outward, rate = np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
        feature = np.empty(n, dtype=bool)
        results = total, outward, rate, feature
        over_ranges(_gather, n, *bends, *around, self.free, self.time_step, *results)
        if self.prescribed:
            along, products = np.empty((n, 3)), np.empty((n, 2))
            rows = edge_start, beside
            over_ranges(_directions, n, *rows, total, outward, feature, along, products)
            over_ranges(_prescribe, n, *rows, along, products, feature, total)
        return Step(-rate[:, None] * total)
