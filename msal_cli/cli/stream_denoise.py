"""Denoise a single mesh from standard input, to standard output, or both."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import TYPE_CHECKING

from msal_cli.cli import console
from msal_cli.cli.options import STREAM
from msal_cli.cli.streams import copy_stream, read_stream
from msal_cli.errors import MsalError, UsageError

if TYPE_CHECKING:
    from msal_cli.cli.streams import Stream
    from msal_cli.job.pipeline import OnProgress
    from msal_cli.job.records import MeshRecord
    from msal_cli.job.settings import Limits, Settings
    from msal_cli.storage.buffers import Buffer


def denoise_stream(
    stream: Stream, settings: Settings, on_progress: OnProgress, limits: Limits
) -> MeshRecord:
    """Read, denoise and write one mesh; nothing is written unless all went well.

    With a limit of time or memory a supervised worker does it, which can be ended.

    Raises
    ------
    UsageError
        if no file can be denoised within ``limits``.
    BrokenPipeError
        if standard output is no longer read.
    """
    from msal_cli.job.pipeline import start_record
    from msal_cli.job.records import Failure

    is_limited = (limits.timeout_s, limits.memory_bytes) != (None, None)
    denoise = _denoise_in_worker if is_limited else _denoise_here
    record = start_record(stream.source, settings)
    try:
        output, record = denoise(stream, settings, on_progress, limits)
        if output is None:
            return record
        if stream.target == STREAM:
            console.put_bytes(output)
            return replace(record, output=STREAM)
        return _write(output, record, stream)
    except UsageError:
        raise
    except MsalError as error:
        failure = Failure(error.code, error.message, error.hint, error.where)
        return replace(record, status="failed", output=None, error=failure)


def _denoise_here(
    stream: Stream, settings: Settings, on_progress: OnProgress, limits: Limits
) -> tuple[Buffer | None, MeshRecord]:
    """The bytes of the output, None if it failed, and the record; made in this process."""
    from msal_cli.codecs import header_check
    from msal_cli.job.pipeline import denoise_bytes

    name = stream.source
    data = read_stream() if name == STREAM else header_check.read_input(name, settings.format)
    return denoise_bytes(data, name, settings, on_progress, limits)


def _denoise_in_worker(
    stream: Stream, settings: Settings, on_progress: OnProgress, limits: Limits
) -> tuple[Buffer | None, MeshRecord]:
    """As ``_denoise_here``, in a worker that is ended when it exceeds its limits.

    What comes through a stream is kept in a private folder until the end.
    """
    import tempfile

    from msal_cli.batch import interrupts
    from msal_cli.batch.run_checks import check_limits
    from msal_cli.batch.single_file import denoise_in_pool
    from msal_cli.job.settings import Task
    from msal_cli.storage import gzip_streams

    check_limits(limits)
    # The folder must be removed, whatever ends this.
    with (
        interrupts.noticed(interrupts.raise_for),
        tempfile.TemporaryDirectory(prefix="msal-") as folder,
    ):
        source, left_s = stream.source, limits.timeout_s
        if source == STREAM:
            source = os.path.join(folder, "input")
            left_s = copy_stream(source, limits.timeout_s, limits.memory_bytes)
        task = Task(source, os.path.join(folder, "output"), relative=stream.source)
        record = denoise_in_pool(task, settings, limits, left_s, on_progress)
        return (None if record.error is not None else gzip_streams.read_whole(task.output)), record


def _write(output: Buffer, record: MeshRecord, stream: Stream) -> MeshRecord:
    """The record after ``output`` was written to a file, compressed if its name says so."""
    import hashlib

    from msal_cli.batch import interrupts
    from msal_cli.job.output import write_output
    from msal_cli.storage import gzip_streams

    target = stream.target
    plain, is_compressed = gzip_streams.expand(output, "")
    compress = target.lower().endswith(".gz")
    if compress != is_compressed:
        output = gzip_streams.compress(plain) if compress else plain
    # From here on there is something to clean up.
    with interrupts.noticed(interrupts.raise_for):
        # What the shell redirects to standard input may be a private file, too.
        sources = (0,) if stream.source == STREAM else (stream.source,)
        write_output(target, output, sources=sources)
    return replace(record, output=target, output_sha256=hashlib.sha256(output).hexdigest())
