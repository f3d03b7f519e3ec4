"""Normals that a file stores for its vertices, computed anew where faces moved."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from msal_cli.tiles.cut import tile_range, tile_records, weld_numbers
from msal_cli.tiles.halo import other_vertices, read_positions
from msal_cli.tiles.join import MOVED
from msal_cli.tiles.vertex_data import STORED_NORMALS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from msal_cli.arrays import Floats, Ints
    from msal_cli.tiles.part_files import TileMesh
    from msal_cli.tiles.scratch import Scratch


def renew_normals(
    scratch: Scratch, tile: int, mesh: TileMesh, moved: Floats, origin: Floats
) -> Floats:
    """New normals (count, 3) of a tile's vertices, as the codecs for whole files compute them; NaN
    for those that are kept.

    They come from all triangles of the file, useless ones too, and vertices that are not welded.

    Parameters
    ----------
    mesh, moved : the tile and its halo, and the new positions (n, 3) of its vertices.
    origin : (3,) of the whole mesh; new positions in file units are in scratch already.
    """
    from msal_cli.kernels.geometry import regrouped_normals
    from msal_cli.kernels.halos import relabel
    from msal_cli.kernels.welding import scatter

    first, stop = tile_range(scratch, tile)
    count = stop - first
    records = tile_records(scratch, tile)
    others = other_vertices(records, first, count)
    numbers = np.arange(count + len(others), dtype=np.int32)
    faces = relabel(records, first, numbers[:count], others, numbers[count:])
    del records
    old = np.concatenate(
        [read_positions(scratch, slice(first, stop)), read_positions(scratch, others)]
    )
    place = _find(mesh, weld_numbers(scratch, others))
    is_used = np.ones(len(mesh.ids), dtype=bool)
    others_new = scatter(mesh.vertices, moved, is_used, place, origin, old[count:])
    placed = scratch.read_range(MOVED, np.float64, first, stop, 3)
    new = np.concatenate([placed, others_new])
    del placed
    # Those of others are not looked at: zero is no normal.
    stored = np.zeros((len(numbers), 3))
    stored[:count] = scratch.read_range(STORED_NORMALS, np.float64, first, stop, 3)
    renewed, is_new = regrouped_normals(old, new, faces, faces, stored)
    return np.where(is_new[:count, None], renewed[:count], np.nan)


def _find(mesh: TileMesh, ids: NDArray[np.uint32]) -> Ints:
    """Vertices of the halo with these numbers, (k,); -1 for those that no usable face has."""
    halo = np.flatnonzero(~mesh.own_vertices)
    known = mesh.ids[halo]
    order = np.argsort(known)
    at = np.searchsorted(known[order], ids).clip(max=max(len(order) - 1, 0))
    if not len(order):
        return np.full(len(ids), -1, dtype=np.int32)
    found = halo[order][at]
    places: Ints = np.where(mesh.ids[found] == ids, found, -1).astype(np.int32)
    return places
