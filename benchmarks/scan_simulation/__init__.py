"""Meshes as scanners make them, from a clean mesh or from a volume.

Noise that is added to a mesh (``noise``) keeps its triangles; a scanner makes its own, with a
staircase, terraces, open borders and noise that neighbours share.
"""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.scan_simulation.settings import DEFAULTS, OPTIONS, SCANNERS, ScannerSettings
from msal_cli.arrays import Floats, Ints
from msal_cli.mesh import Mesh

__all__ = [
    "DEFAULTS",
    "OPTIONS",
    "SCANNERS",
    "Scan",
    "ScannerSettings",
    "find_truth",
    "simulate_scan",
]


@dataclass(frozen=True, eq=False)
class Scan:
    """What a simulated scanner has made.

    Attributes
    ----------
    vertices : (n, 3) positions, in the frame of the mesh that was scanned.
    faces : (m, 3) indices, counter-clockwise from outside.
    cell : edge of a voxel or pixel, file units.
    true_vertices : (n, 3) where a camera's vertices would be without noise; None where there is no
        such place, and ``find_truth`` takes the nearest.
    closed_holes : holes of the mesh that had to be closed to tell inside from outside.
    """

    vertices: Floats
    faces: Ints
    cell: float
    true_vertices: Floats | None = None
    closed_holes: int = 0


def simulate_scan(mesh: Mesh, settings: ScannerSettings) -> Scan:
    """A mesh as a scanner makes it; the same for the same arguments.

    Parameters
    ----------
    mesh : the object, about a local origin, as ``mesh.prepared`` makes it.  Where it is wound
        inside out, volumes are still filled.
    settings : the scanner, its resolution, noise and seed.

    Raises
    ------
    ContentError
        with code ``E_NO_FACES`` where the scanner sees nothing at its resolution.
    TooLargeError
        for more than ``settings.MOST_CELLS`` voxels or ``MOST_PIXELS`` pixels.
    """
    if settings.scanner in ("voxels", "ct", "slices"):
        from benchmarks.scan_simulation.volumes import scan_volume

        vertices, faces, cell, n_holes = scan_volume(mesh, settings)
        return Scan(vertices, faces, cell, closed_holes=n_holes)
    from benchmarks.scan_simulation.frames import cell_length

    cell = cell_length(mesh, settings)
    if settings.scanner == "depth":
        from benchmarks.scan_simulation.depth_camera import scan_depth

        vertices, faces, true_vertices = scan_depth(mesh, settings, cell)
        return Scan(vertices, faces, cell, true_vertices)
    from benchmarks.scan_simulation.fusion import scan_fusion

    vertices, faces = scan_fusion(mesh, settings, cell)
    return Scan(vertices, faces, cell)


def find_truth(mesh: Mesh, scan: Scan) -> Floats:
    """Where the scan's vertices would be without noise (n, 3).

    That is known for a camera.  For others it is the nearest point of the mesh, so that triangles
    next to a sharp edge may lose their area.
    """
    if scan.true_vertices is not None:
        return scan.true_vertices
    from benchmarks.scan_simulation.surface import Surface

    return Surface(mesh).closest_points(scan.vertices)
