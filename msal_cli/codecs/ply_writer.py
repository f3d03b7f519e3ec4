"""New PLY files of one mesh, binary little-endian: columns of numbers at vertices, and polygons."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Ints, Longs

Column = tuple[str, str, NDArray[Any]]
"""The name of a property, its type in numpy's words, and a number (n,) for each vertex."""

_TYPES = {"<f4": "float", "<f8": "double", "u1": "uchar"}


def write_ply(
    columns: Sequence[Column], corners: Longs, sizes: Longs, comments: Sequence[str] = ()
) -> bytes:
    """A file of vertices with these ``columns``, and polygons of ``sizes`` (p,) with ``corners``
    (c,) one behind the other.  Comments are printable ASCII."""
    rows = np.empty(len(columns[0][2]), dtype=[(name, code) for name, code, _ in columns])
    for name, _, values in columns:
        rows[name] = values
    is_long = int(sizes.max()) > 255
    header = ["ply", "format binary_little_endian 1.0"]
    header += [f"comment {one}" for one in comments]
    header += [f"element vertex {len(rows)}"]
    header += [f"property {_TYPES[code]} {name}" for name, code, _ in columns]
    header += [f"element face {len(sizes)}"]
    header += [f"property list {'uint' if is_long else 'uchar'} int vertex_indices"]
    head = "\n".join([*header, "end_header", ""]).encode()
    return b"".join((head, rows.data, _face_bytes(corners, sizes, "<u4" if is_long else "u1")))


def corners_of(polygons: list[Any] | Ints) -> tuple[Longs, Longs]:
    """The corners (c,) of polygons one behind the other, and how many each has (p,)."""
    if isinstance(polygons, np.ndarray):
        sizes = np.full(len(polygons), polygons.shape[1], dtype=np.int64)
        return polygons.reshape(-1).astype(np.int64), sizes
    sizes = np.array([len(one) for one in polygons], dtype=np.int64)
    return np.concatenate(polygons).astype(np.int64), sizes


def _face_bytes(corners: Longs, sizes: Longs, code: str) -> memoryview:
    """Lists of corners: a count of type ``code``, then 32-bit indices."""
    if (sizes == sizes[0]).all():
        k = int(sizes[0])
        faces = np.empty(len(sizes), dtype=[("count", code), ("corners", "<i4", (k,))])
        faces["count"] = k
        faces["corners"] = corners.reshape(-1, k)
        return faces.view(np.uint8).data
    width = np.dtype(code).itemsize
    starts = np.cumsum(sizes * 4 + width) - (sizes * 4 + width)
    out = np.empty(int(starts[-1] + sizes[-1] * 4 + width), dtype=np.uint8)
    counts = sizes.astype(code).view(np.uint8).reshape(-1, width)
    out[starts[:, None] + np.arange(width)] = counts
    inside = np.arange(len(corners)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    at = np.repeat(starts + width, sizes) + 4 * inside
    out[at[:, None] + np.arange(4)] = corners.astype("<i4").view(np.uint8).reshape(-1, 4)
    return out.data
