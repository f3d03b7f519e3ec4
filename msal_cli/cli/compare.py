"""``msal compare``: a mesh, or a folder of meshes, against a reference."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from msal_cli.cli import console as talk
from msal_cli.cli import exit_codes
from msal_cli.cli.file_options import CHECK, UNIT, file_options
from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from msal_cli.batch.inputs import DiscoveredInput
    from msal_cli.cli.gates_check import Measure
    from msal_cli.job.records import ComparisonRecord, Failure

_PATH = click.Path(readable=False, allow_dash=False)

_NO_PARTNER = "E_NO_PARTNER"


@dataclass(frozen=True)
class Request:
    """The command line of ``msal compare``, as click has read it."""

    before: str
    after: str
    heatmap: str | None
    include: tuple[str, ...]
    exclude: tuple[str, ...]
    format: str | None
    fail_on: tuple[str, ...]
    unit: str | None
    checks: tuple[str, ...]
    baseline: str | None
    tolerance: float | None
    ignore_missing: bool
    as_json: bool
    verbose: int


def _tolerance(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> float | None:
    """A share that is written in percent; None for None."""
    if value is None:
        return None
    match = re.fullmatch(r"(?a)(\d{1,9}(?:\.\d{1,9})?)\s*%", value.strip())
    if match is None:
        raise click.BadParameter(f"{value!r} is not a percentage such as 2% or 0.5%")
    return float(match[1]) / 100.0


@click.command(
    "compare",
    short_help="Measure a mesh against another.",
    epilog="""\b
Examples:
  msal compare truth.ply denoised.ply --heatmap deviation.ply
  msal compare scans denoised --json > known.json
  msal compare scans denoised --baseline known.json --tolerance 2%
\b
Exit status: see msal --help.""",
)
@click.argument("before", metavar="A", type=_PATH)
@click.argument("after", metavar="B", type=_PATH)
@click.option(
    "--heatmap",
    metavar="FILE.ply",
    type=_PATH,
    help="Write B as PLY with its distance from A, vertex by vertex, as property deviation and as "
    "colours; comments in the file tell their range.",
)
@file_options("The files' format, where neither their names nor their content tells.")
@click.option(
    "--fail-on",
    metavar="EXPR",
    multiple=True,
    help="Exit with 4 if this is so for any pair, such as 'mean_angular_error_deg > 6' or "
    "'hausdorff > 0.5e' (mean edge lengths of A). Repeatable.",
)
@UNIT
@CHECK
@click.option(
    "--baseline",
    metavar="REPORT.json",
    type=_PATH,
    help="Exit with 4 if a figure is worse than in REPORT.json: what --json printed before, or a "
    "report of msal denoise --reference.",
)
@click.option(
    "--tolerance",
    metavar="PERCENT",
    callback=_tolerance,
    help="With --baseline: by how much of what it was a figure may be worse, such as 2%.  "
    "[default: 1%]",
)
@click.option(
    "--ignore-missing",
    is_flag=True,
    help="Of folders: leave out files that only one of them has, and figures of the baseline whose "
    "files are not there.",
)
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print one JSON object for two files; for folders one document, whose records list holds "
    "an object per pair.",
)
@click.option(
    "-v", "--verbose", count=True, help="Tell more of what goes on; -vv tells everything."
)
def command(**options: Any) -> int:
    """Measure B against A, which is the reference: before and after, or truth and result.

    A and B are two files, or two folders whose files are matched by relative path. Told are the
    displacement, the angles between face normals (mean: the MSAE of the literature), the vertex
    error in % of the mean edge length of A, the change of volume and area, flipped faces, and the
    Hausdorff distance. Where the faces are not the same, the surfaces are compared.

    Of folders the exit status is 3 if a pair cannot be compared, else 4 if a gate is broken or the
    baseline not met, else 3 if a file has no partner; 1 if no pair at all can be compared.
    """
    from msal_cli.cli import logs
    from msal_cli.storage import urls

    request = Request(**urls.settled_in(options, "before", "after", "heatmap"))
    with logs.configured(request.verbose, None):
        return _compared(request)


def _compared(request: Request) -> int:
    from functools import partial

    from msal_cli import codecs as files
    from msal_cli.batch.inputs import discover_inputs
    from msal_cli.cli import option_types as words
    from msal_cli.cli.gates_check import measure_of
    from msal_cli.job import comparison

    measure = measure_of(request.fail_on, request.baseline, request.tolerance, request.unit)
    format = words.settled_format(request.format, files.readable_suffixes, "--format")
    before, after = (
        discover_inputs((one,), request.include, request.exclude)
        for one in (request.before, request.after)
    )
    is_checked = bool(request.checks) or measure.names_field("self_intersections")
    compare = partial(comparison.compare_files, format=format, with_intersections=is_checked)
    are_folders = [any(one.root for one in side) for side in (before, after)]
    if are_folders == [False, False]:
        if request.ignore_missing:
            raise UsageError("--ignore-missing is for folders", hint="leave it out for two files")
        if request.heatmap is not None:
            _refuse_target(request, request.heatmap)
        return _told_of_two(request, compare, measure)
    if not all(are_folders):
        raise UsageError(
            "one of A and B is a file and the other a folder",
            hint="give two files, or two folders whose files have the same relative paths",
        )
    if request.heatmap is not None:
        raise UsageError("--heatmap is for two files", hint="compare them one by one")
    if request.ignore_missing:
        before, after = _with_partners(request, before, after)
    pairs = dict(_pairs(request, before, after, compare))
    return _told_of_many(request, pairs, measure)


def _with_partners(
    request: Request, before: tuple[DiscoveredInput, ...], after: tuple[DiscoveredInput, ...]
) -> tuple[tuple[DiscoveredInput, ...], tuple[DiscoveredInput, ...]]:
    """The files of both folders that have a partner; the number of the others is reported.

    Raises
    ------
    NothingMatched
        if there is none.
    """
    from msal_cli.batch.inputs import NothingMatched

    shared = {one.relative for one in before} & {one.relative for one in after}
    if not shared:
        raise NothingMatched(
            f"no file of {request.before!r} has the relative path of one of {request.after!r}"
        )
    for folder, side in ((request.before, before), (request.after, after)):
        if n_left := sum(one.relative not in shared for one in side):
            files = "file has" if n_left == 1 else "files have"
            talk.say(f"{n_left:,} {files} no partner, only in {folder}: left out")
    kept = [tuple(one for one in side if one.relative in shared) for side in (before, after)]
    return kept[0], kept[1]


def _pairs(
    request: Request,
    before: tuple[DiscoveredInput, ...],
    after: tuple[DiscoveredInput, ...],
    compare: Callable[[str, str], ComparisonRecord],
) -> Iterator[tuple[str, ComparisonRecord]]:
    """Every relative path that one of the folders has and its record, those of A first."""
    partners = {one.relative: one.path for one in after}
    for one in before:
        other = partners.pop(one.relative, None)
        if other is None:
            lonely = _lonely(one, one.path, _place(request.after, one), request.after)
            yield one.relative, lonely
        else:
            yield one.relative, compare(one.path, other)
    for one in after:
        if one.relative in partners:
            lonely = _lonely(one, _place(request.before, one), one.path, request.before)
            yield one.relative, lonely


def _place(folder: str, one: DiscoveredInput) -> str:
    return f"{folder.rstrip('/')}/{one.relative}"


def _lonely(one: DiscoveredInput, before: str, after: str, folder: str) -> ComparisonRecord:
    from msal_cli import __version__
    from msal_cli.job.records import ComparisonRecord, Failure

    failure = Failure(_NO_PARTNER, f"there is no {one.relative!r} in {folder!r}")
    return ComparisonRecord(before, after, version=__version__, error=failure)


def _told_of_two(
    request: Request, compare: Callable[[str, str], ComparisonRecord], measure: Measure
) -> int:
    from msal_cli.errors import MsalError
    from msal_cli.report import comparison_text, document
    from msal_cli.report import json_report as as_json
    from msal_cli.report.gates import is_any_broken

    record = measure.of_two(compare(request.before, request.after))
    failure: MsalError | None = None
    if request.heatmap is not None and record.error is None:
        # What was measured is told, whatever becomes of the picture.
        try:
            _write_heatmap(request, request.heatmap)
        except MsalError as error:
            failure = error
    if request.as_json:
        talk.put_bytes(as_json.json_bytes(document.plain_record(record)))
    if record.error is not None:
        _say_failure(record, record.error)
        return exit_codes.FATAL
    if not request.as_json:
        talk.put_lines(comparison_text.told(record))
    talk.say_lines(comparison_text.broken_gates([record]))
    if failure is not None:
        raise failure
    return exit_codes.of_files(1, 0, is_gate_failed=is_any_broken([record]))


def _refuse_target(request: Request, target: str) -> None:
    """Refuse a heat map that is no PLY, would replace an input, or has no folder to be in."""
    import os

    from msal_cli.codecs import is_url

    if not target.lower().endswith(".ply"):
        raise UsageError(
            f"the heat map {target!r} must be a PLY", hint="name it with the suffix .ply"
        )
    if is_url(target):
        return
    if os.path.isdir(target):
        raise UsageError(f"the heat map {target!r} is a folder", hint="name a file in it")
    real = os.path.realpath(target)
    for name in (request.before, request.after):
        if not is_url(name) and os.path.realpath(name) == real:
            raise UsageError(f"the heat map would replace {name!r}", hint="give it another name")


def _write_heatmap(request: Request, target: str) -> None:
    from msal_cli import codecs as files
    from msal_cli.batch import interrupts as signals
    from msal_cli.cli import option_types as words
    from msal_cli.job import comparison
    from msal_cli.report.text import file_name

    format = words.settled_format(request.format, files.readable_suffixes, "--format")
    before = comparison.opened(request.before, format)
    made = comparison.heatmap(before, comparison.opened(request.after, format), request.before)
    with signals.noticed(signals.raise_for):
        files.write_whole(target, [made.data])
    talk.say(f"{file_name(target)}: deviation, pale to dark for {made.low:g} to {made.high:.4g}")


def _told_of_many(request: Request, pairs: Mapping[str, ComparisonRecord], measure: Measure) -> int:
    from msal_cli import __version__
    from msal_cli.job.records import ComparisonRecord
    from msal_cli.report import comparison_text, document
    from msal_cli.report import json_report as as_json
    from msal_cli.report.gates import is_any_broken
    from msal_cli.report.text import file_name

    names = list(pairs)
    records = measure.of_many(list(pairs.values()), names)
    # Who leaves out files by a pattern does not miss them.
    is_all = not request.include and not request.exclude and not request.ignore_missing
    there = [name for name, one in pairs.items() if not _is_lonely(one)]
    vanished = measure.vanished(there) if is_all else []
    if request.as_json:
        data = {
            "schema": ComparisonRecord.schema,
            "version": __version__,
            "records": [document.plain_record(record) for record in records],
        }
        talk.put_bytes(as_json.json_bytes(data))
        for record in records:
            if record.error is not None:
                _say_failure(record, record.error)
    else:
        talk.put_lines(comparison_text.table(records, width=talk.width()))
    talk.say_lines(comparison_text.broken_gates(records))
    for name in vanished:
        talk.say(f"{file_name(name)}: in the baseline, and not here", "bad")
    return _status(records, is_gate_failed=is_any_broken(records) or bool(vanished))


def _status(records: Sequence[ComparisonRecord], *, is_gate_failed: bool) -> int:
    """The exit status for folders: a pair that cannot be compared weighs more than a broken gate,
    and that more than a file without a partner."""
    n_failed = sum(record.error is not None for record in records)
    n_lonely = sum(map(_is_lonely, records))
    if is_gate_failed and n_failed == n_lonely < len(records):
        return exit_codes.GATE_FAILED
    return exit_codes.of_files(len(records), n_failed)


def _is_lonely(record: ComparisonRecord) -> bool:
    return record.error is not None and record.error.code == _NO_PARTNER


def _say_failure(record: ComparisonRecord, error: Failure) -> None:
    """Tell why two files could not be compared, under the name of the one that is at fault."""
    from dataclasses import replace

    for path in (record.before, record.after):
        if error.where == path or error.where.startswith(f"{path}: "):
            talk.say_failure(path, replace(error, where=error.where[len(path) + 2 :]))
            return
    talk.say_failure(record.after, error)
