"""Files to meshes and back: one codec per format, and whole files in and out of the disk."""

from msal_cli.codecs.detection import resolve_format
from msal_cli.codecs.mesh_file import MeshFile
from msal_cli.storage.regular import Buffer


def open_mesh(data: Buffer, name: str, format: str | None = None) -> MeshFile:
    """Read a mesh from the bytes of its file.

    Parameters
    ----------
    data : the content, not compressed (see ``gzip_streams.expand``).
    name : the file's name; its suffix is the format, in any case and before ``.gz``.
    format : the format's name, over the suffix; needed for a stream if its content is not enough.

    Raises UnsupportedError for a format, or a feature of one, that is not read; FormatError,
    TruncatedError, ContentError, TooLargeError for invalid content, FormatError also for content of
    another format than the name.
    """
    wanted = resolve_format(data, name, format)
    # Codecs are imported where they are used, so that each file imports only its own.
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
    from msal_cli.codecs import off, vtk

    layout = off.parse(data) if wanted == "off" else vtk.parse(data)
    return MeshFile(data, wanted, layout)
