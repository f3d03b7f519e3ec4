"""What changed, measured tile by tile, and the figures of a record that come of it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from msal_cli.analysis import harm
from msal_cli.analysis.enclosure import MOST_PARTS, describe_turned
from msal_cli.analysis.measures import (
    DisplacementStatistics,
    NormalStatistics,
    SurfaceChange,
    is_negative,
)
from msal_cli.job import changes
from msal_cli.job.records import NormalChange
from msal_cli.mesh import Defects
from msal_cli.tiles import part_volumes
from msal_cli.tiles.part_files import save_array
from msal_cli.tiles.plan import load_plan, read_globals
from msal_cli.tiles.representative import read_settings

if TYPE_CHECKING:
    from msal_cli.arrays import Floats
    from msal_cli.mesh import Mesh
    from msal_cli.tiles.part_files import TileMesh
    from msal_cli.tiles.scratch import Scratch

_LENGTHS = "lengths.npy"
_KEY_BITS = np.uint64(42)
"""Bits of a length that do not count when lengths are counted: 10 of its fraction are left, so that
those that count alike differ by 0.1 % at most."""


def measure_tile(
    scratch: Scratch, tile: int, tile_mesh: TileMesh, before: Mesh, moved: Floats
) -> dict[str, Any]:
    """What a tile contributes to the figures of the whole.

    Parameters
    ----------
    before : the mesh of the tile and its halo, ``tile_mesh``.
    moved : (n, 3) its new positions.
    """
    from msal_cli.kernels.geometry import distances
    from msal_cli.kernels.surface_change import surface_figures

    lengths = distances(before.vertices, moved)[tile_mesh.own_vertices]
    own_faces = np.ascontiguousarray(tile_mesh.faces[tile_mesh.own_faces])
    if _counts_by_part(defects_of(scratch)):
        part_volumes.save_figures(scratch.tile_folder(tile), tile_mesh, moved)
    keys, counts = _count_lengths(lengths)
    save_array(scratch.tile_folder(tile) / _LENGTHS, np.stack([keys, counts]))
    return {
        "vertices": len(lengths),
        "sum": float(lengths.sum()),
        "squares": float((lengths * lengths).sum()),
        "max": float(lengths.max()),
        "moved": int(np.count_nonzero(lengths)),
        "surface": surface_figures(before.vertices, moved, own_faces).tolist(),
        "folds": _count_folds(scratch, tile_mesh, before),
    }


def sample_fidelity(scratch: Scratch, tile_mesh: TileMesh, fidelity: Floats | None) -> list[float]:
    """lambda (n,) of the first sweep at every k-th vertex of the whole mesh, of those of a tile."""
    if fidelity is None:
        return []
    known = read_globals(scratch)
    n_vertices = known["used_vertices"] if known["n_welded"] else known["tile_starts"][-1]
    step = changes.fidelity_step(n_vertices)
    ids = tile_mesh.ids[tile_mesh.own_vertices]
    is_chosen = scratch.array("old.u4", np.uint32)[ids] % np.uint32(step) == 0
    sample: list[float] = fidelity[tile_mesh.own_vertices][is_chosen].tolist()
    return sample


def is_ruled_by_spike(scratch: Scratch) -> bool:
    """See ``job.changes.is_ruled_by_spike``."""
    tiles = _last_measures(scratch).values()
    return changes.is_ruled_by_spike(
        np.array([value for one in tiles for value in one["fidelity"]])
    )


def _count_lengths(lengths: Floats) -> tuple[Any, Any]:
    """Leading bits (k,) of the lengths above zero, ascending, and how many have them."""
    bits = lengths[lengths > 0.0].view(np.uint64) >> _KEY_BITS
    if not len(bits):
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    keys = bits.view(np.int64)
    least = int(keys.min())
    counts = np.bincount(keys - least)
    used = np.flatnonzero(counts)
    return used + least, counts[used]


def _count_folds(scratch: Scratch, tile_mesh: TileMesh, before: Mesh) -> int:
    """Folded faces among those of the tile that are looked at."""
    step = harm.sampling_step(read_globals(scratch)["counts"]["faces"])
    chosen = tile_mesh.own_faces & (tile_mesh.triangles % np.uint32(step) == 0)
    return harm.count_folds(before, np.ascontiguousarray(tile_mesh.faces[chosen]))


# Figures of the whole


def defects_of(scratch: Scratch) -> Defects:
    """What was found in the mesh, and put aside."""
    known = read_globals(scratch)
    counts = known["counts"]
    n_file = known["tile_starts"][-1]
    return Defects(
        welded_vertices=known["n_welded"],
        unreferenced_vertices=n_file - known["n_welded"] - known["used_vertices"],
        degenerate_faces=known["repeated_faces"] + counts["flat"],
        duplicate_faces=counts["duplicates"],
        boundary_edges=counts["boundary"],
        non_manifold_edges=counts["non_manifold"],
        inconsistent_edges=counts["inconsistent"],
        turned_faces=counts["turned"],
        unorientable_parts=counts["unorientable"],
        components=counts["components"],
    )


def changes_of(scratch: Scratch) -> changes.Measured:
    """What ``job.changes.measure`` gives of the same mesh in memory, but for the noise: fields of
    the record, warnings and the harm.

    The sums differ in their last digits, the 95th percentile by 0.05 % at most.  Of a mesh from
    which faces were left out other faces are looked at for folds.
    """
    defects = defects_of(scratch)
    edge = read_globals(scratch)["known"]["mean edge length"]
    tiles = _last_measures(scratch)
    statistics = _combine_lengths(scratch, tiles)
    surface = _combine_surfaces(tiles)
    objection = defects.volume_objection
    surface, n_turned = _turn_outwards(scratch, defects, surface)
    warnings = []
    if n_turned:
        warnings.append((changes.INSIDE_OUT, describe_turned(n_turned, defects.components)))
    n_faces = read_globals(scratch)["counts"]["faces"]
    n_folds = sum(one["folds"] for one in tiles.values()) * harm.sampling_step(n_faces)
    found = harm.judge_change(surface, n_faces, lambda: n_folds, has_volume=not objection)
    if found is not None:
        warnings.append((found.code, changes.damage_words(found)))
    normals = surface.normals
    fields = {
        "displacement": changes.displacement_field(statistics, edge),
        "normal_change": NormalChange(
            normals.mean_angular_error_deg, normals.max_angular_error_deg
        ),
        "flipped_faces": normals.flipped_faces,
        "inside_out": n_turned > 0,
        "volume": changes.volume_changed(
            surface.volume_before, surface.volume_after, surface.area_before, objection
        ),
        "area": changes.area_changed(surface.area_before, surface.area_after),
        "seam_gap": max((one["seam_gap"] for one in tiles.values()), default=0.0),
    }
    known = read_settings(load_plan(scratch))
    if known.lock:
        fields["locked_vertices"] = _count(scratch, "locked")
    if known.max_move is not None:
        fields["clamped_vertices"] = _count(scratch, "clamped")
    return changes.Measured(fields, tuple(warnings), found)


def _counts_by_part(defects: Defects) -> bool:
    """Whether the volume is that of several parts, each of which may be inside out."""
    return not defects.volume_objection and 1 < defects.components <= MOST_PARTS


def _turn_outwards(
    scratch: Scratch, defects: Defects, surface: SurfaceChange
) -> tuple[SurfaceChange, int]:
    """See ``part_volumes.turn_outwards``."""
    if _counts_by_part(defects):
        folders = [scratch.tile_folder(tile) for tile in _last_measures(scratch)]
        return part_volumes.turn_outwards(folders, defects.components, surface)
    if defects.volume_objection or not is_negative(surface.volume_before, surface.area_before):
        return surface, 0
    turned = replace(
        surface, volume_before=-surface.volume_before, volume_after=-surface.volume_after
    )
    return turned, defects.components


def _last_measures(scratch: Scratch) -> dict[int, dict[str, Any]]:
    """What the tiles measured in the last round of the method, by tile."""
    results = _last_results(scratch)
    return {tile: one["measures"] for tile, one in results.items() if "measures" in one}


def _last_results(scratch: Scratch) -> dict[int, dict[str, Any]]:
    number = 0
    while scratch.finished(f"denoise-{number + 1}"):
        number += 1
    return scratch.results(f"denoise-{number}")


def _count(scratch: Scratch, name: str) -> int:
    """How many vertices of all tiles, those without faces too, are ``locked`` or ``clamped``."""
    results = _last_results(scratch).values()
    return sum(one.get("measures", one).get(name, 0) for one in results)


def _combine_lengths(scratch: Scratch, tiles: dict[int, dict[str, Any]]) -> DisplacementStatistics:
    n_vertices = sum(one["vertices"] for one in tiles.values())
    n_moved = sum(one["moved"] for one in tiles.values())
    counts = np.zeros(1 << (64 - int(_KEY_BITS)), dtype=np.int64)
    for tile in tiles:
        keys, own = np.load(scratch.tile_folder(tile) / _LENGTHS)
        counts[keys] += own
    # The very rank of ``analysis.measures.distance_statistics``; vertices that stayed come first.
    rank = min(n_vertices - 1, int(np.ceil(0.95 * n_vertices)) - 1) - (n_vertices - n_moved)
    longest = max(one["max"] for one in tiles.values())
    return DisplacementStatistics(
        mean=sum(one["sum"] for one in tiles.values()) / n_vertices,
        rms=float(np.sqrt(sum(one["squares"] for one in tiles.values()) / n_vertices)),
        p95=0.0 if rank < 0 else min(_find_length(counts, rank), longest),
        max=longest,
        moved_vertices=n_moved,
    )


def _find_length(counts: Any, rank: int) -> float:
    """The middle of the lengths that count like the one of this rank."""
    key = int(np.searchsorted(np.cumsum(counts), rank, side="right"))
    ends = (np.array([key, key + 1], dtype=np.uint64) << _KEY_BITS).view(np.float64)
    return float(ends.mean())


def _combine_surfaces(tiles: dict[int, dict[str, Any]]) -> SurfaceChange:
    from msal_cli.kernels import surface_change as core

    rows = np.array([one["surface"] for one in tiles.values()])
    total = rows.sum(axis=0)
    return SurfaceChange(
        area_before=float(total[core.DOUBLED_AREA_BEFORE] / 2.0),
        area_after=float(total[core.DOUBLED_AREA_AFTER] / 2.0),
        volume_before=float(total[core.SIXFOLD_VOLUME_BEFORE] / 6.0),
        volume_after=float(total[core.SIXFOLD_VOLUME_AFTER] / 6.0),
        normals=NormalStatistics(
            mean_angular_error_deg=float(
                np.degrees(total[core.ANGLES] / max(total[core.COMPARED], 1.0))
            ),
            max_angular_error_deg=float(np.degrees(rows[:, core.LARGEST_ANGLE].max())),
            flipped_faces=int(total[core.FLIPPED]),
        ),
    )
