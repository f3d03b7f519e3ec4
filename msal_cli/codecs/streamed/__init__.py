"""Mesh files that are read and rewritten in pieces, so that they are never in memory whole."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from msal_cli.arrays import Bytes
from msal_cli.codecs.detection import resolve_format
from msal_cli.codecs.ply_header import MOST_BYTES
from msal_cli.codecs.streamed.byte_ranges import file_size, read_range
from msal_cli.codecs.streamed_mesh import StreamedMesh
from msal_cli.errors import OutputError, UnsupportedError
from msal_cli.storage.atomic import write_whole
from msal_cli.storage.gzip_streams import (
    GZIP_MAGIC,
    OnBytes,
    expand_file,
    is_gzip_name,
    refuse_content,
)
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
    folder : where the numbers of a text are kept, and what a compressed file expands to; it is
        made.  The first call reads the file once and fills it, others find what it left.  Without
        it texts and compressed files are refused.
    on_bytes : called while a text or a compressed file is read, as ``on_bytes(done, total)``.

    Raises
    ------
    UnsupportedError
        for what cannot be read in pieces.
    InputError
        with code ``E_READ`` if the system cannot read it.
    FormatError, TruncatedError, ContentError, TooLargeError
        for what the header and the size of the file show, as ``codecs.open_mesh``; of a text for
        whatever is wrong with it.
    OutputError
        if the folder cannot be written.
    """
    name = os.fspath(path)
    place = None if folder is None else Path(folder)
    content = _expand(name, place, on_bytes)
    size = file_size(content)
    head = read_range(content, 0, min(size, max(LOOKED_AT, MOST_BYTES)))
    wanted = resolve_format(head.data, name, format, size)
    if wanted == "ply" and not _is_ascii_ply(head, size):
        from msal_cli.codecs.streamed.ply import StreamedPly

        return StreamedPly(content, head, size)
    if wanted == "stl" and not _is_ascii_stl(head, size):
        from msal_cli.codecs.streamed.stl import StreamedStl

        return StreamedStl(content, head, size)
    if wanted not in _TEXTS or place is None:
        raise UnsupportedError(
            f"{wanted.upper()} files{' of text' * (wanted in _TEXTS)} cannot be read in pieces",
            hint="convert the mesh to a binary PLY, or run on a machine with more memory",
        )
    from msal_cli.codecs.streamed.text_facts import TextFacts

    facts = TextFacts.load(place, name)
    if facts is None:
        with _errors_of(place):
            place.mkdir(parents=True, exist_ok=True)
            facts = _convert(wanted, name, content, size, place, on_bytes)
        facts.save(place)
    return _open_text(place, facts)


_CONTENT, _EXPANDED = "content.bin", "expanded.json"
_TEXTS = ("ply", "obj", "stl")


def _is_ascii_ply(head: Bytes, size: int) -> bool:
    from msal_cli.codecs.ply_header import parsed

    return parsed(memoryview(head.tobytes()), len(head) == size).encoding == "ascii"


def _is_ascii_stl(head: Bytes, size: int) -> bool:
    from msal_cli.codecs.stl import is_text

    return is_text(head.tobytes(), size)


def _expand(path: str, folder: Path | None, on_bytes: OnBytes | None) -> str:
    """The path of the content of a file: its own, or of what it expands to."""
    size = file_size(path)
    if read_range(path, 0, min(size, 2)).tobytes() != GZIP_MAGIC:
        if is_gzip_name(path):
            raise refuse_content(size)
        return path
    if folder is None:
        raise UnsupportedError(
            "a compressed file cannot be read in pieces", hint="expand it with gunzip"
        )
    from msal_cli.codecs.streamed.text_facts import identify

    content, mark = folder / _CONTENT, folder / _EXPANDED
    known = json.dumps(identify(path)).encode()
    if not mark.exists() or mark.read_bytes() != known:
        with _errors_of(folder):
            folder.mkdir(parents=True, exist_ok=True)
            with open(content, "wb") as file:
                for piece in expand_file(path, on_bytes):
                    file.write(piece)
        write_whole(mark, known)
    return str(content)


@contextmanager
def _errors_of(folder: Path) -> Iterator[None]:
    """Turn errors of the system into one that names the folder that cannot be written."""
    try:
        yield
    except OSError as failure:
        raise OutputError(
            f"what is read of the file cannot be kept: {failure.strerror or failure}",
            path=str(folder),
            hint="choose a scratch folder with more space",
        ) from failure


def _convert(
    format: str, path: str, text: str, size: int, folder: Path, on_bytes: OnBytes | None
) -> TextFacts:
    """Read a text once and write its numbers into a folder."""
    from msal_cli.codecs.streamed import obj_text, ply_text, stl_text

    convert = {"ply": ply_text.convert, "obj": obj_text.convert, "stl": stl_text.convert}[format]
    return convert(path, text, size, folder, on_bytes)


def _open_text(folder: Path, facts: TextFacts) -> StreamedMesh:
    from msal_cli.codecs.streamed import obj_text, ply_text, stl_text

    if facts.format == "obj":
        return obj_text.StreamedObj(folder, facts)
    if facts.format == "stl":
        return stl_text.StreamedStlText(folder, facts)
    return ply_text.StreamedPlyText(folder, facts)
