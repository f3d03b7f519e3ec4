"""Stages ``wind`` and ``turn``: faces of the whole mesh wound one way, where some are not.

In memory ``kernels.components.faces_to_flip`` turns the lesser number of faces of each patch.  Here
the tiles find pieces of patches; pieces that have a face in common are of one patch.  The tile
decides for a patch that no other tile shares, else the reduction, which sees no faces but those
that tiles share.  Files in the folder of a tile, besides those of ``part_files``:

    pieces.npy     (m,) int32, for faces with a vertex of the tile the number of their piece; -1
                   where the tile decided
    against.npy    (m,) bool, whether a face is wound against the first one of its piece; where the
                   tile decided, whether it is to be turned
    shared.npy     (k, 3) uint32, of shared faces: number of the triangle, piece, whether against
    figures.npy    (pieces, 4) int64, see ``_Figures``
    decisions.npy  (pieces,) uint8, written by the reduction
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from msal_cli.kernels import windings
from msal_cli.kernels.halos import shared_faces
from msal_cli.tiles.part_files import TURNED, TileMesh, load_array, save_array
from msal_cli.tiles.plan import read_globals, write_globals

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from msal_cli.arrays import Flags
    from msal_cli.tiles.scratch import Scratch

_PIECES, _AGAINST, _SHARED = "pieces.npy", "against.npy", "shared.npy"
_FIGURES, _DECISIONS = "figures.npy", "decisions.npy"

_TURN_AGAINST, _TURN_OTHERS, _TURN_NONE = range(3)
"""Decisions for a piece: which of its faces are to be turned."""


class _Figures(NamedTuple):
    """Columns of ``figures.npy``: the lowest triangle of a piece, how many faces the tile has of it
    and how many of these are against that one, and whether it has no consistent winding."""

    lowest: NDArray[np.int64]
    size: NDArray[np.int64]
    against: NDArray[np.int64]
    torn: NDArray[np.int64]


def is_needed(scratch: Scratch) -> bool:
    """Whether any faces are wound against each other."""
    return bool(read_globals(scratch)["counts"]["inconsistent"])


def run_wind(scratch: Scratch, tile: int) -> dict[str, Any]:
    """Find the pieces of patches in a tile, and decide for patches that no other tile shares."""
    if not scratch.result("prepare", tile)["own"]:
        return {"pieces": 0, "unorientable": 0}
    folder = scratch.tile_folder(tile)
    mesh = TileMesh.load(folder)
    own = mesh.own_vertices
    roots, against, torn = windings.patch_faces(mesh.faces, mesh.links, own)
    shared = shared_faces(mesh.faces, own)
    shared_roots = np.unique(roots[shared])
    numbers = np.full(len(roots), -1, dtype=np.int32)
    numbers[shared_roots] = np.arange(len(shared_roots))
    pieces = numbers[roots]
    size = np.bincount(roots[mesh.own_faces], minlength=len(roots))
    n_against = np.bincount(roots[mesh.own_faces & against], minlength=len(roots))
    figures = _Figures(*(one.astype(np.int64) for one in (mesh.triangles, size, n_against, torn)))
    rows = np.stack([one[shared_roots] for one in figures], axis=1)
    links = [mesh.triangles[shared], pieces[shared], against[shared]]
    is_decided = pieces < 0
    majority = 2 * n_against > size
    turned = (against ^ majority[roots]) & ~torn
    save_array(folder / _PIECES, pieces)
    save_array(folder / _AGAINST, np.where(is_decided, turned, against))
    save_array(folder / _SHARED, np.stack([one.astype(np.uint32) for one in links], axis=1))
    save_array(folder / _FIGURES, rows)
    is_root = roots == np.arange(len(roots))
    n_torn = int(np.count_nonzero(torn & is_decided & is_root))
    return {"pieces": len(shared_roots), "unorientable": n_torn}


def reduce_wind(scratch: Scratch) -> None:
    """Decide for the patches that tiles share, and count those that no winding suits."""
    results = scratch.results("wind")
    n_torn = sum(one["unorientable"] for one in results.values())
    counts = {tile: one["pieces"] for tile, one in results.items() if one["pieces"]}
    if counts:
        starts = np.concatenate([[0], np.cumsum(list(counts.values()))])
        folders = [scratch.tile_folder(tile) for tile in counts]
        decisions, n_shared_torn = _decide(folders, starts)
        n_torn += n_shared_torn
        for folder, start, stop in zip(folders, starts[:-1], starts[1:], strict=True):
            save_array(folder / _DECISIONS, decisions[start:stop])
    known = read_globals(scratch)["counts"]
    write_globals(scratch, counts=known | {"unorientable": n_torn})


def run_turn(scratch: Scratch, tile: int) -> dict[str, Any]:
    """Turn the faces of a tile and its halo; the result counts those of the tile."""
    if not scratch.result("prepare", tile)["own"]:
        return {"turned": 0}
    folder = scratch.tile_folder(tile)
    mesh = TileMesh.load_unturned(folder)
    is_near = mesh.own_vertices[mesh.faces].any(axis=1)
    flips = np.zeros(len(mesh.faces), dtype=bool)
    flips[is_near] = _read_flips(folder, np.flatnonzero(is_near))
    far = np.flatnonzero(~is_near)
    starts = np.array(read_globals(scratch)["tile_starts"])
    # The tile of any corner has the face among those near to it.
    owners = np.searchsorted(starts, mesh.ids[mesh.faces[far, 0]], side="right") - 1
    for owner in np.unique(owners):
        chosen = far[owners == owner]
        other = scratch.tile_folder(int(owner))
        places = np.searchsorted(load_array(other / "triangles.npy"), mesh.triangles[chosen])
        flips[chosen] = _read_flips(other, places)
    save_array(folder / TURNED, np.where(flips[:, None], mesh.faces[:, ::-1], mesh.faces))
    return {"turned": int(np.count_nonzero(flips & mesh.own_faces))}


def reduce_turn(scratch: Scratch) -> None:
    """Count the faces that were turned."""
    turned = sum(one["turned"] for one in scratch.results("turn").values())
    counts = read_globals(scratch)["counts"]
    write_globals(scratch, counts=counts | {"turned": turned})


def _decide(folders: list[Path], starts: NDArray[np.int64]) -> tuple[NDArray[np.uint8], int]:
    """The decision for each piece of all tiles, and how many patches have no consistent winding;
    the pieces of a folder begin at its start."""
    shared = []
    for folder, start in zip(folders, starts[:-1], strict=True):
        rows = load_array(folder / _SHARED).astype(np.int64)
        rows[:, 1] += start
        shared.append(rows)
    rows = np.concatenate(shared)
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    same = rows[1:, 0] == rows[:-1, 0]
    one, other = rows[:-1][same], rows[1:][same]
    roots, parity, torn = windings.join_pieces(
        int(starts[-1]),
        one[:, 1].astype(np.int32),
        other[:, 1].astype(np.int32),
        one[:, 2] != other[:, 2],
    )
    columns = np.concatenate([load_array(folder / _FIGURES) for folder in folders]).T
    figures = _Figures(*columns)
    count = len(roots)
    is_torn = np.zeros(count, dtype=bool)
    np.logical_or.at(is_torn, roots, torn | figures.torn.astype(bool))
    # Relative to the lowest face of the whole patch, as in memory.
    lowest = np.full(count, np.iinfo(np.int64).max)
    np.minimum.at(lowest, roots, figures.lowest)
    leads = figures.lowest == lowest[roots]
    lead_parity = np.zeros(count, dtype=bool)
    lead_parity[roots[leads]] = parity[leads]
    opposed = parity ^ lead_parity[roots]
    against = np.where(opposed, figures.size - figures.against, figures.against)
    total, total_against = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    np.add.at(total, roots, figures.size)
    np.add.at(total_against, roots, against)
    majority = 2 * total_against > total
    decisions = np.where(opposed ^ majority[roots], _TURN_OTHERS, _TURN_AGAINST)
    decisions[is_torn[roots]] = _TURN_NONE
    is_root = roots == np.arange(count)
    return decisions.astype(np.uint8), int(np.count_nonzero(is_torn & is_root))


def _read_flips(folder: Path, places: NDArray[np.intp]) -> Flags:
    """Whether the faces of a tile at these places are to be turned."""
    pieces = load_array(folder / _PIECES)[places]
    against: Flags = load_array(folder / _AGAINST)[places]
    if not (pieces >= 0).any():
        return against
    decisions = load_array(folder / _DECISIONS)[pieces]
    flips: Flags = np.where(
        pieces < 0, against, (against ^ (decisions == _TURN_OTHERS)) & (decisions != _TURN_NONE)
    )
    return flips
