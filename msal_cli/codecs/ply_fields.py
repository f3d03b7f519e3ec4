"""Numbers at the vertices of a mesh as a PLY of their own: properties, colours, and what they mean.

Such a file is for looking at and for computing with, not an output of denoising: it holds the
positions, the polygons, the fields and colours, and nothing else of the file that they come from.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats
from msal_cli.codecs.mesh_file import MeshFile
from msal_cli.codecs.ply_writer import Column, corners_of, write_ply
from msal_cli.errors import InternalError
from msal_cli.storage.regular import Buffer

_NAME = re.compile(r"[a-z][a-z0-9_]*")
_TAKEN = frozenset({"x", "y", "z", "red", "green", "blue"})
_LONGEST_COMMENT = 1000


def with_fields(
    mesh_file: MeshFile,
    vertices: Floats,
    fields: Mapping[str, Floats],
    colours: NDArray[np.uint8] | None = None,
    comments: Sequence[str] = (),
) -> Buffer:
    """A binary PLY of the mesh with numbers, and colours, at its vertices.

    Parameters
    ----------
    mesh_file : the file whose polygons, and whose precision of positions, are taken.
    vertices : (n, 3) positions in file order, file units.
    fields : (n,) numbers by the name of their property; stored as ``float``.
    colours : (n, 3), stored as ``red``, ``green`` and ``blue``; None for none.
    comments : lines of the header; what is no printable ASCII in them is escaped.
    """
    from msal_cli.codecs.slots import as_float32

    is_single = mesh_file.precision == "float32"
    positions: NDArray[Any] = as_float32(vertices) if is_single else vertices
    real = "<f4" if is_single else "<f8"
    columns: list[Column] = [(name, real, positions[:, k]) for k, name in enumerate("xyz")]
    if colours is not None:
        columns += [(name, "u1", colours[:, k]) for k, name in enumerate(("red", "green", "blue"))]
    for name, values in fields.items():
        if not _NAME.fullmatch(name) or name in _TAKEN or len(values) != len(vertices):
            raise InternalError(f"{name!r} cannot be a field of {len(vertices)} vertices")
        # What is too large for the type becomes infinite, which readers know.
        with np.errstate(over="ignore"):
            columns.append((name, "<f4", values.astype(np.float32)))
    is_triangulated = mesh_file.n_polygons == len(mesh_file.faces)
    corners, sizes = corners_of(mesh_file.faces if is_triangulated else mesh_file.polygons())
    return write_ply(columns, corners, sizes, [_printable(one) for one in comments])


def _printable(comment: str) -> str:
    text = comment.encode("ascii", "backslashreplace").decode()
    text = "".join(one if one.isprintable() else f"\\x{ord(one):02x}" for one in text)
    return text[:_LONGEST_COMMENT]
