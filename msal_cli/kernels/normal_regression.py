"""Face normals by regression: descriptors of each face, and the network that combines them.

The network is small and weights candidate normals.  The inputs of a face are the coordinates of its
vectors along its three axes, and its features (``normal_descriptors``).  Each layer is W x + b,
followed by the leaky rectifier x -> max(x, x / 64) except for the last one, which gives a
coefficient for each vector.  The normal is their normalised combination, so if all vectors are
equal, it is that vector for any coefficients.

Inputs and vectors are computed for FACES at once, and are not kept.  Sums over inputs go from the
first to the last.  ``TILE`` outputs of twice ``LANES`` faces are summed at once, which takes half
of the registers of any processor.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Floats32, Ints
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
"""Largest number of faces near one, without itself."""

OTHERS = 4
"""Normals by other filters: vectors of each stage."""

GUIDED = 2
"""Vectors of each stage after these: the face's own normals filtered with the first as guide, two
ranges."""

EARLIER = 4
"""Additional vectors of later stages: the scanned normal, that of the stage before, and the first
filtered with the second as guide, with two ranges."""

STATISTICS = 5
"""Features of a face, after the others, that are the same for all stages."""

ROOT_3 = 3.0**0.5
"""Edge length of equilateral triangles over the distance of their centroids."""

QUIET, MIN_LOUD = 0.14, 0.02
"""Value of the third of the STATISTICS up to which a face of a mesh with uneven noise is quiet,
about a third of the level; and the share of louder ones from which they are ignored."""

SAMPLED = 1 << 15
"""Number of evenly spread faces, up to twice as many, for the medians of a mesh."""

GLOBALS = 11
"""Inputs that are the same for all faces of a mesh."""


@compiled
def _measure_distances(start, stop, c, ring_start, ring, distances):
    """Mean distances of the centroids c, flat, to those of their neighbours; zero without any."""
    for f in range(np.uint64(start), np.uint64(stop)):
        own, total, places = vec.load(c, f), 0.0, vec.row_range(ring_start, f)
        for at in places:
            total += vec.norm(vec.subtract(vec.load(c, ring[at]), own))
        distances[f] = total / np.float64(max(len(places), 1))


@compiled
def _average_units(start, stop, distances, ring_start, ring, units):
    """The mean of a face's distance and those of its neighbours, times root 3."""
    for f in range(np.uint64(start), np.uint64(stop)):
        total, places = distances[f], vec.row_range(ring_start, f)
        for at in places:
            total += distances[ring[at]]
        units[f] = ROOT_3 * total / np.float64(len(places) + 1)


@compiled
def _fill_marks(start, stop, normals, areas, per_area, ring_start, ring, marks):
    """Normal and relative area of each face in one row, flat.

    Degenerate faces have area zero, and the mean normal of their neighbours, weighted by area.
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
    """Absolute normal components of vectors ``left``; after the second umbrella also tangential."""
    for i in range(np.uint64(start), np.uint64(stop)):
        vector = vec.load(left, i)
        along = vec.dot(vector, vec.load(normals, i))
        ripples[i, time] = abs(along)
        if time == 1:
            ripples[i, 3] = np.sqrt(max(vec.dot(vector, vector) - along * along, 0.0))


def measure_ripples(vertices: Floats, normals: Floats, links: Connectivity) -> Floats:
    """Roughness of the surface at each vertex (ripples), (n, 4), in the unit of ``vertices`` (n,
    3).

    The absolute components along the ``normals`` (n, 3) of the umbrella operator applied once,
    twice and three times, for ever finer ripples; the last is the tangential length for the second.
    They are zero at boundary vertices.
    """
    inner = links.has_ring & ~links.boundary
    left, ripples = vertices, np.empty((len(vertices), 4))
    moves = np.empty((2, *vertices.shape))
    for time in range(3):
        left = apply_umbrella(left, *links.one_ring, inner, moves[time % 2])
        over_ranges(_measure_heights, len(vertices), left, normals, time, ripples)
    return ripples


def _find_units(centroids: Floats, *rows: NDArray[np.uint32]) -> Floats:
    """The local unit (m,) at each of the ``centroids`` (m, 3), file units; rows of neighbours."""
    distances = fill_array(_measure_distances, len(centroids), centroids.reshape(-1), *rows)
    return fill_array(_average_units, len(centroids), distances, *rows)


# The network

TILE = np.uint64(4)
"""Outputs that are summed at once; layers are padded with zeros to a multiple of it."""

LEAK = np.float32(1.0 / 64.0)

_0, _1, _TINY = np.float32(0.0), np.float32(1.0), 1e-12


@compiled
def _store_output(y, to, first, second, leak):
    """Write the outputs of twice ``LANES`` faces; negative ones are multiplied by ``leak``."""
    zero, slope = fill_lanes(_0), fill_lanes(leak)
    store_lanes(y, to, choose_greater(first, zero, first, first * slope))
    store_lanes(y, to + LANES, choose_greater(second, zero, second, second * slope))


@compiled
def _multiply(n_in, n_out, weights, at, x, y, leak):
    """One layer: ``y`` of ``x``; ``weights`` has n_out biases from ``at`` on, then the matrix.

    The matrix is in tiles of ``TILE`` rows: for each input the weights of these outputs.  Returns
    the start of the next.
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
    """The unit normals (m, 3), flat, by a network with two hidden layers; see ``lay_inputs``.

    ``n_in`` is the number of inputs, ``n_hidden`` and ``n_out`` are multiples of ``TILE``, the last
    at least ``n_vectors``.  ``weights`` has the three concatenated layers.
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
    """Evidence on a scan for the descriptors of its faces; see ``methods/_cascade``."""

    noise: float | None  # level of noise, mean edge lengths; None if unknown
    is_white: bool  # whether that is white noise along the normals
    # whether much of the mesh has no noise, and is left out of its medians
    is_uneven: bool
    # (m, 3 OTHERS) normals by other filters; zero for none
    normals: Floats32
    statistics: Floats32  # (m, STATISTICS) of the surroundings of each face


def count_vectors(stage: int) -> int:
    """Vectors of each face in a stage, counted from 0; a multiple of four."""
    return VECTORS + OTHERS + GUIDED + (EARLIER if stage else 0)


@dataclass(frozen=True, eq=False)
class Descriptors:
    """The descriptors of all faces in a stage."""

    # arguments of ``lay_inputs``, which computes most descriptors: storing them takes as long
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
        """Number of candidate vectors for the normal of a face."""
        return count_vectors(int(self.is_later))

    def predict(self, network: Network, normals: Floats | None = None) -> Floats:
        """The unit normals (m, 3) by the network, in the memory of ``normals``."""
        m = len(self.sources[1])
        normals = np.empty((m, 3)) if normals is None else normals
        sizes = self.n_vectors, network.n_in, network.n_hidden, network.n_out
        weights = network.bound(self.globals)
        of = *self.sources, self.is_later, *sizes, weights
        over_ranges(predict_normals, m, *of, normals.reshape(-1))
        return normals


@dataclass(frozen=True, eq=False)
class Network:
    """A network with two hidden layers; see the module's description."""

    # (bias (out,), matrix (out, in)) of each of the three
    layers: tuple[tuple[Floats32, Floats32], ...]

    @property
    def n_in(self) -> int:
        """Number of inputs of a face."""
        return int(self.layers[0][1].shape[1]) - GLOBALS

    @property
    def n_hidden(self) -> int:
        """Number of units in each hidden layer."""
        return len(self.layers[1][0])

    @property
    def n_out(self) -> int:
        """Number of coefficients, padded."""
        return _fill(len(self.layers[2][0]))

    def bound(self, values: Floats32) -> Floats32:
        """The concatenated layers for the kernel, with these global inputs in the biases."""
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
    """``count`` rounded up to a multiple of ``TILE``."""
    return -(-count // int(TILE)) * int(TILE)


class NormalDescriber:
    """Computes the descriptors of the faces of one mesh, stage by stage.

    Each call overwrites the result of the previous one, since new memory is slow.

    Parameters
    ----------
    faces, vertices : (m, 3) and (n, 3), the scan, from which the faces near each are found.
    ring_start, ring : faces that share an edge with each face, in CSR form.
    evidence : on the scan.
    """

    def __init__(
        self, faces: Ints, vertices: Floats, ring_start: Ints, ring: Ints, evidence: Evidence
    ) -> None:
        m = len(faces)
        centroids = face_centroids(vertices, faces)
        self._ring = ring_start.view(np.uint32), ring.view(np.uint32)
        reach = WIDE * _find_units(centroids, *self._ring)
        # The nearest first; the same for all stages.
        near_start, near = faces_within(centroids, ring_start, ring, reach, MAX_NEAR)
        self._near = near_start.view(np.uint64), near.view(np.uint32)
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
        known, records = self._known, self._records
        if earlier is not None:
            records[:, 20:23] = earlier
        m, given = len(known), self.evidence
        normals, areas = face_normals_and_areas(positions, self._faces)
        per_area = 1.0 / (float(areas.mean()) or 1.0)
        over_ranges(_fill_marks, m, normals.reshape(-1), areas, per_area, *self._ring, self._marks)
        del normals, areas
        points = centroid_points(positions, self._faces)
        units = _find_units(points[:-1].reshape(-1, 3), *self._ring)
        of = units, float(units.mean()) or 1.0, *self._near
        corners, others = self._faces.reshape(-1).view(np.uint32), given.normals.reshape(-1)
        made = known.reshape(-1), records.reshape(-1)
        over_ranges(describe, m, points, self._marks, *of, corners, ripples, others, *made)
        inputs = points, *of, *made, given.statistics.reshape(-1), others
        values = _find_globals(known, records, given)
        return Descriptors(inputs, earlier is not None, values)


def _find_globals(known: Floats32, records: Floats32, evidence: Evidence) -> Floats32:
    """Global features: medians of differences between means, of the deviation from planes, of
    scatter and ripples; the level of noise, whether it is known, and whether as white."""
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
