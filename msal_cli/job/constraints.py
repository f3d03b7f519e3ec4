"""Constraints that keep vertices near their place: --max-move, --lock and --weights.

Limits and pins apply to the result of any method.  Methods that support pins also treat the pinned
vertices as fixed during their sweeps.  Trust goes into the data term of methods that have one.
"""

from typing import Any

import numpy as np

from msal_cli.arrays import Flags, Floats
from msal_cli.codecs.mesh_file import MeshFile, Surface
from msal_cli.codecs.text_slots import extent_decimals
from msal_cli.errors import ContentError
from msal_cli.job.settings import AXES, COMPARISONS, Lock, Settings, parse_length, parse_lock
from msal_cli.kernels.geometry import distances
from msal_cli.kernels.welding import used_vertices
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh, PreparedMesh

# Rounding error of a sum of coordinates and of a distance, relative to the largest coordinate.
_ROUNDING = 2.0**-50


@dataclass(frozen=True, eq=False)
class Constraints:
    """The constraints on one mesh."""

    mesh: Mesh  # to be denoised, with the pins and the trust
    held: Flags | None  # (n,) vertices that are pinned, or None
    limit: float | None  # largest displacement of a vertex in file units, or None
    step: float = 0.0  # last decimal of positions in text, file units

    def apply(self, vertices: Floats) -> tuple[Floats, int]:
        """A method's result (n, 3) with pinned vertices back in their place and the displacement of
        others cut to the limit, and how many were cut.

        They stop slightly before the limit, so that rounding does not take them beyond it and a
        gate at the limit holds.
        """
        before, limit = self.mesh.vertices, self.limit
        if self.held is not None:
            vertices = np.where(self.held[:, None], before, vertices)
        if limit is None:
            return vertices, 0
        lengths, limit = distances(before, vertices), max(0.0, limit - self.step)
        beyond = np.flatnonzero(lengths > limit)
        if len(beyond):
            vertices = vertices.copy()
            start = before[beyond]
            reached = max(0.0, limit - _ROUNDING * float(np.abs(start).max() + limit))
            moves = vertices[beyond] - start
            vertices[beyond] = start + moves * (reached / lengths[beyond])[:, None]
        return vertices, len(beyond)


def build_constraints(
    ready: PreparedMesh, mesh_file: Surface, settings: Settings, pinned: Flags | None = None
) -> Constraints:
    """The constraints of a file.

    ``pinned`` (n_file,) are vertices that stay whatever the settings say.

    Raises InputError if the file lacks a property (``E_PROPERTY``), or if the property cannot be
    used as trust.
    """
    max_move, weights = settings.max_move, settings.weights
    mesh = ready.mesh
    flags = [] if pinned is None else [pinned]
    held: Flags = np.zeros(len(mesh.vertices), dtype=np.bool_)
    for lock in map(parse_lock, settings.lock):
        if lock is None:
            held |= mesh.topology.boundary
        elif lock.name in AXES:
            flags.append(select_vertices(lock, mesh_file.vertices[:, AXES.index(lock.name)]))
        else:
            flags.append(select_vertices(lock, mesh_file.vertex_property(lock.name)))
    for file_pins in flags:
        # A pin applies to all vertices that coincide.
        held |= _spread_largest(ready, file_pins.astype(np.float64)) > 0.0
    trust = None if weights is None else _build_trust(ready, mesh_file, weights)
    limit = None if max_move is None else parse_length(max_move).in_units(mesh.mean_edge_length)
    pins, step = held if settings.lock or pinned is not None else None, 0.0
    if limit is not None and isinstance(mesh_file, MeshFile) and mesh_file.precision == "text":
        step = 10.0 ** -(extent_decimals(mesh_file.vertices) or 0)
    return Constraints(mesh.with_constraints(pins, trust), pins, limit, step)


def _build_trust(ready: PreparedMesh, mesh_file: Surface, name: str) -> Floats:
    """Trust (n,) from 0 to 1: the property over its largest value, where it is above 0.

    Of coincident vertices the most trusted counts.
    """
    if name in AXES:
        raise ContentError(
            f"{name!r} is a coordinate, and says nothing about trust",
            hint="choose another property of the vertices, or denoise without weights",
        )
    is_used = used_vertices(len(mesh_file.vertices), mesh_file.faces.astype(np.int32))
    values = np.where(is_used, mesh_file.vertex_property(name), 0.0)
    finite = np.isfinite(values)
    if not finite.all():
        raise ContentError(
            f"the property {name!r} is not finite",
            code="E_NONFINITE",
            where=f"vertex {int(np.argmin(finite))}",
            hint="mend it, or denoise without weights",
        )
    largest = float(values.max(initial=0.0))
    if largest <= 0.0:
        raise ContentError(
            f"the property {name!r} is nowhere above 0, so that no vertex is to be trusted",
            hint="choose other weights, or denoise without",
        )
    return _spread_largest(ready, np.clip(values / largest, 0.0, 1.0))


def _spread_largest(ready: PreparedMesh, values: Floats) -> Floats:
    """For each of the mesh's vertices (n,) the largest of the ``values`` (n_file,), at least 0, of
    the file's vertices."""
    if ready.vertex_map is None:
        return values
    largest = np.zeros(len(ready.mesh.vertices))
    is_used = ready.vertex_map >= 0
    np.maximum.at(largest, ready.vertex_map[is_used], values[is_used])
    return largest


def select_vertices(lock: Lock, values: Floats) -> Flags:
    """Which vertices a lock selects, by a property's values (n,).

    A property in single precision is compared in single precision, so that a stored 0.2 is equal
    to 0.2.
    """
    value: Any = lock.value
    with np.errstate(over="ignore", invalid="ignore"):
        single = np.float32(value)
        is_single = bool((values.astype(np.float32) == values).all())
    if np.isfinite(single) and is_single:
        value = float(single)
    result: Flags = COMPARISONS[lock.comparison](values, value)
    return result
