"""How far face normals turned."""

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


def normal_statistics(before: Mesh, after: Mesh) -> NormalStatistics:
    """Angles between the face normals of two meshes with the same faces."""
    from msal_cli.core.geometry import normal_angles

    angles = normal_angles(before.vertices, after.vertices, before.faces)
    angles = angles[~np.isnan(angles)]
    if not len(angles):
        return NormalStatistics(0.0, 0.0, 0)
    return NormalStatistics(
        mean_angular_error_deg=float(np.degrees(angles.mean())),
        max_angular_error_deg=float(np.degrees(angles.max())),
        flipped_faces=int((angles > np.pi / 2).sum()),
    )
