"""Whole files in memory: reading, gzip with a limit on expansion, hashes."""

import hashlib
import os
import zlib
from collections.abc import Callable, Iterable, Iterator
from typing import BinaryIO

from msal_cli.errors import FormatError, InputError, MissingFileError, TooLargeError, cut_short
from msal_cli.machine import in_background
from msal_cli.storage import regular
from msal_cli.storage.urls import is_url

GZIP_MAGIC = b"\x1f\x8b"

ALWAYS_EXPANDED = 32 << 20
"""A compressed file may always expand to this many bytes."""

MAX_RATIO = 200
"""Limit of expanded bytes per compressed byte beyond that.  Meshes reach 3 to 30, the most
repetitive text files about 100; deflate allows 1032, which only malicious files approach."""

_READ_HINTS: dict[type, str] = {
    regular.NotRegularError: "write what comes through it to a file first",
    IsADirectoryError: "name a file in it",
}

_FIRST_PIECE = 1 << 10
_MAX_PIECE = 1 << 20


def read_whole(
    path: str | os.PathLike[str],
    size: int | None = None,
    *,
    check: Callable[[BinaryIO, int], None] | None = None,
) -> regular.Buffer:
    """The bytes of a regular file, or of an object behind a URL.

    A large file comes as a read-only numpy array, in large pages where the system has them: to
    clear thousands of small pages takes longer than to copy the content.

    Parameters
    ----------
    size : bytes of an object, if known.
    check : called with the open file and its size before anything is read; its errors pass.

    Raises InputError (``E_READ``) if the system cannot read it, or it is not a regular file;
    TooLargeError if it has, or grows to, more than half of the machine's memory.
    """
    if isinstance(path, str) and is_url(path):
        from msal_cli.storage import objects as remote

        return remote.read_whole(path, size)
    try:
        with regular.open_regular(path, buffering=0) as file:
            expected = os.fstat(file.fileno()).st_size
            if check is not None:
                check(file, expected)
                file.seek(0)
            return _read_to_end(file, expected)
    except (OSError, ValueError) as failure:
        reason = getattr(failure, "strerror", None) or str(failure)
        is_missing = isinstance(failure, FileNotFoundError)
        error_class = MissingFileError if is_missing else InputError
        raise error_class(
            f"the file cannot be read: {reason}",
            path=os.fspath(path),
            code="E_READ",
            hint=_READ_HINTS.get(type(failure), "check that it exists and that you may read it"),
        ) from failure


def _read_to_end(file: BinaryIO, expected: int) -> regular.Buffer:
    """All bytes of an open file; it may have more than ``expected``, up to ``largest_bytes``."""
    if expected > regular.largest_bytes():
        raise regular.too_large(expected)
    # Room for one byte more than expected, so that one read finds the end.
    pieces: list[regular.Buffer] = []
    size, room = 0, expected + 1
    if expected >= regular.LARGE_BYTES:
        import numpy as np

        array = np.empty(room, dtype=np.uint8).data
        while size < room and (got := file.readinto(array[size:])):  # type: ignore[attr-defined]
            size += got
        pieces.append(array[:size].toreadonly())
        if size < room:
            return pieces[0]
        room = _MAX_PIECE
    while piece := file.read(room):
        pieces.append(piece)
        size += len(piece)
        if size > regular.largest_bytes():
            raise regular.too_large(size)
        room = max(expected + 1 - size, _MAX_PIECE)
    return pieces[0] if len(pieces) == 1 else b"".join(pieces)


def is_gzip_name(name: str) -> bool:
    return name.lower().endswith(".gz")


def is_gzip(data: regular.Buffer) -> bool:
    """Whether a file is compressed: its bytes begin like gzip's."""
    return bytes(memoryview(data).cast("B")[:2]) == GZIP_MAGIC


def expand(data: regular.Buffer, name: str = "") -> regular.Buffer:
    """The content of a file that may be compressed with gzip.

    The members of a file with several are joined; what is not gzip is returned as it is.

    Raises FormatError if the ``name`` ends in ``.gz`` and the content is not gzip, or is damaged;
    TruncatedError if it ends early; TooLargeError if it would expand to more than half of the
    machine's memory, or than the greater of ``ALWAYS_EXPANDED`` and ``MAX_RATIO`` times the
    compressed bytes read so far.
    """
    view = memoryview(data).cast("B")
    if not is_gzip(data):
        if not is_gzip_name(name):
            return data
        if not view:
            raise cut_short("the file is empty")
        raise FormatError(
            "the name ends in .gz but the content is not gzip",
            where="byte 0",
            hint="rename the file, or compress it",
        )
    pieces = _expand_pieces(view)
    # Libraries would copy what is not ``bytes``.
    return _gather(pieces) if isinstance(data, memoryview) else b"".join(pieces)


def _gather(pieces: Iterable[bytes]) -> memoryview:
    """Join pieces in one read-only array, because large arrays may live in files."""
    import numpy as np

    room, size = np.empty(regular.LARGE_BYTES, dtype=np.uint8), 0
    for piece in pieces:
        if size + len(piece) > len(room):
            room.resize(size + len(piece) + size // 2, refcheck=False)
        room[size : size + len(piece)] = np.frombuffer(piece, dtype=np.uint8)
        size += len(piece)
    return room[:size].data.toreadonly()


def _expand_pieces(data: memoryview) -> Iterator[bytes]:
    size = len(data)
    expanded = 0
    position = 0
    while position < size:
        begin = bytes(data[position : position + 2])
        # Zero bytes after the last member are padding (tape blocks), as for gzip itself.
        rest = range(position, size, _MAX_PIECE) if position and begin[0] == 0 else ()
        if rest and not any(bytes(data[at : at + _MAX_PIECE]).strip(b"\0") for at in rest):
            break
        if position and begin not in (GZIP_MAGIC, GZIP_MAGIC[:1]):
            raise FormatError(
                f"{size - position:,} bytes behind the compressed data are not gzip",
                where=f"byte {position}",
                hint="the file is damaged, or two files were joined; compress it again",
            )
        member = zlib.decompressobj(wbits=31)
        # Pieces begin small: ``unused_data`` would copy a file of many tiny members too often.
        piece = _FIRST_PIECE
        while not member.eof:
            part = data[position : position + piece]
            if not part:
                raise cut_short(
                    f"the compressed data end after {position:,} bytes, in the middle",
                    f"byte {position}",
                )
            # The first pieces reveal a decompression bomb.
            allowed = max(ALWAYS_EXPANDED, MAX_RATIO * (position + len(part)))
            allowed = min(regular.largest_bytes(), allowed)
            try:
                text = member.decompress(part, max(allowed - expanded, 0) + 1)
            except zlib.error as failure:
                raise FormatError(
                    f"the compressed data are damaged ({failure})",
                    where=f"bytes {position} to {position + len(part)}",
                    hint="the file is damaged; copy it again",
                ) from failure
            expanded += len(text)
            if expanded > allowed:
                raise TooLargeError(
                    f"{position + len(part):,} of {size:,} compressed bytes expand to more than "
                    f"{allowed:,}",
                    where=f"byte {position}",
                    hint="no mesh compresses so well; if you trust the file, expand it with gunzip",
                )
            yield text
            position += len(part) - len(member.unused_data)
            piece = min(2 * piece, _MAX_PIECE)


def compress(data: regular.Buffer) -> regular.Buffer:
    """``data`` as gzip, always the same bytes: no time, no name, no operating system."""
    view = memoryview(data).cast("B")
    pieces = _compress_pieces(view)
    return b"".join(pieces) if len(view) < regular.LARGE_BYTES else _gather(pieces)


def _compress_pieces(view: memoryview) -> Iterator[bytes]:
    deflate = zlib.compressobj(6, zlib.DEFLATED, -15)
    yield GZIP_MAGIC + b"\x08\x00" + bytes(4) + b"\x00\xff"
    for at in range(0, len(view), _MAX_PIECE):
        yield deflate.compress(view[at : at + _MAX_PIECE])
    yield deflate.flush()
    checksum, size = zlib.crc32(view), len(view)
    yield checksum.to_bytes(4, "little") + (size & 0xFFFFFFFF).to_bytes(4, "little")


THREAD_BYTES = 1 << 20
"""Data of at least this size are worth a thread."""


def sha256_meanwhile(data: regular.Buffer) -> Callable[[], str]:
    """Begin to hash ``data``, which must not change; the returned function gives the hex digits.

    A second core hashes while the first one parses; a single core while the disk writes.
    """
    if len(data) >= THREAD_BYTES:
        return in_background(lambda: hashlib.sha256(data).hexdigest())
    return hashlib.sha256(data).hexdigest
