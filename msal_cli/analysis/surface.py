"""How a surface changed: area, volume, and the angles between its faces' normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from msal_cli.mesh import Mesh


@dataclass(frozen=True)
class NormalStatistics:
    """Angles between corresponding face normals, over the faces that have one in both meshes.

    ``mean_angular_error_deg`` is what much of the literature prints as MSAE;
    ``flipped_faces`` turned by more than a right angle.
    """

    mean_angular_error_deg: float
    max_angular_error_deg: float
    flipped_faces: int


@dataclass(frozen=True)
class SurfaceChange:
    """Areas in squared and signed volumes in cubed file units (see ``volume``), and the normals."""

    area_before: float
    area_after: float
    volume_before: float
    volume_after: float
    normals: NormalStatistics


def measure_surface_change(before: Mesh, after: Mesh) -> SurfaceChange:
    """The change between two meshes with the same faces."""
    from msal_cli.kernels import surface_change as core

    figures = core.surface_figures(before.vertices, after.vertices, before.faces)
    compared = figures[core.COMPARED]
    return SurfaceChange(
        area_before=float(figures[core.DOUBLED_AREA_BEFORE] / 2.0),
        area_after=float(figures[core.DOUBLED_AREA_AFTER] / 2.0),
        volume_before=float(figures[core.SIXFOLD_VOLUME_BEFORE] / 6.0),
        volume_after=float(figures[core.SIXFOLD_VOLUME_AFTER] / 6.0),
        normals=NormalStatistics(
            mean_angular_error_deg=float(np.degrees(figures[core.ANGLES] / max(compared, 1.0))),
            max_angular_error_deg=float(np.degrees(figures[core.LARGEST_ANGLE])),
            flipped_faces=int(figures[core.FLIPPED]),
        ),
    )


def normal_statistics(before: Mesh, after: Mesh) -> NormalStatistics:
    """Angles between the face normals of two meshes with the same faces."""
    return measure_surface_change(before, after).normals
