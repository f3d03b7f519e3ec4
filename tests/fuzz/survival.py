"""What every file must end in, however it is damaged: an error of msal's own, or a whole result."""

import numpy as np

from msal_cli import codecs
from msal_cli.codecs import detection, mesh_file
from msal_cli.errors import InternalError, MsalError
from msal_cli.mesh import prepare_mesh
from msal_cli.storage import gzip_streams

FORMATS = ("ply", "obj", "stl", "glb", "gltf", "3mf", "gz")
"""The formats with a corpus and mutants of their own, and gzip around any of them."""

_PREPARED_UP_TO = 2_000
"""Faces; the mathematics behind the gate is not what is tested here."""


def outcome(data: bytes, format: str) -> str:
    """The code of the error that ``data`` ends in, or ``"ok"`` for a mesh that is read, prepared,
    written with vertices moved, checked and read again, and re-encoded.

    Anything but an MsalError comes out as it is, and so does an InternalError.
    """
    try:
        return _outcome(data, format)
    except InternalError:
        raise
    except MsalError as error:
        assert error.message and not error.message.endswith("."), error
        assert error.code != InternalError.code
        return error.code


def _outcome(data: bytes, format: str) -> str:
    whole = gzip_streams.expand(data, f"scan.{format}")
    if format == "gz":
        # Formats that libraries read are not ours to bend.
        if detection.content_format(whole) not in detection.OWN_FORMATS:
            return "other"
        format = ""
    name = f"scan.{format}" if format else "scan"
    file = codecs.open_mesh(whole, name)
    vertices, faces = file.vertices, file.faces
    assert np.isfinite(vertices).all()
    assert len(faces) and faces.min() >= 0 and faces.max() < len(vertices)
    assert bytes(file.replaced(vertices.copy())) == bytes(whole)
    file.polygons()
    if len(faces) <= _PREPARED_UP_TO:
        ready = prepare_mesh(vertices, faces)
        scattered = ready.to_file_vertices(ready.mesh.vertices, vertices)
        assert np.array_equal(scattered, vertices)
    moved = vertices.copy()
    moved[::2] += 0.0078125 * np.abs(vertices).max() + 0.125
    output = file.replaced(moved)
    file.check(output, moved)
    again = codecs.open_mesh(bytes(output), name, file.format)
    _require_same_faces(again, file)
    for encoding, precision in (("ascii", "float64"), ("binary", "float32")):
        try:
            output = file.encoded(moved, encoding, precision)
        except InternalError:
            raise
        except MsalError:
            continue  # what the format cannot hold may be refused
        _require_same_faces(codecs.open_mesh(bytes(output), name, file.format), file)
    return "ok"


def _require_same_faces(again: mesh_file.MeshFile, file: mesh_file.MeshFile) -> None:
    if file.format == "stl":
        # Corners that were apart may be at one place once they are rounded.
        assert again.faces.shape == file.faces.shape
    else:
        assert np.array_equal(again.faces, file.faces)
    n_again = len(again.vertices) + again.merged_vertices
    assert n_again == len(file.vertices) + file.merged_vertices
