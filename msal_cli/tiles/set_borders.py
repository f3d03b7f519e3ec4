"""The borders of the files of a tile set: which points of different files are one.

A border point is a place at the end of an edge with one face.  Vertices of one file that coincide
are one point already, as they are when the file is denoised by itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from msal_cli.errors import UsageError
from msal_cli.kernels.connectivity import boundary_curves
from msal_cli.kernels.welding import first_alike

if TYPE_CHECKING:
    from msal_cli.arrays import Flags, Floats, Ints, Longs
    from msal_cli.codecs.mesh_file import MeshFile
    from msal_cli.mesh import PreparedMesh

NEAR_EDGES = 0.25
"""Distance in mean edge lengths below which a border point lies at the border of another file."""

_MOST_PAIRS = 50_000_000
_ROUNDING = 2.0**-52
_MOST_STEPS = 64

_AHEAD = [
    (x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) > (0, 0, 0)
]
"""Half of the neighbours of a cell, so that each pair of cells is looked at once."""


@dataclass(frozen=True, eq=False)
class Border:
    """The border points of one file.

    Attributes
    ----------
    positions : (k, 3) float64, as the file stores them; no two are alike.
    vertices : (v,) int64, the vertices of the file at these points, ascending.
    points : (v,) int32, the point of each.
    corners : (k,) int64, a corner of a face at each point: an index into the flattened faces.
    edges : (e, 2) int32, edges with one face, between points.
    """

    positions: Floats
    vertices: Longs
    points: Ints
    corners: Longs
    edges: Ints


def find_border(ready: PreparedMesh, mesh_file: MeshFile) -> Border:
    """The border of a file, whose mesh is ``ready``."""
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
    positions = np.empty((n_points, 3))
    # Of those that coincide the first counts, which may have another sign of zero.
    positions[points[::-1]] = mesh_file.vertices[vertices[::-1]]
    corner_points = point_of_vertex[mesh_file.faces.reshape(-1)]
    at = np.flatnonzero(corner_points >= 0)
    corners = np.zeros(n_points, dtype=np.int64)
    corners[corner_points[at[::-1]]] = at[::-1]
    row_start, row = boundary_curves(mesh.faces, mesh.topology)
    ends = np.repeat(np.arange(len(boundary), dtype=np.int32), np.diff(row_start))
    edges = np.stack([ends, row[: len(ends)]], axis=1)
    return Border(positions, vertices, points, corners, number[edges[ends < edges[:, 1]]])


@dataclass(frozen=True, eq=False)
class SharedBorders:
    """Which border points of the files of a set are one.

    The points of all files stand behind one another, in the order of the files.

    Attributes
    ----------
    starts : (files + 1,) first point of each file.
    positions : (n, 3) of all points, as the files store them.
    file_of : (n,) int32, the file of each point.
    group : (n,) int64, the first point that a point is one with: itself where it is alone.
    """

    starts: Longs
    positions: Floats
    file_of: Ints
    group: Longs

    @property
    def is_shared(self) -> Flags:
        """(n,) whether any other file has the point."""
        counts = np.bincount(self.group, minlength=len(self.group))
        shared: Flags = counts[self.group] > 1
        return shared

    @property
    def is_moved(self) -> Flags:
        """(n,) whether a point takes the position of the first one, which is another."""
        moved: Flags = (self.positions[self.group] != self.positions).any(axis=1)
        return moved

    def pairs(self) -> Iterator[tuple[Longs, Longs]]:
        """All pairs of points that are one, in a few arrays."""
        order = np.argsort(self.group, kind="stable")
        group = self.group[order]
        step = 1
        while step < len(order):
            at = np.flatnonzero(group[step:] == group[:-step])
            if not len(at):
                return
            yield order[at], order[at + step]
            step += 1

    def with_single(self, is_single: Flags) -> Flags:
        """(n,) whether any file that has the point is in single precision, as ``is_single``
        (files,) says, although not all are."""
        n = len(self.group)
        counts = np.bincount(self.group, minlength=n)
        n_single = np.bincount(self.group, weights=is_single[self.file_of], minlength=n)
        is_mixed = (n_single > 0) & (n_single < counts)
        mixed: Flags = is_mixed[self.group]
        return mixed

    def distances(self, positions: Floats) -> Floats:
        """(n,) for each point the largest distance to another that is one with it, if points lie
        at ``positions`` (n, 3); NaN counts as no position."""
        largest = np.zeros(len(self.group))
        for one, other in self.pairs():
            way = positions[one] - positions[other]
            lengths = np.nan_to_num(np.sqrt((way * way).sum(axis=1)), nan=0.0)
            np.maximum.at(largest, one, lengths)
            np.maximum.at(largest, other, lengths)
        return largest

    def neighbours(self) -> list[list[int]]:
        """For each file those that share a point with it, in order."""
        found: set[tuple[int, int]] = set()
        for one, other in self.pairs():
            both = np.unique(np.stack([self.file_of[one], self.file_of[other]], axis=1), axis=0)
            found |= {(int(a), int(b)) for a, b in both} | {(int(b), int(a)) for a, b in both}
        rows: list[list[int]] = [[] for _ in range(len(self.starts) - 1)]
        for a, b in sorted(found):
            rows[a].append(b)
        return rows

    def of_file(self, index: int) -> slice:
        """The points of a file."""
        return slice(int(self.starts[index]), int(self.starts[index + 1]))


def share_borders(
    borders: Sequence[Border], is_single: Sequence[bool], weld: float = 0.0
) -> SharedBorders:
    """Which points of these files are one.

    That are those at one position, in single precision where one of the files has only that, and,
    of different files, those within ``weld`` (file units).  Pairs are joined in the order of
    their distance, but never so that two points of one file become one.

    Parameters
    ----------
    is_single : for each file whether it stores single precision.
    weld : 0 for none.

    Raises
    ------
    UsageError
        if ``weld`` is so long that it joins most of a border with most of another.
    """
    counts = [len(one.positions) for one in borders]
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    positions = np.concatenate([np.empty((0, 3)), *(one.positions for one in borders)])
    file_of = np.repeat(np.arange(len(borders), dtype=np.int32), counts)
    group = _alike(positions)
    pairs = [(np.arange(len(group)), group)]
    single = np.array(is_single, dtype=np.bool_)
    if single.any() and not single.all():
        with np.errstate(over="ignore"):
            first = _alike(positions.astype(np.float32).astype(np.float64))
        order = np.argsort(first, kind="stable")
        # Every other point of a place with one that is in single precision, if there is such.
        is_first = single[file_of[order]]
        leader = np.full(len(first), -1, dtype=np.int64)
        leader[first[order[is_first][::-1]]] = order[is_first][::-1]
        leader = leader[first]
        has_leader = leader >= 0
        pairs.append((np.flatnonzero(has_leader), leader[has_leader]))
    # Within less than positions are rounded by, only the same ones are.
    if weld > _ROUNDING * float(np.abs(positions).max(initial=0.0)):
        pairs.append(near_pairs(positions, positions, weld, most=_MOST_PAIRS))
    if len(pairs) > 1:
        one = np.concatenate([pair[0] for pair in pairs])
        other = np.concatenate([pair[1] for pair in pairs])
        is_foreign = file_of[one] != file_of[other]
        group = _join(positions, file_of, one[is_foreign], other[is_foreign])
    return SharedBorders(starts, positions, file_of, group)


def _alike(positions: Floats) -> Longs:
    """The first of the positions (n, 3) that each is equal to, (n,)."""
    return first_alike(positions, np.ones(len(positions), dtype=np.bool_))[0].astype(np.int64)


def count_unmatched(borders: Sequence[Border], shared: SharedBorders, edge: float) -> list[int]:
    """For each file its border points that lie at the border of another file, within
    ``NEAR_EDGES`` times ``edge``, the mean edge length, but are no points of it."""
    alone = np.flatnonzero(~shared.is_shared)
    counts = [0] * len(borders)
    if not len(alone) or len(borders) < 2:
        return counts
    reach = NEAR_EDGES * edge
    ends = np.concatenate(
        [one.edges + start for one, start in zip(borders, shared.starts, strict=False)]
    )
    a, b = shared.positions[ends[:, 0]], shared.positions[ends[:, 1]]
    lengths = np.sqrt(((b - a) ** 2).sum(axis=1))
    # Places along each edge, so close that one is near wherever the edge is.
    n_steps = np.clip(np.ceil(lengths / reach), 1, _MOST_STEPS).astype(np.int64)
    edge_of = np.repeat(np.arange(len(ends)), n_steps)
    step = np.arange(len(edge_of)) - np.repeat(np.cumsum(n_steps) - n_steps, n_steps)
    share = ((step + 0.5) / n_steps[edge_of])[:, None]
    places = a[edge_of] + share * (b[edge_of] - a[edge_of])
    one, other = near_pairs(shared.positions[alone], places, 1.5 * reach)
    point, along = alone[one], edge_of[other]
    is_foreign = shared.file_of[point] != shared.file_of[ends[along, 0]]
    point, along = point[is_foreign], along[is_foreign]
    near = _distances_to_edges(shared.positions[point], a[along], b[along]) <= reach
    found = np.unique(point[near])
    return [int(n) for n in np.bincount(shared.file_of[found], minlength=len(borders))]


def near_pairs(
    points: Floats, others: Floats, reach: float, most: int | None = None
) -> tuple[Longs, Longs]:
    """All pairs of ``points`` (n, 3) and ``others`` (m, 3) within ``reach``: their indices.

    Raises
    ------
    UsageError
        if more than ``most`` pairs lie in cells of this size.
    """
    low = np.minimum(points.min(axis=0), others.min(axis=0)) if len(points) * len(others) else 0.0
    cells, other_cells = _cells(points - low, reach), _cells(others - low, reach)
    order = np.argsort(_keys(other_cells), kind="stable")
    keys = _keys(other_cells)[order]
    found: list[tuple[Longs, Longs]] = []
    n_pairs = 0
    ways = [(0, 0, 0), *_AHEAD, *((-x, -y, -z) for x, y, z in _AHEAD)]
    for way in ways:
        wanted = _keys(cells + np.array(way))
        first, last = np.searchsorted(keys, wanted), np.searchsorted(keys, wanted, "right")
        counts = last - first
        n_pairs += int(counts.sum())
        if most is not None and n_pairs > most:
            raise UsageError(
                f"--weld {reach:g} file units is as long as many edges of the borders",
                hint="give less: the largest gap between vertices that should be one, such as 0.1e",
            )
        one = np.repeat(np.arange(len(points)), counts)
        step = np.arange(len(one)) - np.repeat(np.cumsum(counts) - counts, counts)
        other = order[np.repeat(first, counts) + step]
        gap = points[one] - others[other]
        near = (gap * gap).sum(axis=1) <= reach * reach
        found.append((one[near], other[near]))
    one = np.concatenate([pair[0] for pair in found])
    other = np.concatenate([pair[1] for pair in found])
    # Cells whose keys agree by chance are looked at more than once.
    both = np.unique(np.stack([one, other], axis=1), axis=0)
    return both[:, 0], both[:, 1]


def _cells(positions: Floats, size: float) -> Longs:
    return np.floor(positions / size).astype(np.int64)


def _keys(cells: Longs) -> Longs:
    """A number for each cell; different ones may have the same."""
    x, y, z = cells.T
    key: Longs = (x * 73_856_093) ^ (y * 19_349_669_329) ^ (z * 83_492_791_007_113)
    return key


def _distances_to_edges(points: Floats, a: Floats, b: Floats) -> Floats:
    """Distances of points (n, 3) from the edges between ``a`` and ``b`` (n, 3)."""
    along = b - a
    squares = np.maximum((along * along).sum(axis=1), np.finfo(float).tiny)
    share = np.clip(((points - a) * along).sum(axis=1) / squares, 0.0, 1.0)
    way = points - (a + share[:, None] * along)
    lengths: Floats = np.sqrt((way * way).sum(axis=1))
    return lengths


def _join(positions: Floats, file_of: Ints, one: Longs, other: Longs) -> Longs:
    """The first point of each one's group (n,) when pairs of points are joined, nearest first."""
    group = _components(len(positions), one, other)
    is_clear = ~_has_twice(group, file_of)[group[one]]
    if is_clear.all():
        return group
    # The groups that would have two points of one file are joined pair by pair.
    joined = _components(len(positions), one[is_clear], other[is_clear])
    one, other = one[~is_clear], other[~is_clear]
    gap = positions[one] - positions[other]
    order = np.lexsort((other, one, (gap * gap).sum(axis=1)))
    members: dict[int, list[int]] = {}
    for at in order:
        a, b = int(joined[one[at]]), int(joined[other[at]])
        if a == b:
            continue
        ours, theirs = members.get(a, [a]), members.get(b, [b])
        if {int(file_of[i]) for i in ours} & {int(file_of[i]) for i in theirs}:
            continue
        both = sorted(ours + theirs)
        joined[both] = both[0]
        members[both[0]] = both
    return joined


def _components(n: int, one: Longs, other: Longs) -> Longs:
    """The first point (n,) that each is connected with by pairs."""
    group = np.arange(n, dtype=np.int64)
    while True:
        lowest = np.minimum(group[one], group[other])
        new = group.copy()
        np.minimum.at(new, one, lowest)
        np.minimum.at(new, other, lowest)
        new = new[new]
        if np.array_equal(new, group):
            return group
        group = new


def _has_twice(group: Longs, file_of: Ints) -> Flags:
    """(n,) whether the group whose first point this is has two points of one file."""
    order = np.lexsort((file_of, group))
    group, files = group[order], file_of[order]
    again = (group[1:] == group[:-1]) & (files[1:] == files[:-1])
    result = np.zeros(len(group), dtype=np.bool_)
    result[group[1:][again]] = True
    return result
