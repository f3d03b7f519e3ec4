"""Face normals by regression: descriptors of every face, and the network that reads them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from msal_cli.arrays import Floats, Floats32, Ints, Longs
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.faces import centroid_points, face_centroids, faces_within
from msal_cli.kernels.geometry import apply_umbrella, face_normals_and_areas, lay_face_normals
from msal_cli.kernels.library import compiled
from msal_cli.kernels.near_blocks import RECORD, WIDE
from msal_cli.kernels.normal_descriptors import (
    AXES,
    DEVIATION,
    KNOWN,
    OWN_NUMBERS,
    VECTORS,
    describe,
)
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.quantiles import median
from msal_cli.kernels.regression_network import TILE, predict_normals
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

QUIET, MIN_LOUD = 0.14, 0.02
"""The third of the STATISTICS up to which a face of an uneven mesh is quiet, about a third of the
level; and the part of the faces that must be louder."""

SAMPLED = 1 << 15
"""Faces from which the medians of a mesh are taken, or up to twice as many, evenly spread."""

GLOBALS = 11
"""Inputs that are the same for all faces of a mesh."""

_FOUR = np.uint64(4)


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
def _measure_heights(start, stop, left, normals, time, ripples):
    """How long what is left is along the normals; after the second ``time`` also across them."""
    for i in range(np.uint64(start), np.uint64(stop)):
        x, y, z = left[i, 0], left[i, 1], left[i, 2]
        along = x * normals[i, 0] + y * normals[i, 1] + z * normals[i, 2]
        ripples[i, time] = abs(along)
        if time == 1:
            ripples[i, 3] = np.sqrt(max(x * x + y * y + z * z - along * along, 0.0))


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
    """Two hidden layers; see ``regression_network``."""

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
        self.around = find_neighbourhoods(face_centroids(vertices, faces), ring_start, ring)
        self.evidence = evidence
        self._faces = faces
        self._marks = np.empty(4 * m, dtype=np.float32)
        self._known = np.empty((m, int(KNOWN)), dtype=np.float32)
        self._records = np.empty((m, int(RECORD)), dtype=np.float32)
        lay_face_normals(vertices, faces, self._records, 16)

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
