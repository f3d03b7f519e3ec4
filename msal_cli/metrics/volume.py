"""Surface area and signed volume of a mesh."""

from __future__ import annotations

from msal_cli.mesh import Mesh


def area_and_volume(mesh: Mesh) -> tuple[float, float]:
    """Area in squared and signed volume in cubed file units (Desbrun et al. 1999).

    The volume means something only where the surface is closed, manifold and wound one way; that
    of an open surface is the one seen from the mesh's local origin.
    """
    from msal_cli.core import geometry

    return geometry.area_and_volume(mesh.vertices, mesh.faces)
