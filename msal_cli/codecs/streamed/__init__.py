"""Mesh files that are read and rewritten in pieces, so that they are never in memory whole."""

from __future__ import annotations

import os

from msal_cli.codecs.detection import resolve_format
from msal_cli.codecs.ply_header import MOST_BYTES
from msal_cli.codecs.streamed.byte_ranges import file_size, read_range
from msal_cli.codecs.streamed_mesh import StreamedMesh
from msal_cli.errors import UnsupportedError
from msal_cli.storage.gzip_streams import GZIP_MAGIC
from msal_cli.storage.limits import LOOKED_AT


def open_streamed(path: str | os.PathLike[str], format: str | None = None) -> StreamedMesh:
    """Open a mesh file of any size; only its header is read.

    Parameters
    ----------
    path : a file of the disk.
    format : the format's name, over the suffix.

    Raises
    ------
    UnsupportedError
        for what cannot be read in pieces.
    InputError
        with code ``E_READ`` if the system cannot read it.
    FormatError, TruncatedError, ContentError, TooLargeError
        for what the header and the size of the file show, as ``codecs.open_mesh``.
    """
    name = os.fspath(path)
    size = file_size(name)
    head = read_range(name, 0, min(size, max(LOOKED_AT, MOST_BYTES)))
    if head[:2].tobytes() == GZIP_MAGIC:
        raise UnsupportedError(
            "a compressed file cannot be read in pieces", hint="expand it with gunzip"
        )
    wanted = resolve_format(head.data, name, format, size)
    if wanted == "ply":
        from msal_cli.codecs.streamed.ply import StreamedPly

        return StreamedPly(name, head, size)
    if wanted == "stl":
        from msal_cli.codecs.streamed.stl import StreamedStl

        return StreamedStl(name, head, size)
    raise UnsupportedError(
        f"{wanted.upper()} files cannot be read in pieces",
        hint="convert the mesh to a binary PLY, or run on a machine with more memory",
    )
