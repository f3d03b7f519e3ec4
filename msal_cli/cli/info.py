"""``msal info``: what is in mesh files."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterable
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
    from msal_cli.report.text import InfoTable, describe_info

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
    table = None
    if request.as_json:
        records = list(records)
        console.put_json(InfoRecord.schema, records=records)
    elif len(paths) > 1 and not request.verbose:
        table = InfoTable(paths, console.width(sys.stdout))
    n_printed = n_failed = 0
    # Each file is printed as soon as it is known.
    for record in records:
        if record.error is not None:
            n_failed += 1
            console.say_failure(record.input, record.error)
            continue
        if table is not None:
            console.put_lines(
                [table.row(record)] if n_printed else [table.head(), table.row(record)]
            )
        elif not request.as_json:
            console.put("\n" if n_printed else "")
            console.put_lines(describe_info(record))
        n_printed += 1
        console.flush()
    if table is not None and n_printed:
        console.put_lines([table.foot()])
    return console.status_of_files(n_printed + n_failed, n_failed)


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
