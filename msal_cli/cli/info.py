"""``msal info``: what is in mesh files."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from msal_cli.cli import console
from msal_cli.cli.command import Request, grouped_command
from msal_cli.cli.options import INPUTS, MESSAGES, STREAM, group, resolve_format
from msal_cli.errors import MsalError, UsageError

if TYPE_CHECKING:
    from msal_cli.job.records import InfoRecord


@grouped_command(
    "info",
    group("Input and output", "--include\n--exclude\n--format\n"),
    group(
        "What to report",
        """
--check
--json -> as_json
    Print one JSON document, for one file as for many: its records list holds the files.
""",
    ),
    group(
        MESSAGES,
        """
-v, --verbose ...
    Show all that is known of each file, and more of what is done; -vv shows everything, with
    times.
""",
    ),
    arguments=[INPUTS],
)
def command(request: Request) -> int:
    """Report what is in mesh files: format, counts, defects, size, volume, noise, and what is
    carried along.

    INPUT is a file, a folder (with all its subfolders), a pattern, a URL of one of these, or - for
    standard input. Of several files there is one line each. Nothing is written.

    Lengths are in file units.
    """
    from msal_cli.cli.streams import read_stream
    from msal_cli.job.comparison import inspect_file
    from msal_cli.job.records import Failure, InfoRecord
    from msal_cli.report.text import describe_info, info_table

    format, is_checked = resolve_format(request.format), bool(request.checks)
    unlisted: list[MsalError] = []
    paths = _find_paths(request, unlisted)
    inspected = (
        inspect_file(
            path,
            format,
            data=read_stream() if STREAM in request.inputs else None,
            with_intersections=is_checked,
        )
        for path in paths
    )
    failed = (InfoRecord(str(error.path), error=Failure.of(error)) for error in unlisted)
    records: Iterable[InfoRecord] = itertools.chain(inspected, failed)
    if request.as_json:
        records = list(records)
        console.put_json(InfoRecord.schema, records=records)
    n_read = n_failed = 0

    def read_files() -> Iterator[InfoRecord]:
        """The records of readable files; prints the failures of the others."""
        nonlocal n_read, n_failed
        for record in records:
            if record.error is None:
                n_read += 1
                yield record
            else:
                n_failed += 1
                console.say_failure(record.input, record.error)

    # Each file is printed as soon as it is known.
    if len(paths) > 1 and not request.verbose and not request.as_json:
        for line in info_table(read_files(), paths, console.width(sys.stdout)):
            console.put_lines([line])
            console.flush()
    else:
        for record in read_files():
            if not request.as_json:
                console.put("\n" if n_read > 1 else "")
                console.put_lines(describe_info(record))
                console.flush()
    return console.status_of_files(n_read + n_failed, n_failed)


def _find_paths(request: Request, unlisted: list[MsalError]) -> tuple[str, ...]:
    from msal_cli.batch.inputs import discover_inputs

    inputs: tuple[str, ...] = request.inputs
    patterns = request.include, request.exclude
    if STREAM not in inputs:
        found = discover_inputs(inputs, *patterns, failures=unlisted)
        return tuple(file.path for file in found)
    if len(inputs) > 1 or any(patterns):
        raise UsageError(
            "- must be the only input: standard input is one mesh", hint="give - and no other"
        )
    return inputs
