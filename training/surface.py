"""The true surface that a mesh is a sample of: patches between sharp edges, and the edges.

Every face of a mesh has the label of its patch.  Edges between two labels, and boundary edges, are
*curves*: a remeshed triangulation has vertices and edges on them, and never crosses them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import fcpw
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from training.connectivity import Floats, Ints, build_edges, edge_lengths, face_crosses, to_unit


@dataclass(frozen=True, eq=False)
class LabelledMesh:
    """A mesh with the patch of every face.

    Attributes
    ----------
    vertices : (n, 3).
    faces : (m, 3).
    labels : (m,) the patch that the face belongs to, from 0.
    """

    vertices: Floats
    faces: Ints
    labels: Ints


class Surface(Protocol):
    """What brings points back to the true surface."""

    def project(self, points: Floats, labels: Ints) -> Floats:
        """Points (n, 3) of patches (n,) on the surface."""

    def project_to_curves(self, points: Floats, pairs: Ints) -> Floats:
        """Points (n, 3) on the curves between two patches each, (n, 2), -1 for the outside."""


def label_patches(
    vertices: Floats, faces: Ints, groups: Ints | None = None, crease_deg: float = 20.0
) -> Ints:
    """Patches (m,): connected faces of one group whose edges bend by less than ``crease_deg``."""
    edges = build_edges(faces, len(vertices))
    normals = to_unit(face_crosses(vertices, faces))
    inner = edges.faces[~edges.is_boundary]
    cosine = np.einsum("ij,ij->i", normals[inner[:, 0]], normals[inner[:, 1]])
    joined = cosine > np.cos(np.radians(crease_deg))
    if groups is not None:
        joined &= groups[inner[:, 0]] == groups[inner[:, 1]]
    # A face without area has no normal: it goes with the one beside its longest edge.
    areas = np.linalg.norm(face_crosses(vertices, faces), axis=1)
    lengths = edge_lengths(vertices, edges.ends[~edges.is_boundary])
    longest = np.zeros(len(faces))
    np.maximum.at(longest, inner.reshape(-1), np.repeat(lengths, 2))
    narrow = areas < 1e-6 * longest**2
    joined &= ~narrow[inner].any(axis=1)
    joined |= (narrow[inner] & (longest[inner] == lengths[:, None])).any(axis=1)
    return _components(inner[joined], len(faces))


def _components(pairs: Ints, count: int) -> Ints:
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)


class PolyhedralSurface:
    """A fine mesh as the true surface; exact on planes and straight edges."""

    def __init__(self, mesh: LabelledMesh) -> None:
        self._mesh = mesh
        self._patches: dict[int, Callable[[Floats], Floats]] = {}
        self._curves = _collect_curves(mesh)

    def project(self, points: Floats, labels: Ints) -> Floats:
        """Points (n, 3) of patches (n,) on their patches."""
        result = points.copy()
        for label in np.unique(labels):
            if label not in self._patches:
                self._patches[label] = _patch_projection(self._mesh, label)
            chosen = labels == label
            result[chosen] = self._patches[label](points[chosen])
        return result

    def project_to_curves(self, points: Floats, pairs: Ints) -> Floats:
        """Points (n, 3) on the curves between the two patches of each, (n, 2).

        Where two patches have no curve, because a narrow one between them is lost, points stay.
        """
        result = points.copy()
        for low, high in np.unique(pairs, axis=0):
            if (low, high) not in self._curves:
                continue
            chosen = (pairs[:, 0] == low) & (pairs[:, 1] == high)
            result[chosen] = _nearest_on_segments(points[chosen], *self._curves[low, high])
        return result


def _collect_curves(mesh: LabelledMesh) -> dict[tuple[int, int], tuple[Floats, Floats]]:
    """Segments (starts, ends) by the two labels beside them, the lower first."""
    edges = build_edges(mesh.faces, len(mesh.vertices))
    pairs = face_labels(edges.faces, mesh.labels)
    is_curve = pairs[:, 0] != pairs[:, 1]
    pairs, ends = pairs[is_curve], edges.ends[is_curve]
    return {
        (int(low), int(high)): (mesh.vertices[some[:, 0]], mesh.vertices[some[:, 1]])
        for low, high in np.unique(pairs, axis=0)
        for some in [ends[(pairs[:, 0] == low) & (pairs[:, 1] == high)]]
    }


def face_labels(faces: Ints, labels: Ints) -> Ints:
    """Labels (e, 2) of the faces (e, 2) beside edges, the lower first; -1 for none."""
    pairs: Ints = np.sort(np.where(faces < 0, -1, labels[faces]), axis=1)
    return pairs


def _nearest_on_segments(points: Floats, starts: Floats, ends: Floats) -> Floats:
    """The nearest points (n, 3) on any of the segments (s, 3)."""
    along = ends - starts
    squared = np.maximum(np.einsum("ij,ij->i", along, along), 1e-300)
    result = np.empty_like(points)
    step = max(1, 2_000_000 // len(starts))
    for first in range(0, len(points), step):
        some = points[first : first + step]
        offset = some[:, None] - starts
        share = np.clip(np.einsum("nsk,sk->ns", offset, along) / squared, 0.0, 1.0)
        gap = offset - share[:, :, None] * along
        best = np.argmin(np.einsum("nsk,nsk->ns", gap, gap), axis=1)
        rows = np.arange(len(some))
        result[first : first + step] = starts[best] + share[rows, best, None] * along[best]
    return result


def _patch_projection(mesh: LabelledMesh, label: int) -> Callable[[Floats], Floats]:
    """What projects points to one patch: to its plane where it is flat."""
    faces = mesh.faces[mesh.labels == label]
    crosses = face_crosses(mesh.vertices, faces)
    normal = to_unit(crosses.sum(axis=0, keepdims=True))[0]
    heights = mesh.vertices[np.unique(faces)] @ normal
    extent = float(np.ptp(mesh.vertices[np.unique(faces)], axis=0).max())
    if np.ptp(heights) <= 1e-9 * extent:
        level = float(heights.mean())
        return lambda points: points - ((points @ normal) - level)[:, None] * normal
    return build_projection(mesh.vertices, faces)


def build_projection(vertices: Floats, faces: Ints) -> Callable[[Floats], Floats]:
    """What projects points (n, 3) to the nearest triangle, found in single precision."""
    kept, number = np.unique(faces, return_inverse=True)
    own = vertices[kept]
    scene = fcpw.scene_3D()
    scene.set_object_count(1)
    scene.set_object_vertices(np.asfortranarray(own, dtype=np.float32), 0)
    triangles = number.reshape(-1, 3).astype(np.int32)
    scene.set_object_triangles(np.asfortranarray(triangles), 0)
    scene.build(fcpw.aggregate_type.bvh_surface_area, True)
    corners = own[triangles]

    def project(points: Floats) -> Floats:
        hits = fcpw.interaction_3D_list()
        reach = np.full(len(points), np.inf, dtype=np.float32)
        scene.find_closest_points(np.asfortranarray(points, dtype=np.float32), reach, hits)
        nearest = np.fromiter((hit.primitive_index for hit in hits), np.intp, len(points))
        return _nearest_on_triangles(points, corners[nearest])

    return project


def _nearest_on_triangles(points: Floats, corners: Floats) -> Floats:
    """The nearest points (n, 3), each on its own triangle (n, 3, 3)."""
    first = corners[:, 0]
    normals = np.cross(corners[:, 1] - first, corners[:, 2] - first)
    squared = np.maximum(np.einsum("ij,ij->i", normals, normals), 1e-300)
    foot = points - (np.einsum("ij,ij->i", points - first, normals) / squared)[:, None] * normals
    inside = np.ones(len(points), dtype=bool)
    best = foot.copy()
    distance = np.full(len(points), np.inf)
    for start, end in ((0, 1), (1, 2), (2, 0)):
        edge, offset = corners[:, end] - corners[:, start], points - corners[:, start]
        inside &= np.einsum("ij,ij->i", np.cross(edge, offset), normals) >= 0.0
        length = np.maximum(np.einsum("ij,ij->i", edge, edge), 1e-300)
        share = np.clip(np.einsum("ij,ij->i", offset, edge) / length, 0.0, 1.0)
        on_edge = corners[:, start] + share[:, None] * edge
        gap = np.linalg.norm(points - on_edge, axis=1)
        nearer = gap < distance
        best[nearer], distance[nearer] = on_edge[nearer], gap[nearer]
    best[inside] = foot[inside]
    return best
