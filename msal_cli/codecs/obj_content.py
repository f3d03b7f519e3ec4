"""What the walk over an OBJ file, or over a part of it, makes of its statements."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from msal_cli.arrays import Bytes, Floats, Ints, Longs


@dataclass(frozen=True, eq=False)
class Content:
    """One OBJ file, parsed.

    Attributes
    ----------
    vertices : (n, 3) float64, file units; vertex_at : (n,) int64, where each statement begins;
        decimals : (n,) uint8, the most decimals of its numbers.
    normals, normal_at, normal_decimals : the same for the vn statements, (g, 3), (g,), (g,).
    faces : (m, 3) int32, polygons cut into triangles.
    face_normals : (m, 3) int32, the vn of each corner, -1 for none; None where no corner has one.
    corners, sizes : (k,) and (p,) int32, the p polygons as they are in the file; ``corners`` and
        ``faces`` share memory where all are triangles.
    state : (N_STATE,) int64, the counts that ``kernels.obj_scan`` names.
    keywords : every other keyword, how often it occurs, and where first.
    libraries : (l,) int64, where the mtllib statements begin.
    """

    vertices: Floats
    vertex_at: Longs
    decimals: Bytes
    normals: Floats
    normal_at: Longs
    normal_decimals: Bytes
    faces: Ints
    face_normals: Ints | None
    corners: Ints
    sizes: Ints
    state: Longs
    keywords: dict[bytes, tuple[int, int]]
    libraries: Longs


class Arrays(NamedTuple):
    """What the statements of a file, or of a part of it, hold: see ``Content``.

    ``corner_normals`` (k,) are the normals of corners, -1 for none; empty without any normals.
    """

    vertices: Floats
    vertex_at: Longs
    decimals: Bytes
    normals: Floats
    normal_at: Longs
    normal_decimals: Bytes
    corners: Ints
    corner_normals: Ints
    sizes: Ints


class Before(NamedTuple):
    """What a part of a file has before it; faces of fewer than three corners count, too."""

    bytes: int = 0
    lines: int = 0
    vertices: int = 0
    normals: int = 0
    texture: int = 0
    faces: int = 0


def cut_triangles(corners: Ints, sizes: Ints) -> Ints:
    """(m, 3), the polygons cut into fans; a view where all are triangles."""
    if len(corners) == 3 * len(sizes) and bool((sizes == 3).all()):
        return corners.reshape(-1, 3)
    from msal_cli.kernels.ply_scan import fans

    triangles = np.empty((len(corners) - 2 * len(sizes), 3), dtype=np.int32)
    fans(corners, sizes, triangles)
    return triangles
