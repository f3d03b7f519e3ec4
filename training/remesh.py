"""Isotropic remeshing that keeps sharp edges (Botsch and Kobbelt 2004), many elements at a time.

Edges longer than 4/3 of the target are split, those shorter than 4/5 collapsed, edges flipped to
Delaunay's criterion, and vertices moved along the surface to the mean of their neighbours and back
onto it.  A vertex on a curve (see ``training.surface``) stays on it, and a corner where it is.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_array

from training.connectivity import (
    Bools,
    Edges,
    Floats,
    Ints,
    build_edges,
    corner_angles,
    drop_unused,
    edge_lengths,
    face_crosses,
    shape_quality,
    to_unit,
    vertex_normals,
)
from training.surface import LabelledMesh, Surface, face_labels

LONG, SHORT = 4.0 / 3.0, 4.0 / 5.0
"""Shares of the target beyond which edges are split and collapsed."""

FEW = 0.008
"""Share of the vertices: rounds that change no more are the last ones."""

TINY = 0.1
"""Share of the target below which even corners are merged: boolean operations leave such edges."""

CORNER_DEG = 35.0
"""A curve that turns by more has a corner there."""

Sizing = Callable[[Floats], Floats]
"""Target edge lengths (n,) at points (n, 3)."""


class Remesher:
    """A mesh that is being remeshed.

    Attributes
    ----------
    vertices, faces, labels : as in LabelledMesh.
    fixed : (n,) corners, which never move.
    """

    def __init__(self, mesh: LabelledMesh, surface: Surface, sizing: Sizing, seed: int) -> None:
        self.vertices, self.faces, self.labels = mesh.vertices, mesh.faces, mesh.labels
        self._surface = surface
        self._sizing = sizing
        self._generator = np.random.default_rng(seed)
        self.fixed = np.zeros(len(self.vertices), dtype=bool)
        self.fixed = self._find_corners()

    def mesh(self) -> LabelledMesh:
        """The mesh as it is now."""
        return LabelledMesh(self.vertices, self.faces, self.labels)

    def edges(self) -> Edges:
        """The edges as they are now."""
        return build_edges(self.faces, len(self.vertices))

    def _curve_edges(self, edges: Edges) -> tuple[Bools, Ints]:
        """(e,) whether edges are on curves, and the labels (e, 2) beside them."""
        pairs = face_labels(edges.faces, self.labels)
        return pairs[:, 0] != pairs[:, 1], pairs

    def _curve_valence(self, edges: Edges, is_curve: Bools) -> Ints:
        return np.bincount(edges.ends[is_curve].reshape(-1), minlength=len(self.vertices))

    def _find_corners(self) -> Bools:
        """Vertices where curves end, meet or turn sharply."""
        edges = self.edges()
        is_curve, pairs = self._curve_edges(edges)
        valence = self._curve_valence(edges, is_curve)
        corner = (valence != 0) & (valence != 2)
        ends, pairs = edges.ends[is_curve], pairs[is_curve]
        along = to_unit(self.vertices[ends[:, 1]] - self.vertices[ends[:, 0]])
        total = np.zeros_like(self.vertices)
        np.add.at(total, ends[:, 0], along)
        np.add.at(total, ends[:, 1], -along)
        # Two unit vectors that leave a vertex add up to 2 sin(turn / 2).
        sharp = np.linalg.norm(total, axis=1) > 2.0 * np.sin(np.radians(CORNER_DEG) / 2.0)
        lowest = np.full((len(self.vertices), 2), np.iinfo(np.int64).max)
        highest = np.full((len(self.vertices), 2), -2)
        for side in range(2):
            np.minimum.at(lowest, ends[:, side], pairs)
            np.maximum.at(highest, ends[:, side], pairs)
        changed = (lowest != highest).any(axis=1)
        return self.fixed | corner | ((valence == 2) & (sharp | changed))

    def _mean_normals(self, edges: Edges) -> Floats:
        """Normals (m, 3) of faces together with those around them in the same patch.

        A face that has turned over has a normal far from that.
        """
        is_curve, _ = self._curve_edges(edges)
        first, second = edges.faces[~is_curve].T
        normals = face_crosses(self.vertices, self.faces)
        for _ in range(3):
            total = normals.copy()
            np.add.at(total, first, normals[second])
            np.add.at(total, second, normals[first])
            normals = total
        return to_unit(normals)

    def split_long(self, passes: int = 12) -> None:
        """Split edges that are too long in the middle, each of their faces into two to four."""
        for _ in range(passes):
            edges = self.edges()
            middle = 0.5 * (self.vertices[edges.ends[:, 0]] + self.vertices[edges.ends[:, 1]])
            length = edge_lengths(self.vertices, edges.ends)
            is_long = length > LONG * self._sizing(middle)
            if not is_long.any():
                return
            self.split(edges, is_long, middle[is_long])

    def split(self, edges: Edges, chosen: Bools, points: Floats) -> None:
        """Split the chosen edges (e,) at points (k, 3), each of their faces into two to four."""
        n = len(self.vertices)
        number = np.full(len(chosen), -1, dtype=np.int64)
        number[chosen] = n + np.arange(len(points))
        # The new vertex opposite to each corner of each face.
        added = np.full(self.faces.shape, -1, dtype=np.int64)
        for side in range(2):
            beside = edges.faces[:, side] >= 0
            face, third = edges.faces[beside, side], edges.opposite[beside, side]
            corner = np.argmax(self.faces[face] == third[:, None], axis=1)
            added[face, corner] = number[beside]
        self.vertices = np.concatenate([self.vertices, points])
        self.fixed = np.concatenate([self.fixed, np.zeros(len(points), dtype=bool)])
        count = (added >= 0).sum(axis=1)
        faces, labels = [self.faces[count == 0]], [self.labels[count == 0]]
        for splits in (1, 2, 3):
            some = count == splits
            parts = _split_faces(self.vertices, self.faces[some], added[some], splits)
            faces += parts
            labels += [self.labels[some]] * len(parts)
        self.faces, self.labels = np.concatenate(faces), np.concatenate(labels)

    def collapse_short(
        self, share: float = SHORT, rounds: int = 8, few: float = FEW, least: float = 0.7
    ) -> None:
        """Collapse edges below ``share`` of the target where shape and topology allow it.

        A round that collapses no more than ``few`` times the number of vertices is the last;
        ``least`` is the cosine between new faces and those around that is allowed.
        """
        for _ in range(rounds):
            if self._collapse_round(share, least) <= few * len(self.vertices):
                return

    def _collapse_round(self, share: float, least: float) -> int:
        edges = self.edges()
        is_curve, _ = self._curve_edges(edges)
        valence = self._curve_valence(edges, is_curve)
        length = edge_lengths(self.vertices, edges.ends)
        size = self._sizing(self.vertices)
        target = 0.5 * (size[edges.ends[:, 0]] + size[edges.ends[:, 1]])
        rank = np.where(self.fixed, 2, np.where(valence > 0, 1, 0))
        # A vertex with three neighbours can go wherever it is: what stays is the face around it.
        count = np.bincount(edges.ends.reshape(-1), minlength=len(self.vertices))
        rank[(rank == 0) & (count == 3)] = -1
        kept, gone = edges.ends[:, 0].copy(), edges.ends[:, 1].copy()
        swap = (rank[gone] > rank[kept]) | ((rank[gone] == rank[kept]) & (gone < kept))
        kept[swap], gone[swap] = gone[swap], kept[swap]
        tiny = length < TINY * target
        allowed = (rank[gone] <= 0) | (is_curve & ((rank[gone] == 1) | tiny))
        allowed &= (length < share * target) | (rank[gone] < 0)
        candidate = np.flatnonzero(allowed)
        if len(candidate) == 0:
            return 0
        i, j = kept[candidate], gone[candidate]
        link = _count_common(edges.ends, i, j, len(self.vertices))
        sound = link == np.where(edges.is_boundary[candidate], 1, 2)
        i, j = i[sound], j[sound]
        chosen = self._choose_apart(edges.ends, i, j)
        return self._collapse(edges, i[chosen], j[chosen], size, least)

    def _choose_apart(self, ends: Ints, i: Ints, j: Ints) -> Bools:
        """Which pairs of vertices can be merged at once: none has a neighbour of another."""
        priority = self._generator.permutation(len(i)).astype(np.float64)
        chosen = np.zeros(len(i), dtype=bool)
        for _ in range(4):
            near = np.full(len(self.vertices), np.inf)
            np.minimum.at(near, i, priority)
            np.minimum.at(near, j, priority)
            wide = near.copy()
            np.minimum.at(wide, ends[:, 0], near[ends[:, 1]])
            np.minimum.at(wide, ends[:, 1], near[ends[:, 0]])
            chosen |= (priority == wide[i]) & (priority == wide[j]) & (priority < np.inf)
            # What is chosen comes first from now on, and keeps others away.
            priority[chosen] = -1.0 - np.arange(chosen.sum())
        return chosen

    def _collapse(self, edges: Edges, i: Ints, j: Ints, size: Floats, least: float) -> int:
        """Merge vertices j into i but where a face would turn over or an edge become long."""
        onto = np.arange(len(self.vertices))
        onto[j] = i
        refused = np.zeros(len(self.vertices), dtype=bool)
        for side in range(2):
            moved, other = edges.ends[:, side], edges.ends[:, 1 - side]
            some = (onto[moved] != moved) & (onto[moved] != other)
            moved, other = moved[some], other[some]
            grown = np.linalg.norm(self.vertices[onto[moved]] - self.vertices[other], axis=1)
            before = np.linalg.norm(self.vertices[moved] - self.vertices[other], axis=1)
            refused[moved[(grown > LONG * size[onto[moved]]) & (grown > 1.3 * before)]] = True
        renamed = onto[self.faces]
        touched = (renamed != self.faces).any(axis=1)
        whole = _have_three(renamed)
        some = np.flatnonzero(touched & whole)
        around = self._mean_normals(edges)[some]
        turned = _is_turned(self.vertices, self.faces[some], renamed[some], around, least)
        poor = shape_quality(self.vertices, renamed[some]) < np.minimum(
            0.1, 0.5 * shape_quality(self.vertices, self.faces[some])
        )
        bad = self.faces[some[turned | poor]]
        refused[bad[onto[bad] != bad]] = True
        onto[refused] = np.flatnonzero(refused)
        renamed = onto[self.faces]
        whole = _have_three(renamed)
        self.labels = self.labels[whole]
        self.vertices, self.faces, old = drop_unused(self.vertices, renamed[whole])
        self.fixed = self.fixed[old]
        return int((~refused[j]).sum())

    def flip_edges(self, rounds: int = 6, below: float = 1.1, least: float = 0.9) -> None:
        """Flip edges within patches until the opposite angles add up to no more than 180 degrees.

        Only edges of faces whose shape quality is lower than ``below``: 0.1 flips slivers alone.
        ``least`` is the cosine between new faces and those around that is allowed.
        """
        for _ in range(rounds):
            if self._flip_round(below, least) <= FEW * len(self.vertices):
                return

    def merge_facets(self) -> None:
        """Make the long and narrow faces that boolean operations leave fewer.

        Split as they are, they would become very many.  Edges flip within planes only: in a curved
        patch of long faces, others would come to cut across the curve.
        """
        for _ in range(3):
            self.flip_edges(30, 1.1, 1.0 - 1e-9)
            self.collapse_short(SHORT, 16, FEW, 0.985)

    def _flip_round(self, below: float, least: float) -> int:
        edges = self.edges()
        is_curve, _ = self._curve_edges(edges)
        poor = shape_quality(self.vertices, self.faces) < below
        inner = np.flatnonzero(~is_curve & poor[edges.faces].any(axis=1))
        a, b = edges.ends[inner].T
        c, d = edges.opposite[inner].T
        v = self.vertices
        excess = corner_angles(v, a, c, b) + corner_angles(v, a, d, b) - np.pi
        worth = excess > 1e-6
        inner, excess = inner[worth], excess[worth]
        a, b, c, d = (x[worth] for x in (a, b, c, d))
        old = [np.stack(x, axis=1) for x in ((a, b, c), (b, a, d))]
        new = [np.stack(x, axis=1) for x in ((a, d, c), (d, b, c))]
        sound = ~_have_edges(edges.ends, np.stack([c, d], axis=1), len(v))
        around = self._mean_normals(edges)
        around = to_unit(around[edges.faces[inner, 0]] + around[edges.faces[inner, 1]])
        if least > 0.99:
            pair = to_unit(face_crosses(v, old[0])), to_unit(face_crosses(v, old[1]))
            sound &= np.einsum("ij,ij->i", *pair) > least
        for one, other in zip(old, new, strict=True):
            sound &= ~_is_turned(v, one, other, around, least)
        priority = np.where(sound, -excess, np.inf)
        beside = edges.faces[inner]
        best = np.full(len(self.faces), np.inf)
        for side in range(2):
            np.minimum.at(best, beside[:, side], priority)
        sound &= (best[beside] == priority[:, None]).all(axis=1)
        # Equal excess in one face, and equal new edges of two pairs: the first one only.
        _keep_first(sound, beside.reshape(-1), len(self.faces))
        chosen = np.flatnonzero(sound)
        _, first = np.unique(
            np.sort(np.stack([c, d], 1)[chosen], axis=1), axis=0, return_index=True
        )
        chosen = chosen[first]
        self.faces = self.faces.copy()
        for side in range(2):
            self.faces[beside[chosen, side]] = new[side][chosen]
        return len(chosen)

    def relax(self, step: float = 0.8, below: float = 1.1) -> None:
        """Move vertices to the mean of their neighbours, along the surface or their curve.

        Only vertices of faces whose shape quality is lower than ``below``.
        """
        edges = self.edges()
        is_curve, _ = self._curve_edges(edges)
        valence = self._curve_valence(edges, is_curve)
        on_curve = valence > 0
        mean = np.zeros_like(self.vertices)
        count = np.zeros(len(self.vertices))
        for side in range(2):
            start, end = edges.ends[:, side], edges.ends[:, 1 - side]
            some = is_curve | ~on_curve[start]
            np.add.at(mean, start[some], self.vertices[end[some]])
            np.add.at(count, start[some], 1.0)
        shift = step * (mean / np.maximum(count, 1.0)[:, None] - self.vertices)
        normals = vertex_normals(self.vertices, self.faces)
        inner = ~on_curve
        along = np.einsum("ij,ij->i", shift, normals)[:, None] * normals
        shift[inner] -= along[inner]
        chosen = np.zeros(len(shift), dtype=bool)
        chosen[self.faces[shape_quality(self.vertices, self.faces) < below]] = True
        shift[~chosen] = 0.0
        self.shift(shift)

    def remove_slivers(self, share: float) -> None:
        """Collapse edges below ``share`` of the target, and improve nearly flat faces."""
        for _ in range(5):
            self.collapse_short(share, 12, 0.0)
            self.flip_edges(4, 0.25)
            if shape_quality(self.vertices, self.faces).min() > 0.1:
                return
            self.relax(0.8, 0.15)

    def shift(self, offsets: Floats) -> None:
        """Move vertices by (n, 3) and back onto the surface, but where faces would turn over."""
        placed = self.project(self.vertices + np.where(self.fixed[:, None], 0.0, offsets))
        around = self._mean_normals(self.edges())
        before = np.einsum("ij,ij->i", to_unit(face_crosses(self.vertices, self.faces)), around)
        for _ in range(6):
            after = np.einsum("ij,ij->i", to_unit(face_crosses(placed, self.faces)), around)
            turned = (after < 0.5) & (after <= before)
            if not turned.any():
                break
            back = np.unique(self.faces[turned])
            placed[back] = self.vertices[back]
        self.vertices = placed

    def project(self, points: Floats) -> Floats:
        """Positions (n, 3) of the vertices on their patches and curves."""
        edges = self.edges()
        is_curve, pairs = self._curve_edges(edges)
        self.fixed = self._find_corners_by_labels(edges, is_curve, pairs)
        on_curve = self._curve_valence(edges, is_curve) > 0
        patch = np.zeros(len(points), dtype=np.int64)
        patch[self.faces.reshape(-1)] = np.repeat(self.labels, 3)
        pair = np.zeros((len(points), 2), dtype=np.int64)
        for side in range(2):
            pair[edges.ends[is_curve, side]] = pairs[is_curve]
        result = points.copy()
        inner = ~on_curve & ~self.fixed
        result[inner] = self._surface.project(points[inner], patch[inner])
        bound = on_curve & ~self.fixed
        result[bound] = self._surface.project_to_curves(points[bound], pair[bound])
        return result

    def _find_corners_by_labels(self, edges: Edges, is_curve: Bools, pairs: Ints) -> Bools:
        valence = self._curve_valence(edges, is_curve)
        return self.fixed | ((valence != 0) & (valence != 2))


def remesh(
    mesh: LabelledMesh, surface: Surface, sizing: Sizing, seed: int, iterations: int = 4
) -> LabelledMesh:
    """The mesh with edges of about the target lengths that ``sizing`` gives."""
    state = Remesher(mesh, surface, sizing, seed)
    state.merge_facets()
    for k in range(iterations):
        state.split_long()
        state.collapse_short()
        if k == 0:
            # Narrow faces leave many more than are wanted, and flips make more of them collapse.
            state.flip_edges(2)
            state.collapse_short()
        state.flip_edges()
        state.relax()
    state.flip_edges()
    state.remove_slivers(0.25)
    return state.mesh()


def _split_faces(vertices: Floats, faces: Ints, added: Ints, splits: int) -> list[Ints]:
    """Faces (m, 3) cut at ``splits`` new vertices, each opposite to a corner; -1 for none."""
    if splits == 3:
        (a, b, c), (p, q, r) = faces.T, added.T
        rows = ((a, r, q), (r, b, p), (q, p, c), (p, q, r))
        return [np.stack(row, axis=1) for row in rows]
    # Turned so that the edge opposite to the first corner is the odd one.
    odd = np.argmax((added >= 0) if splits == 1 else (added < 0), axis=1)
    turn = (odd[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(faces, turn, axis=1).T
    p, q, r = np.take_along_axis(added, turn, axis=1).T
    if splits == 1:
        return [np.stack(row, axis=1) for row in ((a, b, p), (a, p, c))]
    # The quadrilateral r, b, c, q, by its shorter diagonal.
    first = np.linalg.norm(vertices[r] - vertices[c], axis=1)
    second = np.linalg.norm(vertices[b] - vertices[q], axis=1)
    by_first = (first < second)[:, None]
    return [
        np.stack([a, r, q], axis=1),
        np.where(by_first, np.stack([r, b, c], axis=1), np.stack([r, b, q], axis=1)),
        np.where(by_first, np.stack([r, c, q], axis=1), np.stack([b, c, q], axis=1)),
    ]


def _count_common(ends: Ints, i: Ints, j: Ints, n: int) -> Ints:
    """How many neighbours the vertices i (k,) and j (k,) share."""
    rows, columns = np.concatenate([ends, ends[:, ::-1]]).T
    ones = np.ones(len(rows), dtype=np.int32)
    adjacent = coo_array((ones, (rows, columns)), shape=(n, n)).tocsr()
    common: Ints = adjacent[i].multiply(adjacent[j]).sum(axis=1)
    return np.asarray(common).reshape(-1)


def _is_turned(vertices: Floats, old: Ints, new: Ints, around: Floats, least: float) -> Bools:
    """(k,) whether new faces lie worse than the old ones to the normals around, and badly."""
    before = np.einsum("ij,ij->i", to_unit(face_crosses(vertices, old)), around)
    after = np.einsum("ij,ij->i", to_unit(face_crosses(vertices, new)), around)
    return (after < least) & (after <= before)


def _have_three(faces: Ints) -> Bools:
    """(m,) whether faces have three different vertices."""
    a, b, c = faces.T
    return (a != b) & (b != c) & (c != a)


def _have_edges(ends: Ints, wanted: Ints, n: int) -> Bools:
    """(k,) whether pairs of vertices (k, 2) are edges."""
    low, high = np.sort(ends, axis=1).T
    keys = np.sort(low * n + high)
    low, high = np.sort(wanted, axis=1).T
    key = low * n + high
    place = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
    return keys[place] == key


def _keep_first(chosen: Bools, beside: Ints, count: int) -> None:
    """Unset ``chosen`` (k,) but for the first with each of its two faces, ``beside`` (2 k,)."""
    first = np.full(count, len(chosen), dtype=np.int64)
    rows = np.flatnonzero(chosen)
    faces = beside.reshape(-1, 2)
    for side in range(2):
        np.minimum.at(first, faces[rows, side], rows)
    chosen[rows] = (first[faces[rows]] == rows[:, None]).all(axis=1)
