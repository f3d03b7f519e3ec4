"""Standard input, read to its end within bounds of memory and time."""

from __future__ import annotations

import os
import queue
import sys
import threading
import time
from typing import TYPE_CHECKING, Any

from msal_cli.errors import InputError, MsalError, OutputError, ResourceError, TooLargeError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from msal_cli.storage.buffers import Buffer

_PIECE = 1 << 20

# Pieces that wait between the thread that reads and the one that uses them.
_MOST_WAITING = 4

_LARGE_BYTES = 4 << 20


def read_stream() -> Buffer:
    """All of standard input.

    Raises
    ------
    InputError
        with code ``E_READ`` if it cannot be read.
    TooLargeError
        as soon as it has more than half of the machine's memory.
    ResourceError
        with code ``E_MEMORY`` as soon as it has more than is left of the memory.
    """
    most = _most_bytes()
    # Joined pieces would be held twice for a moment.
    data = bytearray()
    for piece in _pieces():
        data += piece
        most.check(len(data))
    # A library would copy what is no ``bytes``; a large file is not copied.
    return bytes(data) if len(data) < _LARGE_BYTES else memoryview(data).toreadonly()


def copy_stream(path: str, timeout_s: float | None, memory_bytes: int | None) -> float | None:
    """Write all of standard input to a new file; the seconds that are left of ``timeout_s``.

    Raises
    ------
    ResourceError
        with code ``E_TIMEOUT`` if it does not end in time, with code ``E_MEMORY`` as soon as it
        has more than ``memory_bytes``.
    OutputError
        if the file cannot be written.
    InputError, TooLargeError
        as ``read_stream``.
    """
    begun = time.monotonic()
    most = _most_bytes(memory_bytes)
    size = 0
    try:
        with open(path, "xb", buffering=0) as file:
            for piece in _pieces(timeout_s):
                size += len(piece)
                most.check(size)
                rest = memoryview(piece)
                while rest:
                    rest = rest[file.write(rest) or 0 :]
    except OSError as error:
        # Errors of reading have become InputError by now.
        raise OutputError(
            f"the stream cannot be kept in {os.path.dirname(path)!r}: {error.strerror}",
            hint="name a folder with more room by TMPDIR",
        ) from None
    return None if timeout_s is None else timeout_s - (time.monotonic() - begun)


class _Most:
    """The most bytes that standard input may have, and the error if it has more."""

    def __init__(self, size: int, error: Callable[[str], MsalError]) -> None:
        self._size = size
        self._error = error

    def check(self, size: int) -> None:
        if size > self._size:
            raise self._error(f"the stream has more than {self._size:,} bytes")


def _most_bytes(memory_limit: int | None = None) -> _Most:
    from msal_cli.machine import available_bytes
    from msal_cli.storage.limits import largest_bytes

    def beyond_limit(what: str) -> MsalError:
        return ResourceError(
            f"{what}, and the memory limit is no more",
            code="E_MEMORY",
            hint="raise --memory-limit if the machine has more",
        )

    def beyond_free(what: str) -> MsalError:
        return ResourceError(
            f"{what}, and no more memory is left",
            code="E_MEMORY",
            hint="use a machine, or a container, with more memory",
        )

    def beyond_half(what: str) -> MsalError:
        return TooLargeError(
            f"{what}, and more cannot be held in the memory of this machine",
            hint="cut the mesh into parts, or use a machine with more memory",
        )

    half, free = largest_bytes(), available_bytes()
    if memory_limit is not None and memory_limit < half:
        return _Most(memory_limit, beyond_limit)
    if memory_limit is None and free is not None and free < half:
        return _Most(free, beyond_free)
    return _Most(half, beyond_half)


def _pieces(timeout_s: float | None = None) -> Iterator[bytes]:
    """What comes through standard input; ResourceError if it does not end within ``timeout_s``."""
    read = _reader()
    try:
        if timeout_s is None:
            while piece := read(_PIECE):
                yield piece
            return
        yield from _timely_pieces(read, timeout_s)
    except OSError as error:
        raise InputError(f"the stream cannot be read: {error.strerror}", code="E_READ") from None


def _reader() -> Callable[[int], bytes]:
    if sys.stdin is None:
        raise InputError("standard input is closed", code="E_READ")
    try:
        handle = sys.stdin.buffer.fileno()
    except (OSError, ValueError):
        return sys.stdin.buffer.read
    # A buffered stream cannot be left while another thread reads it.
    return lambda size: os.read(handle, size)


def _timely_pieces(read: Callable[[int], bytes], timeout_s: float) -> Iterator[bytes]:
    # A thread, since only sockets can be waited for on every system.
    came: queue.Queue[Any] = queue.Queue(_MOST_WAITING)

    def pass_on() -> None:
        try:
            while piece := read(_PIECE):
                came.put(piece)
            came.put(b"")
        except (OSError, ValueError) as error:
            came.put(error)

    threading.Thread(target=pass_on, name="msal-stdin", daemon=True).start()
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise queue.Empty
            piece = came.get(timeout=left)
        except queue.Empty:
            raise ResourceError(
                f"the stream did not end within {timeout_s:g} s",
                code="E_TIMEOUT",
                hint="raise --timeout, or look at the program that writes it",
            ) from None
        if isinstance(piece, BaseException):
            raise piece
        if not piece:
            return
        yield piece
