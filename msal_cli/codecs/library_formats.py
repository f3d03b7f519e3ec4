"""Formats beside PLY, OBJ, STL and GLB: which codec reads them, and new files of them.

Each is read, and written again, by a codec of our own that replaces positions inside the original
bytes.  Only new files, for conversions, are made by trimesh and meshio; they are read back by our
codecs before they are trusted.
"""

from __future__ import annotations

import importlib
import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints
from msal_cli.codecs.library_guard import guarded
from msal_cli.codecs.mesh_file import MeshFile
from msal_cli.codecs.slot_file import SlotFile
from msal_cli.storage.buffers import Buffer

_PARSERS = {
    "off": "off.parse",
    "dae": "dae.parse",
    "vtk": "vtk.parse",
    "vtu": "vtk_xml.parse_vtu",
    "vtp": "vtk_xml.parse_vtp",
    "msh": "gmsh.parse",
    "mesh": "medit.parse",
    "meshb": "medit.parse",
    "inp": "abaqus.parse",
    "avs": "avs.parse",
    "vol": "netgen.parse",
    "med": "med.parse",
    "xdmf": "xdmf.parse",
}
"""Suffixes and the functions that parse them, in the order in which help names them."""

_BY_MESHIO = {
    "vtk": "vtk42",
    "vtu": "vtu",
    "msh": "gmsh",
    "mesh": "medit",
    "meshb": "medit",
    "inp": "abaqus",
    "avs": "avsucd",
    "vol": "netgen",
    "med": "med",
}
"""Suffixes and meshio's names for their formats; of VTK's versions the one that most can read."""

_NEEDED = {"med": "h5py"}
"""Packages that are not installed with msal."""


def readable() -> tuple[str, ...]:
    """The formats that are read here, in the order in which help names them."""
    return tuple(_PARSERS)


def writable() -> tuple[str, ...]:
    """Formats of which new files can be written, with the packages that are installed."""
    return tuple(
        name
        for name in ("off", "dae", "xdmf", "vtp", *_BY_MESHIO, "glb")
        if name not in _NEEDED or importlib.util.find_spec(_NEEDED[name])
    )


def read(data: Buffer, format: str) -> MeshFile:
    """Read a mesh of one of the formats in ``readable()``.

    Raises
    ------
    FormatError, TruncatedError
        if the file is not what its format says.
    UnsupportedError
        for a feature of the format that is not read, or a package that is not installed.
    ContentError
        ``E_NO_FACES``, ``E_INDEX`` or ``E_NONFINITE``.
    TooLargeError, ResourceError
        if reading it takes too much memory or does not end.
    """
    module, _, function = _PARSERS[format].partition(".")
    parse = getattr(importlib.import_module(f"msal_cli.codecs.{module}"), function)
    return SlotFile(data, format, parse)


def cells_written(points: NDArray[Any], faces: Ints, format: str, encoding: str) -> bytes:
    """A new file of one of meshio's formats, of points (n, 3) and triangles (m, 3)."""
    options: dict[str, Any] = {}
    if format in ("vtk", "vtu", "msh"):
        options["binary"] = encoding != "ascii"

    def write() -> bytes:
        import tempfile

        import meshio

        with tempfile.TemporaryDirectory(prefix="msal-") as folder:
            path = Path(folder) / f"mesh.{format}"
            mesh = meshio.Mesh(points, [("triangle", faces)])
            mesh.write(path, file_format=_BY_MESHIO[format], **options)
            return path.read_bytes()

    return guarded(write, "meshio", f"write a {format.upper()} file", points.nbytes)[0]


def surface_written(
    points: Floats, faces: Ints, colours: NDArray[np.uint8] | None, format: str
) -> bytes:
    """A new file of one of trimesh's formats: points (n, 3), triangles (m, 3), colours (n, k)."""

    def write() -> bytes:
        import trimesh

        mesh = trimesh.Trimesh(points, faces, vertex_colors=colours, process=False, validate=False)
        scene: Any = trimesh.Scene(mesh)
        return bytes(scene.export(file_type=format))

    return guarded(write, "trimesh", f"write a {format.upper()} file", points.nbytes)[0]
