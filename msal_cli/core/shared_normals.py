"""Stored normals that several places of a surface share, and the faces that they no longer fit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msal_cli.core.geometry import face_normals

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Flags = NDArray[np.bool_]


class Misfits(NamedTuple):
    """Which shared normals (g,) are further than a limit from one of their faces after vertices
    moved, and which faces (m,) are further from one of theirs before and after."""

    entries: Flags
    faces_before: Flags
    faces_after: Flags


def find_misfits(
    old_vertices: Floats,
    new_vertices: Floats,
    faces: Ints,
    corner_entry: Ints,
    old_normals: Floats,
    new_normals: Floats,
    limit: float,
) -> Misfits | None:
    """Find what one normal for many faces gets wrong after the faces have turned differently.

    A normal at one place of the surface is the mean of the faces around it, and fits as well as a
    smooth normal can.  One that faces at several places name can only be the mean of them all.

    Parameters
    ----------
    old_vertices, new_vertices : (n, 3), before and after.
    faces : (m, 3), the triangles.
    corner_entry : (m, 3), the normal that each corner uses; negative for none.
    old_normals, new_normals : (g, 3), as stored, of any length, and as they are to be stored.
    limit : angle in radians between a face and its normal from which on they do not fit.

    Returns
    -------
    None where no normal is shared by several places.
    """
    if np.array_equal(corner_entry, faces):
        return None
    shared = _shared(old_vertices, faces, corner_entry, len(old_normals))
    if not shared.any():
        return None
    corners = np.flatnonzero((corner_entry >= 0) & shared[corner_entry])
    entry, face = corner_entry.reshape(-1)[corners], corners // 3
    before = _cosines(face_normals(old_vertices, faces), face, old_normals, entry)
    after = _cosines(face_normals(new_vertices, faces), face, new_normals, entry)
    # A file may store all normals of a part inwards, which is kept.
    sense = np.bincount(entry, np.nan_to_num(before), minlength=len(shared))
    sense = np.where(sense < 0.0, -1.0, 1.0)[entry]
    found = Misfits(np.zeros(len(shared), dtype=bool), *np.zeros((2, len(faces)), dtype=bool))
    # Faces without area and normals that are no numbers have NaN, which is not below.
    found.faces_before[face[before * sense < np.cos(limit)]] = True
    is_off = after * sense < np.cos(limit)
    found.faces_after[face[is_off]] = True
    found.entries[entry[is_off]] = True
    return found


def _shared(vertices: Floats, faces: Ints, corner_entry: Ints, n_entries: int) -> Flags:
    """Which entries (n_entries,) are named by corners of different faces at different positions."""
    entry, vertex = corner_entry.reshape(-1), faces.reshape(-1)
    corner = np.arange(len(entry))
    if entry.size and entry.min() < 0:
        corner = np.flatnonzero(entry >= 0)
        entry, vertex = entry[corner], vertex[corner]
    one_corner = np.zeros(n_entries, dtype=np.int64)
    one_corner[entry] = corner
    one_vertex = faces.reshape(-1)[one_corner]
    other = np.flatnonzero(
        (vertex != one_vertex[entry]) & (corner // 3 != (one_corner // 3)[entry])
    )
    apart = (vertices[vertex[other]] != vertices[one_vertex[entry[other]]]).any(axis=1)
    shared = np.zeros(n_entries, dtype=bool)
    shared[entry[other[apart]]] = True
    return shared


def _cosines(unit: Floats, face: NDArray[np.int64], normals: Floats, entry: Ints) -> Floats:
    """Cosines of the angles between faces' normals and stored ones; NaN where either is zero."""
    with np.errstate(over="ignore", under="ignore", divide="ignore", invalid="ignore"):
        largest = np.abs(normals).max(axis=1, initial=0.0)[:, None]
        scaled = normals / largest
        scaled /= np.sqrt((scaled * scaled).sum(axis=1))[:, None]
        cosines: Floats = (unit[face] * scaled[entry]).sum(axis=1)
    cosines[~np.asarray(unit.any(axis=1))[face]] = np.nan
    return cosines
