"""What a run by tiles will take: tiles, memory, scratch space and seconds, by counts alone.

The constants were measured by benchmarks/beyond_memory.py on closed meshes with twice as many
triangles as vertices.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from msal_cli.job.settings import Settings, method_bytes_per_face
from msal_cli.tiles.opening import CORNERS_PER_VERTEX
from msal_cli.tiles.plan import CHUNK_VERTICES, TILE_VERTICES

if TYPE_CHECKING:
    from msal_cli.tiles.outlook import Found

PROCESS_BYTES = 60_000_000
"""Resident memory of a process before it has any tile, and of the one that leads."""

LOCAL_BYTES = 300
"""Memory of a task per vertex of the tile and its halo, at its peak."""

FEWEST_TILE_VERTICES = 20_000
"""A smaller tile is mostly halo."""

USUAL_RINGS = 10
"""Rings that a method which is not chosen yet is expected to reach."""

SECONDS_PER_MILLION = 3.0
"""Seconds of one core for a million vertices, from reading to writing, for a method as fast as
``msal``: 2.6 s of processor time were measured on two million vertices in eight tiles."""


@dataclass(frozen=True)
class TileEstimate:
    """What a run is expected to take.

    Attributes
    ----------
    tile_vertices : of a tile at most, about; six corners of STL facets count as one.
    n_tiles : a power of two.
    jobs : tasks at the same time.
    memory_bytes : of all processes together.
    scratch_bytes : in the scratch folder, the output included.
    output_bytes : of the output.
    seconds : from start to end.
    """

    tile_vertices: int
    n_tiles: int
    jobs: int
    memory_bytes: int
    scratch_bytes: int
    output_bytes: int
    seconds: float

    @property
    def chunk_vertices(self) -> int:
        """Vertices that a task reads at a time."""
        return min(CHUNK_VERTICES, 2 * self.tile_vertices)


def estimate_run(
    mesh: Found, settings: Settings, *, jobs: int, memory_bytes: int | None
) -> TileEstimate:
    """The estimate for a mesh, with as many ``jobs`` as fit into ``memory_bytes``, if any."""
    n = mesh.n_vertices // (CORNERS_PER_VERTEX if mesh.are_corners else 1)
    rings = _expected_rings(settings)
    per_vertex = LOCAL_BYTES + 2 * method_bytes_per_face(settings)
    tile_vertices, jobs = _fit_tiles(n, per_vertex, rings, jobs, memory_bytes)
    n_tiles = 1 << max(0, -(-n // tile_vertices) - 1).bit_length()
    own = -(-n // n_tiles)
    local = with_halo(own, rings)
    jobs = min(jobs, n_tiles)
    position = 3 * mesh.vertex_type().itemsize
    # Numbers, positions before and after; then faces by tile; then the mesh of each tile.
    scratch = mesh.n_vertices * (12 + position + 24 * (1 + 2 * mesh.has_normals))
    n_properties = len(settings.lock) + (settings.weights is not None)
    scratch += mesh.n_vertices * (8 * n_properties + _PIN_BYTES * (n_properties > 0))
    scratch += int(16 * mesh.n_polygons * local / max(own, 1))
    scratch += n_tiles * local * _TILE_BYTES
    return TileEstimate(
        tile_vertices=tile_vertices,
        n_tiles=n_tiles,
        jobs=jobs,
        memory_bytes=PROCESS_BYTES + jobs * (PROCESS_BYTES + per_vertex * local),
        scratch_bytes=scratch + mesh.size,
        output_bytes=mesh.size,
        seconds=SECONDS_PER_MILLION * n * local / max(own, 1) / 1e6 / jobs,
    )


_PIN_BYTES = 9
"""Whether a vertex is pinned, and how much it is trusted."""

_TILE_BYTES = 180
"""Of the files of a tile, for each vertex of it and of its halo: positions, faces, numbers, rings,
and the state of sweeps; some more than was measured, 155 to 165."""


def with_halo(own: int, rings: int) -> int:
    """Vertices of a tile of ``own`` vertices and of so many rings around it, about: those of a
    square, of which ``rings`` rows are added on each side."""
    side = math.isqrt(own)
    return own + 4 * rings * (side + rings)


def _expected_rings(settings: Settings) -> int:
    from msal_cli import methods
    from msal_cli.job.settings import CHOOSING

    if settings.method in CHOOSING:
        return USUAL_RINGS
    return methods.find(settings.method).reach(settings.parameters) or USUAL_RINGS


def _fit_tiles(
    n: int, per_vertex: int, rings: int, jobs: int, memory_bytes: int | None
) -> tuple[int, int]:
    """Vertices of a tile, and tasks at the same time, that fit into memory; at the least one task
    with the smallest tile, whether it fits or not."""
    if memory_bytes is None:
        return TILE_VERTICES, jobs
    for n_jobs in range(jobs, 0, -1):
        room = (memory_bytes - PROCESS_BYTES) // n_jobs - PROCESS_BYTES
        own = TILE_VERTICES
        while own > FEWEST_TILE_VERTICES and per_vertex * with_halo(own, rings) > room:
            own = max(own * 9 // 10, FEWEST_TILE_VERTICES)
        # Fewer tasks at a time are better than tiles that are mostly halo.
        if per_vertex * with_halo(own, rings) <= room and own >= min(
            n, TILE_VERTICES, _fewest(n_jobs)
        ):
            return own, n_jobs
    return FEWEST_TILE_VERTICES, 1


def _fewest(jobs: int) -> int:
    return FEWEST_TILE_VERTICES if jobs == 1 else 5 * FEWEST_TILE_VERTICES
