"""``msal compare``: meshes, or a folder of meshes, against a reference."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import click

from msal_cli.batch import interrupts
from msal_cli.cli import console, options
from msal_cli.cli.command import Request, grouped_command
from msal_cli.cli.options import PATH, STREAM, find_given, group, refuse_conflicts, resolve_format
from msal_cli.errors import UsageError
from msal_cli.storage import gzip_streams
from msal_cli.version import __version__

if TYPE_CHECKING:
    from msal_cli.job.records import ComparisonRecord
    from msal_cli.report.gates import Gate

_NO_PARTNER = "E_NO_PARTNER"

_HEAT_MAP = r"ply\r?\nformat [^\n]*\n(comment [^\n]*\n)*?comment msal [^\n]*: deviation from "
"""A pattern for the beginning of a heat map that an earlier call wrote."""


@grouped_command(
    "compare",
    group("Input and output", "--include\n--exclude\nmore:\n--format\n"),
    group(
        "What to measure",
        """
--heatmap FILE.ply
    Write B as PLY with its distance from A, vertex by vertex, as property deviation and as
    colours; comments in the file give their range.
more:
--check
--unit
""",
    ),
    group(
        "Gates",
        """
--fail-on EXPR ...
    Exit with 4 if this is so for any pair, such as 'mean_angular_error_deg > 6' or 'hausdorff >
    0.5e' (mean edge lengths of A). Repeatable.
--baseline REPORT.json
    Exit with 4 if a figure is worse than in REPORT.json: what --json printed before, or a report
    of msal denoise --reference.
more:
--tolerance PERCENT
    With --baseline: by how much of what it was a figure may be worse, such as 2%. [default: 1%]
""",
    ),
    group(
        "Reports",
        """
--json -> as_json
    Print one JSON object for two files; for more files and for folders one document, whose records
    list holds an object per pair.
""",
    ),
    group(options.MESSAGES, "--verbose\n"),
    arguments=[
        click.Argument(["before"], metavar="A", type=PATH),
        click.Argument(["others"], metavar="B...", nargs=-1, required=True, type=PATH),
    ],
    examples="""
  msal compare truth.ply denoised.ply --heatmap deviation.ply
  msal compare truth.ply plain.ply auto.ply msal.ply
  msal compare scans denoised --json > known.json
  msal compare scans denoised --baseline known.json --tolerance 2%
""",
)
def command(request: Request) -> int:
    """Measure B against A, which is the reference: before and after, or truth and result.

    A and B are two files, or two folders whose files are matched by relative path. With more than
    one file B there is a table, a row for each. Measured are
    the displacement, the angles between face normals (mean: the MSAE of the literature), the vertex
    error in % of the mean edge length of A, the change of volume and area, flipped faces, and the
    Hausdorff distance. Where the faces are not the same, the surfaces are compared.

    Of folders and of more than two files the exit status is 3 if a pair cannot be compared, else 4
    if a gate is broken or the baseline not met, else 3 if a file has no partner; 1 if no pair at
    all can be compared.
    """
    from msal_cli.batch.inputs import discover_inputs
    from msal_cli.cli.report_files import refuse_target, require_files
    from msal_cli.job.comparison import compare_files, open_mesh_file
    from msal_cli.job.fields import path_beside
    from msal_cli.job.records import ComparisonRecord, Failure
    from msal_cli.report.comparison import read_comparisons
    from msal_cli.report.gates import need_intersections, parse_gates

    refuse_conflicts(find_given(request.context))
    gates = parse_gates(request.fail_on, ComparisonRecord, request.unit)
    if STREAM in (request.before, *request.others):
        raise UsageError("A and B are files", hint="write the stream to a file first")
    earlier = None
    if (baseline := request.baseline) is not None:
        require_files((baseline,))
        earlier = read_comparisons(bytes(gzip_streams.read_whole(baseline)), baseline)
    request.format = resolve_format(request.format)
    before, others, heatmap = request.before, request.others, request.heatmap
    patterns = request.include, request.exclude
    sides = [discover_inputs((path,), *patterns) for path in (before, *others)]
    is_checked = bool(request.checks) or need_intersections(gates)
    # The heat map is made of the files that were measured; a second download would take long.
    read = partial(open_mesh_file, unit=request.unit)
    open_file = request.open_file = read if heatmap is None else cache(read)
    compare = partial(
        compare_files, format=request.format, with_intersections=is_checked, open_file=open_file
    )
    are_folders = [any(file.root for file in side) for side in sides]
    after = others[0]
    if any(are_folders) and are_folders != [True, True]:
        raise UsageError(
            "A and B are files and folders",
            hint="give files, or two folders whose files have the same relative paths",
        )
    if heatmap is not None:
        if any(are_folders) or len(others) > 1:
            raise UsageError("--heatmap is for two files", hint="compare them one by one")
        if not heatmap.lower().endswith(".ply"):
            raise UsageError(
                f"the heat map {heatmap!r} must be a PLY", hint="name it with the suffix .ply"
            )
        refuse_target(heatmap, "the heat map", (before, after), replaces=_HEAT_MAP)
    if not any(are_folders):
        pairs = {path: compare(before, path) for path in others}
        is_pair = len(pairs) == 1
        return _conclude(request, gates, earlier, pairs, is_pair=is_pair, is_all=not is_pair)
    first, second = ({file.relative: file.path for file in side} for side in sides)
    for side in (first, second):
        # Files that --fields wrote beside a mesh are not compared.
        for name in [path_beside(name) for name in side]:
            side.pop(name, None)
    records = {}
    for name in dict.fromkeys((*first, *second)):
        missing = before if name not in first else after if name not in second else None
        paths = (
            first.get(name, f"{before.rstrip('/')}/{name}"),
            second.get(name, f"{after.rstrip('/')}/{name}"),
        )
        if missing is None:
            records[name] = compare(*paths)
        else:
            failure = Failure(_NO_PARTNER, f"there is no {name!r} in {missing!r}")
            records[name] = ComparisonRecord(*paths, version=__version__, error=failure)
    # Files that were excluded on purpose are not reported as missing.
    is_all = not any(patterns)
    return _conclude(request, gates, earlier, records, is_all=is_all)


def _write_heatmap(request: Request) -> None:
    from msal_cli.job.comparison import build_heatmap
    from msal_cli.job.room import DISTANCES_BYTES_PER_FACE, room_for_files
    from msal_cli.report.facts import file_name
    from msal_cli.storage import atomic

    paths, target = (request.before, *request.others), request.heatmap
    with room_for_files(paths, request.format, bytes_per_face=DISTANCES_BYTES_PER_FACE):
        before, after = (request.open_file(path, request.format) for path in paths)
        data, low, high = build_heatmap(before, after, request.before)
        with interrupts.catch_signals():
            atomic.write_whole(target, [data], sources=paths)
    console.say(f"{file_name(target)}: deviation, pale to dark for {low:g} to {high:.4g}")


def _conclude(
    request: Request,
    gates: Sequence[Gate],
    earlier: Mapping[str, Any] | None,
    pairs: Mapping[str, ComparisonRecord],
    *,
    is_all: bool,
    is_pair: bool = False,
) -> int:
    """Check the gates of the records, by relative path or by the name of B, and print them; returns
    the exit status.

    ``earlier`` are the figures of the baseline by path; None without one.  ``is_all``: all files
    were compared, so files that only the baseline has are missing.  ``is_pair``: A and B are files.
    """
    from msal_cli.job.records import ComparisonRecord
    from msal_cli.report import comparison, data
    from msal_cli.report.facts import Line, file_name, gate_text, list_broken
    from msal_cli.report.gates import with_gates

    known = earlier or {}
    tolerance = 0.01 if request.tolerance is None else request.tolerance
    records = with_gates(gates, [*pairs.values()])
    for at, (name, record) in enumerate(zip(pairs, records, strict=True)):
        # A baseline of one pair is for this pair, whatever the files are called.
        is_of_pair = is_pair and len(known) == 1
        then = next(iter(known.values())) if is_of_pair else comparison.find_partner(name, known)
        if record.error is None and then is not None:
            broken = comparison.compare_with_baseline(record, then, tolerance)
            records[at] = replace(record, gates=record.gates + broken)
        elif record.error is None and is_pair and earlier is not None:
            raise UsageError(
                f"the baseline has no figures of {name!r}",
                hint="make it anew with msal compare --json",
            )
    failures = [record for record in records if record.error is not None]
    present = [
        name
        for name, record in pairs.items()
        if record.error is None or record.error.code != _NO_PARTNER
    ]
    vanished = comparison.list_missing(present, known) if is_all else []
    try:
        if request.as_json and is_pair:
            console.put_bytes(data.json_bytes(data.plain(records[0])))
        elif request.as_json:
            console.put_json(ComparisonRecord.schema, records=records)
        elif not is_pair:
            console.put_lines(comparison.comparison_table(records, width=console.width(sys.stdout)))
        elif not failures:
            console.put_lines(comparison.describe_comparison(records[0]))
        if request.as_json or is_pair:
            for record in failures:
                assert record.error is not None
                name = record.before if record.at_fault == "before" else record.after
                console.say_failure(name, record.error)
        console.say_lines(
            Line(f"{file_name(record.after)}: {gate_text(gate)}", "bad")
            for record in records
            for gate in list_broken(record)
        )
        for name in vanished:
            console.say(f"{file_name(name)}: in the baseline, and not here", "bad")
    finally:
        # Write the heat map even if printing fails.
        if request.heatmap is not None and not failures:
            _write_heatmap(request)
    # A pair that cannot be compared outweighs a broken gate, which outweighs a missing partner.
    is_gate_failed = any(map(list_broken, records)) or bool(vanished)
    if is_gate_failed and len(failures) == len(records) - len(present) < len(records):
        return console.GATE_FAILED
    return console.status_of_files(len(records), len(failures))
