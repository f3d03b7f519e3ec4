"""The proof that facets of binary STL were replaced as they must be."""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled

RIGHT, CORNER, NORMAL, ATTRIBUTE = range(4)
"""What ``check_facets`` found wrong with a facet."""

_CORNERS, _ATTRIBUTE = 6, 24
_LENGTH_ERROR = 1e-5
"""By how much the square of a unit normal's length may differ from 1 in float32."""


@compiled
def check_facets(  # type: ignore[no-untyped-def]
    start, stop, old, new, faces, words_before, words, corners_before, normals, corners
):
    """The first facet that is not as ``facet_normals.replace_facets`` must leave it, and its fault.

    old, new (n, 3) float64 : vertices; ``faces`` (m, 3) are the facets' corners among them.
    normals (m, 3), corners (m, 9) float32 : views into the file, after and before.
    words (m, 25) uint16 : all of a facet, before and after: six of the normal, eighteen of the
        corners, and the attribute.
    """
    for f in range(start, stop):
        if words[f, _ATTRIBUTE] != words_before[f, _ATTRIBUTE]:
            return f, ATTRIBUTE
        moved = False
        for corner in range(3):
            i = faces[f, corner]
            for k in range(3):
                at = 3 * corner + k
                if old[i, k] != corners_before[f, at]:
                    return f, CORNER
                word = _CORNERS + 2 * at
                if new[i, k] != old[i, k]:
                    moved = True
                    if corners[f, at] != np.float32(new[i, k]):
                        return f, CORNER
                elif (
                    words[f, word] != words_before[f, word]
                    or words[f, word + 1] != words_before[f, word + 1]
                ):
                    return f, CORNER
        changed = False
        for word in range(_CORNERS):
            changed = changed or words[f, word] != words_before[f, word]
        if changed:
            x = np.float64(normals[f, 0])
            y = np.float64(normals[f, 1])
            z = np.float64(normals[f, 2])
            if not moved or not abs(x * x + y * y + z * z - 1.0) < _LENGTH_ERROR:
                return f, NORMAL
    return stop, RIGHT
