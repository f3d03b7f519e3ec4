"""Standard input and output: which of them a command uses, reading within limits, and denoising a
mesh from or to a stream.
"""

from __future__ import annotations

import os
import sys
from contextlib import nullcontext
from typing import TYPE_CHECKING

from msal_cli.cli import console
from msal_cli.cli.options import STREAM
from msal_cli.codecs.detection import format_of_name, output_name, refuse_unknown_format
from msal_cli.errors import InputError, ResourceError, TooLargeError, UsageError
from msal_cli.job.output import write_output
from msal_cli.job.settings import Task
from msal_cli.storage.regular import LARGE_BYTES, largest_bytes
from msal_cli.storage.urls import is_url

if TYPE_CHECKING:
    from msal_cli.job.pipeline import OnProgress
    from msal_cli.job.records import MeshRecord
    from msal_cli.job.settings import Settings
    from msal_cli.storage.regular import Buffer

_PIECE = 1 << 20


def find_stream(inputs: tuple[str, ...], output: str | None) -> Task:
    """The task for these inputs and this output, one of which is ``-``, a standard stream."""
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
    if output is not None and (os.path.isdir(output) or output.endswith(("/", os.sep))):
        raise UsageError(
            f"the output {output!r} is a folder, and standard input has no name to put there",
            hint="name a file with -o",
        )
    if output is not None and output != STREAM:
        from msal_cli.cli.report_files import refuse_target

        refuse_unknown_format(output)
        refuse_target(output, "the output", [source] if source != STREAM else [], replaces="")
    return Task(source, output or STREAM, source)


def choose_format(target: str, to: str | None) -> str | None:
    """The format to convert to: that of ``--to``, else that of the output's suffix, if any."""
    if not (named := format_of_name(target)):
        return to
    if to is not None and output_name(target, to).lower() != target.lower():
        raise UsageError(
            f"--to {to} and the output {target!r} say two formats", hint="give one of them"
        )
    return named


def read_stream() -> Buffer:
    """All of standard input.

    Raises InputError (``E_READ``) if it cannot be read, TooLargeError once it exceeds half of the
    machine's memory, and ResourceError (``E_MEMORY``) once it exceeds the available memory.
    """
    from msal_cli.machine import available_bytes

    if sys.stdin is None:
        raise InputError("standard input is closed", code="E_READ")
    half, free = largest_bytes(), available_bytes()
    limit = half if free is None else min(half, free)
    # Joining a list of pieces would need twice the memory.
    data = bytearray()
    try:
        while len(data) <= limit and (piece := sys.stdin.buffer.read(_PIECE)):
            data += piece
    except OSError as error:
        raise InputError(f"the stream cannot be read: {error.strerror}", code="E_READ") from None
    if len(data) > limit < half:
        raise ResourceError(
            f"the stream has more than {limit:,} bytes, and no more memory is left",
            code="E_MEMORY",
            hint="use a machine, or a container, with more memory",
        )
    if len(data) > limit:
        raise TooLargeError(
            f"the stream has more than {half:,} bytes, and more does not fit into the memory of "
            "this machine",
            hint="cut the mesh into parts, or use a machine with more memory",
        )
    # Libraries copy what is not ``bytes``; a large file must not be copied here.
    return bytes(data) if len(data) < LARGE_BYTES else memoryview(data).toreadonly()


def denoise_stream(task: Task, settings: Settings, on_progress: OnProgress) -> MeshRecord:
    """As ``denoise_file``, for a mesh from or to a standard stream.

    Raises BrokenPipeError if standard output has no reader.
    """
    from msal_cli.codecs import header
    from msal_cli.job.pipeline import FileRun
    from msal_cli.job.room import room_for_task

    name, target = task.input, task.output
    run = FileRun(name, settings, on_progress)
    place = None if target == STREAM else target
    try:
        # What comes from a stream is in memory before its size is known.
        planned = Task(name, place or "", name)
        with nullcontext() if name == STREAM else room_for_task(planned, settings):
            data = read_stream() if name == STREAM else header.read_input(name, settings.format)
            made = run.denoise(data, place)
            if place is None:
                console.put_bytes(made.data)
            else:
                # The shell may have redirected a private file to standard input: take its
                # permissions.
                write_output(place, made.data, sources=[0])
        return run.finish(target)
    except (UsageError, BrokenPipeError):
        raise
    except Exception as error:
        return run.fail(error)
