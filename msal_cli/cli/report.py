"""``msal report``: what earlier runs did, from what they left behind."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from msal_cli.cli import console as talk
from msal_cli.cli import exit_codes
from msal_cli.cli.file_options import UNIT
from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from msal_cli.cli.run_summary import RunSummary

_PATH = click.Path(readable=False, allow_dash=True)


@dataclass(frozen=True)
class Request:
    """The command line of ``msal report``, as click has read it."""

    runs: tuple[str, ...]
    outputs: tuple[str, ...]
    fail_on: tuple[str, ...]
    unit: str | None
    as_json: bool
    check: bool
    quiet: bool
    verbose: int


@click.command(
    "report", short_help="Report on earlier runs.", epilog="Exit status: see msal --help."
)
@click.argument("runs", metavar="RUN...", nargs=-1, required=True, type=_PATH)
@click.option(
    "-o",
    "--output",
    "outputs",
    metavar="FILE",
    multiple=True,
    type=_PATH,
    help="Write a record of every file, in the format of the suffix; see --report of msal denoise. "
    "Repeatable.",
)
@click.option(
    "--fail-on",
    metavar="EXPR",
    multiple=True,
    help="As in msal denoise: exit with 4 if this is so for any file; implies --check. Repeatable.",
)
@UNIT
@click.option("--json", "as_json", is_flag=True, help="Print the JSON report to standard output.")
@click.option(
    "--check",
    is_flag=True,
    help="Exit with 1 if all files failed, 3 if some failed or are not finished, 4 if a gate in "
    "the report is broken.",
)
@click.option("-q", "--quiet", is_flag=True, help="No summary; only errors.")
@click.option("-v", "--verbose", count=True, help="List every file.")
def command(**options: Any) -> int:
    """Tell what earlier runs did, shards and reruns together, each file once.

    RUN is an output folder or its URL, a manifest in it, or a report in .json or .jsonl. Of several
    records of a file the newest counts. A file that a run set out to write and did not finish is
    planned.
    """
    from msal_cli.storage import urls

    request = Request(**urls.settled_in(options, "runs", "outputs"))
    if request.quiet and request.verbose:
        raise UsageError("--quiet and --verbose contradict each other", hint="give one of them")
    return _reported(request)


def _reported(request: Request) -> int:
    from dataclasses import replace

    from msal_cli.cli import github, run_summary
    from msal_cli.cli import report_files as reports
    from msal_cli.job.records import MeshRecord
    from msal_cli.report import json_report as as_json
    from msal_cli.report import text as as_text
    from msal_cli.report.gates import parsed, refuse_without_reference, with_gates

    # What says nothing is cheaper to refuse before a large folder is read.
    reports.check(request.outputs, ())
    gates = parsed(request.fail_on, MeshRecord, request.unit)
    account = run_summary.summarize(request.runs)
    done = [record for record in account.records if record.error is None and record.output]
    if done and all(record.reference is None for record in done):
        refuse_without_reference(gates, "name a JSON report of msal denoise --reference")
    account = replace(account, records=tuple(with_gates(gates, account.records)))
    meshes = [path for one in account.records for path in (one.input, one.output) if path]
    reports.check(request.outputs, [*account.paths, *meshes])
    if not request.quiet:
        lines = as_text.summary(
            account.run, account.records, width=talk.width(), verbose=request.verbose > 0
        )
        talk.say_lines(lines)
    elif request.fail_on:
        talk.say_lines(as_text.broken_gates(account.records, verbose=False))
    for remark in account.remarks:
        talk.say(remark, "bad")
    if request.check or gates:
        github.annotate(account.records)
    try:
        reports.write(request.outputs, account.run, account.records, is_quiet=request.quiet)
    finally:
        if request.as_json:
            talk.put_bytes(as_json.encoded(account.run, account.records))
    return _status(account) if request.check or gates else exit_codes.SUCCESS


def _status(account: RunSummary) -> int:
    """The status of a run that left this behind; what is not finished counts as failed."""
    from msal_cli.report.gates import is_any_broken

    n_lost = sum(record.status in ("failed", "planned") for record in account.records)
    status = exit_codes.of_files(
        len(account.records), n_lost, is_gate_failed=is_any_broken(account.records)
    )
    return status if account.is_whole else exit_codes.worst(status, exit_codes.SOME_FAILED)
