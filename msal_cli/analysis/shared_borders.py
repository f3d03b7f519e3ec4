"""Border points that the meshes of a set of files share.

A border point is a position at an end of a boundary edge.  Vertices of one mesh that coincide are
one point, because they are welded when the mesh is denoised alone.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints, Longs
from msal_cli.kernels.connectivity import boundary_curves
from msal_cli.kernels.nearest_triangles import find_nearest_triangles
from msal_cli.kernels.welding import first_alike, first_places
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import PreparedMesh

NEAR_EDGES = 0.25
"""Distance in mean edge lengths up to which a border point lies at the border of another file."""


@dataclass(frozen=True, eq=False)
class Border:
    """The border points of one file."""

    positions: Floats  # (k, 3) float64, as the file stores them; all different
    vertices: Longs  # (v,) int64, the vertices of the file at these points, ascending
    points: Ints  # (v,) int32, the point of each of these vertices
    # (k,) int64, a corner of a face at each point: an index into the flattened faces
    corners: Longs
    edges: Ints  # (e, 2) int32, boundary edges between points


def find_border(ready: PreparedMesh, file_vertices: Floats, file_faces: Ints) -> Border:
    """The border of a file with these vertices (n, 3) and faces (m, 3), whose mesh is ``ready``."""
    mesh = ready.mesh
    boundary = mesh.topology.boundary
    n_points = int(np.count_nonzero(boundary))
    number = np.cumsum(boundary, dtype=np.int32) - np.int32(1)
    point_of_vertex = np.where(boundary, number, np.int32(-1))
    if ready.vertex_map is not None:
        is_used = ready.vertex_map >= 0
        point_of_vertex = np.where(is_used, point_of_vertex[ready.vertex_map], np.int32(-1))
    vertices = np.flatnonzero(point_of_vertex >= 0)
    points = point_of_vertex[vertices].astype(np.int32)
    # That of the first of coinciding vertices: signs of 0 may differ.
    positions = file_vertices[vertices[first_places(points, n_points)]]
    corners = first_places(point_of_vertex[file_faces.reshape(-1)], n_points)
    row_start, row = boundary_curves(mesh.faces, mesh.topology)
    ends = np.repeat(np.arange(len(boundary), dtype=np.int32), np.diff(row_start))
    edges = np.stack([ends, row[: len(ends)]], axis=1)
    return Border(positions, vertices, points, corners, number[edges[ends < edges[:, 1]]])


@dataclass(frozen=True, eq=False)
class SharedBorders:
    """The border points of the files of a set, and the groups of points that are the same.

    The points of all files are concatenated, in the order of the files."""

    starts: Longs  # (files + 1,) first point of each file
    positions: Floats  # (n, 3) of all points, as the files store them
    file_of: Ints  # (n,) int32, the file of each point
    group: Longs  # (n,) int64, the first point of each point's group

    @property
    def is_shared(self) -> Flags:
        """(n,) whether another file has the point."""
        shared: Flags = np.bincount(self.group, minlength=len(self.group))[self.group] > 1
        return shared

    @property
    def joined_positions(self) -> Floats:
        """(n, 3) positions in the joined mesh: those in the first file that has the point."""
        first = self.positions[self.group]
        # Where they are equal, a point keeps its own zeros, whose signs may differ.
        return np.where((first != self.positions).any(axis=1)[:, None], first, self.positions)

    def pairs(self) -> Iterator[tuple[Longs, Longs]]:
        """All pairs of points of one group, as two arrays at a time."""
        order = np.argsort(self.group, kind="stable")
        group = self.group[order]
        for step in range(1, len(order)):
            ranks = np.flatnonzero(group[step:] == group[:-step])
            if not len(ranks):
                return
            yield order[ranks], order[ranks + step]

    def distances(self, positions: Floats) -> Floats:
        """(n,) the largest distance of each point to another of its group, with the points at
        ``positions`` (n, 3); rows with NaN are ignored."""
        largest = np.zeros(len(self.group))
        for a, b in self.pairs():
            offsets = positions[a] - positions[b]
            lengths = np.nan_to_num(np.sqrt((offsets * offsets).sum(axis=1)), nan=0.0)
            np.maximum.at(largest, a, lengths)
            np.maximum.at(largest, b, lengths)
        return largest

    def neighbours(self) -> list[list[int]]:
        """For each file the indices of the files that share a point with it, ascending."""
        rows: list[set[int]] = [set() for _ in range(len(self.starts) - 1)]
        for a, b in self.pairs():
            for file, other in np.unique(self.file_of[np.stack([a, b], axis=1)], axis=0).tolist():
                rows[file].add(other)
                rows[other].add(file)
        return [sorted(row) for row in rows]

    def of_file(self, index: int) -> slice:
        """The points of a file."""
        return slice(int(self.starts[index]), int(self.starts[index + 1]))


def share_borders(borders: Sequence[Border], is_single: Sequence[bool]) -> SharedBorders:
    """Group the border points at equal positions.

    Positions are compared in single precision where one of the files stores them so, which
    ``is_single`` says of each file.
    """
    counts = [len(border.positions) for border in borders]
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    positions = np.concatenate([np.empty((0, 3)), *(border.positions for border in borders)])
    file_of = np.repeat(np.arange(len(borders), dtype=np.int32), counts)
    group = _first_alike(positions)
    if any(is_single) and not all(is_single):
        with np.errstate(over="ignore"):
            place = _first_alike(positions.astype(np.float32).astype(np.float64))
        _join_rounded(group, place, np.array(is_single)[file_of], file_of)
    return SharedBorders(starts, positions, file_of, group)


def _first_alike(positions: Floats) -> Longs:
    """The first of the positions (n, 3) that each is equal to, (n,)."""
    return first_alike(positions, np.ones(len(positions), dtype=np.bool_))[0].astype(np.int64)


def _join_rounded(group: Longs, place: Longs, is_single: Flags, file_of: Ints) -> None:
    """Set the ``group`` (n,) of points to their ``place`` (n,), the first point at their rounded
    position, if one of the points there is in single precision and no two are of one file."""
    has_single = np.zeros(len(place), dtype=np.bool_)
    has_single[place[is_single]] = True
    at = np.flatnonzero(has_single[place])
    at = at[np.lexsort((file_of[at], place[at]))]
    is_repeated = (place[at[1:]] == place[at[:-1]]) & (file_of[at[1:]] == file_of[at[:-1]])
    is_unclear = np.zeros(len(place), dtype=np.bool_)
    is_unclear[place[at[1:][is_repeated]]] = True
    clear = at[~is_unclear[place[at]]]
    group[clear] = place[clear]


def count_unmatched(borders: Sequence[Border], shared: SharedBorders, edge: float) -> list[int]:
    """For each file the number of border points that lie at the border of another file, within
    ``NEAR_EDGES`` times ``edge``, the mean edge length, but are shared with no file."""
    radius = NEAR_EDGES * edge
    is_alone = ~shared.is_shared
    low, high = np.full((len(borders), 3), np.inf), np.full((len(borders), 3), -np.inf)
    np.minimum.at(low, shared.file_of, shared.positions)
    np.maximum.at(high, shared.file_of, shared.positions)
    counts = []
    for index in range(len(borders)):
        own = shared.of_file(index)
        points = shared.positions[own][is_alone[own]]
        is_near = ((low - radius <= high[index]) & (high + radius >= low[index])).all(axis=1)
        is_near[index] = False
        ends = [
            borders[other].edges + shared.starts[other]
            for other in np.flatnonzero(is_near).tolist()
        ]
        edges = np.concatenate([np.empty((0, 2), dtype=np.int64), *ends])
        if not len(points) or not len(edges):
            counts.append(0)
            continue
        # Edges, as degenerate triangles.
        triangles = np.ascontiguousarray(edges[:, [0, 1, 1]], dtype=np.int32)
        _, distances = find_nearest_triangles(points, shared.positions, triangles)
        counts.append(int(np.count_nonzero(distances <= radius)))
    return counts
