"""Faces of one mesh that intersect each other, and how many more do after it was moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Longs
from msal_cli.kernels.intersections import intersecting_pairs
from msal_cli.mesh import Mesh


@dataclass(frozen=True)
class IntersectionChange:
    """Pairs of faces that intersect before and after, and those after that did not before."""

    before: int
    after: int
    created: int


def count_self_intersections(mesh: Mesh) -> int:
    """How many pairs of faces intersect; see ``kernels.intersections``.

    Faces without area are left out: they touch their neighbours all along an edge.
    """
    return len(_pairs(mesh))


def self_intersection_change(before: Mesh, after: Mesh) -> IntersectionChange:
    """The counts for a mesh and the same faces at other positions."""
    pairs = _pairs(before)
    if np.array_equal(before.vertices, after.vertices):
        return IntersectionChange(len(pairs), len(pairs), 0)
    later = _pairs(after)
    created = np.setdiff1d(later, pairs, assume_unique=True)
    return IntersectionChange(len(pairs), len(later), len(created))


def _pairs(mesh: Mesh) -> Longs:
    """A number for each pair of faces that intersect, the same for the same faces."""
    from msal_cli.kernels.geometry import face_normals

    has_area = np.flatnonzero(face_normals(mesh.vertices, mesh.faces).any(axis=1))
    pairs = has_area[intersecting_pairs(mesh.vertices, mesh.faces[has_area])]
    numbers: Longs = pairs[:, 0] * len(mesh.faces) + pairs[:, 1]
    return numbers
