"""The loop of ``msal noise`` and ``msal scan``: read each input, make an output of it, write both.

Every output appears whole or not at all; a file that fails does not stop the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from msal_cli.cli import console, exit_codes
from msal_cli.cli.options import STREAM
from msal_cli.errors import MsalError, ResourceError, UsageError

if TYPE_CHECKING:
    from msal_cli.batch.inputs import DiscoveredInput
    from msal_cli.job.output import MadeFile
    from msal_cli.storage.buffers import Buffer


@dataclass(frozen=True)
class Target:
    """An input, its output and, where one is requested, the file of its true positions."""

    source: str
    output: str
    truth: str | None = None


def find_inputs(
    inputs: tuple[str, ...], include: tuple[str, ...], exclude: tuple[str, ...], output: str | None
) -> tuple[DiscoveredInput, ...] | None:
    """The files to work on; None if one mesh comes or goes through a standard stream.

    Raises
    ------
    UsageError
        if there is no output, or a pattern for a stream.
    """
    from msal_cli.batch.inputs import discover_inputs
    from msal_cli.cli.streams import find_stream

    if STREAM not in (*inputs, output):
        if output is None:
            raise UsageError("there is no output", hint="name a file or a folder with -o")
        return discover_inputs(inputs, include, exclude, output=output)
    find_stream(inputs, output)
    if include or exclude:
        raise UsageError("--include and --exclude are for files, not for standard input or output")
    return None


def refuse_existing(targets: Iterable[Target], *, force: bool) -> None:
    """Refuse to replace files, unless ``force`` allows it, and those of msal's own in any case;
    UsageError."""
    import os

    from msal_cli.cli.side_files import refuse_target

    for target in targets:
        for path in (target.output, target.truth):
            if path is None or path == STREAM:
                continue
            refuse_target(path, "the output", replaces="")
            if not force and os.path.lexists(path):
                raise UsageError(
                    f"the output {path!r} is there already",
                    hint="give it another name, or --force to replace it",
                )


def make_files(
    targets: Iterable[Target],
    read: Callable[[str], Buffer],
    make: Callable[[Buffer, Target], MadeFile],
    *,
    quiet: bool,
) -> int:
    """Make all outputs and say what each is; the exit status.

    The failure of a single mesh that goes through a standard stream is raised.
    """
    from msal_cli.batch import interrupts
    from msal_cli.job.display_names import escape_for_display
    from msal_cli.report.phrases import file_name

    n_files = n_failed = 0
    for target in targets:
        n_files += 1
        try:
            # A signal must not leave a temporary file.
            with interrupts.noticed(interrupts.raise_for):
                made = _make_file(target, read, make)
        except MsalError as error:
            if STREAM in (target.source, target.output):
                raise
            n_failed += 1
            error.path = error.path or target.source
            console.say_error(error)
            continue
        if not quiet:
            name = file_name(target.output)
            console.say(f"{name}: {escape_for_display(made.description)}")
            for warning in made.warnings:
                console.say(f"warning: {name}: {escape_for_display(warning)}")
    return exit_codes.of_files(n_files, n_failed)


def _make_file(
    target: Target, read: Callable[[str], Buffer], make: Callable[[Buffer, Target], MadeFile]
) -> MadeFile:
    from msal_cli.cli.streams import read_stream
    from msal_cli.codecs.companions import list_sources
    from msal_cli.job.output import write_output

    try:
        data = read_stream() if target.source == STREAM else read(target.source)
        made = make(data, target)
        sources = (0,) if target.source == STREAM else list_sources(target.source, data)
        if target.truth is not None and made.truth is not None:
            write_output(target.truth, made.truth, sources=sources)
        if target.output == STREAM:
            console.put_bytes(made.output)
        else:
            write_output(target.output, made.output, made.companions, sources)
    except MemoryError:
        raise ResourceError("not enough memory", code="E_MEMORY") from None
    return made
