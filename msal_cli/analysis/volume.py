"""Surface area and signed volume of a mesh."""

from __future__ import annotations

import math

from msal_cli.mesh import Mesh

FLAT = 1e-9
"""A volume below this share of area ** 1.5 is rounding: the surface encloses nothing."""


def area_and_volume(mesh: Mesh) -> tuple[float, float]:
    """Area in squared and signed volume in cubed file units (Desbrun et al. 1999).

    The volume means something only where the surface is closed, manifold and wound one way; that
    of an open surface is the one seen from the mesh's local origin.  It is negative where the
    surface is inside out.
    """
    from msal_cli.kernels import geometry

    return geometry.area_and_volume(mesh.vertices, mesh.faces)


def is_negative(volume: float, area: float) -> bool:
    """Whether a closed surface with this signed volume and area is inside out."""
    return volume < -_flat_volume(area)


def relative_volume_change(before: float, after: float, area: float) -> float | None:
    """Change of the volume that a closed surface encloses, over what it enclosed before.

    ``before`` and ``after`` are volumes of the same faces with one sign, ``area`` is the area
    before.  Less is shrinking, also of negative volumes; below -1 the surface passed through
    itself.  None where it encloses nothing before.
    """
    if abs(before) <= _flat_volume(area):
        return None
    return (after - before) / before


def _flat_volume(area: float) -> float:
    return FLAT * area * math.sqrt(area)
