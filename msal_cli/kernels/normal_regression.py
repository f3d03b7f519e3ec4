"""Face normals by regression: descriptors of every face, and the network that reads them.

The network is small and weighs candidate normals.  The inputs of a face are its vectors along its
three axes, one behind the other, and its numbers (``normal_descriptors``).  Each layer is W x + b,
followed by x -> max(x, x / 64) but for the last.  The last one gives a coefficient for each vector;
the normal is their combination, normalised.  So where all vectors are one, the normal is that one,
whatever the coefficients.

Inputs and vectors are made for FACES at a time, and are not kept.  Every sum over inputs goes from
the first to the last.  ``TILE`` outputs of twice ``LANES`` faces are summed at a time, which takes
half of the registers that any processor has.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from msal_cli.arrays import Floats, Floats32, Ints, Longs
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.faces import centroid_points, face_centroids, faces_within
from msal_cli.kernels.geometry import apply_umbrella, face_normals, face_normals_and_areas
from msal_cli.kernels.lanes import LANES, choose_greater, fill_lanes, load_lanes, store_lanes
from msal_cli.kernels.library import compiled
from msal_cli.kernels.normal_descriptors import (
    AXES,
    DEVIATION,
    FACES,
    FOUR,
    KNOWN,
    OWN_NUMBERS,
    RECORD,
    S1,
    S2,
    S3,
    VECTORS,
    WIDE,
    describe,
    lay_inputs,
    memory_for_inputs,
)
from msal_cli.kernels.parallel import fill_array, over_ranges
from msal_cli.kernels.quantiles import median
from msal_cli.kernels.vectors import ONE, THREE, TWO, ZERO
from msal_cli.light_dataclass import dataclass

MAX_NEAR = 63
"""Faces near one at most, beside itself."""

OTHERS = 4
"""Normals of the outcomes of other filters, given for a mesh: vectors of every stage."""

GUIDED = 2
"""Vectors of every stage behind these: the face's own normals filtered by the first of them, with
two ranges."""

EARLIER = 4
"""Vectors that a later stage has in addition: the scanned normal, that of the stage before, and
the first filtered by the second, with two ranges."""

STATISTICS = 5
"""Numbers of a face, behind the others, that are given for a mesh."""

ROOT_3 = 3.0**0.5
"""The edge of equilateral triangles over the distance of their centroids."""

QUIET, MIN_LOUD = 0.14, 0.02
"""The third of the STATISTICS up to which a face of an uneven mesh is quiet, about a third of the
level; and the part of the faces that must be louder."""

SAMPLED = 1 << 15
"""Faces from which the medians of a mesh are taken, or up to twice as many, evenly spread."""

GLOBALS = 11
"""Inputs that are the same for all faces of a mesh."""


@compiled
def _measure_distances(start, stop, c, ring_start, ring, distances):
    """Mean distances of the centroids c, flat, to those of the row of each face; zero for none."""
    for f in range(np.uint64(start), np.uint64(stop)):
        own, total, places = vec.load(c, f), 0.0, vec.row_range(ring_start, f)
        for at in places:
            total += vec.norm(vec.subtract(vec.load(c, ring[at]), own))
        distances[f] = total / np.float64(max(len(places), 1))


@compiled
def _average_units(start, stop, distances, ring_start, ring, units):
    """The mean of a face's distance and those of its row, times root 3."""
    for f in range(np.uint64(start), np.uint64(stop)):
        total, places = distances[f], vec.row_range(ring_start, f)
        for at in places:
            total += distances[ring[at]]
        units[f] = ROOT_3 * total / np.float64(len(places) + 1)


@compiled
def _fill_marks(start, stop, normals, areas, per_area, ring_start, ring, marks):
    """Normal and area, in the mean, of each face in one row, flat.

    Faces without a normal have no area, and get the mean of those around, weighted by area.
    """
    for f in range(np.uint64(start), np.uint64(stop)):
        normal, area = vec.load(normals, f), areas[f] * per_area
        if vec.is_zero(normal):
            area = 0.0
            for at in vec.row_range(ring_start, f):
                k = np.uint64(ring[at])
                normal = vec.add_scaled(normal, areas[k] * per_area, vec.load(normals, k))
            length = vec.norm(normal)
            if length > 0.0:
                normal = vec.divide(normal, length)
        for axis in range(3):
            marks[FOUR * f + np.uint64(axis)] = np.float32(normal[axis])
        marks[FOUR * f + THREE] = np.float32(area)


@compiled
def _measure_heights(start, stop, left, normals, time, ripples):
    """How long what is left is along the normals; after the second ``time`` also across them."""
    for i in range(np.uint64(start), np.uint64(stop)):
        way = vec.load(left, i)
        along = vec.dot(way, vec.load(normals, i))
        ripples[i, time] = abs(along)
        if time == 1:
            ripples[i, 3] = np.sqrt(max(vec.dot(way, way) - along * along, 0.0))


def measure_ripples(vertices: Floats, normals: Floats, links: Connectivity) -> Floats:
    """How rough the surface is at each vertex, (n, 4), in the unit of ``vertices`` (n, 3).

    The distances along the ``normals`` (n, 3) that are left of the positions when the umbrella is
    applied once, twice and three times: ever finer ripples.  The last is what is left sideways of
    the second.  Boundary vertices have none.
    """
    inner = links.has_ring & ~links.boundary
    left, ripples = vertices, np.empty((len(vertices), 4))
    moves = np.empty((2, *vertices.shape))
    for time in range(3):
        left = apply_umbrella(left, *links.one_ring, inner, moves[time % 2])
        over_ranges(_measure_heights, len(vertices), left, normals, time, ripples)
    return ripples


@dataclass(frozen=True, eq=False)
class Neighbourhoods:
    """Which faces are near each face, the same for all stages."""

    ring_start: Ints  # ring_start, ring: rows of the faces that share an edge with each face
    ring: Ints
    # near_start, near: rows of the faces within ``WIDE`` local units, the nearest first
    near_start: Longs
    near: Ints


def _find_units(centroids: Floats, ring_start: Ints, ring: Ints) -> Floats:
    """The local unit (m,) at each of the ``centroids`` (m, 3), file units."""
    m, rows = len(centroids), (ring_start.view(np.uint32), ring.view(np.uint32))
    distances = fill_array(_measure_distances, m, centroids.reshape(-1), *rows)
    return fill_array(_average_units, m, distances, *rows)


# The network

TILE = np.uint64(4)
"""Outputs that are summed at a time; layers have a multiple of it, filled up with zeros."""

LEAK = np.float32(1.0 / 64.0)

_0, _1, _TINY = np.float32(0.0), np.float32(1.0), 1e-12


@compiled
def _store_output(y, to, first, second, leak):
    """Write the output of twice ``LANES`` faces; what is below zero times ``leak``."""
    zero, slope = fill_lanes(_0), fill_lanes(leak)
    store_lanes(y, to, choose_greater(first, zero, first, first * slope))
    store_lanes(y, to + LANES, choose_greater(second, zero, second, second * slope))


@compiled
def _multiply(n_in, n_out, weights, at, x, y, leak):
    """One layer: ``y`` of ``x``; from ``at`` on are n_out biases, then the matrix.

    Of the matrix ``TILE`` rows are beside each other: for each input their weights.  Returns where
    the next layer begins.
    """
    row, step = at + n_out, n_in * TILE
    for o in range(ZERO, n_out, TILE):
        bias = at + o
        for face in range(ZERO, FACES, LANES + LANES):
            a0 = a1 = fill_lanes(weights[bias])
            b0 = b1 = fill_lanes(weights[bias + ONE])
            c0 = c1 = fill_lanes(weights[bias + TWO])
            d0 = d1 = fill_lanes(weights[bias + THREE])
            of, of_end, w = np.uint64(face), face + n_in * S1, row
            while of < of_end:
                x0, x1 = load_lanes(x, of), load_lanes(x, of + LANES)
                weight = fill_lanes(weights[w])
                a0, a1 = a0 + weight * x0, a1 + weight * x1
                weight = fill_lanes(weights[w + ONE])
                b0, b1 = b0 + weight * x0, b1 + weight * x1
                weight = fill_lanes(weights[w + TWO])
                c0, c1 = c0 + weight * x0, c1 + weight * x1
                weight = fill_lanes(weights[w + THREE])
                d0, d1 = d0 + weight * x0, d1 + weight * x1
                of += S1
                w += TILE
            to = o * S1 + face
            _store_output(y, to, a0, a1, leak)
            _store_output(y, to + S1, b0, b1, leak)
            _store_output(y, to + S2, c0, c1, leak)
            _store_output(y, to + S3, d0, d1, leak)
        row += step
    return row


@compiled
def predict_normals(
    start,
    stop,
    points,
    units,
    unit,
    near_start,
    near,
    known,
    records,
    statistics,
    others,
    is_later,
    n_vectors,
    n_in,
    n_hidden,
    n_out,
    weights,
    normals,
):
    """The unit normals (m, 3), flat, of a network with two hidden layers; see ``lay_inputs``.

    ``n_in`` is the number of inputs, ``n_hidden`` and ``n_out`` are multiples of ``TILE``, the
    last of at least ``n_vectors``.  ``weights`` has the three layers one behind another.
    """
    n_in, n_hidden, n_out = np.uint64(n_in), np.uint64(n_hidden), np.uint64(n_out)
    of = points, units, unit, near_start, near, known, records, statistics, others
    memory = memory_for_inputs(start, stop, near_start)
    vectors = np.zeros(np.int64(S3) * n_vectors, dtype=np.float32)
    x = np.zeros(np.int64(n_in * S1), dtype=np.float32)
    first_layer = np.empty(np.int64(n_hidden * S1), dtype=np.float32)
    second_layer = np.empty(np.int64(n_hidden * S1), dtype=np.float32)
    shares = np.empty(np.int64(n_out * S1), dtype=np.float32)
    last, n_vectors, zero = np.uint64(stop), np.uint64(n_vectors), np.float64(0.0)
    for chunk in range(np.uint64(start), last, FACES):
        for group in range(ZERO, min(FACES, last - chunk), LANES):
            first = chunk + group
            lay_inputs(first, last, group, of, is_later, memory, vectors, x)
        at = _multiply(n_in, n_hidden, weights, ZERO, x, first_layer, LEAK)
        at = _multiply(n_hidden, n_hidden, weights, at, first_layer, second_layer, LEAK)
        _multiply(n_hidden, n_out, weights, at, second_layer, shares, _1)
        for lane in range(min(FACES, last - chunk)):
            total, at = (zero, zero, zero), lane
            for k in range(n_vectors):
                vector = vectors[at], vectors[at + S1], vectors[at + S2]
                total = vec.add_scaled(total, shares[k * S1 + lane], vector)
                at += S3
            length = vec.norm(total)
            if length > _TINY:
                vec.store(normals, chunk + lane, vec.divide(total, length))
            else:
                own = vectors[lane], vectors[S1 + lane], vectors[S2 + lane]
                vec.store(normals, chunk + lane, own)


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is known of a scan before its faces are described; see ``methods/_cascade``."""

    noise: float | None  # standard deviation, mean edge lengths; None where it is not known
    is_white: bool  # whether that is white noise along the normals
    # whether much of the mesh has none of it, and does not count for what the whole mesh is like
    is_uneven: bool
    # (m, 3 OTHERS) normals that other filters give, beside each other; zero for none
    normals: Floats32
    statistics: Floats32  # (m, STATISTICS) of the surroundings of each face


def count_vectors(stage: int) -> int:
    """Vectors of each face in a stage, counted from 0; a multiple of four."""
    return VECTORS + OTHERS + GUIDED + (EARLIER if stage else 0)


@dataclass(frozen=True, eq=False)
class Descriptors:
    """What is known of every face in a stage."""

    # what ``lay_inputs`` makes inputs of: most of what is known is made where it is used, since to
    # write it down takes as long
    sources: tuple[Any, ...]
    is_later: bool  # whether a stage came before
    globals: Floats32  # (GLOBALS,) the inputs that are the same for all faces

    @property
    def axes(self) -> Floats32:
        """The axes (m, 3, 3) of each face."""
        known: Floats32 = self.sources[5].reshape(-1, int(KNOWN))
        return known[:, AXES:OWN_NUMBERS].reshape(-1, 3, 3)

    @property
    def n_vectors(self) -> int:
        """Candidates for the normal of a face."""
        return count_vectors(int(self.is_later))

    def predict(self, network: Network, normals: Floats | None = None) -> Floats:
        """The unit normals (m, 3) that the network gives, in the memory of ``normals``."""
        m = len(self.sources[1])
        normals = np.empty((m, 3)) if normals is None else normals
        sizes = self.n_vectors, network.n_in, network.n_hidden, network.n_out
        weights = network.bound(self.globals)
        of = *self.sources, self.is_later, *sizes, weights
        over_ranges(predict_normals, m, *of, normals.reshape(-1))
        return normals


@dataclass(frozen=True, eq=False)
class Network:
    """Two hidden layers; see the top."""

    # (bias (out,), matrix (out, in)) of each of the three
    layers: tuple[tuple[Floats32, Floats32], ...]

    @property
    def n_in(self) -> int:
        """Inputs of a face."""
        return int(self.layers[0][1].shape[1]) - GLOBALS

    @property
    def n_hidden(self) -> int:
        """Numbers in each hidden layer."""
        return len(self.layers[1][0])

    @property
    def n_out(self) -> int:
        """Coefficients, filled up."""
        return _fill(len(self.layers[2][0]))

    def bound(self, values: Floats32) -> Floats32:
        """All layers one behind another as the kernel reads them, for these global inputs."""
        parts = []
        for at, (bias, matrix) in enumerate(self.layers):
            if at == 0:
                bias = bias.copy()
                for column, value in enumerate(values, start=-GLOBALS):
                    bias += matrix[:, column] * value
                matrix = matrix[:, :-GLOBALS]
            more = _fill(len(bias)) - len(bias)
            tiles = np.pad(matrix, ((0, more), (0, 0))).reshape(-1, int(TILE), matrix.shape[1])
            parts += [np.pad(bias, (0, more)), tiles.transpose(0, 2, 1).reshape(-1)]
        return np.concatenate(parts)


def _fill(count: int) -> int:
    """The next number of outputs that the kernel takes."""
    return -(-count // int(TILE)) * int(TILE)


class NormalDescriber:
    """Makes the descriptors of the faces of one mesh, stage by stage.

    What it gives is overwritten by the next: memory that is new costs as much as the arithmetic.

    Parameters
    ----------
    faces, vertices : (m, 3) and (n, 3), the scan, from which the faces near each are found.
    ring_start, ring : rows of the faces that share an edge with each face.
    evidence : what is known of the scan.
    """

    def __init__(
        self, faces: Ints, vertices: Floats, ring_start: Ints, ring: Ints, evidence: Evidence
    ) -> None:
        m = len(faces)
        centroids = face_centroids(vertices, faces)
        reach = WIDE * _find_units(centroids, ring_start, ring)
        near = faces_within(centroids, ring_start, ring, reach, MAX_NEAR)
        self.around = Neighbourhoods(ring_start, ring, *near)
        self.evidence = evidence
        self._faces = faces
        self._marks = np.empty(4 * m, dtype=np.float32)
        self._known = np.empty((m, int(KNOWN)), dtype=np.float32)
        self._records = np.empty((m, int(RECORD)), dtype=np.float32)
        self._records[:, 16:19] = face_normals(vertices, faces)

    def describe(
        self, positions: Floats, ripples: Floats, earlier: Floats | None = None
    ) -> Descriptors:
        """The descriptors for one stage, with the vertices at ``positions`` (n, 3).

        Parameters
        ----------
        ripples : (n, 4) of the vertices, ``measure_ripples``.
        earlier : the normals (m, 3) of the stage before, for a later stage.
        """
        known, records, around = self._known, self._records, self.around
        if earlier is not None:
            records[:, 20:23] = earlier
        m, given = len(known), self.evidence
        self._lay_marks(*face_normals_and_areas(positions, self._faces))
        points = centroid_points(positions, self._faces)
        units = _find_units(points[:-1].reshape(-1, 3), around.ring_start, around.ring)
        unit = float(units.mean()) or 1.0
        of = units, unit, around.near_start.view(np.uint64), around.near.view(np.uint32)
        corners, others = self._faces.reshape(-1).view(np.uint32), given.normals.reshape(-1)
        made = known.reshape(-1), records.reshape(-1)
        over_ranges(describe, m, points, self._marks, *of, corners, ripples, others, *made)
        inputs = points, *of, *made, given.statistics.reshape(-1), others
        values = _find_globals(known, records, given)
        return Descriptors(inputs, earlier is not None, values)

    def _lay_marks(self, normals: Floats, areas: Floats) -> None:
        """Take normals (m, 3) and areas (m,) for ``describe``; zero normals where there is none."""
        around = self.around
        rows = around.ring_start.view(np.uint32), around.ring.view(np.uint32)
        per_area = 1.0 / (float(areas.mean()) or 1.0)
        of = normals.reshape(-1), areas, per_area, *rows
        over_ranges(_fill_marks, len(normals), *of, self._marks)


def _find_globals(known: Floats32, records: Floats32, evidence: Evidence) -> Floats32:
    """What the whole mesh is like: medians of differences between means, of the deviation from
    planes, of scatter and ripples; the level of the noise, whether it is known, and as white."""
    step = max(len(known) // SAMPLED, 1)
    known, records = known[::step], records[::step]
    if evidence.is_uneven:
        is_loud = evidence.statistics[::step, 2] > QUIET
        if is_loud.mean() > MIN_LOUD:
            known, records = known[is_loud], records[is_loud]
    own, narrow, wide = records[:, :3], known[:, :3], records[:, 8:11]
    of = [np.sqrt(((a - b) ** 2).sum(axis=1)) for a, b in ((own, wide), (narrow, wide))]
    of += [known[:, OWN_NUMBERS + DEVIATION], *records[:, 7::4].T]
    values = [median(column.astype(np.float64)) for column in of] + [evidence.noise or 0.0]
    bounded = [value / (value + 0.1) for value in values]
    is_known = evidence.noise is not None
    flags = [float(is_known), float(is_known and evidence.is_white)]
    return np.array(bounded + flags, dtype=np.float32)
