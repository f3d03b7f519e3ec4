"""Standard input and output: which of them a command uses, reading within limits, and denoising the
mesh that comes or goes there.
"""

from __future__ import annotations

import os
import queue
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from msal_cli.batch import interrupts
from msal_cli.cli import console
from msal_cli.cli.options import STREAM
from msal_cli.errors import (
    InputError,
    MsalError,
    OutputError,
    ResourceError,
    TooLargeError,
    UsageError,
)
from msal_cli.job.output import write_output
from msal_cli.job.records import Failure
from msal_cli.job.settings import Task, is_mesh_name, output_name, refuse_unknown_format, suffix
from msal_cli.storage import gzip_streams
from msal_cli.storage.regular import largest_bytes
from msal_cli.storage.urls import is_url

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from msal_cli.job.pipeline import OnProgress
    from msal_cli.job.records import MeshRecord
    from msal_cli.job.settings import Limits, Settings
    from msal_cli.storage.regular import Buffer

_PIECE = 1 << 20

# Pieces that wait between the thread that reads and the one that uses them.
_MAX_WAITING = 4

_LARGE_BYTES = 4 << 20


class Stream(NamedTuple):
    """Where one mesh comes from and goes to; ``-`` is a standard stream."""

    source: str
    target: str


def find_stream(inputs: tuple[str, ...], output: str | None) -> Stream:
    """The stream that these inputs and this output, one of which is ``-``, ask for."""
    if len(inputs) > 1:
        raise UsageError(
            "standard input and standard output hold one mesh, not several",
            hint="give one input, or a folder with -o",
        )
    (source,) = inputs
    if source != STREAM and not is_url(source) and not os.path.isfile(source):
        what = "no regular file" if os.path.exists(source) else "no file"
        what = "a folder" if os.path.isdir(source) else what
        raise UsageError(
            f"-o - takes one file, and {source!r} is {what}", hint="name an output folder with -o"
        )
    if output is None and console.is_terminal(sys.stdout):
        raise UsageError(
            "the mesh would go to the terminal",
            hint="redirect it (> out.ply), name a file with -o, or insist with -o -",
        )
    if output is not None and os.path.isdir(output):
        raise UsageError(
            f"the output {output!r} is a folder, and standard input has no name to put there",
            hint="name a file with -o",
        )
    if output is not None and output != STREAM:
        from msal_cli.cli.report_files import refuse_target

        refuse_unknown_format(output)
        refuse_target(output, "the output", [source] if source != STREAM else [], replaces="")
    return Stream(source, output or STREAM)


def choose_format(stream: Stream, to: str | None) -> str | None:
    """The format to convert to: that of ``--to``, else that of the output's suffix, if any."""
    if stream.target == STREAM or not is_mesh_name(stream.target):
        return to
    if to is not None and output_name(stream.target, to).lower() != stream.target.lower():
        raise UsageError(
            f"--to {to} and the output {stream.target!r} say two formats", hint="give one of them"
        )
    return suffix(stream.target).lstrip(".")


def read_stream() -> Buffer:
    """All of standard input.

    InputError (``E_READ``) if it cannot be read; as soon as it has more than half of the machine's
    memory TooLargeError, more than is left of it ResourceError (``E_MEMORY``).
    """
    # Joining a list of pieces would need twice the memory.
    data = bytearray()
    for piece in _pieces():
        data += piece
    # A library would copy what is no ``bytes``; a large file is not copied.
    return bytes(data) if len(data) < _LARGE_BYTES else memoryview(data).toreadonly()


def copy_stream(path: str, timeout_s: float | None, memory_bytes: int | None) -> float | None:
    """Write all of standard input to a new file; the seconds that are left of ``timeout_s``.

    ResourceError with ``E_TIMEOUT`` if it does not end in time, with ``E_MEMORY`` as soon as it has
    more than ``memory_bytes``; OutputError if the file cannot be written; else as ``read_stream``.
    """
    begun = time.monotonic()
    try:
        with open(path, "xb", buffering=0) as file:
            for piece in _pieces(timeout_s, memory_bytes):
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


def _find_limit(memory_limit: int | None) -> tuple[int, MsalError]:
    """The most bytes that standard input may have, and the error if it has more."""
    from msal_cli.machine import available_bytes

    half, free = largest_bytes(), available_bytes()
    if memory_limit is not None and memory_limit < half:
        size, why = memory_limit, "the memory limit is no more"
        hint = "raise --memory-limit if the machine has more"
    elif memory_limit is None and free is not None and free < half:
        size, why = free, "no more memory is left"
        hint = "use a machine, or a container, with more memory"
    else:
        return half, TooLargeError(
            f"the stream has more than {half:,} bytes, and more does not fit into the memory of "
            "this machine",
            hint="cut the mesh into parts, or use a machine with more memory",
        )
    message = f"the stream has more than {size:,} bytes, and {why}"
    return size, ResourceError(message, code="E_MEMORY", hint=hint)


def _pieces(timeout_s: float | None = None, memory_limit: int | None = None) -> Iterator[bytes]:
    """What comes through standard input, up to ``_find_limit``; ResourceError if it does not end
    within ``timeout_s``."""
    limit, too_large = _find_limit(memory_limit)
    if sys.stdin is None:
        raise InputError("standard input is closed", code="E_READ")
    read: Callable[[int], bytes] = sys.stdin.buffer.read
    with suppress(OSError, ValueError):
        # A buffered stream cannot be left while another thread reads it.
        read = partial(os.read, sys.stdin.buffer.fileno())
    pieces = iter(partial(read, _PIECE), b"")
    size = 0
    try:
        for piece in pieces if timeout_s is None else _timely_pieces(pieces, timeout_s):
            size += len(piece)
            if size > limit:
                raise too_large
            yield piece
    except OSError as error:
        raise InputError(f"the stream cannot be read: {error.strerror}", code="E_READ") from None


def _timely_pieces(pieces: Iterator[bytes], timeout_s: float) -> Iterator[bytes]:
    # A thread, since only sockets can be waited for on every system.
    came: queue.Queue[Any] = queue.Queue(_MAX_WAITING)

    def pass_on() -> None:
        try:
            for piece in pieces:
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


def denoise_stream(
    stream: Stream, settings: Settings, on_progress: OnProgress, limits: Limits
) -> MeshRecord:
    """Read, denoise and write one mesh; nothing is written unless all went well.

    With a limit of time or memory a supervised worker does it, which can be ended.  UsageError if
    no file can be denoised within ``limits``; BrokenPipeError if standard output is not read.
    """
    from msal_cli.codecs import header
    from msal_cli.job.pipeline import denoise_bytes, start_record

    name = stream.source
    record = start_record(name, settings)
    output: Buffer | None
    try:
        if limits.timeout_s is not None or limits.memory_bytes is not None:
            output, record = _denoise_in_worker(name, settings, on_progress, limits)
        else:
            data = read_stream() if name == STREAM else header.read_input(name, settings.format)
            output, record = denoise_bytes(data, name, settings, on_progress, limits)
        if output is None:
            return record
        if stream.target == STREAM:
            console.put_bytes(output)
            return replace(record, output=STREAM)
        return _write(output, record, stream)
    except UsageError:
        raise
    except MsalError as error:
        return replace(record, status="failed", output=None, error=Failure.of(error))


def _denoise_in_worker(
    name: str, settings: Settings, on_progress: OnProgress, limits: Limits
) -> tuple[Buffer | None, MeshRecord]:
    """The bytes of the output, None if it failed, and the record; by a worker that is ended when it
    exceeds its limits.

    What comes through a stream is kept in a private folder until the end.
    """
    import tempfile

    from msal_cli.batch.run import check_options, denoise_in_pool

    check_options(limits)
    # The folder must be removed, whatever ends this.
    with (
        interrupts.catch_signals(interrupts.raise_for),
        tempfile.TemporaryDirectory(prefix="msal-") as folder,
    ):
        source, left_s = name, limits.timeout_s
        if source == STREAM:
            source = os.path.join(folder, "input")
            left_s = copy_stream(source, limits.timeout_s, limits.memory_bytes)
        task = Task(source, os.path.join(folder, "output"), relative=name)
        record = denoise_in_pool(task, settings, limits, left_s, on_progress)
        return (None if record.error is not None else gzip_streams.read_whole(task.output)), record


def _write(output: Buffer, record: MeshRecord, stream: Stream) -> MeshRecord:
    """The record after ``output`` was written to a file, compressed if its name says so."""
    import hashlib

    target = stream.target
    plain, is_compressed = gzip_streams.expand(output, "")
    compress = target.lower().endswith(".gz")
    if compress != is_compressed:
        output = gzip_streams.compress(plain) if compress else plain
    # From here on there is something to clean up.
    with interrupts.catch_signals(interrupts.raise_for):
        # What the shell redirects to standard input may be a private file, too.
        sources = (0,) if stream.source == STREAM else (stream.source,)
        write_output(target, output, sources=sources)
    return replace(record, output=target, output_sha256=hashlib.sha256(output).hexdigest())
