"""Bilateral means over neighbourhoods within a radius: of heights, and of projections on planes.

The neighbourhood of a vertex is found by breadth-first search through the connectivity, not in a
ball in space, so the other side of a thin wall is not included, and no search tree is needed.
"""

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.faces import face_centroids
from msal_cli.kernels.geometry import face_normals, face_normals_and_areas, vertex_normals
from msal_cli.kernels.library import compiled
from msal_cli.kernels.operators import MIN_SIGMA, Step
from msal_cli.kernels.parallel import fill_array
from msal_cli.kernels.vectors import ONE, ZERO, longest_row
from msal_cli.light_dataclass import dataclass

MAX_FOUND = 2048
"""Items at which a search stops: vertices within 23 mean edge lengths on an even mesh."""

MAX_LOOKS = 4 * MAX_FOUND
"""Neighbours that a search visits beyond the first row, because very high valences are slow."""


@compiled
def room(start, stop, row_start):
    """Items that a search from any of these vertices can find: first rows are included whole."""
    return np.int64(max(MAX_FOUND, longest_row(start, stop, row_start)) + 1)


@compiled
def vertices_around(i, x, ring_start, ring, square_radius, mark, found, squares):
    """Vertices within the radius of i that are connected to it through such vertices.

    x positions.  ``mark`` (n,) must not contain i; ``found`` and ``squares`` have room for all.
    Returns their number: ``found`` begins with i itself, ``squares`` are squared distances.
    """
    mark[i] = i
    found[0] = i
    squares[0] = 0.0
    count = 1
    at = 0
    looks = MAX_LOOKS
    while at < count:
        j = found[at]
        row = ring_start[j]
        end = ring_start[j + 1]
        if at > 0:
            end = min(end, row + looks)
            looks -= end - row
        at += 1
        for entry in range(row, end):
            k = ring[entry]
            if mark[k] == i:
                continue
            mark[k] = i
            square = vec.square_distance(vec.load(x, k), vec.load(x, i))
            if square <= square_radius:
                if at > 1 and count >= MAX_FOUND:
                    return count
                found[count] = k
                squares[count] = square
                count += 1
    return count


@compiled
def faces_around(i, x, centroids, faces, face_start, incident, square_radius, memory):
    """Faces whose centroids are within the radius of i, connected to it through such faces.

    x positions.  Faces that share a vertex are connected.  The marks (n,) and (m,) of ``memory``
    must not contain i; ``corners`` has room for three vertices a face.  Returns the number of faces
    ``found``, with the squared distances of their centroids in ``squares``.
    """
    vertex_mark, face_mark, corners, found, squares = memory
    own, name = vec.load(x, np.uint64(i)), np.int32(i)
    vertex_mark[np.uint64(i)] = name
    corners[0] = name
    waiting, count, at = ONE, ZERO, ZERO
    looks = MAX_LOOKS
    while at < waiting:
        j = np.uint64(corners[at])
        row = face_start[j]
        end = face_start[j + ONE]
        if at > ZERO:
            end = min(end, row + looks)
            looks -= end - row
        at += ONE
        for entry in range(np.uint64(row), np.uint64(end)):
            f = np.uint64(incident[entry])
            if face_mark[f] == name:
                continue
            face_mark[f] = name
            square = vec.square_distance(vec.load(centroids, f), own)
            if square > square_radius:
                continue
            if at > ONE and count >= MAX_FOUND:
                return np.int64(count)
            found[count] = f
            squares[count] = square
            count += ONE
            for corner in range(3):
                k = faces[f, corner]
                if vertex_mark[np.uint64(k)] != name:
                    vertex_mark[np.uint64(k)] = name
                    corners[waiting] = k
                    waiting += ONE
    return np.int64(count)


@compiled
def _shortest_edge(i, x, ring_start, ring, floor):
    """Length of the shortest edge at i that is longer than the floor; 0 if there is none."""
    shortest = np.inf
    for at in range(ring_start[i], ring_start[i + 1]):
        square = vec.square_distance(vec.load(x, ring[at]), vec.load(x, i))
        if square > floor * floor:
            shortest = min(shortest, square)
    return np.sqrt(shortest) if shortest < np.inf else 0.0


@compiled
def _ball_bilateral(
    start, stop, x, normals, ring_start, ring, free, radius, closeness, similarity, floor, moves
):
    """x positions, h heights, t distances of the neighbourhood, g the product of both Gaussians."""
    capacity = room(start, stop, ring_start)
    mark = np.full(len(ring_start) - 1, -1, dtype=np.int32)
    found = np.empty(capacity, dtype=np.int32)
    squares = np.empty(capacity)
    h = np.empty(capacity)
    g = np.empty(capacity)
    for i in range(start, stop):
        vec.store(moves, i, vec.ORIGIN)
        if not free[i]:
            continue
        width = closeness
        if width == 0.0:
            width = _shortest_edge(i, x, ring_start, ring, floor)
        width = max(width, floor)
        reach = radius if radius > 0.0 else 2.0 * width
        count = vertices_around(i, x, ring_start, ring, reach * reach, mark, found, squares)
        normal = vec.load(normals, i)
        mean = 0.0
        for at in range(count):
            h[at] = vec.dot(vec.offset(x, found[at], i), normal)
            mean += abs(h[at])
        scale = similarity
        if scale == 0.0:
            mean /= count
            variance = 0.0
            for at in range(count):
                offset = abs(h[at]) - mean
                variance += offset * offset
            scale = np.sqrt(variance / count)
        scale = max(scale, floor)
        near = 0.5 / (width * width)
        alike = 0.5 / (scale * scale)
        # The vertex itself, at height and distance 0, has weight 1, so the sum is positive.
        for at in range(count):
            g[at] = -(squares[at] * near) - h[at] * h[at] * alike
        vec.exponentials(g, count)
        weights = moment = 0.0
        for at in range(count):
            weights += g[at]
            moment += g[at] * h[at]
        vec.store(moves, i, vec.times(moment / weights, normal))


@dataclass(frozen=True, eq=False)
class BallBilateral:
    """d n with d = sum(w h) / sum(w) over a neighbourhood, and n the current normals.

    w = exp(-t^2 / 2 sigma_c^2 - h^2 / 2 sigma_s^2) with h the heights over the tangent plane and t
    the distances of the vertices within ``radius``, connected to the vertex through such vertices,
    and of the vertex itself (Fleishman, Drori and Cohen-Or 2003).
    """

    faces: Ints  # faces, links: (m, 3) and its neighbourhoods
    links: Connectivity
    free: Flags  # (n,) bool, False for vertices that must stay
    mean_edge_length: float  # file units; sets the floor of sigma_c and sigma_s
    radius: float = 0.0  # file units; 0 takes 2 sigma_c
    closeness: float = 0.0  # sigma_c, file units; 0 takes the length of each vertex's shortest edge
    # sigma_s, file units; 0 takes the standard deviation of |h| in each neighbourhood
    similarity: float = 0.0
    # of the face normals in a vertex normal, as in ``kernels.geometry.vertex_normals``
    weighting: str = "uniform"
    normals: None = None

    def __call__(self, positions: Floats) -> Step:
        links = self.links
        normals = vertex_normals(positions, self.faces, self.weighting)
        around = positions, normals, *links.one_ring, self.free
        widths = (self.radius, self.closeness, self.similarity, MIN_SIGMA * self.mean_edge_length)
        return Step(fill_array(_ball_bilateral, positions.shape, *around, *widths))


_CENTROIDS, _PROJECTIONS = range(2)

MIN_AREA = 1e-12
"""Area of a mollified face, squared mean edge lengths, up to which its normal is a rounding error:
an isolated triangle shrinks to a point."""


@compiled
def _project(
    start,
    stop,
    x,
    centroids,
    areas,
    normals,
    faces,
    face_start,
    incident,
    free,
    radius,
    closeness,
    similarity,
    floor,
    averaged,
    moves,
):
    """x positions, c centroids, n normals, s = (x - c) . n heights over the planes, g weights."""
    capacity = room(start, stop, face_start)
    vertex_mark = np.full(len(face_start) - 1, -1, dtype=np.int32)
    face_mark = np.full(len(faces), -1, dtype=np.int32)
    corners = np.empty(3 * capacity + 1, dtype=np.int32)
    found = np.empty(capacity, dtype=np.int32)
    squares = np.empty(capacity)
    memory = vertex_mark, face_mark, corners, found, squares
    s = np.empty(capacity)
    g = np.empty(capacity)
    near = 0.5 / max(closeness, floor) ** 2
    alike = 0.5 / max(similarity, floor) ** 2 if averaged == _PROJECTIONS else 0.0
    for i in range(start, stop):
        vec.store(moves, i, vec.ORIGIN)
        if not free[i]:
            continue
        square = radius * radius
        count = faces_around(i, x, centroids, faces, face_start, incident, square, memory)
        own, least = vec.load(x, i), np.inf
        for at in range(count):
            f = np.uint64(found[at])
            s[at] = vec.dot(vec.subtract(own, vec.load(centroids, f)), vec.load(normals, f))
            g[at] = squares[at] * near + s[at] * s[at] * alike
            least = min(least, g[at])
        # Scaled so that the largest Gaussian is 1: the quotient is the same, and never 0/0.
        for at in range(count):
            g[at] = least - g[at]
        vec.exponentials(g, count)
        weights, total = 0.0, vec.ORIGIN
        for at in range(count):
            f = np.uint64(found[at])
            weight = g[at] * areas[f]
            weights += weight
            if averaged == _PROJECTIONS:
                total = vec.add_scaled(total, -(weight * s[at]), vec.load(normals, f))
            else:
                offset = vec.subtract(vec.load(centroids, f), own)
                total = vec.add_scaled(total, weight, offset)
        if weights > 0.0:
            vec.store(moves, i, vec.divide(total, weights))


@dataclass(frozen=True, eq=False)
class ProjectionAverage:
    """dx = sum(w (P(x) - x)) / sum(w) over the faces around x, w = A f(|c - x|) g(|P(x) - x|).

    P(x) is the projection of x on the plane through a face's centroid c along its mollified normal,
    A the face's area, f and g Gaussians of widths ``closeness`` and ``similarity`` (Jones, Durand
    and Desbrun 2003).  Mollified normals are those of the faces after each vertex moved to the
    average of the centroids with weights A f, f half as wide; a face that this makes degenerate
    keeps its own normal.  The faces are those with a centroid within 2 closeness, connected to the
    vertex through such faces; a vertex without any does not move.
    """

    faces: Ints  # faces, links: (m, 3) and its neighbourhoods
    links: Connectivity
    free: Flags  # (n,) bool, False for vertices that must stay
    # file units; areas are taken in squares of it, and it sets the floor of the widths
    mean_edge_length: float
    closeness: float  # closeness, similarity: sigma_f and sigma_g, file units
    similarity: float
    normals: None = None

    def __call__(self, positions: Floats) -> Step:
        own, areas = face_normals_and_areas(positions, self.faces)
        areas /= self.mean_edge_length**2
        centroids = face_centroids(positions, self.faces)
        floor = MIN_SIGMA * self.mean_edge_length

        def average(normals: Floats, free: Flags, closeness: float, averaged: int) -> Floats:
            """Displacements (n, 3) of the vertices to the average of centroids or projections."""
            planes = centroids, areas, normals, self.faces, *self.links.incidence
            widths = 2.0 * self.closeness, closeness, self.similarity, floor
            known = positions, *planes, free, *widths, averaged
            return fill_array(_project, positions.shape, *known)

        everywhere = np.ones_like(self.free)
        smooth = positions + average(own, everywhere, 0.5 * self.closeness, _CENTROIDS)
        normals, smooth_areas = face_normals_and_areas(smooth, self.faces)
        has_normal = smooth_areas > MIN_AREA * self.mean_edge_length**2
        has_normal &= (normals != 0.0).any(axis=1)
        normals = np.where(has_normal[:, None], normals, own)
        return Step(average(normals, self.free, self.closeness, _PROJECTIONS))


@compiled
def _normal_spread(start, stop, unit_normals, normals, face_start, incident, spread):
    for i in range(start, stop):
        total = count = 0.0
        for at in range(face_start[i], face_start[i + 1]):
            normal = vec.load(unit_normals, incident[at])
            if not vec.is_zero(normal):
                total += 1.0 - vec.dot(normal, vec.load(normals, i))
                count += 1.0
        spread[i] = max(0.0, total / count) if count > 0.0 else 0.0


def normal_spread(positions: Floats, faces: Ints, links: Connectivity, normals: Floats) -> Floats:
    """Mean of 1 - n_f . n over the faces around each vertex (n,), n its unit normal (n, 3).

    On an edge between two planes this is 1 - cos of half the angle between their normals.
    Degenerate faces do not count; a vertex without other faces has 0.
    """
    units = face_normals(positions, faces)
    return fill_array(_normal_spread, len(positions), units, normals, *links.incidence)


@compiled
def _step_towards_planes(start, stop, x, normals, ring_start, ring, moves):
    for i in range(start, stop):
        total = vec.ORIGIN
        m = ring_start[i + 1] - ring_start[i]
        for at in range(ring_start[i], ring_start[i + 1]):
            k = ring[at]
            normal = vec.load(normals, k)
            total = vec.add_scaled(total, vec.dot(vec.offset(x, k, i), normal), normal)
        vec.store(moves, i, vec.times(1.0 / m if m else 0.0, total))


def step_towards_planes(positions: Floats, normals: Floats, ring_start: Ints, ring: Ints) -> Floats:
    """Mean of the displacements (n, 3) of each vertex to the tangent planes of its one-ring.

    A gradient step on the sum of squared distances from these planes, the quadric of the
    neighbourhood, whose minimum is the edge between two planes, or the corner of three.  Neighbours
    with a zero normal count as planes through the vertex.
    """
    return fill_array(_step_towards_planes, positions.shape, positions, normals, ring_start, ring)
