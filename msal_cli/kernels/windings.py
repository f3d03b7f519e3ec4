"""Patches of faces that are joined across edges, and which way each is wound: see ``components``.

Where only a part of a mesh is there, its patches are pieces of those of the whole.  Pieces are
joined by what is known of the same faces in several parts.
"""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Flags, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.components import join_patches, root_and_parity
from msal_cli.kernels.connectivity import Connectivity, side_circles


@compiled
def _join_faces(corners, following, own, parent, parity, twisted):
    for side in range(len(corners)):
        other = np.int64(following[side])
        # Each edge with exactly two faces once: its two sides follow each other.
        if other <= side or following[other] != side:
            continue
        start = corners[side]
        end = corners[side + 1 if side % 3 < 2 else side - 2]
        # Of an edge between vertices of others not all faces may be there.
        if own[start] or own[end]:
            join_patches(parent, parity, twisted, side // 3, other // 3, start == corners[other])


@compiled
def _join_items(one, other, opposed, parent, parity, twisted):
    for at in range(len(one)):
        join_patches(parent, parity, twisted, one[at], other[at], opposed[at])


@compiled
def _read_roots(parent, parity, twisted, roots, against, torn):
    for item in range(len(parent)):
        root, is_against = root_and_parity(parent, parity, item)
        roots[item] = root
        against[item] = is_against
        torn[item] = twisted[root]


class _Patches:
    """Items in patches, at first each in one of its own."""

    def __init__(self, count: int) -> None:
        self.state = (
            np.arange(count),
            np.zeros(count, dtype=bool),
            np.zeros(count, dtype=bool),
        )

    def read(self) -> tuple[Ints, Flags, Flags]:
        """Lowest item of each one's patch, whether the item is wound against that one, and whether
        the patch has no consistent winding."""
        count = len(self.state[0])
        roots, against = np.empty(count, dtype=np.int32), np.empty(count, dtype=bool)
        torn = np.empty(count, dtype=bool)
        _read_roots(*self.state, roots, against, torn)
        return roots, against, torn


def patch_faces(faces: Ints, links: Connectivity, own: Flags) -> tuple[Ints, Flags, Flags]:
    """Patches of faces (m, 3) joined across edges of two faces, those with an ``own`` (n,) vertex.

    Returns
    -------
    roots : (m,) the first face of each one's patch.
    against : (m,) whether a face is wound against that one.
    torn : (m,) whether its patch has no consistent winding.
    """
    patches = _Patches(len(faces))
    corners = faces.reshape(-1).view(np.uint32)
    _join_faces(corners, side_circles(faces, links), own, *patches.state)
    return patches.read()


def join_pieces(count: int, one: Ints, other: Ints, opposed: Flags) -> tuple[Ints, Flags, Flags]:
    """The same for ``count`` items, of which those of pairs (k,) are joined, ``opposed`` or not."""
    patches = _Patches(count)
    _join_items(one, other, opposed, *patches.state)
    return patches.read()
