"""Normals that several places share: which are, and which faces they no longer fit."""

from __future__ import annotations

import math

import numpy as np

from msal_cli.kernels.shared_normals import find_misfits, find_users

UP = np.array([[0.0, 0.0, 1.0]])
LIMIT = math.radians(30.0)


def strip(*angles_deg: float) -> np.ndarray:
    """Vertices (4 k, 3) of k separate unit squares, each turned about its side along y."""
    squares = []
    for k, angle in enumerate(np.radians(angles_deg)):
        x, z = math.cos(angle), math.sin(angle)
        squares.append([[3 * k, 0, 0], [3 * k + x, 0, z], [3 * k + x, 1, z], [3 * k, 1, 0]])
    return np.array(squares, dtype=np.float64).reshape(-1, 3)


def triangles(count: int) -> np.ndarray:
    both = np.array([[0, 1, 2], [0, 2, 3]])
    return (both + 4 * np.arange(count)[:, None, None]).reshape(-1, 3).astype(np.int32)


def found(before, after, entry, old=UP, new=UP):
    faces = triangles(len(before) // 4)
    entry = np.asarray(entry, dtype=np.int32)
    if entry.shape != faces.shape:
        entry = np.repeat(entry.reshape(-1, 1), 3, axis=1)
    users = find_users(before, faces, entry, len(old))
    if users is None:
        return None
    return find_misfits(users, before, after, faces, old, new, LIMIT)


def test_faces_that_turn_beyond_the_limit_are_found_and_others_are_not():
    misfits = found(strip(0, 0, 40), strip(29, -31, 40), [0] * 6)
    assert misfits.faces_before.tolist() == [False] * 4 + [True] * 2
    assert misfits.faces_after.tolist() == [False] * 2 + [True] * 4
    assert misfits.entries.tolist() == [True]


def test_normals_that_point_inwards_are_held_against_the_back():
    misfits = found(strip(0, 0), strip(40, 0), [0] * 4, -UP, -UP)
    assert not misfits.faces_before.any()
    assert misfits.faces_after.tolist() == [True, True, False, False]


def test_a_normal_of_one_face_or_of_one_place_is_not_shared():
    two = np.repeat(UP, 2, axis=0)
    # One for each vertex; one for each triangle; one at a place where two vertices are.
    faces = triangles(2)
    each = np.repeat(UP, 8, axis=0)
    assert find_users(strip(0, 0), faces, faces, 8) is None
    single = np.arange(4, dtype=np.int32)[:, None].repeat(3, axis=1)
    assert found(strip(0, 0), strip(40, 0), single, each, each) is None
    before = strip(0, 0)
    before[4:] = before[:4]
    corners = np.array([[0, -1, -1], [-1, -1, -1], [0, -1, -1], [-1, -1, -1]])
    assert found(before, strip(40, 0), corners, two, two) is None
    before[4:] += 1.0
    assert found(before, strip(40, 0), corners, two, two) is not None


def test_corners_of_their_own_and_whole_faces_share_as_well():
    two = np.repeat(UP, 2, axis=0)
    corners = np.array([[0, 1, 1], [-1, -1, -1], [0, 0, 0], [-1, -1, -1]])
    misfits = found(strip(0, 0), strip(0, 70), corners, two, two)
    assert misfits.faces_after.tolist() == [False, False, True, False]
    assert misfits.entries.tolist() == [True, False]
