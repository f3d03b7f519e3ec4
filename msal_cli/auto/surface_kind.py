"""The kind of a surface, by the angles across its edges."""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats
from msal_cli.mesh import Mesh

MACHINED, TEXTURED, ORGANIC, CLEAN = "machined", "textured", "organic", "clean"

SHARP = 9.0
"""How many times the third quartile of the angles their 98th percentile is, from where on edges
are sharp ones between smooth parts.  On the models of benchmarks/ground_truth.py, after a first
blend: 9.3 and more on machined ones, 8.7 and less on others, 5 on most."""

ROUGH_DEG = 10.0
"""The 90th percentile of the angles, in degrees, from which on a surface is called textured."""

EVEN = 3.3
"""The same ratio up to which a rough surface is rough all over: 2.3 to 2.8 on texture, 3.9 and more
where noise is left on smooth parts between edges."""

AWAY = 0.02
"""Share of the area of a range scan that may face away from the scanner: by noise, at grazing
angles.  Scans by one view have 0.015 and less."""


def is_seen_from_one_side(mesh: Mesh) -> bool:
    """Whether the mesh is open and hardly any of its area faces away: a scan from one view."""
    from msal_cli.kernels.geometry import face_normals_and_areas

    if not mesh.topology.boundary.any():
        return False
    normals, areas = face_normals_and_areas(mesh.vertices, mesh.faces)
    axis = np.einsum("ij,i->j", normals, areas)
    away = areas[np.einsum("ij,j->i", normals, axis) < 0.0]
    return float(away.sum()) <= AWAY * float(areas.sum())


def surface_kind(mesh: Mesh) -> str:
    """``MACHINED``, ``TEXTURED`` or ``ORGANIC``, for a mesh without much noise."""
    angles = _angles_deg(mesh)
    if not len(angles):
        return ORGANIC
    usual, rough, sharp = np.percentile(angles, [75, 90, 98])
    if sharp > SHARP * usual and sharp > ROUGH_DEG:
        return MACHINED
    return TEXTURED if rough >= ROUGH_DEG and sharp <= EVEN * usual else ORGANIC


def _angles_deg(mesh: Mesh) -> Floats:
    """Angles between the normals of faces that share an edge, degrees, each pair once."""
    from msal_cli.kernels.faces import face_rings
    from msal_cli.kernels.geometry import face_normals_and_areas

    normals, areas = face_normals_and_areas(mesh.vertices, mesh.faces)
    start, ring = face_rings(mesh.faces, mesh.topology, "edge")
    first = np.repeat(np.arange(len(start) - 1), np.diff(start))
    kept = (first < ring) & (areas[first] > 0.0) & (areas[ring] > 0.0)
    alike = np.einsum("ij,ij->i", normals[first[kept]], normals[ring[kept]])
    angles: Floats = np.degrees(np.arccos(np.clip(alike, -1.0, 1.0)))
    return angles
