"""MED files of Salome (``.med``, HDF5): points replaced inside the original bytes.

The HDF5 library only says where the arrays lie, in a process that can open no other file
(``med_child``); numbers in other files, compressed ones and links are refused.
"""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np

from msal_cli.arrays import Bytes, Longs
from msal_cli.codecs.layout import Layout
from msal_cli.codecs.med_sandbox import answer_of
from msal_cli.codecs.slots import ColumnNumbers
from msal_cli.codecs.surface_cells import CURVED, SurfaceCells
from msal_cli.errors import EXPORT_AGAIN, FormatError, TruncatedError, UnsupportedError
from msal_cli.storage.buffers import Buffer

_KINDS = {
    "TR3": "triangle",
    "QU4": "quad",
    "PO1": "vertex",
    "SE2": "line",
    "SE3": "line",
    "TE4": "tetra",
    "PY5": "pyramid",
    "PE6": "wedge",
    "HE8": "hexahedron",
    **dict.fromkeys(("TR6", "TR7", "QU8", "QU9"), CURVED),
}


def parse(data: Buffer) -> Layout:
    """Read a MED file.

    Raises UnsupportedError without h5py, and for several meshes or time steps, compressed numbers,
    numbers in another file, polygons, and curved cells.
    """
    from msal_cli.kernels.text import as_bytes

    if not importlib.util.find_spec("h5py"):
        raise UnsupportedError(
            "MED files are not read without the package h5py",
            hint="pip install h5py, or install msal with the extra [formats]",
        )
    if bytes(memoryview(data)[:4]) != b"\x89HDF":
        raise FormatError("the file is no HDF5", where="byte 0", hint=EXPORT_AGAIN)
    answer = answer_of("med_child", data, "med")
    if answer["dimension"] != 3:
        raise UnsupportedError(
            f"points have {answer['dimension']} coordinates, not three", hint="write a 3D mesh"
        )
    source = as_bytes(data)
    points = answer["points"]
    if points["type"] not in ("<f8", ">f8") or points["count"] % 3:
        raise UnsupportedError(f"points are stored as {points['type']}", hint=EXPORT_AGAIN)
    _require_bytes(source, points)
    positions = ColumnNumbers(source, points["at"], points["count"] // 3, points["type"])
    cells = SurfaceCells()
    for one in answer["cells"]:
        name, size = one["kind"], one["corners"]
        if name == "POG":
            raise UnsupportedError("polygons of MED files are not read", hint="export triangles")
        kind = _KINDS.get(name, f"cells {name}")
        if size := cells.sort(kind, one["count"] // max(size, 1), name):
            cells.add(kind, _columns(source, one, size))
    return cells.content(
        positions,
        "float64",
        corners=cells.corners() - 1,
        properties=tuple(f"field {name}" for name in answer["fields"]),
    )


def _require_bytes(source: Bytes, place: dict[str, Any]) -> None:
    size = place["count"] * np.dtype(place["type"]).itemsize
    if place["at"] < 0 or place["at"] + size > len(source):
        raise TruncatedError(
            "an array ends behind the file", where=f"byte {len(source)}", hint=EXPORT_AGAIN
        )


def _columns(source: Bytes, place: dict[str, Any], size: int) -> Longs:
    """The corners (m, size) of cells, which are stored column by column."""
    code = np.dtype(place["type"])
    if code.kind not in "iu" or place["count"] % size:
        raise FormatError("the corners of cells are no whole numbers", hint=EXPORT_AGAIN)
    _require_bytes(source, place)
    stored = source[place["at"] : place["at"] + place["count"] * code.itemsize].view(code)
    return np.ascontiguousarray(stored.astype(np.int64).reshape(size, -1).T)
