"""``compare``: one mesh against another."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from msal_cli.api.mesh_objects import explained_errors, read_mesh
from msal_cli.codecs.mesh_file import Surface
from msal_cli.job.comparison import compare_meshes, measure_files, open_surface
from msal_cli.job.records import ComparisonRecord


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
    mean edge length, flipped faces, change of volume and area; and, whatever the faces are, the
    distances between the surfaces and the Hausdorff distance, in units of the vertices.  What
    cannot be measured is None, and ``warnings`` says why.

    Raises
    ------
    InputError, UsageError, ResourceError
        where one of them cannot be read, or is no mesh; ``error.path`` is the file.
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
    """The surface of an argument, and what records call it."""
    if _is_path(given):
        return open_surface(os.fsdecode(given)), os.fsdecode(given)
    is_pair = isinstance(given, tuple | list) and len(given) == 2
    mesh = read_mesh(*given) if is_pair else read_mesh(given)
    return Surface(mesh.vertices, np.asarray(mesh.faces)), mesh.name
