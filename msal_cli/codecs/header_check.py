"""What the size of a file and its first 64 KB already tell: a lie is refused before it is loaded.

A header may promise more than the disk holds, and a file may have a hole of a hundred gigabytes
behind a header that is as it should be.  Whatever is refused here the codec would refuse as well,
once all was read; only very large files with very much behind their mesh are refused here alone.
"""

from __future__ import annotations

import errno
import os
from typing import BinaryIO

from msal_cli.codecs.detection import OWN_FORMATS, content_format, format_of_name
from msal_cli.codecs.headers import read_header
from msal_cli.errors import FormatError, TooLargeError
from msal_cli.storage.gzip_streams import GZIP_MAGIC, read_in_large_pages, read_whole
from msal_cli.storage.regular import (
    LARGE_BYTES,
    LOOKED_AT,
    Buffer,
    largest_bytes,
    open_regular,
    too_large,
)

MOST_BEHIND = 256 << 20
"""Bytes behind the mesh that are carried along whatever the mesh's own size."""


def read_input(
    path: str | os.PathLike[str], format: str | None = None, size: int | None = None
) -> Buffer:
    """The bytes of an input file, unless its size and beginning show that it is no mesh.

    ``format`` is the format's name, over the suffix; ``size`` is that of an object behind a URL
    as far as it is known.

    Raises
    ------
    InputError
        with code ``E_READ`` if the system cannot read it.
    FormatError, TruncatedError, TooLargeError, UnsupportedError
        as ``open_mesh``, and TooLargeError for a file that can never fit into memory.
    """
    is_large = False
    try:
        with open_regular(path) as file:
            status = os.fstat(file.fileno())
            is_large = status.st_size >= LARGE_BYTES
            if status.st_size > LOOKED_AT:
                _look(file, status.st_size, os.fspath(path), format)
    except (OSError, ValueError):
        pass  # reading it all says why
    # A library would copy what is no ``bytes``.
    if is_large and (format or format_of_name(os.fspath(path))) in OWN_FORMATS:
        return read_in_large_pages(path)
    return read_whole(path, size)


def check_beginning(path: str | os.PathLike[str], format: str | None = None) -> None:
    """Raise what ``read_input`` would for a large file that cannot be what it says, by its size and
    its beginning; nothing where the system cannot read it."""
    try:
        with open_regular(path) as file:
            size = os.fstat(file.fileno()).st_size
            if size > LOOKED_AT:
                _look(file, size, os.fspath(path), format)
    except (OSError, ValueError):
        return


def _look(file: BinaryIO, size: int, name: str, format: str | None) -> None:
    """Raise for a file of ``size`` bytes that cannot be what it says."""
    if size > largest_bytes():
        raise too_large(size)
    head = file.read(LOOKED_AT)
    said = format.lower().removeprefix(".") if format else format_of_name(name)
    seen = content_format(head, said)
    wanted = said or seen
    is_packed = head[:2] == GZIP_MAGIC
    # Another format than the name says is the codec's to explain.
    if not is_packed and seen not in ("", wanted):
        return
    is_text = True
    if not is_packed:
        header = read_header(wanted, head, size)
        if header.error is not None:
            raise header.error
        if header.is_text is None:
            return
        is_text = header.is_text
        if header.most_bytes is not None:
            _refuse_behind(size, header.most_bytes)
    # A text has no zero bytes, which a hole is made of, and compressed data have not many; some at
    # the end may be carried along.
    hole = _hole(file, size) if is_text else size
    if size - hole > MOST_BEHIND:
        raise FormatError(
            f"a hole full of zeros begins {size - hole:,} bytes before the end",
            where=f"byte {hole}",
            hint="the file was not written to its end; copy or export it again",
        )


def _refuse_behind(size: int, most: int) -> None:
    """Raise TooLargeError for a file much longer than its header asks for."""
    if size > 2 * most + MOST_BEHIND:
        raise TooLargeError(
            f"the header counts {most:,} bytes at the most, but the file has {size:,}",
            where=f"byte {most}",
            hint="cut off what follows, or export the mesh again",
        )


def _hole(file: BinaryIO, size: int) -> int:
    """The first byte of the first hole of a sparse file; ``size`` if it has none that is known."""
    seek_hole = getattr(os, "SEEK_HOLE", None)
    if seek_hole is None:
        return size
    try:
        at = os.lseek(file.fileno(), 0, seek_hole)
        # Believed only if the bytes there are what a hole reads as.
        return at if at < size and os.pread(file.fileno(), 1, at) == b"\0" else size
    except OSError as failure:
        if failure.errno in (errno.EINVAL, errno.ENXIO, errno.ENOTSUP):
            return size
        raise
