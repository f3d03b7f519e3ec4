"""``msal report``: what earlier runs did, from their manifests and reports."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from msal_cli.cli import console
from msal_cli.cli.command import Request, grouped_command
from msal_cli.cli.options import MESSAGES, PATH, find_given, group, refuse_conflicts
from msal_cli.errors import UsageError
from msal_cli.job.records import Run
from msal_cli.storage.gzip_streams import read_whole
from msal_cli.storage.urls import is_url
from msal_cli.version import __version__

if TYPE_CHECKING:
    from msal_cli.batch.resume import FileRow, RunEntry, RunHistory
    from msal_cli.job.records import MeshRecord


@grouped_command(
    "report",
    group(
        "Reports",
        """
-o, --output FILE ... -> outputs
    Write a record of every file, in the format of the suffix; see --report of msal denoise.
    Repeatable.
--json
--csv-columns
""",
    ),
    group(
        "Gates",
        """
--fail-on EXPR ...
    As in msal denoise: exit with 4 if this is so for any file; implies --check. Repeatable.
--unit
--check
    Exit with 1 if all files failed, 3 if some failed, are not finished, or (in a folder or manifest
    named) are gone or changed since they were written, 4 if a gate in the report is broken.
""",
    ),
    group(MESSAGES, "--quiet\n-v, --verbose ...\n    List every file.\n"),
    arguments=[click.Argument(["runs"], metavar="RUN...", nargs=-1, required=True, type=PATH)],
)
def command(request: Request) -> int:
    """Report what earlier runs did, shards and reruns together, each file once.

    RUN is an output folder or its URL, a manifest in it, or a report in .json or .jsonl. Of several
    records of a file the newest counts. A file that a run set out to write and did not finish is
    planned.
    """
    from msal_cli.cli import report_files
    from msal_cli.job.records import MeshRecord
    from msal_cli.report import data, facts, text
    from msal_cli.report.gates import parse_gates, refuse_without_reference, with_gates

    refuse_conflicts(find_given(request.context))
    outputs, quiet, csv_columns = request.outputs, request.quiet, request.csv_columns
    # Checked before a large folder is read.
    report_files.check(outputs, ())
    gates = parse_gates(request.fail_on, MeshRecord, request.unit)
    is_checked = request.check or bool(gates)
    run, rows, remarks, paths = _summarize(request.runs, is_checked)
    found = [row.record for row in rows]
    done = [record for record in found if record.error is None and record.output]
    if done and all(record.reference is None for record in done):
        refuse_without_reference(gates, "name a JSON report of msal denoise --reference")
    records = named = with_gates(gates, found)
    if len({record.input for record in records}) < len(records):
        # Only their outputs tell them apart.
        here = os.path.join(os.getcwd(), "")
        names = ((row.output or row.input).removeprefix(here) for row in rows)
        pairs = zip(records, names, strict=True)
        named = [replace(record, input=name) for record, name in pairs]
    meshes = [path for record in records for path in (record.input, record.output) if path]
    report_files.check(outputs, [*paths, *meshes])
    if not quiet:
        console.say_summary(run, named, verbose=request.verbose > 0)
    elif request.fail_on:
        console.say_lines(text.list_problems(named, False, "Broken gates"))
    for remark in remarks:
        console.say(remark, "bad")
    if is_checked:
        report_files.annotate(records)
    try:
        report_files.write(outputs, run, records, named=named, csv_columns=csv_columns, quiet=quiet)
    finally:
        if request.as_json:
            console.put_bytes(data.render_json(run, records))
    if not is_checked:
        return console.SUCCESS
    statuses = [record.status for record in records]
    is_broken = any(map(facts.list_broken, records))
    status = console.status_of_files(
        len(records), statuses.count("failed"), is_gate_failed=is_broken
    )
    is_unfinished = "planned" in statuses or bool(remarks)
    return console.worst_status(status, console.SOME_FAILED) if is_unfinished else status


_WHAT_TO_NAME = "name an output folder, a manifest in it, or a report in .json or .jsonl"


def _summarize(
    names: Sequence[str], is_checked: bool
) -> tuple[Run, list[FileRow], list[str], list[str]]:
    """The run and the rows of these output folders, manifests and reports; remarks on what is
    missing or still going on; and the paths of the files that were read.

    ``is_checked`` also compares the outputs in local folders with their hashes.

    Raises UsageError for a name without a file, a folder or a manifest in it; FormatError for a
    file that is neither a manifest nor a report; OutputError or InputError if one cannot be read.
    """
    from msal_cli.batch import manifest, resume

    rows: list[FileRow] = []
    runs: list[RunEntry] = []
    remarks: list[str] = []
    paths: list[str] = []
    for name in dict.fromkeys(names):
        path, views, folder = Path(name), [], name
        if is_url(name) or path.is_dir():
            views = manifest.read_views(name)
            if not views:
                raise UsageError(
                    f"there is no manifest in the folder {name!r}",
                    hint="name the output folder of msal denoise (with --in-place the input)",
                    path=name,
                )
            history = resume.read_history(views, name)
            remarks += _missing_parts(history[0], name)
            paths += [] if is_url(name) else map(str, manifest.list_manifests(name))
        elif path.is_file():
            history = _read_file(path)
            paths.append(name)
            if path.name.startswith(manifest.PARTS_FOLDER):
                views, folder = [manifest.LogView.of(manifest.read_lines(path))], str(path.parent)
        else:
            raise UsageError(
                f"{name!r} is neither a regular file nor a folder"
                if path.exists()
                else f"there is no file or folder {name!r}",
                hint=_WHAT_TO_NAME,
                path=name,
            )
        if lost := resume.list_lost(views, folder) if is_checked and not is_url(folder) else []:
            more = f" and {len(lost) - 3:,} more" if len(lost) > 3 else ""
            remarks.append(f"gone or changed: {', '.join(map(repr, lost[:3]))}{more}")
        new_runs, new_rows = history
        runs += new_runs
        rows += new_rows if len(set(names)) == 1 else _locate(new_rows, path)
    if not runs and not rows:
        remarks.append(f"{', '.join(map(repr, names))}: no run is recorded, it is empty or damaged")
    newest = _newest_rows(rows)
    is_finished = not remarks and all(row.record.status != "planned" for row in newest)
    run = _combine(runs, is_finished) if runs else _unknown_run(rows, is_finished)
    return run, newest, remarks, paths


def _locate(rows: Sequence[FileRow], source: Path) -> list[FileRow]:
    """The rows of a folder, manifest or report with absolute paths.

    The paths of a run start in a folder that is not recorded: the nearest at or above ``source``,
    or the current one, that has one of its first files.  If there is none, files that only a report
    has are not those of any other source.
    """
    from msal_cli.batch import inputs, manifest

    is_manifest = source.name.startswith(manifest.PARTS_FOLDER)
    source = inputs.resolve(source.parent if is_manifest else source)
    # A few files show where the folder is.
    records = [row.record for row in rows[:10]]
    names = [name for record in records for name in (record.input, record.output) if name]
    folders = (source, *source.parents, Path.cwd())
    # Only absolute names keep their place below what is no folder.
    base = next(
        (folder for folder in folders if any(map(os.path.isfile, map(folder.joinpath, names)))),
        source,
    )

    def locate(name: str) -> str:
        return name if not name or is_url(name) else str(inputs.resolve(base / name))

    def split(path: str) -> tuple[str, str]:
        stem = os.path.splitext(path.removesuffix(".gz"))[0]
        return os.path.dirname(path), path.removeprefix(stem)

    # In a report a failure has no output; it would be beside that of a file like it.
    like = {split(row.input): split(row.output) for row in rows if row.output}
    located = []
    for row in rows:
        output = row.output
        if not output and (place := like.get(split(row.input))):
            name = os.path.basename(row.input).removesuffix(split(row.input)[1])
            output = os.path.join(place[0], name + place[1])
        located.append(replace(row, input=locate(row.input), output=locate(output)))
    return located


def _missing_parts(runs: Sequence[RunEntry], name: str) -> list[str]:
    """Remarks on what is not finished in a folder: the newest run, or shards of it."""
    from msal_cli.batch.lock import lock_owners

    # A store has no locks.
    at_work = () if is_url(name) else lock_owners(name)
    if at_work:
        return [f"{' and '.join(at_work[:3])} still at work on {name!r}"]
    if not runs:
        return []
    newest = runs[-1]
    alike = [run for run in runs if run.configuration == newest.configuration]
    last = {str(run.shard or ""): run for run in alike}
    ended = {key for key, run in last.items() if not run.interrupted}
    if any(ended.issuperset(_all_shards(run)) for run in last.values()):
        return []
    if newest.shard is None:
        return [f"the run that began at {newest.started} in {name!r} did not come to its end"]
    lost = [key for key in _all_shards(newest) if key not in ended]
    more = f" and {len(lost) - 10:,} more" if len(lost) > 10 else ""
    return [f"in {name!r} did not run, or not to the end: shard {', '.join(lost[:10])}{more}"]


def _all_shards(run: RunEntry) -> list[str]:
    """The shards of the whole that a run is a part of; one empty name for a whole run."""
    count = 0 if run.shard is None else run.shard.count
    return [f"{k}/{count}" for k in range(1, count + 1)] or [""]


def _read_file(path: Path) -> RunHistory:
    from msal_cli.batch import manifest, resume
    from msal_cli.report.data import read_json, read_lines

    name = str(path)
    data = bytes(read_whole(name))
    at = path.stat().st_mtime_ns
    records: Iterable[MeshRecord]
    runs: list[RunEntry] = []
    if path.suffix.lower() == ".jsonl":
        if b'"kind":' in data.lstrip()[:10]:
            view = manifest.LogView.of(manifest.read_lines(path))
            return resume.read_history([view], str(path.parent))
        records = read_lines(data, name)
    elif path.suffix.lower() == ".json":
        run, records = read_json(data, name)
        ended = _parse_time(run.finished)
        at = at if ended is None else int(ended * 1e9)
        runs = [resume.RunEntry(**vars(run), at=at)]
    else:
        raise UsageError(
            f"the suffix of {name!r} is not that of a report that can be read",
            hint=_WHAT_TO_NAME,
            path=name,
        )
    rows = [resume.FileRow(at, made.input, made.output or "", made) for made in records]
    return runs, rows


def _newest_rows(rows: Sequence[FileRow]) -> list[FileRow]:
    """One row for each file, by the path of its input."""
    named = {row.input for row in rows if row.output}
    newest: dict[str, dict[str, FileRow]] = {}
    for row in sorted(rows, key=lambda row: (row.at, not row.output)):
        by_output = newest.setdefault(row.input, {})
        if row.output or row.input not in named:
            by_output[row.output] = row
        else:
            # A failure without an output counts for all outputs of its input.
            by_output.update(dict.fromkeys(by_output, row))
    # Several outputs of one input may have the same failure.
    last = {id(row): row for by_output in newest.values() for row in by_output.values()}
    return sorted(last.values(), key=lambda row: row.record.input.split("/"))


def _combine(runs: Sequence[RunEntry], is_finished: bool) -> Run:
    """The newest of several runs, with the time span of all runs of the same version and settings,
    and the seconds in which at least one of these was running."""
    newest = max(runs, key=lambda run: run.at)
    alike = [run for run in runs if run.configuration == newest.configuration]
    seconds, reached = 0.0, float("-inf")
    starts = [(_parse_time(run.started), run.seconds) for run in alike]
    spans = [(start, start + s) for start, s in starts if start is not None and s > 0.0]
    for start, stop in sorted(spans):
        seconds += max(0.0, stop - max(start, reached))
        reached = max(reached, stop)
    return Run(
        version=newest.version,
        command=newest.command,
        settings=newest.settings,
        started=min(run.started for run in alike),
        finished=max(run.finished for run in alike),
        seconds=round(seconds, 3),
        interrupted=not is_finished,
    )


def _unknown_run(rows: Sequence[FileRow], is_finished: bool) -> Run:
    """A run for a report in .jsonl, which has only records of files."""
    from msal_cli.machine import iso_timestamp

    times = [row.at for row in rows] or [0]
    newest = max(rows, key=lambda row: row.at).record.version if rows else ""
    return Run(
        version=newest or __version__,
        command=(),
        settings={},
        started=iso_timestamp(min(times)),
        finished=iso_timestamp(max(times)),
        seconds=0.0,
        interrupted=not is_finished,
    )


def _parse_time(timestamp: str) -> float | None:
    """Seconds since 1970 of a timestamp in a report; None if it is invalid."""
    try:
        return datetime.fromisoformat(timestamp).timestamp()
    except (ValueError, OverflowError):
        return None
