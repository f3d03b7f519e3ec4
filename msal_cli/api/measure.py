"""``compare``, ``estimate_noise`` and ``add_noise``."""

from __future__ import annotations

import operator
import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from msal_cli.api.mesh_objects import as_array, explained_errors, read_mesh
from msal_cli.codecs.mesh_file import Surface
from msal_cli.errors import UsageError
from msal_cli.job.changes import noise_field
from msal_cli.job.comparison import compare_meshes, measure_files, open_mesh_file, surface_of
from msal_cli.job.records import ComparisonRecord, NoiseEstimate
from msal_cli.job.room import prepare_mesh
from msal_cli.job.settings import NoiseKind, to_number


def compare(before: Any, after: Any, *, intersections: bool = False) -> ComparisonRecord:
    """Measure a mesh against a reference: before and after, or truth and result.

    Parameters
    ----------
    before, after : each a path, a pair ``(vertices, faces)`` of arrays (n, 3) and (m, 3), or a mesh
        object as for ``denoise``.  ``before`` is the reference: its mean edge length is the unit.
    intersections : also count the pairs of faces that intersect each other, which takes longer.

    Returns
    -------
    ComparisonRecord, the figures of ``msal compare``.  With the same faces: displacement, angles
    between face normals in degrees (mean: the MSAE of the literature), vertex error in % of the
    mean edge length, flipped faces, change of volume and area; and, with any faces, the surface
    distances and the Hausdorff distance, in the unit of the vertices.  What cannot be
    measured is None, and ``warnings`` says why.

    Raises
    ------
    InputError, UsageError, ResourceError
        if one of them cannot be read, or is not a mesh; ``error.path`` is the file.
    """
    with explained_errors():
        if _is_path(before) and _is_path(after):
            return measure_files(os.fsdecode(before), os.fsdecode(after), None, intersections)
        first, first_name = _read(before)
        second, second_name = _read(after)
        return compare_meshes(
            first, second, first_name, second_name, with_intersections=intersections
        )


def _is_path(given: Any) -> bool:
    return isinstance(given, str | bytes | os.PathLike)


def _read(given: Any) -> tuple[Surface, str]:
    """The surface of an argument, and its name in records."""
    if _is_path(given):
        return surface_of(open_mesh_file(os.fsdecode(given))), os.fsdecode(given)
    is_pair = isinstance(given, tuple | list) and len(given) == 2
    mesh = read_mesh(*given) if is_pair else read_mesh(given)
    return Surface(mesh.vertices, np.asarray(mesh.faces)), mesh.name


def estimate_noise(vertices: Any, faces: ArrayLike | None = None) -> NoiseEstimate:
    """Estimate how much noise a mesh has, and of what kind; the figures of ``msal info``.

    The estimate does not depend on the mesh's rotation, position or scale, and hardly takes longer
    for a large mesh.  White noise of 0.05 to 0.7 mean edge lengths is estimated to within some per
    cent, correlated noise to within about 15 %.  Detail as fine as the mesh itself looks like
    noise: the interval shows how much of the level may be detail.

    Parameters
    ----------
    vertices, faces : a mesh, as for ``denoise``.

    Returns
    -------
    NoiseEstimate: ``mean_edges`` is the standard deviation in mean edge lengths, ``file_units`` the
    same in the unit of the vertices, ``kind`` the kind of noise; docs/report.md explains all.

    Raises
    ------
    ContentError, UnsupportedError, UsageError, ResourceError
        as ``denoise``.
    """
    with explained_errors():
        return noise_field(prepare_mesh(read_mesh(vertices, faces)).mesh)


def add_noise(
    vertices: Any,
    faces: Any = None,
    kind: NoiseKind = "gaussian-normal",
    *,
    level: float = 0.2,
    seed: int = 0,
    fraction: float | None = None,
    rings: int | None = None,
    direction: Sequence[float] | None = None,
    step: float | None = None,
    border: float | None = None,
) -> Any:
    """Add a known amount of noise to a mesh, as ``msal noise`` does, for tests and comparisons.

    The same arguments give the same noise.  Vertices at one position stay together.

    Parameters
    ----------
    vertices, faces : a mesh, as for ``denoise``.
    kind : ``gaussian-normal`` (along the vertex normals), ``gaussian`` (in each coordinate),
        ``uniform``, ``mixed``, ``impulsive``, ``correlated``, ``view``, ``quantised``,
        ``grazing``, ``half``, ``ramp`` or ``outliers``; docs/commands.md explains them.
    level : standard deviation in mean edge lengths, from 0: greater is noisier.
    seed : whole number from 0; another gives other noise of the same kind.
    fraction : for impulsive and outliers, the share of the vertices that move, 0 to 1; default 0.1.
    rings : averages over one-rings, from 0: more correlates wider, at the same level.  Default 2
        for correlated, else 0.
    direction : (3,) of any length: of the view, or where half and ramp are noisier; default z.
    step : of quantised depths, mean edge lengths: greater is coarser; default 0.5.
    border : for half, the width over which the noise begins, as a share of the extent, 0 to 1.

    Returns
    -------
    New positions (n, 3) in the given number type; for a mesh object a copy of it.

    Raises
    ------
    UsageError
        for a setting that the kind does not use, or an invalid value.
    ContentError, UnsupportedError, ResourceError
        as ``denoise``.
    """
    given = locals()
    from msal_cli.analysis.added_noise import build_noise
    from msal_cli.job.output import move_by_noise

    with explained_errors():
        mesh = read_mesh(vertices, faces)
        settings = {
            name: read(given[name], name) for name, read in _READ.items() if given[name] is not None
        }
        whole = _to_whole_number(seed, "seed")
        noise = build_noise(kind, to_number(level, "level"), whole, settings)
        moved, _ = move_by_noise(mesh, noise)
        return mesh.to_result(mesh.to_given_type(moved))


def _to_whole_number(value: Any, name: str) -> int:
    try:
        return operator.index(value)
    except TypeError:
        raise UsageError(f"{name} is {value!r}, and must be a whole number") from None


def _to_vector(value: Any, name: str) -> tuple[float, ...]:
    vector = as_array(value, name, UsageError)
    if vector.shape != (3,):
        raise UsageError(f"{name} is {value!r}, and must be three numbers")
    return tuple(to_number(number, name) for number in vector.tolist())


_READ: dict[str, Callable[[Any, str], Any]] = {
    "fraction": to_number,
    "rings": _to_whole_number,
    "direction": _to_vector,
    "step": to_number,
    "border": to_number,
}
"""The function that checks each setting."""
