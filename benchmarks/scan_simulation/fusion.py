"""Depth images from around the object, fused in a truncated signed distance volume.

After Curless and Levoy 1996, "A volumetric method for building complex models from range images":
every voxel near a surface gets the mean of its signed distances along the views, weighted by how
squarely the surface is seen, and marching cubes finds where that is 0.  Where no camera has seen
anything the surface stays open.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.scan_simulation.depth_camera import Camera, DepthImage, place_camera, take_image
from benchmarks.scan_simulation.frames import build_frame, turn, turn_back
from benchmarks.scan_simulation.marching import extract_surface
from benchmarks.scan_simulation.occupancy import Grid
from benchmarks.scan_simulation.settings import ScannerSettings
from benchmarks.scan_simulation.surface import Surface
from benchmarks.scan_simulation.volumes import place_grid
from msal_cli.arrays import Floats, Ints
from msal_cli.errors import ContentError
from msal_cli.mesh import Mesh

Volume = NDArray[np.float32]

TRUNCATION = 4.0
"""Signed distances are known, and kept, up to so many voxels."""

VOXELS_AT_ONCE = 1 << 20
"""Voxels that are seen by a camera at a time."""

FRAGMENT = 0.005
"""Pieces of a smaller share of the faces are left out, as tools for fusion do."""

_GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


def scan_fusion(mesh: Mesh, settings: ScannerSettings, voxel: float) -> tuple[Floats, Ints]:
    """Vertices (n, 3) and faces (m, 3) of the fused surface."""
    draw = np.random.Generator(np.random.PCG64(settings.seed))
    frame = build_frame(settings.direction)
    surface = Surface(mesh)
    used = turn(mesh.vertices[mesh.topology.has_ring], frame)
    grid = place_grid(used.min(axis=0), used.max(axis=0), np.full(3, voxel), draw)
    sums = np.zeros(grid.shape, dtype=np.float32)
    weights = np.zeros(grid.shape, dtype=np.float32)
    for direction in spread_directions(int(settings.value("views"))):
        view = build_frame(turn_back(direction[None], frame)[0])
        camera = place_camera(mesh, view, voxel, draw)
        image = take_image(surface, camera, settings, draw)
        offset = settings.value("misalignment") * voxel * draw.standard_normal(3)
        fuse_image(sums, weights, grid, frame, camera, image, offset)
    known = weights > 0.0
    if not (known & (sums <= 0.0)).any():
        raise ContentError(
            "the cameras see no surface",
            code="E_NO_FACES",
            hint="choose a finer --resolution, or more --views",
        )
    # Greater is inside; what is not known does not matter.
    distances = np.where(known, -sums / np.where(known, weights, 1.0), -1.0).astype(np.float32)
    points, faces = extract_surface(distances, 0.0, grid.spacing, known)
    points, faces = drop_fragments(points, faces)
    return turn_back(points + grid.origin, frame), faces


def spread_directions(count: int) -> Floats:
    """Unit vectors (n, 3) spread evenly over the sphere, along a spiral from the third axis."""
    heights = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    radii = np.sqrt(1.0 - heights**2)
    angles = _GOLDEN_ANGLE * np.arange(count)
    return np.stack([radii * np.cos(angles), radii * np.sin(angles), heights], axis=1)


def fuse_image(
    sums: Volume,
    weights: Volume,
    grid: Grid,
    frame: Floats,
    camera: Camera,
    image: DepthImage,
    offset: Floats,
) -> None:
    """Add to every voxel what one camera, whose place is off by ``offset`` (3,), says of it."""
    nx, ny, nz = grid.shape
    # The voxels' coordinates in the camera are sums of what each index adds.
    first = turn_back(grid.origin[None], frame)[0] + offset - camera.centre
    starts = turn(first[None], camera.frame)[0]
    steps = grid.spacing[:, None] * turn(frame, camera.frame)
    reach = TRUNCATION * float(grid.spacing[0])
    rows, columns = image.measured.shape
    measured_flat, weight_flat = image.measured.reshape(-1), 1.0 / image.growth.reshape(-1)
    slab = max(1, VOXELS_AT_ONCE // (ny * nz))
    for start in range(0, nx, slab):
        x = np.arange(start, min(start + slab, nx))
        seen = tuple(
            starts[axis]
            + (steps[0, axis] * x)[:, None, None]
            + (steps[1, axis] * np.arange(ny))[:, None]
            + steps[2, axis] * np.arange(nz)
            for axis in range(3)
        )
        column, row, depths = (one.reshape(-1) for one in camera.project((*seen,)))
        column, row = np.round(column), np.round(row)
        at = np.flatnonzero((column >= 0) & (column < columns) & (row >= 0) & (row < rows))
        pixels = (row[at] * columns + column[at]).astype(np.int64)
        measured = measured_flat[pixels]
        distances = measured - depths[at]
        near = np.flatnonzero((distances > -reach) & np.isfinite(measured))
        weight = weight_flat[pixels[near]].astype(np.float32)
        voxels = at[near] + start * ny * nz
        sums.reshape(-1)[voxels] += weight * np.minimum(distances[near] / reach, 1.0)
        weights.reshape(-1)[voxels] += weight


def drop_fragments(vertices: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """The surface without pieces of less than ``FRAGMENT`` of its faces."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(vertices)
    a, b = faces[:, [0, 1]].reshape(-1), faces[:, [1, 2]].reshape(-1)
    links = coo_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(n, n))
    _, piece = connected_components(links, directed=False)
    counts = np.bincount(piece[faces[:, 0]], minlength=int(piece.max()) + 1)
    faces = faces[(counts >= FRAGMENT * len(faces))[piece[faces[:, 0]]]]
    used = np.unique(faces)
    number = np.full(n, -1, dtype=np.int32)
    number[used] = np.arange(len(used), dtype=np.int32)
    return vertices[used], number[faces]
