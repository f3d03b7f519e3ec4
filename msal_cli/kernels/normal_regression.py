"""Face normals by regression: descriptors of every face, and the network that reads them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Floats32, Ints, Longs
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.faces import faces_within
from msal_cli.kernels.geometry import ring_means
from msal_cli.kernels.near_blocks import WIDE
from msal_cli.kernels.normal_descriptors import (
    DEVIATION,
    NARROW_MEAN,
    NORMAL,
    NUMBERS,
    REFINED,
    SCATTER,
    TWICE,
    UNIT,
    VECTORS,
    WIDE_FILTERED,
    WIDE_MEAN,
    WIDER,
    average_around,
    describe,
    filter_jointly,
)
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.quantiles import median
from msal_cli.kernels.regression_network import STEP, collect_inputs, predict_normals
from msal_cli.kernels.vectors import ONE, THREE, TWO

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

EXCHANGED = 6
"""Vectors that faces read of those near: the normal, the wide filtered one, the wide mean, the
first of the other filters, the scanned normal, that of the stage before."""

SAMPLED = 1 << 15
"""Faces from which the medians of a mesh are taken, or up to twice as many, evenly spread."""

GLOBALS = 11
"""Inputs that are the same for all faces of a mesh."""

_FOUR, _FIVE = np.uint64(4), np.uint64(5)


@compiled
def _measure_distances(start, stop, c, ring_start, ring, distances):
    """Mean distances of the centroids c, flat, to those of the row of each face; zero for none."""
    for f in range(np.uint64(start), np.uint64(stop)):
        own = THREE * f
        x, y, z = c[own], c[own + ONE], c[own + TWO]
        total = 0.0
        row, end = np.uint64(ring_start[f]), np.uint64(ring_start[f + ONE])
        for entry in range(row, end):
            k = THREE * ring[entry]
            dx, dy, dz = c[k] - x, c[k + ONE] - y, c[k + TWO] - z
            total += np.sqrt(dx * dx + dy * dy + dz * dz)
        distances[f] = total / np.float64(max(end - row, ONE))


@compiled
def _average_units(start, stop, distances, ring_start, ring, units):
    """The mean of a face's distance and those of its row, times root 3."""
    for f in range(np.uint64(start), np.uint64(stop)):
        total = distances[f]
        row, end = np.uint64(ring_start[f]), np.uint64(ring_start[f + ONE])
        for entry in range(row, end):
            total += distances[ring[entry]]
        units[f] = ROOT_3 * total / np.float64(end - row + ONE)


@compiled
def _fill_marks(start, stop, normals, areas, per_area, ring_start, ring, marks):
    """Normal and area, in the mean, of each face in one row, flat.

    Faces without a normal have no area, and get the mean of those around, weighted by area.
    """
    for f in range(np.uint64(start), np.uint64(stop)):
        own, to = THREE * f, _FOUR * f
        nx, ny, nz = normals[own], normals[own + ONE], normals[own + TWO]
        area = areas[f] * per_area
        if nx == 0.0 and ny == 0.0 and nz == 0.0:
            area = 0.0
            for entry in range(np.uint64(ring_start[f]), np.uint64(ring_start[f + ONE])):
                k = THREE * ring[entry]
                weight = areas[ring[entry]] * per_area
                nx += weight * normals[k]
                ny += weight * normals[k + ONE]
                nz += weight * normals[k + TWO]
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            if length > 0.0:
                nx, ny, nz = nx / length, ny / length, nz / length
        marks[to], marks[to + ONE] = np.float32(nx), np.float32(ny)
        marks[to + TWO], marks[to + THREE] = np.float32(nz), np.float32(area)


@compiled
def _gather_ripples(start, stop, faces, heights, units, scatter, ripples):
    """Five numbers of each face: its scatter, and means of its corners' ``heights`` (n, 4) in its
    unit."""
    for f in range(np.uint64(start), np.uint64(stop)):
        a, b, c = faces[THREE * f], faces[THREE * f + ONE], faces[THREE * f + TWO]
        per_unit = 1.0 / (3.0 * units[f]) if units[f] > 0.0 else 0.0
        ripples[_FIVE * f] = scatter[f]
        for k in range(_FOUR):
            total = heights[_FOUR * a + k] + heights[_FOUR * b + k] + heights[_FOUR * c + k]
            value = total * per_unit
            # Bounded, so that a single spike does not decide a mean.
            ripples[_FIVE * f + ONE + k] = np.float32(value / (1.0 + value))


def measure_ripples(vertices: Floats, normals: Floats, links: Connectivity) -> Floats:
    """How rough the surface is at each vertex, (n, 4), in the unit of ``vertices`` (n, 3).

    The distances along the ``normals`` (n, 3) that are left of the positions when the umbrella is
    applied once, twice and three times: ever finer ripples.  The last is what is left sideways of
    the second.  Boundary vertices have none.
    """
    rows = links.one_ring
    inner = links.has_ring & ~links.boundary
    left = [np.ascontiguousarray(vertices[:, axis]) for axis in range(3)]
    ripples = np.empty((len(vertices), 4))
    for time in range(3):
        left = [np.where(inner, ring_means(one, *rows) - one, 0.0) for one in left]
        along = left[0] * normals[:, 0] + left[1] * normals[:, 1] + left[2] * normals[:, 2]
        ripples[:, time] = np.abs(along)
        if time == 1:
            square = left[0] ** 2 + left[1] ** 2 + left[2] ** 2 - along**2
            ripples[:, 3] = np.sqrt(np.maximum(square, 0.0))
    return ripples


@dataclass(frozen=True, eq=False)
class Neighbourhoods:
    """Which faces are near each face, the same for all stages.

    Attributes
    ----------
    ring_start, ring : rows of the faces that share an edge with each face.
    near_start, near : rows of the faces within ``WIDE`` local units, the nearest first.
    """

    ring_start: Ints
    ring: Ints
    near_start: Longs
    near: Ints


def find_neighbourhoods(centroids: Floats, ring_start: Ints, ring: Ints) -> Neighbourhoods:
    """The neighbourhoods of faces with ``centroids`` (m, 3); rows as ``face_rings`` has them."""
    reach = WIDE * _find_units(centroids, ring_start, ring)
    near_start, near = faces_within(centroids, ring_start, ring, reach, MAX_NEAR)
    return Neighbourhoods(ring_start, ring, near_start, near)


def _find_units(centroids: Floats, ring_start: Ints, ring: Ints) -> Floats:
    m = len(centroids)
    distances, units = np.empty(m), np.empty(m)
    rows = ring_start.view(np.uint32), ring.view(np.uint32)
    over_ranges(_measure_distances, m, centroids.reshape(-1), *rows, distances)
    over_ranges(_average_units, m, distances, *rows, units)
    return units


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is known of a scan before its faces are described; see ``methods/_evidence``.

    Attributes
    ----------
    noise : standard deviation, mean edge lengths; None where it is not known.
    is_white : whether that is white noise along the normals.
    normals : OTHERS arrays (m, 3): normals that other filters give.
    statistics : (m, STATISTICS) of the surroundings of each face.
    """

    noise: float | None
    is_white: bool
    normals: tuple[Floats32, ...]
    statistics: Floats32


def count_vectors(stage: int) -> int:
    """Vectors of each face in a stage, counted from 0."""
    return VECTORS + OTHERS + GUIDED + (EARLIER if stage else 0)


@dataclass(frozen=True, eq=False)
class Descriptors:
    """What is known of every face.

    Attributes
    ----------
    vectors : (m, k, 3) candidates for its normal, as many as ``count_vectors`` says.
    numbers : (m, NUMBERS + STATISTICS).
    axes : (m, 3, 3) the axes that the vectors are seen along.
    globals : (GLOBALS,) the same for all faces.
    """

    vectors: Floats32
    numbers: Floats32
    axes: Floats32
    globals: Floats32

    def inputs(self) -> Floats32:
        """What the network sees of each face, (m, 3 k + NUMBERS + STATISTICS + GLOBALS)."""
        m, width = self.vectors.shape[:2]
        own = np.empty((m, 3 * width + self.numbers.shape[1]), dtype=np.float32)
        over_ranges(collect_inputs, m, *self._flat(), own)
        return np.concatenate([own, np.broadcast_to(self.globals, (m, GLOBALS))], axis=1)

    def _flat(self) -> tuple[int, Floats32, int, Floats32, Floats32]:
        width = self.vectors.shape[1]
        flat = self.vectors.reshape(-1), self.numbers.reshape(-1), self.axes.reshape(-1)
        return width, flat[0], self.numbers.shape[1], flat[1], flat[2]

    def predict(self, network: Network) -> Floats:
        """The unit normals (m, 3) that the network gives."""
        m = len(self.vectors)
        normals = np.empty((m, 3))
        weights = network.bound(self.globals)
        sizes = network.n_in, network.n_hidden, network.n_out
        over_ranges(predict_normals, m, *self._flat(), *sizes, weights, normals.reshape(-1))
        return normals


@dataclass(frozen=True, eq=False)
class Network:
    """Two hidden layers; see ``regression_network``.

    Attributes
    ----------
    layers : (bias (out,), matrix (out, in)) of each of the three.
    """

    layers: tuple[tuple[Floats32, Floats32], ...]

    @property
    def n_in(self) -> int:
        """Inputs of a face, filled up."""
        return _fill(self.layers[0][1].shape[1] - GLOBALS)

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
            rows, columns = _fill(len(bias)), _fill(matrix.shape[1])
            whole = np.zeros((rows, columns), dtype=np.float32)
            whole[: len(bias), : matrix.shape[1]] = matrix
            parts += [np.pad(bias, (0, rows - len(bias))), whole.reshape(-1)]
        return np.concatenate(parts)


def _fill(count: int) -> int:
    return -(-count // int(STEP)) * int(STEP)


class NormalDescriber:
    """Makes the descriptors of the faces of one mesh, stage by stage.

    What it gives is overwritten by the next: memory that is new costs as much as the arithmetic.

    Parameters
    ----------
    faces : (m, 3).
    centroids : (m, 3) of the scan, file units, from which the faces near each are found.
    ring_start, ring : rows of the faces that share an edge with each face.
    evidence : what is known of the scan.
    """

    def __init__(
        self, faces: Ints, centroids: Floats, ring_start: Ints, ring: Ints, evidence: Evidence
    ) -> None:
        m = len(faces)
        self.around = find_neighbourhoods(centroids, ring_start, ring)
        self.evidence = evidence
        self._corners = faces.reshape(-1).view(np.uint32)
        self._marks = np.empty(4 * m, dtype=np.float32)
        self._table = np.empty(m * 3 * count_vectors(1), dtype=np.float32)
        self._numbers = np.empty((m, NUMBERS + STATISTICS), dtype=np.float32)
        self._numbers[:, NUMBERS:] = evidence.statistics
        self._axes = np.empty((m, 3, 3), dtype=np.float32)
        self._ripples = np.empty((m, 5), dtype=np.float32)
        self._exchange = np.empty(m * 3 * EXCHANGED, dtype=np.float32)

    def describe(
        self,
        normals: Floats,
        areas: Floats,
        centroids: Floats,
        heights: Floats,
        earlier: tuple[Floats, Floats] | None = None,
    ) -> Descriptors:
        """The descriptors for one stage.

        Parameters
        ----------
        normals, areas, centroids : (m, 3), (m,), (m, 3); zero normals where there is none.
        heights : (n, 4) of the vertices, ``measure_ripples``.
        earlier : the scanned normals and those of the stage before, (m, 3) each, for a later
            stage.
        """
        m = len(normals)
        width = count_vectors(1 if earlier else 0)
        table = self._table[: 3 * m * width].reshape(m, width, 3)
        numbers, ripples, around = self._numbers, self._ripples, self.around
        rows = around.ring_start.view(np.uint32), around.ring.view(np.uint32)
        units = _find_units(centroids, around.ring_start, around.ring)
        per_area = 1.0 / (float(areas.mean()) or 1.0)
        over_ranges(_fill_marks, m, normals.reshape(-1), areas, per_area, *rows, self._marks)
        unit = float(units.mean()) or 1.0
        per_reach = 1.0 / (WIDE * np.where(units > 0.0, units, unit))
        near = around.near_start.view(np.uint64), around.near.view(np.uint32)
        of = centroids.reshape(-1), self._marks, per_reach, *near
        to_numbers = numbers.shape[1], numbers.reshape(-1)
        to = width, table.reshape(-1), *to_numbers
        over_ranges(describe, m, *of, *to, self._axes.reshape(-1))
        numbers[:, UNIT] = units / (units + unit)
        scatter = np.ascontiguousarray(numbers[:, SCATTER])
        flat = ripples.reshape(-1)
        over_ranges(_gather_ripples, m, self._corners, heights.reshape(-1), units, scatter, flat)
        over_ranges(average_around, m, self._marks, *near, flat, *to_numbers)
        self._filter_jointly(of, table, earlier)
        values = _find_globals(table, numbers, ripples, self.evidence)
        return Descriptors(table, numbers, self._axes, values)

    def _filter_jointly(
        self,
        of: tuple[Floats, Floats32, Floats, NDArray[np.uint64], NDArray[np.uint32]],
        table: Floats32,
        earlier: tuple[Floats, Floats] | None,
    ) -> None:
        """Fill the vectors that are filtered by others."""
        m, n_read = len(table), EXCHANGED if earlier else EXCHANGED - 2
        exchange = self._exchange[: 3 * m * n_read].reshape(m, n_read, 3)
        for place, slot in enumerate((NORMAL, WIDE_FILTERED, WIDE_MEAN)):
            exchange[:, place] = table[:, slot]
        exchange[:, 3] = self.evidence.normals[0]
        for place, normals in enumerate(self.evidence.normals, start=VECTORS):
            table[:, place] = normals
            has_none = ~normals.any(axis=1)
            if has_none.any():
                table[has_none, place] = table[has_none, NORMAL]
        guided = VECTORS + OTHERS
        tasks = [(1, 0, REFINED), (1, 1, TWICE), (2, 2, WIDER), (3, 0, guided)]
        ranges = [(0.25, 0.5), (0.25, 0.5), (0.25, 0.7), (0.3, 0.6)]
        if earlier is not None:
            own = guided + GUIDED
            for place, before in enumerate(earlier):
                exchange[:, 4 + place] = before
                table[:, own + place] = before
            tasks.append((5, 4, own + 2))
            ranges.append((0.3, 0.6))
        per_range = (1.0 / np.array(ranges) ** 2).astype(np.float32)
        width, flat = table.shape[1], (exchange.reshape(-1), table.reshape(-1))
        over_ranges(filter_jointly, m, *of, np.array(tasks), per_range, n_read, width, *flat)


def _find_globals(
    table: Floats32, numbers: Floats32, ripples: Floats32, evidence: Evidence
) -> Floats32:
    """What the whole mesh is like: medians of differences between means, of the deviation from
    planes, of scatter and ripples; the level of the noise, whether it is known, and as white."""
    step = max(len(table) // SAMPLED, 1)
    table, numbers, ripples = table[::step], numbers[::step], ripples[::step]
    own, narrow, wide = table[:, NORMAL], table[:, NARROW_MEAN], table[:, WIDE_MEAN]
    of = [np.sqrt(((a - b) ** 2).sum(axis=1)) for a, b in ((own, wide), (narrow, wide))]
    of += [numbers[:, DEVIATION], *ripples.T]
    values = [median(column.astype(np.float64)) for column in of] + [evidence.noise or 0.0]
    bounded = [value / (value + 0.1) for value in values]
    is_known = evidence.noise is not None
    flags = [float(is_known), float(is_known and evidence.is_white)]
    return np.array(bounded + flags, dtype=np.float32)
