"""Files to meshes and back: one codec per format, and whole files in and out of the disk."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msal_cli.codecs.detection import resolve_format
from msal_cli.codecs.mesh_file import MeshFile, Surface
from msal_cli.errors import UnsupportedError
from msal_cli.storage.regular import Buffer

if TYPE_CHECKING:
    from msal_cli.codecs.mesh_file import Companion


def open_mesh(data: Buffer, name: str, format: str | None = None) -> MeshFile:
    """Read a mesh from the bytes of its file.

    Parameters
    ----------
    data : the content, not compressed (see ``expanded``).
    name : the file's name; its suffix says the format, in any case and before ``.gz``.
    format : the format's name, over the suffix; needed for a stream whose content does not tell.

    Raises
    ------
    UnsupportedError
        for a format, or a feature of one, that is not read.
    FormatError, TruncatedError, ContentError, TooLargeError
        for a file that is not what it should be; a content of another format than the name says
        is a FormatError.
    """
    wanted = resolve_format(data, name, format)
    # Codecs are imported where they are used, so that one bad format costs only its own time.
    if wanted == "ply":
        from msal_cli.codecs import ply

        return ply.read(data)
    if wanted == "obj":
        from msal_cli.codecs import obj

        return obj.read(data)
    if wanted == "stl":
        from msal_cli.codecs import stl

        return stl.read(data)
    if wanted in ("glb", "gltf"):
        from msal_cli.codecs import gltf

        return gltf.GlbFile(data) if wanted == "glb" else gltf.GltfFile(data, name)
    if wanted == "3mf":
        from msal_cli.codecs import threemf

        return threemf.ThreeMfFile(data)
    if wanted in ("vtu", "vtp"):
        from msal_cli.codecs import vtk_xml

        return vtk_xml.VtkXmlFile(data, wanted)
    from msal_cli.codecs import off, slot_file, vtk

    layout = off.parse(data) if wanted == "off" else vtk.parse(data)
    return slot_file.SlotFile(data, wanted, layout)


def normal_warnings(mesh_file: MeshFile, vertices: NDArray[np.float64]) -> tuple[str, ...]:
    """What a user should know of the normals that the file stores once its vertices are there.

    Only an OBJ stores normals that several places of the surface share.
    """
    if mesh_file.format != "obj":
        return ()
    from msal_cli.codecs import obj

    assert isinstance(mesh_file, obj.ObjFile)
    return mesh_file.normal_warnings(vertices)


def with_companions(
    mesh_file: MeshFile, output: Buffer, vertices: NDArray[np.float64], path: str | None
) -> tuple[Buffer, tuple[Companion, ...]]:
    """``output``, which ``mesh_file`` made of ``vertices`` (n, 3), as it is to be at ``path``, and
    the files that it needs in its folder; see ``gltf.GltfFile.beside``."""
    if mesh_file.format != "gltf":
        return output, ()
    from msal_cli.codecs import gltf

    assert isinstance(mesh_file, gltf.GltfFile)
    return mesh_file.beside(output, vertices, path)


def vertex_property(mesh_file: Surface, name: str) -> NDArray[np.float64]:
    """A number that a mesh has for each vertex, (n,) in the order of its vertices.

    Raises
    ------
    InputError
        with code ``E_PROPERTY`` if it has no such property; the hint lists those that it has.
    UnsupportedError
        for a format other than PLY.
    """
    read = getattr(mesh_file, "vertex_property", None)
    if read is None:
        format = getattr(mesh_file, "format", "")
        raise UnsupportedError(
            f"vertex properties such as {name!r} are read from PLY, not from {format.upper()}",
            hint="give a PLY, or leave out for this file what names a property",
        )
    values: NDArray[np.float64] = read(name)
    return values
