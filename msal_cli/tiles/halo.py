"""The stage ``rim``, and the part of the mesh that a tile is computed on: the tile and its halo.

Distances are counted in edges, from the nearest vertex of the tile.  A tile's *rim* are those of
its triangles that others may need; the halo of a tile is made of the rims of the tiles around it.
Vertices of a part are in the order of the file, and triangles too: so every sum over a
neighbourhood has its terms in the order in which they are in memory.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.errors import ContentError
from msal_cli.mesh import LARGEST_EXTENT
from msal_cli.tiles import vertex_data
from msal_cli.tiles.cut import is_welded, tile_range, tile_records, weld_numbers
from msal_cli.tiles.part_files import load_array, save_array
from msal_cli.tiles.plan import load_plan, read_globals, write_globals

if TYPE_CHECKING:
    from msal_cli.arrays import Flags, Floats, Ints
    from msal_cli.tiles.scratch import Scratch

Records = NDArray[np.uint32]
Ids = NDArray[np.uint32]

_OLD, _POSITIONS = "old.u4", "positions.bin"
_RIM = "rim.npy"
_MEASURED_RINGS = 2
"""Rings beyond those that a method reaches: the measures need the results in the first ring too,
and of the vertices in the last ring some faces are missing."""


@dataclass(frozen=True, eq=False)
class Part:
    """A tile and its halo.

    Attributes
    ----------
    ids : (n,) uint32, numbers of its vertices in tile-major order; of coincident ones the first.
    file_vertices : (n,) uint32, their numbers in the file, ascending.
    faces : (m, 3) int32, triangles with three different vertices, in the order of the file.
    triangles : (m,) uint32, their numbers, ascending.
    own : (n,) the vertices of the tile; the others are the halo.
    """

    ids: Ids
    file_vertices: Ids
    faces: Ints
    triangles: Ids
    own: Flags


def count_rings(scratch: Scratch) -> int:
    """Rings of a halo: what the method of the run reaches, and what the measures need."""
    return max(int(read_globals(scratch)["rings"]), 1) + _MEASURED_RINGS


def run_rim(scratch: Scratch, tile: int) -> dict[str, Any]:
    """Write the rim of a tile; the result has its used vertices, their bounds and its triangles."""
    from msal_cli.kernels import halos, tile_cut

    first, stop = tile_range(scratch, tile)
    records = tile_records(scratch, tile)
    welded = weld_records(scratch, records)
    near = halos.border_records(welded, first, stop - first, count_rings(scratch))
    save_array(scratch.tile_folder(tile) / _RIM, records[near])
    clean = halos.drop_repeated(welded)
    used = tile_cut.mark_own(clean, first, stop - first)
    n_all, n_clean = (
        halos.count_first_corners(one, first, stop - first) for one in (welded, clean)
    )
    result: dict[str, Any] = {
        "used": int(used.sum()),
        "repeated": n_all - n_clean,
        "faces": n_clean,
    }
    if result["used"]:
        low, high = _bounds(scratch, first, used)
        result |= {"low": low.tolist(), "high": high.tolist()}
    return result


def reduce_rim(scratch: Scratch) -> None:
    """Add the origin and counts of vertices and triangles to what all tasks know.

    Raises ContentError (``E_NO_FACES``, ``E_RANGE``).
    """
    vertex_data.create_arrays(scratch)
    results = list(scratch.results("rim").values())
    if not any(one["faces"] for one in results):
        raise ContentError(
            "every face is degenerate: its corners are not three different points",
            code="E_NO_FACES",
            hint="check the file in a viewer; there is no surface to denoise",
        )
    low = np.min([one["low"] for one in results if one["used"]], axis=0)
    high = np.max([one["high"] for one in results if one["used"]], axis=0)
    with np.errstate(over="ignore"):
        extent = float((high - low).max())
    if not 1.0 / LARGEST_EXTENT < extent < LARGEST_EXTENT:
        raise ContentError(
            f"the mesh extends over {extent:g} units, too far or too little to compute with",
            code="E_RANGE",
            hint="scale the mesh, or look for a stray vertex",
        )
    write_globals(
        scratch,
        origin=((low + high) / 2.0).tolist(),
        used_vertices=sum(one["used"] for one in results),
        repeated_faces=sum(one["repeated"] for one in results),
    )


def assemble_part(scratch: Scratch, tile: int) -> Part:
    """The tile with its halo of ``count_rings`` rings."""
    from msal_cli.kernels import halos, tile_cut

    first, stop = tile_range(scratch, tile)
    count = stop - first
    own_records = weld_records(scratch, tile_records(scratch, tile))
    halo = _find_halo(scratch, tile, own_records)
    records = halos.drop_repeated(halos.merge_records(own_records, halo))
    del own_records, halo
    used = tile_cut.mark_own(records, first, count)
    own_ids = np.flatnonzero(used).astype(np.uint32) + np.uint32(first)
    others = other_vertices(records, first, count)
    old = scratch.array(_OLD, np.uint32)
    own_old, other_old = old[first:stop][used], old[others]
    # Both in the order of the file, and then merged.
    order = np.argsort(other_old)
    at_others = np.searchsorted(own_old, other_old[order]) + np.arange(len(others))
    own = np.ones(len(own_ids) + len(others), dtype=bool)
    own[at_others] = False
    ids, file_vertices = np.empty(len(own), dtype=np.uint32), np.empty(len(own), dtype=np.uint32)
    ids[own], ids[at_others] = own_ids, others[order]
    file_vertices[own], file_vertices[at_others] = own_old, other_old[order]
    own_numbers = np.full(count, -1, dtype=np.int32)
    own_numbers[used] = np.flatnonzero(own)
    other_numbers = np.empty(len(others), dtype=np.int32)
    other_numbers[order] = at_others
    faces = halos.relabel(records, first, own_numbers, others, other_numbers)
    return Part(ids, file_vertices, faces, np.ascontiguousarray(records[:, 0]), own)


def read_positions(scratch: Scratch, ids: Ids | slice) -> Floats:
    """Stored positions (n, 3) of vertices, as float64."""
    stored = scratch.array(_POSITIONS, load_plan(scratch).dtype, 3)
    positions: Floats = stored[ids].astype(np.float64)
    return positions


def other_vertices(records: Records, first: int, count: int) -> Ids:
    """The vertices of triangles that are not the tile's, ascending."""
    from msal_cli.kernels import halos

    ids = halos.crossing_records(records, first, count)[:, 1:]
    others: Ids = np.unique(ids[(ids < first) | (ids >= first + count)])
    return others


def weld_records(scratch: Scratch, records: Records) -> Records:
    """The triangles with the first of coincident vertices in place of each."""
    if not is_welded(scratch):
        return records
    welded = records.copy()
    welded[:, 1:] = weld_numbers(scratch, records[:, 1:])
    return welded


def _bounds(scratch: Scratch, first: int, used: Flags) -> tuple[Floats, Floats]:
    """Least and greatest coordinates (3,) of a tile's vertices that are ``used`` (count,)."""
    positions = scratch.array(_POSITIONS, load_plan(scratch).dtype, 3)[first : first + len(used)]
    if not used.all():
        positions = positions[used]
    # Rows of coordinates: numpy reduces the first of two axes slowly where the second is short.
    columns = [np.ascontiguousarray(positions[:, axis]) for axis in range(3)]
    low = np.array([one.min() for one in columns], dtype=np.float64)
    high = np.array([one.max() for one in columns], dtype=np.float64)
    return low, high


def _find_halo(scratch: Scratch, tile: int, own_records: Records) -> Records:
    """The triangles (m, 4) near a tile that have no vertex of it, in the order of the file."""
    from msal_cli.kernels import halos
    from msal_cli.kernels.welding import number_groups

    first, stop = tile_range(scratch, tile)
    rings = count_rings(scratch)
    starts = np.array(read_globals(scratch)["tile_starts"], dtype=np.int64)
    loaded = {tile}
    near = halos.crossing_records(own_records, first, stop - first)
    while True:
        ids = np.ascontiguousarray(near[:, 1:]).reshape(-1)
        numbers, places = number_groups(ids.view(np.int32), np.zeros(len(ids), dtype=np.int32))
        vertices = ids[places]
        is_own = (vertices >= first) & (vertices < stop)
        distances = halos.spread_rings(numbers.reshape(-1, 3), is_own, rings - 1)
        reached = vertices[(distances < rings) & ~is_own]
        tiles = np.unique(np.searchsorted(starts, reached, side="right") - 1)
        new = [int(one) for one in tiles if int(one) not in loaded]
        if not new:
            break
        loaded.update(new)
        near = np.concatenate([near, *(_read_rim(scratch, one) for one in new)])
    nearest = distances[numbers.reshape(-1, 3)].min(axis=1, initial=halos.FAR)
    near = near[(nearest > 0) & (nearest < rings)]
    halo: Records = near[np.unique(near[:, 0], return_index=True)[1]]
    return halo


def _read_rim(scratch: Scratch, tile: int) -> Records:
    """The rim of a tile (m, 4), coincident vertices welded."""
    return weld_records(scratch, load_array(scratch.tile_folder(tile) / _RIM))
