"""``msal report``: what earlier runs did, from what they left behind."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import click

from msal_cli.cli import console, exit_codes, options
from msal_cli.cli.command import MESSAGES, group
from msal_cli.cli.command import command as grouped_command
from msal_cli.cli.conflicts import find_given, refuse_conflicts
from msal_cli.cli.methods import list_defaults

if TYPE_CHECKING:
    from msal_cli.cli.run_summary import RunSummary


@grouped_command("report", epilog="Exit status: see msal --help.")
@click.argument("runs", metavar="RUN...", nargs=-1, required=True, type=options.PATH)
@group(
    "Reports",
    click.option(
        "-o",
        "--output",
        "outputs",
        metavar="FILE",
        multiple=True,
        type=options.PATH,
        help="Write a record of every file, in the format of the suffix; see --report of msal "
        "denoise. Repeatable.",
    ),
    options.JSON_REPORT,
    options.CSV_COLUMNS,
)
@group(
    "Gates",
    click.option(
        "--fail-on",
        metavar="EXPR",
        multiple=True,
        help="As in msal denoise: exit with 4 if this is so for any file; implies --check. "
        "Repeatable.",
    ),
    options.UNIT,
    click.option(
        "--check",
        is_flag=True,
        help="Exit with 1 if all files failed, 3 if some failed or are not finished, 4 if a gate "
        "in the report is broken.",
    ),
)
@group(
    MESSAGES,
    options.QUIET,
    click.option("-v", "--verbose", count=True, help="List every file."),
)
@click.pass_context
def command(
    context: click.Context,
    /,
    runs: tuple[str, ...],
    outputs: tuple[str, ...],
    fail_on: tuple[str, ...],
    unit: str | None,
    as_json: bool,
    csv_columns: str | None,
    check: bool,
    quiet: bool,
    verbose: int,
) -> int:
    """Report what earlier runs did, shards and reruns together, each file once.

    RUN is an output folder or its URL, a manifest in it, or a report in .json or .jsonl. Of several
    records of a file the newest counts. A file that a run set out to write and did not finish is
    planned.
    """
    from dataclasses import replace

    from msal_cli.cli import github, report_files, run_summary
    from msal_cli.job.records import MeshRecord
    from msal_cli.report import json_report, text
    from msal_cli.report.gates import parse_gates, refuse_without_reference, with_gates

    refuse_conflicts(find_given(context))
    # Checked before a large folder is read.
    report_files.check(outputs, (), csv_columns)
    gates = parse_gates(fail_on, MeshRecord, unit)
    account = run_summary.summarize(runs)
    done = [record for record in account.records if record.error is None and record.output]
    if done and all(record.reference is None for record in done):
        refuse_without_reference(gates, "name a JSON report of msal denoise --reference")
    account = replace(account, records=tuple(with_gates(gates, account.records)))
    meshes = [path for one in account.records for path in (one.input, one.output) if path]
    report_files.check(outputs, [*account.paths, *meshes])
    if not quiet:
        console.say_lines(
            text.summary(
                account.run,
                account.records,
                width=console.width(sys.stderr),
                verbose=verbose > 0,
                defaults=list_defaults(account.records),
            )
        )
    elif fail_on:
        console.say_lines(text.broken_gates(account.records, verbose=False))
    for remark in account.remarks:
        console.say(remark, "bad")
    if check or gates:
        github.annotate(account.records)
    try:
        report_files.write(
            outputs, account.run, account.records, csv_columns=csv_columns, quiet=quiet
        )
    finally:
        if as_json:
            console.put_bytes(json_report.render(account.run, account.records))
    return _exit_status(account) if check or gates else exit_codes.SUCCESS


def _exit_status(account: RunSummary) -> int:
    """The status of a run that left this behind; what is not finished counts as failed."""
    from msal_cli.report.gates import is_any_broken

    n_lost = sum(record.status in ("failed", "planned") for record in account.records)
    status = exit_codes.of_files(
        len(account.records), n_lost, is_gate_failed=is_any_broken(account.records)
    )
    return status if account.is_whole else exit_codes.worst(status, exit_codes.SOME_FAILED)
