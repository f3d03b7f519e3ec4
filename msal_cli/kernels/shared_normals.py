"""Stored normals that several places of a surface share, and the faces that they no longer fit.

A normal at one place is the mean of the faces around it, and fits as well as a smooth normal can.
One that faces at several places name can only be the mean of them all.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints, Longs
from msal_cli.kernels.geometry import face_normals

_SMALLEST_SQUARE, _LARGEST_SQUARE = 1e-200, 1e200
"""Squared lengths between which no sum of squares overflows or loses its digits."""


class Users(NamedTuple):
    """Which faces use which shared normals: the numbers of a face and of an entry (k,) each."""

    faces: Longs
    entries: Longs


class Misfits(NamedTuple):
    """Which normals (g,) are further than a limit from one of their faces after vertices moved,
    and which faces (m,) are further from one of theirs before and after."""

    entries: Flags
    faces_before: Flags
    faces_after: Flags


def find_users(vertices: Floats, faces: Ints, corner_entry: Ints, n_entries: int) -> Users | None:
    """Find the faces whose normals are shared with other faces at other places.

    Parameters
    ----------
    vertices : (n, 3).
    faces : (m, 3), the triangles.
    corner_entry : (m, 3), the normal that each corner uses; negative for none.

    Returns
    -------
    None where no normal is shared.
    """
    if np.array_equal(corner_entry, faces):
        return None
    first = corner_entry[:, 0]
    is_flat = (first == corner_entry[:, 1]) & (first == corner_entry[:, 2])
    flat = np.flatnonzero(is_flat & (first >= 0))
    flat_entry = first[flat].astype(np.int64)
    corner = np.flatnonzero(~is_flat[:, None] & (corner_entry >= 0))
    entry = corner_entry.reshape(-1)[corner].astype(np.int64)
    n_flat = np.bincount(flat_entry, minlength=n_entries)
    # A face with one normal for its corners has three places.
    shared = n_flat > 1
    shared |= (n_flat > 0) & (np.bincount(entry, minlength=n_entries) > 0)
    one_corner = np.zeros(n_entries, dtype=np.int64)
    one_corner[entry] = corner
    other_corner = one_corner[entry]
    position, other_position = (vertices[faces.reshape(-1)[c]] for c in (corner, other_corner))
    is_apart = (position != other_position).any(axis=1) & (corner // 3 != other_corner // 3)
    shared[entry[is_apart]] = True
    if not shared.any():
        return None
    flat_used, used = shared[flat_entry], shared[entry]
    return Users(
        np.concatenate([flat[flat_used], corner[used] // 3]),
        np.concatenate([flat_entry[flat_used], entry[used]]),
    )


def find_misfits(
    users: Users,
    old_vertices: Floats,
    new_vertices: Floats,
    faces: Ints,
    old_normals: Floats,
    new_normals: Floats,
    limit: float,
) -> Misfits:
    """Find the shared normals that do not fit their faces.

    Parameters
    ----------
    users : from ``find_users``.
    old_vertices, new_vertices : (n, 3), before and after.
    faces : (m, 3), the triangles.
    old_normals, new_normals : (g, 3), as stored, of any length, and as they are to be stored.
    limit : angle in radians between a face and its normal from which on they do not fit.
    """
    before = _cosines(face_normals(old_vertices, faces), old_normals, users)
    after = _cosines(face_normals(new_vertices, faces), new_normals, users)
    # A file may store all normals of a part inwards, which is kept.
    sense = np.bincount(users.entries, np.nan_to_num(before), minlength=len(old_normals))
    sense = np.where(sense < 0.0, -1.0, 1.0)[users.entries]
    found = Misfits(np.zeros(len(old_normals), dtype=bool), *np.zeros((2, len(faces)), dtype=bool))
    # Faces without area and normals that are no numbers have NaN, which is not below.
    found.faces_before[users.faces[before * sense < np.cos(limit)]] = True
    is_off = after * sense < np.cos(limit)
    found.faces_after[users.faces[is_off]] = True
    found.entries[users.entries[is_off]] = True
    return found


def _cosines(unit: Floats, normals: Floats, users: Users) -> Floats:
    """Cosines (k,) between faces' unit normals (m, 3) and stored ones (g, 3); NaN where either is
    zero or not a number."""
    with np.errstate(over="ignore", under="ignore", divide="ignore", invalid="ignore"):
        squares = np.einsum("ij,ij->i", normals, normals)
        extreme = np.flatnonzero(~((squares > _SMALLEST_SQUARE) & (squares < _LARGEST_SQUARE)))
        if len(extreme):
            normals = normals.copy()
            normals[extreme] /= np.abs(normals[extreme]).max(axis=1)[:, None]
            squares = np.einsum("ij,ij->i", normals, normals)
        cosines: Floats = np.einsum("ij,ij->i", unit[users.faces], normals[users.entries])
        cosines /= np.sqrt(squares)[users.entries]
    # The normal of a face without area is zero: so is its product with any other.
    nothing = np.flatnonzero(cosines == 0.0)
    cosines[nothing[~np.asarray(unit[users.faces[nothing]].any(axis=1))]] = np.nan
    return cosines
