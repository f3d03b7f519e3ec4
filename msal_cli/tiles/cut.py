"""Stages ``count``, ``number``, ``faces`` and ``weld``: a mesh in the order of its tiles, on disk.

Vertices are numbered anew so that every tile owns a range of them, in which they stand in the order
of the file.  Arrays in the scratch folder:

    numbers.u4     (n,) new number of each vertex of the file
    old.u4         (n,) vertex of the file for each new number
    positions.bin  (n, 3) positions as the file stores them, by new number
    back.u4        (n,) how far before a vertex the first one at its position is; mostly 0
    faces/CHUNK.u4 (r, 4) number of a triangle and the new numbers of its corners, sorted by tile
    offsets.u8     (chunks, tiles + 1) where the faces of each tile begin in a chunk's file
    bases.u8       (chunks, tiles) new number of the first vertex of each chunk in each tile

A triangle is among the faces of every tile that owns a corner of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Longs
from msal_cli.codecs.streamed_mesh import FaceChunk
from msal_cli.errors import TooLargeError
from msal_cli.kernels import tile_cut
from msal_cli.kernels.corner_welding import measure_back
from msal_cli.kernels.tile_cut import RECORD_WORDS, TileRanges
from msal_cli.kernels.welding import first_alike
from msal_cli.mesh import bounds, no_faces_error
from msal_cli.tiles import source as sources
from msal_cli.tiles.plan import TilePlan, load_plan, read_globals, write_globals
from msal_cli.tiles.scratch import Scratch

LARGEST_NUMBER = 2**32 - 2
"""Of vertices, and of triangles: numbers have 32 bits, and the last one is kept for none."""

_NUMBERS, _OLD, _POSITIONS, _BACK = "numbers.u4", "old.u4", "positions.bin", "back.u4"
_FACES, _OFFSETS, _BASES = "faces", "offsets.u8", "bases.u8"

Numbers = NDArray[np.uint32]


def create_arrays(plan: TilePlan, scratch: Scratch) -> None:
    """Create the arrays that tasks write ranges of; they take no space yet."""
    n = plan.n_vertices
    for name in (_NUMBERS, _OLD, _BACK):
        scratch.create(name, np.uint32, (n,))
    scratch.create(_POSITIONS, plan.dtype, (n, 3))
    scratch.create(_OFFSETS, np.int64, (len(plan.face_chunks), plan.n_tiles + 1))
    scratch.create(_BASES, np.int64, (len(plan.vertex_chunks), plan.n_tiles))
    (scratch.path / _FACES).mkdir(exist_ok=True)


# Readers, for the stages that follow


def tile_range(scratch: Scratch, tile: int) -> tuple[int, int]:
    """New numbers of the first vertex that a tile owns and of the one behind its last."""
    starts = read_globals(scratch)["tile_starts"]
    return starts[tile], starts[tile + 1]


def tile_ranges(scratch: Scratch) -> TileRanges:
    """Which tile owns a vertex, for ``kernels.tile_cut``."""
    return TileRanges.build(read_globals(scratch)["tile_starts"])


def tile_records(scratch: Scratch, tile: int) -> Numbers:
    """The faces (m, ``RECORD_WORDS``) that have a corner in a tile, ascending: the number of the
    triangle and the new numbers of its corners, which are not welded."""
    parts = [
        scratch.read_range(f"{_FACES}/{chunk}.u4", np.uint32, start, stop, RECORD_WORDS)
        for chunk, start, stop in _find_records(scratch, tile)
    ]
    if len(parts) == 1:
        return parts[0]  # type: ignore[no-any-return]
    return np.concatenate([np.empty((0, RECORD_WORDS), dtype=np.uint32), *parts])


def tile_faces(scratch: Scratch, tile: int) -> tuple[Numbers, Numbers]:
    """The same as numbers (m,) of the triangles and new numbers (m, 3) of their corners."""
    records = tile_records(scratch, tile)
    return records[:, 0].copy(), records[:, 1:].copy()


def read_positions(scratch: Scratch, start: int, stop: int) -> NDArray[Any]:
    """The positions (stop - start, 3) of a range of new numbers, as the file stores them."""
    rows: NDArray[Any] = scratch.read_range(
        _POSITIONS, load_plan(scratch).dtype, start, stop, columns=3
    )
    return rows


def read_old_numbers(scratch: Scratch, start: int, stop: int) -> Numbers:
    """The vertices of the file (stop - start,) for a range of new numbers."""
    old: Numbers = scratch.read_range(_OLD, np.uint32, start, stop)
    return old


def is_welded(scratch: Scratch) -> bool:
    """Whether any two vertices that faces use are at one position."""
    return bool(read_globals(scratch)["n_welded"])


def weld_numbers(scratch: Scratch, numbers: Numbers) -> Numbers:
    """For new numbers of any shape those of the first vertices at their positions, among those that
    faces use; a vertex and the first one like it have the same tile."""
    if not is_welded(scratch):
        return numbers
    welded: Numbers = numbers - scratch.array(_BACK, np.uint32)[numbers]
    return welded


# Stages


def run_count(scratch: Scratch, chunk: int) -> dict[str, Any]:
    """How many vertices of a chunk each tile gets, and their bounds."""
    plan = load_plan(scratch)
    positions = _read_vertices(plan, chunk)
    labels = _label(plan, positions)
    low, high = bounds(positions)
    return {
        "counts": tile_cut.count_labels(labels, plan.n_tiles).tolist(),
        "low": low.tolist(),
        "high": high.tolist(),
    }


def reduce_count(scratch: Scratch) -> None:
    """Make ``tile_starts``, and the bounds ``low`` and ``high`` of all vertices, used or not."""
    plan = load_plan(scratch)
    results = scratch.results("count")
    counts = np.array([results[one]["counts"] for one in sorted(results)], dtype=np.int64)
    counts = counts.reshape(-1, plan.n_tiles)
    starts = np.concatenate(([0], np.cumsum(counts.sum(axis=0))))
    bases = starts[:-1] + np.cumsum(counts, axis=0) - counts
    scratch.write_range(_BASES, 0, bases)
    # A file without vertices has faces that name some; the stage that reads them says so.
    lows = [one["low"] for one in results.values()] or [[0.0] * 3]
    highs = [one["high"] for one in results.values()] or [[0.0] * 3]
    write_globals(
        scratch,
        tile_starts=starts.tolist(),
        low=np.min(lows, axis=0).tolist(),
        high=np.max(highs, axis=0).tolist(),
    )


def run_number(scratch: Scratch, chunk: int) -> dict[str, Any]:
    """Number the vertices of a chunk anew and write their positions in the order of the tiles."""
    plan = load_plan(scratch)
    first = plan.vertex_chunks[chunk][0]
    positions = _read_vertices(plan, chunk)
    labels = _label(plan, positions)
    counts = tile_cut.count_labels(labels, plan.n_tiles)
    bases = _read_row(scratch, _BASES, chunk, plan.n_tiles)
    numbers, order, ordered = tile_cut.sort_by_label(labels, positions, first, counts, bases)
    del positions, labels
    scratch.write_range(_NUMBERS, first * numbers.itemsize, numbers)
    places = np.concatenate(([0], np.cumsum(counts))).tolist()
    for name, values in ((_OLD, order), (_POSITIONS, ordered)):
        size = values[:1].nbytes
        scratch.write_ranges(
            name,
            (
                (int(bases[tile]) * size, values[places[tile] : places[tile + 1]])
                for tile in np.flatnonzero(counts).tolist()
            ),
        )
    return {"vertices": len(numbers)}


def run_faces(scratch: Scratch, chunk: int) -> dict[str, Any]:
    """Write the faces of a chunk, sorted by tile."""
    plan = load_plan(scratch)
    polygons, first, place = plan.face_chunks[chunk]
    source = sources.open_source(plan.source)
    triangles = source.read_triangles(
        FaceChunk((polygons[0], polygons[1]), first, (place[0], place[1]))
    )
    if first + len(triangles) > LARGEST_NUMBER:
        raise TooLargeError(
            f"the mesh has more triangles than the {LARGEST_NUMBER:,} that can be numbered",
            where=f"face {polygons[1] - 1}",
            hint="cut it into parts",
        )
    triangles = np.ascontiguousarray(triangles, dtype=np.uint32)
    n_triangles = len(triangles)
    ids = tile_cut.renumber(triangles, scratch.array(_NUMBERS, np.uint32))
    del triangles
    records, offsets = tile_cut.group_faces(ids, first, tile_ranges(scratch))
    with open(scratch.path / _FACES / f"{chunk}.u4", "wb") as file:
        file.write(records.data)
    scratch.write_range(_OFFSETS, chunk * offsets.nbytes, offsets)
    return {"triangles": n_triangles, "records": len(records)}


def reduce_faces(scratch: Scratch) -> None:
    """Make ``n_triangles``."""
    n_triangles = sum(one["triangles"] for one in scratch.results("faces").values())
    if not n_triangles:
        raise no_faces_error()
    write_globals(scratch, n_triangles=n_triangles)


def run_weld(scratch: Scratch, tile: int) -> dict[str, Any]:
    """Find vertices of a tile at one position, among those that are corners of faces."""
    start, stop = tile_range(scratch, tile)
    n_own = stop - start
    if not n_own:
        return {"used": 0, "welded": 0}
    positions = read_positions(scratch, start, stop)
    if sources.open_source(load_plan(scratch).source).are_corners:
        n_used = n_own
        back, n_welded = measure_back(positions)
    else:
        used = tile_cut.mark_own(tile_records(scratch, tile), start, n_own)
        n_used = int(np.count_nonzero(used))
        first, n_welded = first_alike(positions.astype(np.float64, copy=False), used)
        back = np.arange(n_own, dtype=np.uint32) - first.view(np.uint32)
    if n_welded:
        scratch.write_range(_BACK, start * back.itemsize, back)
    return {"used": n_used, "welded": n_welded}


def reduce_weld(scratch: Scratch) -> None:
    """Make ``n_welded``, vertices that equal an earlier one."""
    results = scratch.results("weld").values()
    write_globals(scratch, n_welded=sum(one["welded"] for one in results))


def _read_vertices(plan: TilePlan, chunk: int) -> NDArray[Any]:
    """The positions of a chunk, as the file stores them."""
    start, stop = plan.vertex_chunks[chunk]
    rows = sources.open_source(plan.source).read_vertices(start, stop)
    return np.ascontiguousarray(rows, dtype=plan.dtype)


def _label(plan: TilePlan, positions: NDArray[Any]) -> Numbers:
    """The tile of each position (n, 3)."""
    axes = np.array(plan.split_axis, dtype=np.uint64)
    return tile_cut.label_positions(positions, axes, np.array(plan.split_at, dtype=np.float64))


def _read_row(scratch: Scratch, name: str, row: int, columns: int) -> Longs:
    values: Longs = scratch.read_range(name, np.int64, row * columns, (row + 1) * columns)
    return values


def _find_records(scratch: Scratch, tile: int) -> Iterator[tuple[int, int, int]]:
    """Chunk, first record and the one behind the last, of all chunks with faces of a tile."""
    plan = load_plan(scratch)
    offsets = scratch.array(_OFFSETS, np.int64, plan.n_tiles + 1)
    starts, stops = offsets[:, tile].tolist(), offsets[:, tile + 1].tolist()
    for chunk, (start, stop) in enumerate(zip(starts, stops, strict=True)):
        if stop > start:
            yield chunk, start, stop
