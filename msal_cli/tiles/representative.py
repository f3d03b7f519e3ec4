"""The stage ``choose``: method and parameters for a mesh that no process can hold.

Whatever looks at the mesh before it is denoised (the choice, the estimate of the noise, the look
for outliers) looks at a part: patches from tiles spread over the mesh, as one mesh.  A mesh that is
hardly larger is looked at as a whole, in the order of the file, so that the same comes out as in
memory.

Lengths in mean edge lengths are those of the part until ``to_whole_units`` knows the mean of all.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msal_cli import methods
from msal_cli.auto import NONE
from msal_cli.errors import ContentError, UsageError
from msal_cli.job.changes import noise_field
from msal_cli.job.choice import Preparation, choose, options_of, prepare
from msal_cli.job.plain_data import as_data
from msal_cli.job.settings import AUTO, CHOOSING, Settings
from msal_cli.mesh import Mesh, PreparedMesh, prepare_mesh
from msal_cli.methods import Method
from msal_cli.methods.blend import format_members, parse_levels, parse_members
from msal_cli.tiles.cut import (
    read_old_numbers,
    read_positions,
    tile_faces,
    tile_range,
)
from msal_cli.tiles.eligibility import names_with_reach
from msal_cli.tiles.plan import TilePlan, load_plan, write_globals

if TYPE_CHECKING:
    from msal_cli.analysis.noise_estimate import NoiseLevel
    from msal_cli.tiles.scratch import Scratch

PATCH_VERTICES = 30_000
"""Vertices of a patch, as the file stores them."""

MOST_PATCHES = 8
"""Tiles that patches are taken from."""

LEAST_NOISE = 1e-9
"""Mean edge lengths that stand for no noise at all, where 0 would mean an estimate by tile."""


@dataclass(frozen=True, eq=False)
class Part:
    """What is looked at of a mesh.

    Attributes
    ----------
    ready : the patches as one mesh, or the whole, in the order of the file.
    n_vertices : how many of the file's vertices it has.
    is_whole : nothing is left out.
    """

    ready: PreparedMesh
    n_vertices: int
    is_whole: bool


def run_choose(scratch: Scratch, index: int = 0) -> dict[str, Any]:
    """What is to be run on the whole mesh, and what the record says of it.

    Returns
    -------
    ``method`` and ``parameters``, all explicit; ``none`` where the mesh stays as it is.
    ``known`` are fields of the record, ``noise_estimate`` another, both as plain data.
    ``mean_edge_length`` (file units), ``vertices`` and ``is_whole`` are of the part.

    Raises
    ------
    UsageError
        if every method that suits the mesh needs the whole of it.
    """
    plan = load_plan(scratch)
    settings = read_settings(plan)
    part = read_part(scratch, plan)
    mesh = part.ready.mesh
    # Outliers are moved in memory only; they are looked for below.
    chosen = prepare(mesh, replace(settings, despike=False), lambda done, total: None)
    warnings = list(chosen.warnings)
    if chosen.method is not None and not has_reach(chosen.method, chosen.parameters):
        chosen, note = _choose_local(mesh, settings, chosen)
        warnings.append(note)
    noise = chosen.noise
    if settings.looks_for_outliers and chosen.method is not None:
        warnings += _look_for_outliers(mesh)
        chosen.known["despiked"] = 0
    method = chosen.method
    parameters = dict(chosen.parameters)
    if method is not None:
        parameters = set_noise(method, parameters, mesh, noise)
    return {
        "method": NONE if method is None else method.name,
        "parameters": parameters,
        "known": as_data(chosen.known),
        "noise_estimate": as_data(noise_field(mesh, noise)),
        "warnings": warnings,
        "mean_edge_length": mesh.mean_edge_length,
        "vertices": part.n_vertices,
        "is_whole": part.is_whole,
    }


def reduce_choose(scratch: Scratch) -> None:
    """Tell all tasks that follow: ``choice`` among the globals, and the rings that it reaches."""
    result = scratch.result("choose", 0)
    reach = 0
    if result["method"] != NONE:
        reach = methods.find(result["method"]).reach(result["parameters"]) or 0
    write_globals(scratch, choice=result, rings=reach)


def read_settings(plan: TilePlan) -> Settings:
    """The settings of a run; JSON has no tuples."""
    values: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in plan.settings.items()
    }
    return Settings(**values)


def to_whole_units(result: Mapping[str, Any], mean_edge_length: float) -> dict[str, Any]:
    """The result of the stage with lengths in mean edge lengths of the whole mesh, which is given
    in file units."""
    factor = result["mean_edge_length"] / mean_edge_length
    if result["is_whole"] or factor == 1.0:
        return dict(result)
    parameters, known = dict(result["parameters"]), dict(result["known"])
    noise = {
        name: _scaled(value, factor) if name.endswith("_edges") else value
        for name, value in result["noise_estimate"].items()
    }
    if result["method"] != NONE:
        method = methods.find(result["method"])
        parameters = _map_noise(method, parameters, lambda level: level * factor)
    if known.get("choice") is not None:
        choice = dict(known["choice"])
        for name in ("noise_edges", "risk_edges"):
            choice[name] = _scaled(choice[name], factor)
        choice["runners_up"] = [
            one | {"risk_edges": _scaled(one["risk_edges"], factor)} for one in choice["runners_up"]
        ]
        if result["method"] != NONE:
            choice["repeat"] = list(options_of(method, parameters))
            known["method"] = {"name": method.name, "parameters": parameters}
        known["choice"] = choice
    return dict(result) | {"parameters": parameters, "known": known, "noise_estimate": noise}


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def has_reach(method: Method, parameters: Mapping[str, Any]) -> bool:
    """Whether a method with complete ``parameters`` can run by tiles."""
    return method.reach(parameters) is not None


# The choice


def _choose_local(mesh: Mesh, settings: Settings, first: Preparation) -> tuple[Preparation, str]:
    """The choice among the methods that can run by tiles, and a note on ``first``, which cannot."""
    assert first.method is not None
    if settings.method not in CHOOSING:
        raise UsageError(
            f"{first.method.name} needs the whole mesh in memory",
            hint=f"by tiles these can run: {', '.join(names_with_reach())}",
        )
    wishes = settings.parameters if settings.method == AUTO else None
    made = choose(mesh, wishes, lambda done, total: None, has_reach, settings.assume)
    if made.method is not None and not has_reach(made.method, made.parameters):
        raise UsageError(
            "every method that suits this mesh needs the whole of it in memory",
            hint=f"give one by hand that can run by tiles: {', '.join(names_with_reach())}",
        )
    best = first.known["choice"].reason.rpartition("; ")[2]
    note = (
        f"the best choice, {best}, needs the whole mesh in memory; this is the best of those that "
        "can run by tiles"
    )
    kept = {name: value for name, value in first.known.items() if name not in made.known}
    return replace(made, known=kept | made.known, noise=made.noise or first.noise), note


def _look_for_outliers(mesh: Mesh) -> list[str]:
    from msal_cli.analysis.outliers import find_outliers

    outliers = find_outliers(mesh)
    if not (outliers.count and outliers.are_clear):
        return []
    return [
        f"{100.0 * outliers.share:.2g} % of the vertices looked at are outliers; by tiles none is "
        "brought back"
    ]


def set_noise(
    method: Method, parameters: Mapping[str, Any], mesh: Mesh, noise: NoiseLevel | None
) -> dict[str, Any]:
    """The parameters with the estimate of ``mesh`` in place of a noise of 0, which would have each
    tile estimate its own."""
    from msal_cli.analysis.noise_estimate import NOISE, estimate_noise

    def given(level: float) -> float:
        if level:
            return level
        found = (noise or estimate_noise(mesh)).assume(NOISE, mesh.mean_edge_length)
        return max(_quotient(found.file_units, mesh.mean_edge_length), LEAST_NOISE)

    return _map_noise(method, parameters, given)


def _quotient(product: float, factor: float) -> float:
    """The number that times ``factor`` is ``product``, to the last bit where there is such."""
    near = product / factor
    others = (near, math.nextafter(near, 0.0), math.nextafter(near, math.inf))
    return next((one for one in others if one * factor == product), near)


def _map_noise(method: Method, parameters: Mapping[str, Any], change: Any) -> dict[str, Any]:
    """The parameters with ``change(noise)`` wherever a level of noise counts."""
    values = dict(parameters)
    if "noise" in values and values.get("schedule", "wiener") == "wiener":
        values["noise"] = change(values["noise"])
    if "members" in values:
        members = parse_members(values["members"], len(parse_levels(values["levels"])))
        listed: list[tuple[Sequence[float], str, dict[str, Any]]] = []
        are_same = True
        for one in members:
            given = _map_noise(one.method, one.parameters, change)
            are_same = are_same and given == one.parameters
            defaults = {spec.name: spec.default for spec in one.method.parameters}
            stated = {name: value for name, value in given.items() if value != defaults[name]}
            listed.append((one.weights, one.method.name, stated))
        values["members"] = values["members"] if are_same else format_members(listed)
    return values


# The part


@dataclass(frozen=True, eq=False)
class _Patch:
    """Vertices of one tile and faces around them.

    Attributes
    ----------
    old : (k,) numbers of the vertices in the file, ascending.
    positions : (k, 3) as the file stores them.
    triangles, corners : (m,) numbers of the faces, and (m, 3) new numbers of their corners.
    """

    old: NDArray[np.uint32]
    positions: NDArray[Any]
    triangles: NDArray[np.uint32]
    corners: NDArray[np.uint32]


def read_part(scratch: Scratch, plan: TilePlan) -> Part:
    """What is looked at of the mesh of a run."""
    is_whole = plan.n_vertices <= MOST_PATCHES * PATCH_VERTICES
    if is_whole:
        patches = [_read_patch(scratch, tile, None) for tile in range(plan.n_tiles)]
    else:
        some = (_read_patch(scratch, tile, PATCH_VERTICES) for tile in _spread(plan.n_tiles))
        # A tile may have no face of its own.
        patches = list(itertools.islice((one for one in some if len(one.corners)), MOST_PATCHES))
    if not patches:
        raise ContentError(
            "no tile has a face of its own",
            code="E_NO_FACES",
            hint="the file's vertices are not near those that they share faces with",
        )
    numbers = np.concatenate([one.old for one in patches])
    positions = np.concatenate([one.positions for one in patches])
    # More than one tile may have a face.
    _, first = np.unique(np.concatenate([one.triangles for one in patches]), return_index=True)
    corners = np.concatenate([one.corners for one in patches])[first]
    order = np.argsort(numbers, kind="stable")
    corners = scratch.array("old.u4", np.uint32)[corners]
    faces = np.searchsorted(numbers[order], corners).astype(np.int32)
    ready = prepare_mesh(positions[order].astype(np.float64), faces)
    return Part(ready, len(numbers), is_whole)


def _spread(n_tiles: int) -> Iterator[int]:
    """All tiles, at first ``MOST_PATCHES`` that are spread evenly over their order in space."""
    count = min(MOST_PATCHES, n_tiles)
    first = [(2 * k + 1) * n_tiles // (2 * count) for k in range(count)]
    yield from first
    yield from (tile for tile in range(n_tiles) if tile not in first)


def _read_patch(scratch: Scratch, tile: int, most: int | None) -> _Patch:
    """Some ``most`` vertices in the middle of a tile, or all of them.

    Faces with a corner beyond the patch are left out, but not where all vertices are wanted, for
    then other tiles have those corners.
    """
    start, stop = tile_range(scratch, tile)
    triangles, corners = tile_faces(scratch, tile)
    old, positions = read_old_numbers(scratch, start, stop), read_positions(scratch, start, stop)
    if most is None:
        return _Patch(old, positions, triangles, corners)
    inside = ((corners >= start) & (corners < stop)).all(axis=1)
    triangles, corners = triangles[inside], corners[inside]
    used = np.zeros(stop - start, dtype=np.bool_)
    used[corners - np.uint32(start)] = True
    chosen = np.flatnonzero(used)
    if len(chosen) > most:
        places = positions[chosen].astype(np.float64)
        ways = ((places - np.median(places, axis=0)) ** 2).sum(axis=1)
        chosen = np.sort(chosen[np.argsort(ways, kind="stable")[:most]])
        used[:] = False
        used[chosen] = True
        kept = used[corners - np.uint32(start)].all(axis=1)
        triangles, corners = triangles[kept], corners[kept]
    return _Patch(old[chosen], positions[chosen], triangles, corners)
