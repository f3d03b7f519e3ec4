"""Faces of a piece of a binary PLY file as triangles of 32-bit unsigned vertex numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Longs
from msal_cli.codecs.ply_faces import bad_index, broken_index
from msal_cli.codecs.ply_sections import Fixed, Section

Ids = NDArray[np.uint32]

_NO_VERTEX = 2**32 - 1
"""A number that no vertex has."""


def cut_polygons(section: Section, name: str, n_vertices: int) -> Ids:
    """The triangles (t, 3) of polygons whose corners are the list ``name``, cut as in memory.

    Raises ContentError (``E_INDEX``) and FormatError (a corner is not a whole number) with the
    face.
    """
    items: NDArray[Any]
    lengths: Longs | None
    if isinstance(section, Fixed):
        items, lengths = section.column(name), None
    else:
        items, each = section.items(name)
        lengths = np.ascontiguousarray(each, dtype=np.int64)
    ids = _as_ids(items, section, name, n_vertices)
    if ids.size and int(ids.max()) >= n_vertices:
        item = int(np.argmax(ids.reshape(-1) >= n_vertices))
        raise bad_index(section, name, item, n_vertices)
    if lengths is None:
        return _cut_alike(ids)
    from msal_cli.kernels.ply_scan import fans

    triangles = np.empty((int(np.maximum(lengths - 2, 0).sum()), 3), dtype=np.int32)
    # The kernel moves numbers and does not look at them.
    fans(ids.view(np.int32), lengths, triangles)
    return triangles.view(np.uint32)


def _cut_alike(ids: Ids) -> Ids:
    """The triangles of polygons (p, k)."""
    k = ids.shape[1]
    if k == 3:
        return ids
    if k < 3:
        return np.empty((0, 3), dtype=np.uint32)
    cut = np.empty((len(ids), k - 2, 3), dtype=np.uint32)
    cut[:, :, 0] = ids[:, :1]
    cut[:, :, 1] = ids[:, 1:-1]
    cut[:, :, 2] = ids[:, 2:]
    return cut.reshape(-1, 3)


def _as_ids(items: NDArray[Any], section: Section, name: str, n_vertices: int) -> Ids:
    """Corners as unsigned numbers; what is below 0 or too large is made one that no vertex has."""
    kind, size = items.dtype.kind, items.dtype.itemsize
    if kind == "f":
        values = items.astype(np.float64)
        is_whole = np.isfinite(values) & (np.rint(values) == values)
        if not is_whole.all():
            raise broken_index(section, name, int(np.argmin(is_whole.reshape(-1))))
        values[(values < 0.0) | (values > _NO_VERTEX)] = _NO_VERTEX
        return np.ascontiguousarray(values.astype(np.uint32))
    if size == 8:
        values = items.astype(items.dtype.newbyteorder("="))
        values[(values < 0) | (values > _NO_VERTEX)] = _NO_VERTEX
        return np.ascontiguousarray(values.astype(np.uint32))
    if size < 4:
        # A negative number becomes one of the largest.
        return np.ascontiguousarray(items.astype(np.int32).view(np.uint32))
    if items.ndim == 2 and items.size and items.dtype.isnative and items.strides[1] == size:
        # Record by record, not number by number.
        row = np.dtype(f"V{items.shape[1] * size}")
        ids = np.ascontiguousarray(items.view(row)).view(np.uint32)
    else:
        ids = np.ascontiguousarray(items.astype(items.dtype.newbyteorder("="))).view(np.uint32)
    if kind == "i" and n_vertices > 2**31:
        ids[ids >= 2**31] = _NO_VERTEX
    return ids
