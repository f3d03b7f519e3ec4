"""A single mesh through standard input, standard output, or both."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from msal_cli.cli import console as talk
from msal_cli.cli.standard_input import copy_stream, read_stream
from msal_cli.errors import MsalError, OutputError, UsageError

if TYPE_CHECKING:
    from msal_cli.job.pipeline import OnProgress
    from msal_cli.job.records import MeshRecord
    from msal_cli.job.settings import Limits, Settings
    from msal_cli.storage.buffers import Buffer

STREAM = "-"


@dataclass(frozen=True)
class Pipe:
    """Where one mesh comes from and goes to; ``-`` is a standard stream."""

    source: str
    target: str


def pipe(inputs: tuple[str, ...], output: str | None) -> Pipe | None:
    """The pipe that these inputs and this output are; None if no standard stream is in it.

    Raises
    ------
    UsageError
        if a stream is to be shared by several files, or would fill a terminal with a mesh; if the
        output is called like a file of no known format.
    """
    if STREAM not in inputs and output != STREAM:
        return None
    if len(inputs) > 1:
        raise UsageError(
            "standard input and standard output hold one mesh, not several",
            hint="give one input, or a folder with -o",
        )
    from msal_cli.codecs import is_url

    (source,) = inputs
    if source != STREAM and not is_url(source) and not os.path.isfile(source):
        what = "no regular file" if os.path.exists(source) else "no file"
        what = "a folder" if os.path.isdir(source) else what
        raise UsageError(
            f"-o - takes one file, and {source!r} is {what}", hint="name an output folder with -o"
        )
    if output is None and talk.is_terminal(sys.stdout):
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
        from msal_cli.job.settings import refuse_unknown_format

        refuse_unknown_format(output)
    return Pipe(source, output or STREAM)


def target_format(one: Pipe, to: str | None) -> str | None:
    """The format to convert to: that of ``--to``, else that of the output's suffix, if any.

    Raises
    ------
    UsageError
        if the two contradict each other.
    """
    from msal_cli.job.settings import is_mesh_name, output_name

    if one.target == STREAM or not is_mesh_name(one.target):
        return to
    stem = one.target[:-3] if one.target.lower().endswith(".gz") else one.target
    suffix = os.path.splitext(stem)[1].lstrip(".").lower()
    if to is not None and output_name(one.target, to).lower() != one.target.lower():
        raise UsageError(
            f"--to {to} and the output {one.target!r} say two formats", hint="give one of them"
        )
    return suffix


def denoised(
    one: Pipe,
    settings: Settings,
    on_progress: OnProgress,
    limits: Limits,
) -> MeshRecord:
    """Read, denoise, write, and tell; nothing is written unless all went well.

    With a limit of time or memory a supervised worker does it, which can be ended.

    Raises
    ------
    UsageError
        if no file can be denoised within ``limits``.
    BrokenPipeError
        if nobody reads standard output.
    """
    from msal_cli import __version__
    from msal_cli.job.records import Failure, MeshRecord, MethodUsed

    is_limited = (limits.timeout_s, limits.memory_bytes) != (None, None)
    make = _made_by_worker if is_limited else _made_here
    record = MeshRecord(
        input=one.source,
        status="failed",
        version=__version__,
        method=MethodUsed(settings.method, dict(settings.parameters)),
    )
    try:
        output, record = make(one, settings, on_progress, limits)
        if output is None:
            return record
        if one.target == STREAM:
            talk.put_bytes(output)
            return replace(record, output=STREAM)
        return _written(output, record, one.target)
    except UsageError:
        raise
    except MsalError as error:
        failure = Failure(error.code, error.message, error.hint, error.where)
        return replace(record, status="failed", output=None, error=failure)


def _made_here(
    one: Pipe, settings: Settings, on_progress: OnProgress, limits: Limits
) -> tuple[Buffer | None, MeshRecord]:
    """The bytes of the output, None if it failed, and the record; made in this process."""
    from msal_cli import codecs as files
    from msal_cli.job.pipeline import denoise_bytes

    name = one.source
    data = read_stream() if name == STREAM else files.read_input(name, settings.format)
    return denoise_bytes(data, name, settings, on_progress, limits)


def _made_by_worker(
    one: Pipe, settings: Settings, on_progress: OnProgress, limits: Limits
) -> tuple[Buffer | None, MeshRecord]:
    """As ``_made_here``, in a worker that is ended when it goes beyond its limits.

    What comes through a stream is kept in a private folder until the end.
    """
    import tempfile

    from msal_cli import codecs as files
    from msal_cli.batch import interrupts as signals
    from msal_cli.batch.run import check_limits
    from msal_cli.batch.single_file import denoise_in_pool
    from msal_cli.job.settings import Task

    check_limits(limits)
    # The folder is to go, whatever ends this.
    with (
        signals.noticed(signals.raise_for),
        tempfile.TemporaryDirectory(prefix="msal-") as folder,
    ):
        source, left_s = one.source, limits.timeout_s
        if source == STREAM:
            source = os.path.join(folder, "input")
            left_s = copy_stream(source, limits.timeout_s, limits.memory_bytes)
        task = Task(source, os.path.join(folder, "output"), relative=one.source)
        record = denoise_in_pool(task, settings, limits, left_s, on_progress)
        return (None if record.error is not None else files.read_whole(task.output)), record


def _written(output: Buffer, record: MeshRecord, target: str) -> MeshRecord:
    """The record after ``output`` was written to a file, compressed if its name says so."""
    import hashlib
    from pathlib import Path

    from msal_cli import codecs as files
    from msal_cli.batch import interrupts as signals

    plain, is_compressed = files.expanded(output, "")
    is_to_be = target.lower().endswith(".gz")
    if is_to_be != is_compressed:
        output = files.compressed(plain) if is_to_be else plain
    try:
        if not files.is_url(target):
            Path(target).absolute().parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"the folder of {target!r} cannot be made: {error.strerror}", path=target
        ) from None
    # From here on there is something to clean up.
    with signals.noticed(signals.raise_for):
        files.write_whole(target, [output])
    return replace(record, output=target, output_sha256=hashlib.sha256(output).hexdigest())
