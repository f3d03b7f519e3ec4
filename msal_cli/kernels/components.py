"""Connected parts of a mesh, and whether each is wound one way."""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Flags, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.connectivity import Connectivity, side_circles


@compiled
def _root(parent, item):
    while parent[item] != item:
        parent[item] = parent[parent[item]]
        item = parent[item]
    return item


@compiled
def _count_components(faces, used, parent):
    components = 0
    for i in range(len(parent)):
        parent[i] = i
        if used[i]:
            components += 1
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if parent[a] == parent[b] and parent[b] == parent[c]:
            continue
        first = _root(parent, a)
        for corner in range(1, 3):
            other = _root(parent, faces[f, corner])
            if other != first:
                components -= 1
                # The lower number becomes the root, so that the forest does not depend on luck.
                if other < first:
                    parent[first] = other
                    first = other
                else:
                    parent[other] = first
    return components


def count_components(n_vertices: int, faces: Ints, used: Flags) -> int:
    """Number of connected parts among the vertices that ``used`` (n,) marks."""
    return int(_count_components(faces, used, np.empty(n_vertices, dtype=np.int32)))


def component_labels(n_vertices: int, faces: Ints) -> Ints:
    """For each vertex (n,) the lowest number of a vertex in its connected part."""
    labels = np.empty(n_vertices, dtype=np.int32)
    _count_components(faces, np.ones(n_vertices, dtype=bool), labels)
    while (above := labels[labels]).tobytes() != labels.tobytes():
        labels = above
    return labels


@compiled
def root_and_parity(parent, parity, face):
    """Root of a face and whether the face is wound against it; paths are shortened."""
    root = face
    against = False
    while parent[root] != root:
        against ^= parity[root]
        root = parent[root]
    here, left = face, against
    while parent[here] != root and here != root:
        up, was = parent[here], parity[here]
        parent[here] = root
        parity[here] = left
        left ^= was
        here = up
    return root, against


@compiled
def join_patches(parent, parity, twisted, one, other, opposed):
    """Join the patches of two items, which are ``opposed`` or not; the lower root stays."""
    a, a_against = root_and_parity(parent, parity, one)
    b, b_against = root_and_parity(parent, parity, other)
    if a == b:
        if (a_against ^ b_against) != opposed:
            twisted[a] = True
    else:
        low, high = min(a, b), max(a, b)
        parent[high] = low
        parity[high] = a_against ^ b_against ^ opposed
        twisted[low] |= twisted[high]


@compiled
def _to_flip(corners, following, flip):
    m = len(flip)
    parent = np.arange(m)
    parity = np.zeros(m, dtype=np.bool_)
    twisted = np.zeros(m, dtype=np.bool_)
    for side in range(len(corners)):
        other = np.int64(following[side])
        # Each edge with exactly two faces once: its two sides follow each other.
        if other <= side or following[other] != side:
            continue
        opposed = corners[side] == corners[other]
        join_patches(parent, parity, twisted, side // 3, other // 3, opposed)
    against = np.zeros(m, dtype=np.int64)
    size = np.zeros(m, dtype=np.int64)
    for f in range(m):
        root, is_against = root_and_parity(parent, parity, f)
        size[root] += 1
        if is_against:
            against[root] += 1
        flip[f] = is_against
    unorientable = 0
    for f in range(m):
        root, _ = root_and_parity(parent, parity, f)
        if twisted[root]:
            flip[f] = False
            if root == f:
                unorientable += 1
        elif 2 * against[root] > size[root]:
            flip[f] = not flip[f]
    return unorientable


def faces_to_flip(faces: Ints, links: Connectivity) -> tuple[Flags, int]:
    """The faces to turn round so that every part that can be is wound one way.

    Faces are joined across edges with exactly two faces.  In each part the lesser number of faces
    is turned; a part that has no consistent winding (a Moebius band) is left as it is.

    Returns
    -------
    flip : (m,) bool.
    unorientable : number of parts that have no consistent winding.
    """
    flip = np.zeros(len(faces), dtype=bool)
    corners = faces.reshape(-1).view(np.uint32)
    unorientable = _to_flip(corners, side_circles(faces, links), flip)
    return flip, int(unorientable)
