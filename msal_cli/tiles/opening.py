"""Opening a run: the plan of its tiles, from a sample of the positions, and empty arrays."""

from __future__ import annotations

import os
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from msal_cli.arrays import Floats
from msal_cli.errors import TooLargeError
from msal_cli.mesh import no_faces_error
from msal_cli.tiles import source as sources
from msal_cli.tiles.cut import LARGEST_NUMBER, create_arrays
from msal_cli.tiles.plan import CHUNK_VERTICES, TILE_VERTICES, TilePlan

if TYPE_CHECKING:
    from msal_cli.codecs.streamed_mesh import StreamedMesh
    from msal_cli.job.settings import Settings, Task
    from msal_cli.tiles.scratch import Scratch

CORNERS_PER_VERTEX = 6
"""Corners of facets to each vertex of a closed surface."""

_SAMPLE = 200_000
_SAMPLE_PER_TILE = 400
_RANGE = 8
_READ_WHOLE = 100
_BYTES_PER_VERTEX = 32
_TAIL = 0.02


def open_run(
    task: Task,
    settings: Settings,
    scratch: Scratch,
    *,
    tile_vertices: int = TILE_VERTICES,
    chunk_vertices: int = CHUNK_VERTICES,
    source: dict[str, Any] | None = None,
) -> TilePlan:
    """Plan a run and create its arrays in a scratch folder that exists; the plan is saved last.

    Parameters
    ----------
    tile_vertices : vertices of a tile at most, about; six corners of facets count as one.
    chunk_vertices : vertices that a task reads at a time.
    source : how tasks open the input, see ``TilePlan``; by default the file of ``task``.

    Raises
    ------
    InputError
        for a file that cannot be read in pieces or has no faces, and TooLargeError
        for one whose vertices cannot be numbered.
    """
    if source is None:
        path = os.path.abspath(task.input)
        folder = os.path.abspath(scratch.path / sources.TEXT)
        source = {"kind": sources.FILE, "path": path, "format": settings.format, "folder": folder}
    identity = sources.identify(source)
    mesh = sources.open_source(source)
    n = mesh.n_vertices
    if n > LARGEST_NUMBER:
        raise TooLargeError(
            f"the mesh has {n:,} vertices, more than the {LARGEST_NUMBER:,} that can be numbered",
            hint="cut it into parts",
        )
    if not mesh.n_polygons:
        raise no_faces_error()
    of_tile = tile_vertices * (CORNERS_PER_VERTEX if mesh.are_corners else 1)
    n_levels = max(0, -(-n // of_tile) - 1).bit_length()
    sample = _read_sample(mesh, max(_SAMPLE, _SAMPLE_PER_TILE << n_levels), chunk_vertices)
    split_axis, split_at = build_tree(sample, n_levels)
    chunks = mesh.face_chunks(2 * chunk_vertices)
    plan = TilePlan(
        source=source,
        identity=identity,
        settings=asdict(settings),
        output=os.path.abspath(task.output) if task.output else None,
        n_vertices=n,
        n_polygons=mesh.n_polygons,
        vertex_type=np.dtype(mesh.vertex_type).name,
        split_axis=split_axis,
        split_at=split_at,
        n_tiles=1 << n_levels,
        vertex_chunks=[(at, min(at + chunk_vertices, n)) for at in range(0, n, chunk_vertices)],
        face_chunks=[[list(one.polygons), one.first_triangle, list(one.place)] for one in chunks],
        pieces=mesh.output_pieces(_BYTES_PER_VERTEX * chunk_vertices),
    )
    create_arrays(plan, scratch)
    plan.save(scratch)
    return plan


def _read_sample(mesh: StreamedMesh, wanted: int, chunk_vertices: int) -> Floats:
    """Positions (about ``wanted``, 3) that lie regularly in the file; all if there are no more."""
    n = mesh.n_vertices
    if n <= _READ_WHOLE * wanted:
        # Reading all in long pieces takes less time than as many short ones.
        step = max(1, n // wanted)
        parts = []
        for at in range(0, n, chunk_vertices):
            rows = mesh.read_vertices(at, min(at + chunk_vertices, n))
            parts.append(rows[-at % step :: step].astype(np.float64))
        return np.concatenate(parts) if parts else np.empty((0, 3))
    n_ranges = wanted // _RANGE
    starts = [at * (n - _RANGE) // (n_ranges - 1) for at in range(n_ranges)]
    ranges = [mesh.read_vertices(at, at + _RANGE) for at in starts]
    return np.concatenate(ranges).astype(np.float64)


def build_tree(sample: Floats, n_levels: int) -> tuple[list[int], list[float]]:
    """A full k-d tree of ``n_levels`` that shares out the positions (n, 3) evenly.

    Every node is split across the axis of its largest extent, stray positions left out.  Returns
    axis and threshold of all inner nodes, as ``kernels.tile_cut.label_positions`` takes them.
    """
    n_inner = (1 << n_levels) - 1
    axes, thresholds = [0] * n_inner, [0.0] * n_inner
    parts = {0: sample}
    for node in range(n_inner):
        points = parts.pop(node)
        axes[node], thresholds[node] = _choose_split(points)
        is_left = points[:, axes[node]] < thresholds[node]
        parts[2 * node + 1], parts[2 * node + 2] = points[is_left], points[~is_left]
    return axes, thresholds


def _choose_split(points: Floats) -> tuple[int, float]:
    """Axis and threshold for some positions (n, 3): at a median, but between different numbers.

    Where more than three quarters would be on one side, because many have one coordinate in common,
    another axis may do better.
    """
    n = len(points)
    if not n:
        return 0, 0.0
    columns = np.sort(points, axis=0).T
    tail = int(_TAIL * n)
    with np.errstate(over="ignore"):
        extents = columns[:, n - 1 - tail] - columns[:, tail]
    best = (-1, 0, 0.0)
    for axis in np.argsort(-extents, kind="stable").tolist():
        column = columns[axis]
        middle = column[n // 2]
        first, behind = np.searchsorted(column, middle), np.searchsorted(column, middle, "right")
        for left in (int(first), int(behind)):
            smaller = min(left, n - left)
            if smaller > best[0]:
                best = (smaller, axis, float(column[min(left, n - 1)]))
        if 4 * best[0] >= n:
            break
    return best[1], best[2]
