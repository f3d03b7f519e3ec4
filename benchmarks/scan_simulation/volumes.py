"""Meshes out of simulated volumes: binary voxels, grey values of a CT, and thick slices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.scan_simulation.frames import build_frame, cell_length, turn, turn_back
from benchmarks.scan_simulation.marching import extract_surface
from benchmarks.scan_simulation.occupancy import Grid, close_holes, fill_centres, fill_voxels
from benchmarks.scan_simulation.settings import MOST_CELLS, ScannerSettings
from msal_cli.arrays import Floats, Ints
from msal_cli.errors import ContentError, TooLargeError
from msal_cli.kernels.geometry import area_and_volume
from msal_cli.mesh import Mesh

Volume = NDArray[np.float32]

MARGIN = 3
"""Voxels of air around the object."""


def scan_volume(mesh: Mesh, settings: ScannerSettings) -> tuple[Floats, Ints, float, int]:
    """Vertices (n, 3) and faces (m, 3) of the object in a volume, the edge of a voxel, and how
    many holes of the mesh were closed."""
    frame = build_frame(settings.direction)
    draw = np.random.Generator(np.random.PCG64(settings.seed))
    vertices, faces, n_holes = close_holes(turn(mesh.vertices, frame), mesh.faces)
    if area_and_volume(vertices, faces)[1] < 0.0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    edge = cell_length(mesh, settings)
    apart = settings.value("slices") if settings.scanner == "slices" else 1.0
    used = vertices[faces.reshape(-1)]
    low, high = used.min(axis=0), used.max(axis=0)
    grid = place_grid(low, high, edge * np.array([1.0, 1.0, apart]), draw)
    if settings.scanner == "ct":
        volume = _grey_values(vertices, faces, grid, settings, draw)
    else:
        volume = fill_centres(vertices, faces, grid).astype(np.float32)
    if not float(volume.max()) > 0.5:
        raise ContentError(
            f"the mesh fills no voxel at this resolution (cells of {edge:.4g})", code="E_NO_FACES"
        )
    points, triangles = extract_surface(volume, 0.5, grid.spacing)
    return turn_back(points + grid.origin, frame), triangles, edge, n_holes


def place_grid(low: Floats, high: Floats, spacing: Floats, draw: np.random.Generator) -> Grid:
    """A grid over a box with air around it, whose place within a voxel is drawn; TooLargeError for
    more than ``MOST_CELLS`` voxels."""
    counts = np.ceil((high - low) / spacing) + 2 * MARGIN + 1
    if float(counts.prod()) > MOST_CELLS:
        raise TooLargeError(
            f"the volume would have {counts.prod():,.0f} voxels, more than {MOST_CELLS:,}",
            hint="choose a coarser resolution",
        )
    origin = low - spacing * (MARGIN + draw.random(3))
    nx, ny, nz = (int(count) for count in counts)
    return Grid(origin, spacing, (nx, ny, nz))


def _grey_values(
    vertices: Floats, faces: Ints, grid: Grid, settings: ScannerSettings, draw: np.random.Generator
) -> Volume:
    """What a CT measures: 1 inside, 0 outside, in between where a voxel is partly filled, blurred
    and with noise; without specks that hang in the air or in the object."""
    from scipy.ndimage import gaussian_filter

    volume: Volume = fill_voxels(vertices, faces, grid)
    volume = gaussian_filter(volume, settings.value("smoothing"), mode="nearest")
    level = settings.value("level")
    if not level:
        return volume
    noise = draw.standard_normal(grid.shape, dtype=np.float32)
    if correlation := settings.value("correlation"):
        noise = gaussian_filter(noise, correlation, mode="wrap")
        noise /= float(noise.std(dtype=np.float64))
    return remove_specks(volume + np.float32(level) * noise, volume >= 0.5)


def remove_specks(volume: Volume, inside: NDArray[np.bool_]) -> Volume:
    """The volume without those pieces of its solid that lie outside the object ``inside``, and
    without those cavities that lie within it, as tools for segmentation leave them out."""
    from scipy.ndimage import generate_binary_structure, label

    result = volume.copy()
    touching = generate_binary_structure(3, 3)
    for is_solid, is_object, other in ((volume >= 0.5, inside, 0.0), (volume < 0.5, ~inside, 1.0)):
        pieces, count = label(is_solid, touching)
        is_kept = np.zeros(count + 1, dtype=np.bool_)
        is_kept[np.unique(pieces[is_object & is_solid])] = True
        result[is_solid & ~is_kept[pieces]] = other
    return result
