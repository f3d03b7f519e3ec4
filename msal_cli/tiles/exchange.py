"""What tiles give each other between two rounds: rows of saved arrays, from those that own them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.tiles import part_files
from msal_cli.tiles.plan import read_globals

if TYPE_CHECKING:
    from msal_cli.arrays import Floats
    from msal_cli.tiles.part_files import TileMesh
    from msal_cli.tiles.scratch import Scratch


def load_saved(
    scratch: Scratch, tile: int, mesh: TileMesh, round_number: int
) -> dict[str, NDArray[Any]]:
    """What a tile saved in a round, with the rows of its halo as the tiles have them that own them.

    That is of the arrays that ``kernels.whole.Pending.exchanged`` names.
    """
    saved = part_files.load_state(scratch.tile_folder(tile), round_number)
    for name in scratch.result(f"denoise-{round_number}", tile)["pending"]["exchanged"]:
        saved[name] = _replace_halo(scratch, mesh, round_number, name, saved[name])
    return saved


def _replace_halo(
    scratch: Scratch, mesh: TileMesh, round_number: int, name: str, rows: Floats
) -> Floats:
    """A copy of ``rows`` (n, 3) in which only those of own vertices are as they were."""
    starts = np.array(read_globals(scratch)["tile_starts"], dtype=np.int64)
    places = np.flatnonzero(~mesh.own_vertices)
    wanted = mesh.ids[places]
    owners = np.searchsorted(starts, wanted, side="right") - 1
    result = np.array(rows)
    for owner in np.unique(owners):
        folder = scratch.tile_folder(int(owner))
        other = part_files.TileMesh.load_unturned(folder)
        own = np.flatnonzero(other.own_vertices)
        is_there = owners == owner
        # Within a tile numbers rise as in the file, and so do those of its own vertices.
        at = own[np.searchsorted(other.ids[own], wanted[is_there])]
        result[places[is_there]] = part_files.load_state(folder, round_number)[name][at]
    return result
