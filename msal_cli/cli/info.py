"""``msal info``: what is in mesh files."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from msal_cli.cli import console, options
from msal_cli.cli.command import MESSAGES, group
from msal_cli.cli.command import command as grouped_command
from msal_cli.cli.options import STREAM
from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from msal_cli.job.records import InfoRecord
    from msal_cli.report.info import InfoTable


@grouped_command("info", epilog="Exit status: see msal --help.")
@options.INPUTS
@group(
    "Input and output",
    options.FILES,
    options.FORMAT,
)
@group(
    "What to report",
    options.CHECK,
    click.option(
        "--json",
        "as_json",
        is_flag=True,
        help="Print one JSON document, for one file as for many: its records list holds the files.",
    ),
)
@group(
    MESSAGES,
    click.option(
        "-v",
        "--verbose",
        count=True,
        help="Show all that is known of each file, and more of what is done; -vv shows everything.",
    ),
)
def command(
    inputs: tuple[str, ...],
    include: tuple[str, ...],
    exclude: tuple[str, ...],
    format: str | None,
    checks: tuple[str, ...],
    as_json: bool,
    verbose: int,
) -> int:
    """Report what is in mesh files: format, counts, defects, size, volume, noise, and what is
    carried along.

    INPUT is a file, a folder (with all its subfolders), a pattern, a URL of one of these, or - for
    standard input. Of several files there is one line each. Nothing is written.

    Lengths are in file units.
    """
    from msal_cli.cli import logs
    from msal_cli.report.info import InfoTable

    with logs.log_to_console(verbose):
        known = options.resolve_format(format)
        paths = _find_paths(inputs, include, exclude)
        records = _inspect(paths, known, with_intersections=bool(checks))
        if as_json:
            return _print_json(records)
        is_table = len(paths) > 1 and not verbose
        table = InfoTable(paths, console.width(sys.stdout)) if is_table else None
        return _print_lines(records, table)


def _find_paths(
    inputs: tuple[str, ...], include: tuple[str, ...], exclude: tuple[str, ...]
) -> tuple[str, ...]:
    from msal_cli.batch.inputs import discover_inputs

    if STREAM not in inputs:
        return tuple(file.path for file in discover_inputs(inputs, include, exclude))
    if len(inputs) > 1 or include or exclude:
        raise UsageError(
            "- must be the only input: standard input is one mesh", hint="give - and no other"
        )
    return inputs


def _inspect(
    paths: tuple[str, ...], format: str | None, *, with_intersections: bool
) -> Iterator[InfoRecord]:
    from msal_cli.cli.streams import read_stream
    from msal_cli.job import inspection

    for path in paths:
        data = read_stream() if path == STREAM else None
        yield inspection.inspect_file(
            path, format, data=data, with_intersections=with_intersections
        )


def _print_lines(records: Iterator[InfoRecord], table: InfoTable | None) -> int:
    """Print each file as soon as it is known, as a row of ``table`` if there is one, failures to
    standard error; the exit status."""
    from msal_cli.report.info import describe_info

    n_printed = n_failed = 0
    for record in records:
        if record.error is not None:
            n_failed += 1
            console.say_failure(record.input, record.error)
            continue
        if table is None:
            console.put("\n" if n_printed else "")
            console.put_lines(describe_info(record))
        else:
            console.put_lines(
                [table.row(record)] if n_printed else [table.head(), table.row(record)]
            )
        n_printed += 1
        console.flush()
    if table is not None and n_printed:
        console.put_lines([table.foot()])
    return console.status_of_files(n_printed + n_failed, n_failed)


def _print_json(records: Iterator[InfoRecord]) -> int:
    """Print the document; the exit status."""
    from msal_cli.job.plain_data import as_data
    from msal_cli.job.records import InfoRecord

    everything = list(records)
    console.put_json(InfoRecord.schema, records=[as_data(record) for record in everything])
    n_failed = 0
    for record in everything:
        if record.error is not None:
            n_failed += 1
            console.say_failure(record.input, record.error)
    return console.status_of_files(len(everything), n_failed)
