"""Earlier runs, from what they left behind: one account of all, each file once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msal_cli.errors import InputError, UsageError
from msal_cli.report.document import Run
from msal_cli.storage.urls import is_url

if TYPE_CHECKING:
    from msal_cli.batch.run_history import History, Row, RunNote
    from msal_cli.job.records import MeshRecord


@dataclass(frozen=True)
class Account:
    """What earlier runs did.

    ``remarks`` say in words what is missing or still going on; it ``is_whole`` if nothing is.
    ``paths`` are the files that it was read from.
    """

    run: Run
    records: tuple[MeshRecord, ...]
    remarks: tuple[str, ...]
    is_whole: bool
    paths: tuple[str, ...]


@dataclass(frozen=True)
class _Call:
    """A run, and where in time it stands among others (nanoseconds since 1970)."""

    at: int
    run: Run


def account(names: Sequence[str]) -> Account:
    """What the runs did that these output folders, manifests and reports tell of.

    Of several records of a file, told apart by the paths of its input and output, the newest
    counts.  The run is the newest one; its times span all runs of the same version and settings,
    and its seconds are those in which any of them was at work.

    Raises
    ------
    UsageError : there is no such file or folder, or no manifest in the folder.
    FormatError : a file is neither a manifest nor a report.
    OutputError, InputError : a file cannot be read.
    """
    rows: list[Row] = []
    calls: list[_Call] = []
    remarks: list[str] = []
    paths: list[str] = []
    is_whole = True
    for name in dict.fromkeys(names):
        path = Path(name)
        if is_url(name) or path.is_dir():
            history, missing = _of_folder(name)
            remarks += missing
            is_whole &= not missing
        elif path.is_file():
            history = _of_file(path)
        else:
            is_there = path.exists()
            raise UsageError(
                f"{name!r} is neither a regular file nor a folder"
                if is_there
                else f"there is no file or folder {name!r}",
                hint="name an output folder, a manifest in it, or a report in .json or .jsonl",
                path=name,
            )
        rows += history.rows
        calls += [_Call(one.at, _as_run(one)) for one in history.runs]
        paths += [] if is_url(name) else _read_from(path)
    records = _newest(rows)
    is_finished = is_whole and not any(record.status == "planned" for record in records)
    run = _together(calls, rows, is_finished=is_finished)
    return Account(run, tuple(records), tuple(remarks), is_whole, tuple(paths))


def _read_from(path: Path) -> list[str]:
    from msal_cli.batch.manifest import paths_in

    return [str(one) for one in paths_in(str(path))] if path.is_dir() else [str(path)]


# One place


def _of_folder(name: str) -> tuple[History, list[str]]:
    """What the manifests of a folder tell, and what is missing there, in words."""
    from msal_cli.batch import lock
    from msal_cli.batch import run_history as history

    found = history.of_folder(name)
    if found is None:
        raise UsageError(
            f"there is no manifest in the folder {name!r}",
            hint="name the output folder of msal denoise (with --in-place the input)",
            path=name,
        )
    # A store has no locks that could tell.
    at_work = () if is_url(name) else lock.who_works(name)
    if at_work:
        return found, [f"{' and '.join(at_work[:3])} still at work on {name!r}"]
    return found, _missing(found.runs, name)


def _missing(runs: Sequence[RunNote], name: str) -> list[str]:
    """What did not come to its end in a folder: the newest run, or one of its shards."""
    if not runs:
        # Manifests of older versions do not tell of runs.
        return []
    newest = runs[-1]
    alike = [one for one in runs if _what(_as_run(one)) == _what(_as_run(newest))]
    last = {str(one.shard or ""): one for one in alike}
    if any(all(_is_ended(last.get(key)) for key in keys) for keys in _wholes(last.values())):
        return []
    if newest.shard is None:
        return [f"the run that began at {newest.started} in {name!r} did not come to its end"]
    lost = [k for k in _wholes([newest])[0] if not _is_ended(last.get(k))]
    more = f" and {len(lost) - 10} more" if len(lost) > 10 else ""
    return [f"in {name!r} did not run, or not to the end: shard {', '.join(lost[:10])}{more}"]


def _wholes(runs: Iterable[RunNote]) -> list[list[str]]:
    """For each way in which runs deal out the files: the shards that make up the whole."""
    counts = {one.shard.count if one.shard is not None else 0 for one in runs}
    return [[f"{k}/{n}" for k in range(1, n + 1)] if n else [""] for n in counts]


def _is_ended(run: RunNote | None) -> bool:
    return run is not None and not run.interrupted


def _of_file(path: Path) -> History:
    from msal_cli.batch import run_history as history
    from msal_cli.codecs import read_whole
    from msal_cli.report import read_report as reading

    name = str(path)
    data = read_whole(name)
    try:
        time_ns = path.stat().st_mtime_ns
    except OSError as error:
        raise InputError(
            f"the file cannot be read: {error.strerror}", path=name, code="E_READ"
        ) from None
    if path.suffix.lower() == ".jsonl":
        if b'"kind":' in data.lstrip()[:10]:
            return history.read([path])
        return _reported(None, reading.lines(data, name), time_ns)
    if path.suffix.lower() != ".json":
        raise UsageError(
            f"the suffix of {name!r} is not that of a report that can be read",
            hint="name an output folder, a manifest in it, or a report in .json or .jsonl",
            path=name,
        )
    run, records = reading.document(data, name)
    return _reported(run, records, time_ns)


def _reported(run: Run | None, records: Iterable[MeshRecord], time_ns: int) -> History:
    """A report as if manifests had told it; ``time_ns`` is when the file was written."""
    from msal_cli.batch.run_history import History, Row, RunNote

    at = time_ns
    runs: tuple[RunNote, ...] = ()
    if run is not None:
        ended = _seconds_of(run.finished)
        at = time_ns if ended is None else int(ended * 1e9)
        runs = (
            RunNote(
                version=run.version,
                command=run.command,
                settings=run.settings,
                shard=None,
                started=run.started,
                pid=0,
                host="",
                files=0,
                at=at,
                finished=run.finished,
                seconds=run.seconds,
                interrupted=run.interrupted,
            ),
        )
    return History(runs, tuple(Row(at, one.input, one.output or "", one) for one in records))


def _as_run(note: RunNote) -> Run:
    return Run(
        version=note.version,
        command=note.command,
        settings=note.settings,
        started=note.started,
        finished=note.finished,
        seconds=note.seconds,
        interrupted=note.interrupted,
    )


# All together


def _newest(rows: Iterable[Row]) -> list[MeshRecord]:
    """One record for each file, by the path of its input."""
    rows = list(rows)
    named = {row.input for row in rows if row.output}
    kept: dict[tuple[str, str], Row] = {}
    loose: list[Row] = []
    for row in sorted(rows, key=lambda one: one.at):
        if row.output or row.input not in named:
            kept[row.input, row.output] = row
        else:
            loose.append(row)
    outputs: dict[str, list[tuple[str, str]]] = {}
    for key in kept:
        outputs.setdefault(key[0], []).append(key)
    for row in loose:
        # In a report a failure does not say which output is missing: any of its input.
        for key in outputs[row.input]:
            if kept[key].at <= row.at:
                kept[key] = row
    # Several outputs of one input may have got the same failure.
    several = {id(row): row.record for row in kept.values()}
    return sorted(several.values(), key=lambda one: one.input.split("/"))


def _what(run: Run) -> tuple[str, str]:
    import json

    return run.version, json.dumps(run.settings, sort_keys=True, default=repr)


def _together(calls: Sequence[_Call], rows: Sequence[Row], *, is_finished: bool) -> Run:
    from dataclasses import replace

    if not calls:
        return _unknown(rows, is_finished=is_finished)
    newest = max(calls, key=lambda one: one.at).run
    alike = [one.run for one in calls if _what(one.run) == _what(newest)]
    return replace(
        newest,
        started=min(one.started for one in alike),
        finished=max(one.finished for one in alike),
        seconds=round(_seconds_at_work(alike), 3),
        interrupted=not is_finished,
    )


def _unknown(rows: Sequence[Row], *, is_finished: bool) -> Run:
    """What can be said of a run that only its files tell of."""
    from msal_cli import __version__
    from msal_cli.batch.run_history import moment

    times = [row.at for row in rows] or [0]
    newest = max(rows, key=lambda row: row.at).record if rows else None
    settings: dict[str, Any] = {}
    if newest is not None and newest.method is not None:
        settings = {"method": newest.method.name, "parameters": newest.method.parameters}
    if newest is not None and newest.choice is not None:
        from msal_cli.job.settings import ADAPTIVE, AUTO

        method = AUTO if newest.choice.wishes else ADAPTIVE
        settings = {"method": method, "parameters": newest.choice.wishes}
    return Run(
        version=(newest.version if newest is not None else "") or __version__,
        command=(),
        settings=settings,
        started=moment(min(times)),
        finished=moment(max(times)),
        seconds=0.0,
        interrupted=not is_finished,
    )


def _seconds_at_work(runs: Iterable[Run]) -> float:
    """The seconds in which at least one run was at work."""
    spans = []
    for run in runs:
        began = _seconds_of(run.started)
        if began is not None and run.seconds > 0.0:
            spans.append((began, began + run.seconds))
    total, reached = 0.0, float("-inf")
    for start, stop in sorted(spans):
        total += max(0.0, stop - max(start, reached))
        reached = max(reached, stop)
    return total


def _seconds_of(moment: str) -> float | None:
    """Seconds since 1970 of a time as reports write it; None if it is none."""
    try:
        return datetime.fromisoformat(moment).timestamp()
    except (ValueError, OverflowError):
        return None
