"""What a closed surface encloses, whichever side its normals point to.

The signed volume is negative where a surface is inside out, and in a file of several parts one
that is inside out counts against the others.  Here each part is taken with its normals outwards,
but for cavities: a part within another one keeps its winding relative to that one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.measures import SurfaceChange, area_and_volume, is_negative
from msal_cli.arrays import Floats
from msal_cli.mesh import Defects, Mesh, PreparedMesh

MAX_PARTS = 1000
"""Parts beyond which only the sum of all is looked at: each is compared with each other."""

INSIDE_OUT = "the surface is inside out: its normals point inwards"


@dataclass(frozen=True, eq=False)
class Enclosure:
    """Which faces of a closed surface have their normals inwards.

    Attributes
    ----------
    inward : (m,) the faces of parts that are inside out; None if there are none.
    n_turned, n_parts : how many parts are inside out, and how many there are.
    """

    inward: NDArray[np.bool_] | None
    n_turned: int
    n_parts: int

    @property
    def is_inside_out(self) -> bool:
        """Whether the surface, or a part of it, is inside out."""
        return self.inward is not None

    @property
    def words(self) -> str:
        """Which parts are inside out, in words; empty if none is."""
        if not self.is_inside_out:
            return ""
        if self.n_turned == self.n_parts:
            return INSIDE_OUT
        are = "is" if self.n_turned == 1 else "are"
        return (
            f"{self.n_turned:,} of {self.n_parts:,} parts {are} inside out: normals point inwards"
        )

    def volume(self, mesh: Mesh, signed: float) -> float:
        """The volume that ``mesh``, with these faces and this ``signed`` volume, encloses."""
        if self.inward is None:
            return signed
        if self.inward.all():
            return -signed
        faces = np.where(self.inward[:, None], mesh.faces[:, ::-1], mesh.faces)
        return area_and_volume(Mesh(mesh.vertices, faces))[1]

    def change(self, before: Mesh, after: Mesh, change: SurfaceChange) -> SurfaceChange:
        """``change`` with the volumes that are enclosed in place of the signed ones."""
        return replace(
            change,
            volume_before=self.volume(before, change.volume_before),
            volume_after=self.volume(after, change.volume_after),
        )

    def outward_signs(self, mesh: Mesh) -> Floats | float:
        """1 where normals point outwards and -1 where they point inwards, for each vertex (n,), or
        one number for all."""
        if self.inward is None or self.inward.all():
            return 1.0 if self.inward is None else -1.0
        signs = np.ones(len(mesh.vertices))
        signs[mesh.faces[self.inward]] = -1.0
        return signs


def measure_enclosure(ready: PreparedMesh) -> Enclosure:
    """What a surface encloses; one that has no volume has no inside."""
    return enclosure_of(ready.mesh, ready.defects, *area_and_volume(ready.mesh))


def enclosure_of(mesh: Mesh, defects: Defects, area: float, volume: float) -> Enclosure:
    """The same for a mesh of which ``area`` and signed ``volume`` are known."""
    n_parts = defects.components
    if defects.volume_objection:
        return Enclosure(None, 0, n_parts)
    if 1 < n_parts <= MAX_PARTS:
        return _enclosure_by_part(mesh)
    if is_negative(volume, area):
        return Enclosure(np.ones(len(mesh.faces), dtype=bool), n_parts, n_parts)
    return Enclosure(None, 0, n_parts)


def _enclosure_by_part(mesh: Mesh) -> Enclosure:
    from msal_cli.kernels.connectivity import component_labels
    from msal_cli.kernels.geometry import face_normals_and_areas

    first = mesh.faces[:, 0]
    labels = component_labels(len(mesh.vertices), mesh.faces)
    numbers, part_of_face = np.unique(labels[first], return_inverse=True)
    n_parts = len(numbers)
    normals, face_areas = face_normals_and_areas(mesh.vertices, mesh.faces)
    # A face and the origin span a third of area times height.
    heights = np.einsum("ij,ij->i", mesh.vertices[first], normals)
    areas = np.bincount(part_of_face, face_areas, n_parts)
    volumes = np.bincount(part_of_face, face_areas * heights, n_parts) / 3.0
    is_turned = np.array([is_negative(*figures) for figures in zip(volumes, areas, strict=True)])
    if not is_turned.any():
        return Enclosure(None, 0, n_parts)
    used = np.flatnonzero(mesh.topology.has_ring)
    part_of_vertex = np.searchsorted(numbers, labels[used])
    low, high = np.full((n_parts, 3), np.inf), np.full((n_parts, 3), -np.inf)
    np.minimum.at(low, part_of_vertex, mesh.vertices[used])
    np.maximum.at(high, part_of_vertex, mesh.vertices[used])
    # Each part is as the largest one whose box it lies in: itself, if there is none.
    is_within = (low[:, None] > low[None]).all(axis=2) & (high[:, None] < high[None]).all(axis=2)
    is_within |= np.eye(n_parts, dtype=bool)
    outermost = np.where(is_within, (high - low).prod(axis=1)[None], -1.0).argmax(axis=1)
    is_turned = is_turned[outermost]
    n_turned = int(np.count_nonzero(is_turned))
    return Enclosure(is_turned[part_of_face] if n_turned else None, n_turned, n_parts)
