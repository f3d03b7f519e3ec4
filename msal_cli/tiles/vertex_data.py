"""Stages ``values`` and ``pins``: what a file stores for its vertices, in the order of tiles, and
what of it keeps vertices near their place.

    values-K.f8   (n,) the K-th property that an option names
    stored.f8     (n, 3) stored normals, where the file has such
    held.b1       (n,) vertices that --lock pins by a property, with all that coincide with them
    trust.f8      (n,) trust from 0 to 1 by --weights, of coincident vertices the largest

The stages are left out where there is nothing to read.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from msal_cli.job.constraints import Constraints, Lock, parse_length, parse_lock, require_trust
from msal_cli.tiles import source as sources
from msal_cli.tiles.cut import is_welded, tile_range, weld_numbers
from msal_cli.tiles.plan import load_plan, read_globals, write_globals
from msal_cli.tiles.representative import read_settings

if TYPE_CHECKING:
    from msal_cli.arrays import Flags, Floats
    from msal_cli.job.settings import Settings
    from msal_cli.mesh import Mesh
    from msal_cli.tiles.part_files import TileMesh
    from msal_cli.tiles.scratch import Scratch

STORED_NORMALS = "stored.f8"

_HELD, _TRUST = "held.b1", "trust.f8"


def create_arrays(scratch: Scratch) -> None:
    """Create the arrays that the stages fill."""
    plan = load_plan(scratch)
    settings = read_settings(plan)
    n = plan.n_vertices
    has_normals = sources.open_source(plan.source).has_normals
    names = _property_names(settings)
    for at in range(len(names)):
        scratch.create(_values_name(at), np.float64, (n,))
    if has_normals:
        scratch.create(STORED_NORMALS, np.float64, (n, 3))
    if any(_property_locks(settings)):
        scratch.create(_HELD, np.bool_, (n,))
    if settings.weights is not None:
        scratch.create(_TRUST, np.float64, (n,))
    write_globals(scratch, vertex_properties=names, has_normals=has_normals)


def has_values(scratch: Scratch) -> bool:
    """Whether anything is to be read of the vertices but positions."""
    known = read_globals(scratch)
    return bool(known["vertex_properties"] or known["has_normals"])


def has_pins(scratch: Scratch) -> bool:
    """Whether properties of vertices keep any near their place."""
    return bool(read_globals(scratch)["vertex_properties"])


def run_values(scratch: Scratch, chunk: int) -> dict[str, Any]:
    """Write properties and normals of a chunk of vertices in the order of tiles.

    The result has of each property whether all values are in single precision, the largest one,
    and the first vertex where it is not finite, None if there is none.
    """
    plan, known = load_plan(scratch), read_globals(scratch)
    start, stop = plan.vertex_chunks[chunk]
    mesh = sources.open_source(plan.source)
    numbers = scratch.read_range("numbers.u4", np.uint32, start, stop)
    properties = []
    for at, name in enumerate(known["vertex_properties"]):
        values = mesh.read_property(name, start, stop)
        scratch.write_rows(_values_name(at), numbers, values)
        finite = np.isfinite(values)
        bad = None if finite.all() else start + int(np.argmin(finite))
        largest = float(values.max(initial=0.0)) if bad is None else 0.0
        properties.append({"single": Lock.is_single(values), "largest": largest, "bad": bad})
    if known["has_normals"]:
        scratch.write_rows(STORED_NORMALS, numbers, mesh.read_normals(start, stop))
    return {"properties": properties}


def reduce_values(scratch: Scratch) -> None:
    """Check the property of --weights, and keep its largest value.

    Raises ContentError if it means nothing as trust.
    """
    results = [one["properties"] for _, one in sorted(scratch.results("values").items())]
    names = read_globals(scratch)["vertex_properties"]
    columns = [[one[at] for one in results] for at in range(len(names))]
    weights = read_settings(load_plan(scratch)).weights
    largest = 0.0
    if weights is not None:
        column = columns[names.index(weights)]
        bad = [one["bad"] for one in column if one["bad"] is not None]
        largest = max(one["largest"] for one in column)
        require_trust(weights, min(bad, default=None), largest)
    singles = [all(one["single"] for one in column) for column in columns]
    write_globals(scratch, are_single=singles, largest_weight=largest)


def run_pins(scratch: Scratch, tile: int) -> dict[str, Any]:
    """Write which vertices of a tile are pinned and how much each is trusted.

    The result counts pinned ones that no face has.
    """
    known = read_globals(scratch)
    settings = read_settings(load_plan(scratch))
    first, stop = tile_range(scratch, tile)
    ids = np.arange(first, stop, dtype=np.uint32)
    place = (weld_numbers(scratch, ids) - np.uint32(first)).astype(np.intp)
    names = known["vertex_properties"]

    def read(name: str) -> Floats:
        values: Floats = scratch.read_range(
            _values_name(names.index(name)), np.float64, first, stop
        )
        return values

    if scratch.has(_HELD):
        held = np.zeros(stop - first, dtype=bool)
        for lock in _property_locks(settings):
            flags = lock.select(read(lock.name), known["are_single"][names.index(lock.name)])
            np.logical_or.at(held, place, flags)
        scratch.write_range(_HELD, first, held)
    if settings.weights is not None:
        trust = np.zeros(stop - first)
        values = read(settings.weights) / known["largest_weight"]
        np.maximum.at(trust, place, np.clip(values, 0.0, 1.0))
        scratch.write_range(_TRUST, first * trust.itemsize, trust)
    return {}


def build_constraints(scratch: Scratch, tile_mesh: TileMesh, mesh: Mesh) -> Constraints | None:
    """What keeps vertices of a tile and its halo near their place, see ``job.constraints``; None if
    no option sets any."""
    settings = read_settings(load_plan(scratch))
    if (settings.max_move, settings.lock, settings.weights) == (None, (), None):
        return None
    held: Flags | None = None
    if settings.lock:
        held = np.zeros(len(tile_mesh.ids), dtype=bool)
        if scratch.has(_HELD):
            held |= scratch.array(_HELD, np.bool_)[tile_mesh.ids]
        if None in _parse_locks(settings):
            held |= tile_mesh.links.boundary
    trust: Floats | None = None
    if settings.weights is not None:
        trust = np.array(scratch.array(_TRUST, np.float64)[tile_mesh.ids])
    limit = None
    if settings.max_move is not None:
        limit = parse_length(settings.max_move).in_units(mesh.mean_edge_length)
    return Constraints(mesh.with_constraints(held, trust), held, limit)


def count_held_strays(scratch: Scratch, tile: int, tile_mesh: TileMesh | None) -> int:
    """Pinned vertices of a tile that no face has: they count where nothing in the mesh is welded,
    as in memory."""
    if is_welded(scratch) or not scratch.has(_HELD):
        return 0
    first, stop = tile_range(scratch, tile)
    held = scratch.read_range(_HELD, np.bool_, first, stop)
    if tile_mesh is not None:
        held[tile_mesh.ids[tile_mesh.own_vertices] - np.uint32(first)] = False
    return int(np.count_nonzero(held))


def _parse_locks(settings: Settings) -> list[Lock | None]:
    return [parse_lock(one) for one in settings.lock]


def _property_locks(settings: Settings) -> list[Lock]:
    return [one for one in _parse_locks(settings) if one is not None]


def _property_names(settings: Settings) -> list[str]:
    names = [one.name for one in _property_locks(settings)]
    if settings.weights is not None:
        names.append(settings.weights)
    return list(dict.fromkeys(names))


def _values_name(at: int) -> str:
    return f"values-{at}.f8"
