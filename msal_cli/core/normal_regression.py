"""Face normals by regression: descriptors of every face, and the network that reads them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msal_cli.core.compiled import compiled
from msal_cli.core.connectivity import Connectivity
from msal_cli.core.face_reach import faces_within
from msal_cli.core.geometry import ring_means
from msal_cli.core.medians import median
from msal_cli.core.near_blocks import RECORD, WIDE
from msal_cli.core.normal_descriptors import (
    GUIDE,
    GUIDED,
    NARROW_MEAN,
    NORMAL,
    NUMBERS,
    REFINED,
    TWICE,
    VECTORS,
    WIDE_FILTERED,
    WIDE_MEAN,
    WIDER,
    describe,
    filter_jointly,
    pick_guides,
)
from msal_cli.core.parallel import over_ranges
from msal_cli.core.regression_network import STEP, collect_inputs, predict_normals
from msal_cli.core.ring_blocks import ONE, THREE, TWO

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int32]
LongInts = NDArray[np.int64]

MOST_NEAR = 63
"""Faces near one at most, beside itself."""

EARLIER = 4
"""Vectors that a later stage has in addition: the scanned normal, that of the stage before, and
the first filtered by the second, with two ranges."""

ROOT_3 = 3.0**0.5
"""The edge of equilateral triangles over the distance of their centroids."""

GLOBALS = 8
"""Inputs that are the same for all faces of a mesh."""

_FIVE, _SIX, _SEVEN = np.uint64(5), np.uint64(6), np.uint64(7)
_FOUR = np.uint64(4)


@compiled
def _mean_distances(start, stop, c, ring_start, ring, distances):  # type: ignore[no-untyped-def]
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
def _local_units(start, stop, distances, ring_start, ring, units):  # type: ignore[no-untyped-def]
    """The mean of a face's distance and those of its row, times root 3."""
    for f in range(np.uint64(start), np.uint64(stop)):
        total = distances[f]
        row, end = np.uint64(ring_start[f]), np.uint64(ring_start[f + ONE])
        for entry in range(row, end):
            total += distances[ring[entry]]
        units[f] = ROOT_3 * total / np.float64(end - row + ONE)


@compiled
def _records(start, stop, c, normals, areas, per_unit, per_area, records):  # type: ignore[no-untyped-def]
    """Centroid, normal and area of each face in one row; lengths in the unit, areas in the mean."""
    for f in range(np.uint64(start), np.uint64(stop)):
        own, to = THREE * f, RECORD * f
        nx, ny, nz = normals[own], normals[own + ONE], normals[own + TWO]
        records[to] = c[own] * per_unit
        records[to + ONE] = c[own + ONE] * per_unit
        records[to + TWO] = c[own + TWO] * per_unit
        records[to + THREE] = nx
        records[to + _FOUR] = ny
        records[to + _FIVE] = nz
        has_normal = (nx != 0.0) | (ny != 0.0) | (nz != 0.0)
        records[to + _SIX] = areas[f] * per_area if has_normal else 0.0
        records[to + _SEVEN] = 0.0


@compiled
def _fill_missing(start, stop, ring_start, ring, normals, records):  # type: ignore[no-untyped-def]
    """Give faces without a normal the mean of those around, weighted by area."""
    for f in range(np.uint64(start), np.uint64(stop)):
        own = THREE * f
        if normals[own] != 0.0 or normals[own + ONE] != 0.0 or normals[own + TWO] != 0.0:
            continue
        x = y = z = 0.0
        for entry in range(np.uint64(ring_start[f]), np.uint64(ring_start[f + ONE])):
            k = THREE * ring[entry]
            area = records[RECORD * ring[entry] + _SIX]
            x += area * normals[k]
            y += area * normals[k + ONE]
            z += area * normals[k + TWO]
        length = np.sqrt(x * x + y * y + z * z)
        if length > 0.0:
            to = RECORD * f
            records[to + THREE] = x / length
            records[to + _FOUR] = y / length
            records[to + _FIVE] = z / length


@compiled
def _corner_means(start, stop, faces, heights, units, scatter, ripples):  # type: ignore[no-untyped-def]
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
    rows = links.ring_start, links.ring
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
    near_start: LongInts
    near: Ints


def find_neighbourhoods(centroids: Floats, ring_start: Ints, ring: Ints) -> Neighbourhoods:
    """The neighbourhoods of faces with ``centroids`` (m, 3); rows as ``face_rings`` has them."""
    reach = WIDE * _find_units(centroids, ring_start, ring)
    near_start, near = faces_within(centroids, ring_start, ring, reach, MOST_NEAR)
    return Neighbourhoods(ring_start, ring, near_start, near)


def _find_units(centroids: Floats, ring_start: Ints, ring: Ints) -> Floats:
    m = len(centroids)
    distances, units = np.empty(m), np.empty(m)
    rows = ring_start.view(np.uint32), ring.view(np.uint32)
    over_ranges(_mean_distances, m, centroids.reshape(-1), *rows, distances)
    over_ranges(_local_units, m, distances, *rows, units)
    return units


@dataclass(frozen=True, eq=False)
class Descriptors:
    """What is known of every face.

    Attributes
    ----------
    vectors : (m, k, 3) candidates for its normal, VECTORS of them or EARLIER more.
    numbers : (m, NUMBERS).
    axes : (m, 3, 3) the axes that the vectors are seen along.
    globals : (GLOBALS,) the same for all faces.
    """

    vectors: Singles
    numbers: Singles
    axes: Singles
    globals: Singles

    def inputs(self) -> Singles:
        """What the network sees of each face, (m, 3 k + NUMBERS + GLOBALS)."""
        m, width = self.vectors.shape[:2]
        own = np.empty((m, 3 * width + NUMBERS), dtype=np.float32)
        over_ranges(collect_inputs, m, *self._flat(), own)
        return np.concatenate([own, np.broadcast_to(self.globals, (m, GLOBALS))], axis=1)

    def _flat(self) -> tuple[int, Singles, int, Singles, Singles]:
        width = self.vectors.shape[1]
        flat = self.vectors.reshape(-1), self.numbers.reshape(-1), self.axes.reshape(-1)
        return width, flat[0], NUMBERS, flat[1], flat[2]

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

    layers: tuple[tuple[Singles, Singles], ...]

    @property
    def n_in(self) -> int:
        """Inputs of a face, filled up."""
        return _filled(self.layers[0][1].shape[1] - GLOBALS)

    @property
    def n_hidden(self) -> int:
        """Numbers in each hidden layer."""
        return len(self.layers[1][0])

    @property
    def n_out(self) -> int:
        """Coefficients, filled up."""
        return _filled(len(self.layers[2][0]))

    def bound(self, values: Singles) -> Singles:
        """All layers one behind another as the kernel reads them, for these global inputs."""
        parts = []
        for at, (bias, matrix) in enumerate(self.layers):
            if at == 0:
                bias = bias.copy()
                for column, value in enumerate(values, start=-GLOBALS):
                    bias += matrix[:, column] * value
                matrix = matrix[:, :-GLOBALS]
            rows, columns = _filled(len(bias)), _filled(matrix.shape[1])
            whole = np.zeros((rows, columns), dtype=np.float32)
            whole[: len(bias), : matrix.shape[1]] = matrix
            parts += [np.pad(bias, (0, rows - len(bias))), whole.reshape(-1)]
        return np.concatenate(parts)


def _filled(count: int) -> int:
    return -(-count // int(STEP)) * int(STEP)


def describe_normals(
    normals: Floats,
    areas: Floats,
    centroids: Floats,
    heights: Floats,
    faces: Ints,
    around: Neighbourhoods,
    earlier: tuple[Floats, Floats] | None = None,
) -> Descriptors:
    """The descriptors of faces.

    Parameters
    ----------
    normals, areas, centroids : (m, 3), (m,), (m, 3); zero normals where there is none.
    heights : (n, 4) of the vertices, ``measure_ripples``.
    faces : (m, 3).
    earlier : the scanned normals and those of the stage before, (m, 3) each, for a later stage.
    """
    m = len(normals)
    width = VECTORS + (EARLIER if earlier else 0)
    rows = around.ring_start.view(np.uint32), around.ring.view(np.uint32)
    units = _find_units(centroids, around.ring_start, around.ring)
    unit = float(units.mean()) or 1.0
    mean_area = float(areas.mean()) or 1.0
    records = np.empty(m * int(RECORD))
    flat = normals.reshape(-1)
    to_units = 1.0 / unit, 1.0 / mean_area
    over_ranges(_records, m, centroids.reshape(-1), flat, areas, *to_units, records)
    if not normals.any(axis=1).all():
        over_ranges(_fill_missing, m, *rows, flat, records)
    numbers = np.empty((m, NUMBERS), dtype=np.float32)
    numbers[:, 17] = units / (units + unit)
    per_reach = unit / (WIDE * np.where(units > 0.0, units, unit))
    near = around.near_start.view(np.uint64), around.near.view(np.uint32)
    axes = np.empty((m, 3, 3), dtype=np.float32)
    table = np.empty((m, width, 3), dtype=np.float32)
    flat_table = table.reshape(-1)
    of = records, per_reach, *near
    over_ranges(describe, m, *of, width, flat_table, numbers.reshape(-1), axes.reshape(-1))
    ripples = np.empty((m, 5), dtype=np.float32)
    scatter = np.ascontiguousarray(numbers[:, 14])
    corners = faces.reshape(-1).view(np.uint32)
    over_ranges(_corner_means, m, corners, heights.reshape(-1), units, scatter, ripples.reshape(-1))
    to = width, flat_table, numbers.reshape(-1)
    over_ranges(pick_guides, m, records, *near, ripples.reshape(-1), *to)
    tasks = [
        (GUIDE, NORMAL, GUIDED),
        (WIDE_FILTERED, NORMAL, REFINED),
        (WIDE_FILTERED, WIDE_FILTERED, TWICE),
        (WIDE_MEAN, WIDE_MEAN, WIDER),
    ]
    ranges = [(0.3, 0.6), (0.25, 0.5), (0.25, 0.5), (0.25, 0.7)]
    if earlier is not None:
        table[:, VECTORS] = earlier[0]
        table[:, VECTORS + 1] = earlier[1]
        tasks.append((VECTORS + 1, VECTORS, VECTORS + 2))
        ranges.append((0.3, 0.6))
    per_range = (1.0 / np.array(ranges) ** 2).astype(np.float32)
    over_ranges(filter_jointly, m, *of, np.array(tasks), per_range, width, flat_table)
    return Descriptors(table, numbers, axes, _find_globals(table, numbers, ripples))


def _find_globals(table: Singles, numbers: Singles, ripples: Singles) -> Singles:
    """What the whole mesh is like: medians of scatter, of differences between means, of ripples."""
    own, narrow, wide = table[:, NORMAL], table[:, NARROW_MEAN], table[:, WIDE_MEAN]
    of = [np.sqrt(((a - b) ** 2).sum(axis=1)) for a, b in ((own, wide), (narrow, wide))]
    of += [numbers[:, 9], *ripples.T]
    medians = [median(one.astype(np.float64)) for one in of]
    return np.array([m / (m + 0.1) for m in medians], dtype=np.float32)
