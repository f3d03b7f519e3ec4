"""Mesh files that are read and rewritten in pieces, so that they are never in memory whole."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from msal_cli.arrays import Bytes
from msal_cli.codecs.detection import resolve_format
from msal_cli.codecs.ply_header import MOST_BYTES
from msal_cli.codecs.streamed.byte_ranges import file_size, read_range
from msal_cli.codecs.streamed.line_blocks import OnBytes
from msal_cli.codecs.streamed_mesh import StreamedMesh
from msal_cli.errors import UnsupportedError
from msal_cli.storage.gzip_streams import GZIP_MAGIC
from msal_cli.storage.limits import LOOKED_AT

if TYPE_CHECKING:
    from msal_cli.codecs.streamed.text_facts import TextFacts


def open_streamed(
    path: str | os.PathLike[str],
    format: str | None = None,
    folder: str | os.PathLike[str] | None = None,
    on_bytes: OnBytes | None = None,
) -> StreamedMesh:
    """Open a mesh file of any size; of a binary one only the header is read.

    Parameters
    ----------
    path : a file of the disk.
    format : the format's name, over the suffix.
    folder : where the numbers of a text are kept; it is made.  The first call reads the text once
        and writes them there, others find them.  Without it texts are refused.
    on_bytes : called while a text is read.

    Raises
    ------
    UnsupportedError
        for what cannot be read in pieces.
    InputError
        with code ``E_READ`` if the system cannot read it.
    FormatError, TruncatedError, ContentError, TooLargeError
        for what the header and the size of the file show, as ``codecs.open_mesh``; of a text for
        whatever is wrong with it.
    """
    name = os.fspath(path)
    size = file_size(name)
    head = read_range(name, 0, min(size, max(LOOKED_AT, MOST_BYTES)))
    if head[:2].tobytes() == GZIP_MAGIC:
        raise UnsupportedError(
            "a compressed file cannot be read in pieces", hint="expand it with gunzip"
        )
    wanted = resolve_format(head.data, name, format, size)
    if wanted == "ply" and not _is_ascii_ply(head, size):
        from msal_cli.codecs.streamed.ply import StreamedPly

        return StreamedPly(name, head, size)
    if wanted == "stl" and not _is_ascii_stl(head, size):
        from msal_cli.codecs.streamed.stl import StreamedStl

        return StreamedStl(name, head, size)
    if wanted not in _TEXTS or folder is None:
        raise UnsupportedError(
            f"{wanted.upper()} files{' of text' * (wanted in _TEXTS)} cannot be read in pieces",
            hint="convert the mesh to a binary PLY, or run on a machine with more memory",
        )
    from msal_cli.codecs.streamed.text_facts import TextFacts

    place = Path(folder)
    facts = TextFacts.load(place, name)
    if facts is None:
        place.mkdir(parents=True, exist_ok=True)
        facts = _convert(wanted, name, size, place, on_bytes)
        facts.save(place)
    return _open_text(place, facts)


_TEXTS = ("ply", "obj", "stl")


def _is_ascii_ply(head: Bytes, size: int) -> bool:
    from msal_cli.codecs.ply_header import parsed

    return parsed(memoryview(head.tobytes()), len(head) == size).encoding == "ascii"


def _is_ascii_stl(head: Bytes, size: int) -> bool:
    from msal_cli.codecs.stl import is_text

    return is_text(head.tobytes(), size)


def _convert(
    format: str, path: str, size: int, folder: Path, on_bytes: OnBytes | None
) -> TextFacts:
    """Read a text once and write its numbers into a folder."""
    from msal_cli.codecs.streamed import obj_text, ply_text, stl_text

    convert = {"ply": ply_text.convert, "obj": obj_text.convert, "stl": stl_text.convert}[format]
    return convert(path, path, size, folder, on_bytes)


def _open_text(folder: Path, facts: TextFacts) -> StreamedMesh:
    from msal_cli.codecs.streamed import obj_text, ply_text, stl_text

    if facts.format == "obj":
        return obj_text.StreamedObj(folder, facts)
    if facts.format == "stl":
        return stl_text.StreamedStlText(folder, facts)
    return ply_text.StreamedPlyText(folder, facts)
