"""The stages ``prepare``, which makes the mesh of each tile and its halo, and ``denoise-0``,
``denoise-1`` ..., which run the method on it.

``prepare`` counts what the record says of the mesh.  An edge belongs to the tile of its vertex of
lower number in the file, a triangle to that of its first corner, so that each counts once.  A
round of ``denoise`` ends where the method needs a number of the whole mesh (``kernels.whole``); the
reduction makes it of what all tiles contribute, and the next round goes on from there.  The last
round of a tile writes its new positions and measures what changed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from msal_cli import methods
from msal_cli.auto import NONE
from msal_cli.errors import InternalError
from msal_cli.kernels import exact_sum
from msal_cli.kernels.whole import Pending, Whole, combine
from msal_cli.mesh import Mesh
from msal_cli.tiles import borders, measures, new_normals, part_files, vertex_data
from msal_cli.tiles.cut import tile_range, weld_numbers
from msal_cli.tiles.exchange import load_saved
from msal_cli.tiles.halo import Part, assemble_part, read_positions
from msal_cli.tiles.join import MOVED, NORMALS
from msal_cli.tiles.part_files import TileMesh
from msal_cli.tiles.plan import load_plan, read_globals, write_globals
from msal_cli.tiles.representative import to_whole_units

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from msal_cli.arrays import Floats
    from msal_cli.job.constraints import Constraints
    from msal_cli.methods import Method, Result
    from msal_cli.tiles.scratch import Scratch

MEAN_EDGE_LENGTH = "mean edge length"
"""Key of this number among those of the whole mesh."""

_BLOCK_ROWS = 1 << 19

_COUNTS = ("faces", "duplicates", "flat", "boundary", "inconsistent", "non_manifold")


def run_prepare(scratch: Scratch, tile: int) -> dict[str, Any]:
    """Make the mesh of a tile and its halo; the result is what the tile contributes to the counts
    of the whole, ``own`` vertices first."""
    part = assemble_part(scratch, tile)
    if not part.own.any():
        return {"own": 0}
    mesh, n_duplicate = _connect(scratch, part)
    folder = scratch.tile_folder(tile)
    mesh.save(folder)
    return {
        "own": int(np.count_nonzero(mesh.own_vertices)),
        "faces": int(np.count_nonzero(mesh.own_faces)),
        "duplicates": n_duplicate,
        **_count_defects(mesh),
        "edges": _measure_edges(mesh),
        "parts": borders.save_links(folder, mesh),
    }


def reduce_prepare(scratch: Scratch) -> None:
    """Add counts and the mean edge length of the whole mesh to what all tasks know."""
    results = {tile: one for tile, one in scratch.results("prepare").items() if one["own"]}
    counts = {name: sum(one[name] for one in results.values()) for name in _COUNTS}
    folders = [scratch.tile_folder(tile) for tile in results]
    components = borders.join_parts(folders, [one["parts"] for one in results.values()])
    mean = exact_sum.combine_means(one["edges"] for one in results.values())
    n_vertices = load_plan(scratch).n_vertices
    scratch.create(MOVED, np.float64, (n_vertices, 3))
    if read_globals(scratch)["has_normals"]:
        scratch.create(NORMALS, np.float64, (n_vertices, 3))
    write_globals(
        scratch,
        counts=counts | {"components": components, "turned": 0, "unorientable": 0},
        known={MEAN_EDGE_LENGTH: mean},
    )


def run_denoise(scratch: Scratch, round_number: int, tile: int) -> dict[str, Any]:
    """Run the method on a tile as far as the numbers are known that it needs.

    The result is ``pending``, the key of a number and what the tile contributes to it; or
    ``measures``, once the new positions are written; or nothing, of a tile that no face has.
    """
    folder = scratch.tile_folder(tile)
    part_files.remove_state(folder, round_number - 2)
    if not scratch.result("prepare", tile)["own"]:
        _write_moved(scratch, tile, None, np.empty((0, 3)))
        if scratch.has(NORMALS):
            first, stop = tile_range(scratch, tile)
            _write_rows(scratch, NORMALS, tile, np.full((stop - first, 3), np.nan))
        return {"locked": vertex_data.count_held_strays(scratch, tile, None)}
    tile_mesh = TileMesh.load(folder)
    saved = load_saved(scratch, tile, tile_mesh, round_number - 1) if round_number else {}
    mesh = _build_mesh(scratch, tile_mesh, saved)
    constraints = vertex_data.build_constraints(scratch, tile_mesh, mesh)
    if constraints is not None:
        mesh = constraints.mesh
    if round_number:
        part_files.load_normals(folder, mesh)
    try:
        method, result = _run_method(scratch, mesh)
    except Pending as pending:
        if not round_number:
            part_files.save_normals(folder, mesh)
        part_files.save_state(folder, round_number, pending.state, saved)
        waits = {"key": pending.key, "partial": pending.partial}
        return {"pending": {**waits, "exchanged": list(pending.exchanged)}}
    _check_result(method, mesh, result)
    moved, counts = result.vertices, {}
    if constraints is not None:
        counts = _count_constrained(scratch, tile, tile_mesh, constraints, moved)
        moved, _ = constraints.apply(moved)
    seam_gap = _write_moved(scratch, tile, tile_mesh, moved)
    figures = measures.measure_tile(scratch, tile, tile_mesh, mesh, moved)
    sample = measures.sample_fidelity(scratch, tile_mesh, result.fields.get("fidelity"))
    if scratch.has(NORMALS):
        mesh.release_normals()
        del mesh, constraints, result
        origin = np.array(read_globals(scratch)["origin"])
        normals = new_normals.renew_normals(scratch, tile, tile_mesh, moved, origin)
        _write_rows(scratch, NORMALS, tile, normals)
    return {"measures": figures | counts | {"fidelity": sample, "seam_gap": seam_gap}}


def reduce_denoise(scratch: Scratch, round_number: int) -> bool:
    """Make the number that all tiles wait for; False where they are finished."""
    results = scratch.results(f"denoise-{round_number}").values()
    pending = [one["pending"] for one in results if "pending" in one]
    if not pending:
        return False
    keys = {one["key"] for one in pending}
    if len(keys) > 1 or any("measures" in one for one in results):
        raise InternalError(f"tiles wait for different numbers of the whole mesh: {sorted(keys)}")
    number = combine([one["partial"] for one in pending])
    write_globals(scratch, known=read_globals(scratch)["known"] | {keys.pop(): number})
    return True


def find_method(scratch: Scratch) -> tuple[Method | None, dict[str, Any]]:
    """The method of the run, None where the mesh stays as it is, and all its parameters."""
    known = read_globals(scratch)
    choice = to_whole_units(known["choice"], known["known"][MEAN_EDGE_LENGTH])
    if choice["method"] == NONE:
        return None, {}
    return methods.find(choice["method"]), choice["parameters"]


# The mesh of a tile


def _connect(scratch: Scratch, part: Part) -> tuple[TileMesh, int]:
    """The mesh of a part, and how many duplicate faces of the tile were left out."""
    from msal_cli.kernels.connectivity import connectivity
    from msal_cli.kernels.welding import duplicate_faces

    faces, triangles, n_duplicate = part.faces, part.triangles, 0
    links = connectivity(len(part.ids), faces)
    if links.non_manifold_edges or links.inconsistent_edges:
        # Faces can only share all three vertices where some edge is crowded or twisted.
        duplicate = duplicate_faces(faces)
        if duplicate.any():
            n_duplicate = int(np.count_nonzero(part.own[faces[duplicate, 0]]))
            faces = np.ascontiguousarray(faces[~duplicate])
            triangles = triangles[~duplicate]
            links = connectivity(len(part.ids), faces)
    vertices = read_positions(scratch, part.ids)
    vertices -= np.array(read_globals(scratch)["origin"])
    own_faces = part.own[faces[:, 0]]
    mesh = TileMesh(vertices, faces, part.ids, triangles, part.own, own_faces, links)
    return mesh, n_duplicate


def _count_defects(mesh: TileMesh) -> dict[str, int]:
    """Edges of the tile that are not between two faces wound one way, and its flat faces."""
    from msal_cli.kernels import halos

    links, own = mesh.links, mesh.own_vertices
    edges = (0, 0, 0)
    # The rim of the halo is open, too.
    if links.non_manifold_edges or links.inconsistent_edges or (links.boundary & own).any():
        edges = halos.count_own_edges(mesh.faces, links.incidence, own)
    boundary, inconsistent, non_manifold = edges
    return {
        "boundary": boundary,
        "inconsistent": inconsistent,
        "non_manifold": non_manifold,
        "flat": halos.count_flat_faces(mesh.vertices, mesh.faces, mesh.own_faces),
    }


def _measure_edges(mesh: TileMesh) -> dict[str, Any]:
    from msal_cli.kernels.geometry import edge_lengths_partial

    return edge_lengths_partial(mesh.vertices, *mesh.links.one_ring, mesh.own_vertices)


def _build_mesh(scratch: Scratch, tile_mesh: TileMesh, saved: Mapping[str, NDArray[Any]]) -> Mesh:
    """The mesh that a method runs on, which knows what is known of the whole."""
    known: Mapping[str, Any] = read_globals(scratch)["known"]
    whole = Whole(tile_mesh.own_vertices, tile_mesh.own_faces, known, saved)
    mesh = Mesh(tile_mesh.vertices, tile_mesh.faces, whole=whole)
    mesh.__dict__["topology"] = tile_mesh.links
    return mesh


def _run_method(scratch: Scratch, mesh: Mesh) -> tuple[Method | None, Result]:
    method, parameters = find_method(scratch)
    if method is None:
        return None, methods.Result(mesh.vertices)
    return method, method.denoise(mesh, parameters)


def _check_result(method: Method | None, mesh: Mesh, result: Result) -> None:
    """A method must return finite positions for the same vertices."""
    name = NONE if method is None else method.name
    if result.vertices.shape != mesh.vertices.shape:
        raise InternalError(f"{name} changed the number of vertices")
    if not np.isfinite(result.vertices).all():
        raise InternalError(f"{name} made a position that is not finite")


# New positions


def _write_moved(scratch: Scratch, tile: int, mesh: TileMesh | None, moved: Floats) -> float:
    """Write the new positions of all vertices of a tile; the result is the widest seam: the largest
    distance between those of coincident ones.

    A vertex that did not move, or that no face has, keeps its stored value; a welded one gets that
    of the first at its place.
    """
    from msal_cli.kernels.geometry import distances
    from msal_cli.kernels.welding import scatter

    first, stop = tile_range(scratch, tile)
    gap = 0.0
    if mesh is not None:
        own = np.flatnonzero(mesh.own_vertices)
        numbers = np.full(stop - first, -1, dtype=np.int32)
        numbers[mesh.ids[own] - np.uint32(first)] = own
        is_used = np.ones(len(mesh.ids), dtype=bool)
        origin = np.array(read_globals(scratch)["origin"])
    # Facets have six corners for each vertex: all at once would take more than the mesh itself.
    for start in range(first, stop, _BLOCK_ROWS):
        ids = np.arange(start, min(start + _BLOCK_ROWS, stop), dtype=np.uint32)
        rows = read_positions(scratch, slice(start, start + len(ids)))
        if mesh is not None:
            welded = weld_numbers(scratch, ids)
            place = numbers[welded - np.uint32(first)]
            known = mesh.vertices, moved, is_used, place, origin
            rows = scatter(*known, rows)
            if welded is not ids:
                first_alike = scatter(*known, read_positions(scratch, welded))
                gap = max(gap, float(distances(rows, first_alike).max()))
        scratch.write_range(MOVED, start * 3 * rows.itemsize, rows)
    return gap


def _write_rows(scratch: Scratch, name: str, tile: int, rows: Floats) -> None:
    """Write the rows (count, 3) of a tile's vertices."""
    first, _ = tile_range(scratch, tile)
    scratch.write_range(name, first * 3 * rows.itemsize, rows)


def _count_constrained(
    scratch: Scratch, tile: int, mesh: TileMesh, constraints: Constraints, moved: Floats
) -> dict[str, int]:
    """How many of a tile's vertices are pinned, and how many moved further than they may."""
    from msal_cli.kernels.geometry import distances

    own, counts = mesh.own_vertices, {}
    if constraints.held is not None:
        own = own & ~constraints.held
        counts["locked"] = int(np.count_nonzero(mesh.own_vertices & constraints.held))
        counts["locked"] += vertex_data.count_held_strays(scratch, tile, mesh)
    if constraints.limit is not None:
        lengths = distances(mesh.vertices, moved)
        counts["clamped"] = int(np.count_nonzero(own & (lengths > constraints.limit)))
    return counts
