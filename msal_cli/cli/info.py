"""``msal info``: what is in mesh files."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from msal_cli.cli import console as talk
from msal_cli.cli import exit_codes
from msal_cli.cli.file_options import CHECK, file_options
from msal_cli.cli.stream_denoise import STREAM
from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from msal_cli.job.records import InfoRecord

_PATH = click.Path(readable=False, allow_dash=True)


@click.command(
    "info", short_help="Report what is in mesh files.", epilog="Exit status: see msal --help."
)
@click.argument("inputs", metavar="INPUT...", nargs=-1, required=True, type=_PATH)
@file_options("The inputs' format, where neither their name nor their content tells.")
@CHECK
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print one JSON document, for one file as for many: its records list holds the files.",
)
@click.option(
    "-v", "--verbose", count=True, help="Tell more of what goes on; -vv tells everything."
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
    standard input. Lengths are in file units. Nothing is written.
    """
    from msal_cli import codecs as files
    from msal_cli.cli import logs
    from msal_cli.cli import option_types as words
    from msal_cli.storage import urls

    inputs = tuple(map(urls.settled, inputs))
    with logs.configured(verbose, None):
        known = words.settled_format(format, files.readable_suffixes, "--format")
        records = _inspected(_paths(inputs, include, exclude), known, bool(checks))
        return _print_json(records) if as_json else _print_text(records)


def _paths(
    inputs: tuple[str, ...], include: tuple[str, ...], exclude: tuple[str, ...]
) -> tuple[str, ...]:
    from msal_cli.batch.inputs import discover_inputs

    if STREAM not in inputs:
        return tuple(one.path for one in discover_inputs(inputs, include, exclude))
    if len(inputs) > 1 or include or exclude:
        raise UsageError("- stands alone: standard input is one mesh", hint="give - and no other")
    return inputs


def _inspected(
    paths: tuple[str, ...], format: str | None, with_intersections: bool
) -> Iterator[InfoRecord]:
    from functools import partial

    from msal_cli.cli.standard_input import read_stream
    from msal_cli.job import inspection

    of_bytes = partial(inspection.inspect_bytes, with_intersections=with_intersections)
    of_file = partial(inspection.inspect_file, with_intersections=with_intersections)
    for path in paths:
        if path == STREAM:
            yield of_bytes(read_stream(), path, format)
        else:
            yield of_file(path, format)


def _print_text(records: Iterator[InfoRecord]) -> int:
    """Print each file as soon as it is known, failures to standard error; the exit status."""
    from msal_cli.report import info_text

    n_told = n_failed = 0
    for record in records:
        if record.error is not None:
            n_failed += 1
            talk.say_failure(record.input, record.error)
            continue
        if n_told:
            talk.put("\n")
        n_told += 1
        talk.put_lines(info_text.told(record))
        talk.flush()
    return exit_codes.of_files(n_told + n_failed, n_failed)


def _print_json(records: Iterator[InfoRecord]) -> int:
    """Print the document; the exit status."""
    from msal_cli import __version__
    from msal_cli.job.records import InfoRecord
    from msal_cli.report import document
    from msal_cli.report import json_report as as_json

    everything = list(records)
    data = {
        "schema": InfoRecord.schema,
        "version": __version__,
        "records": [document.plain_record(record) for record in everything],
    }
    talk.put_bytes(as_json.json_bytes(data))
    failed = [record for record in everything if record.error is not None]
    for record in failed:
        if record.error is not None:
            talk.say_failure(record.input, record.error)
    return exit_codes.of_files(len(everything), len(failed))
