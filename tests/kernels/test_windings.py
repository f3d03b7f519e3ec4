"""Patches of faces, found in one piece or in several."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels.components import faces_to_flip
from msal_cli.kernels.connectivity import connectivity
from msal_cli.kernels.windings import join_pieces, patch_faces
from tests.shapes import grid, torus


def surface(seed: int) -> tuple[np.ndarray, int]:
    """A torus and a sheet, some faces of which are turned."""
    _, faces = torus(8, 6)
    _, sheet = grid(7, 5)
    faces = np.concatenate([faces, sheet + 48])
    turned = np.random.default_rng(seed).random(len(faces)) < 0.4
    return np.where(turned[:, None], faces[:, ::-1], faces).astype(np.int32), 48 + 35


def flips(roots: np.ndarray, against: np.ndarray, torn: np.ndarray) -> np.ndarray:
    size = np.bincount(roots, minlength=len(roots))
    n_against = np.bincount(roots, against, len(roots))
    return (against ^ (2 * n_against > size)[roots]) & ~torn


@pytest.mark.parametrize("seed", range(5))
def test_patches_say_which_faces_to_turn(seed):
    faces, n = surface(seed)
    links = connectivity(n, faces)
    expected, unorientable = faces_to_flip(faces, links)
    patches = patch_faces(faces, links, np.ones(n, dtype=bool))
    assert flips(*patches).tolist() == expected.tolist()
    assert unorientable == 0


@pytest.mark.parametrize("seed", range(5))
def test_pieces_are_joined_over_faces_that_they_share(seed):
    faces, n = surface(seed)
    links = connectivity(n, faces)
    expected, _ = faces_to_flip(faces, links)
    owner = np.random.default_rng(seed).integers(0, 3, n)
    pieces = [patch_faces(faces, links, owner == part) for part in range(3)]
    m = len(faces)
    one, other, opposed = [], [], []
    for part, (roots, against, _) in enumerate(pieces):
        # Item m * part + root stands for a piece, the last m items for the faces themselves.
        one.append(m * part + roots)
        other.append(3 * m + np.arange(m))
        opposed.append(against)
    joined = [np.concatenate(columns) for columns in (one, other)]
    roots, parity, torn = join_pieces(
        4 * m, *(column.astype(np.int32) for column in joined), np.concatenate(opposed)
    )
    faces_of = slice(3 * m, None)
    same = flips(roots[faces_of], parity[faces_of], torn[faces_of])
    # Patches of equal shares may be turned either way.
    for patch in np.unique(roots[faces_of]):
        chosen = roots[faces_of] == patch
        wound = same[chosen] ^ expected[chosen]
        assert wound.all() or not wound.any()


def test_a_patch_that_no_winding_suits_is_torn():
    one, other = np.array([0, 1, 2, 3], dtype=np.int32), np.array([1, 2, 0, 4], dtype=np.int32)
    opposed = np.array([True, False, False, True])
    roots, against, torn = join_pieces(6, one, other, opposed)
    assert roots.tolist() == [0, 0, 0, 3, 3, 5]
    assert torn.tolist() == [True, True, True, False, False, False]
    assert against[3:].tolist() == [False, True, False]
