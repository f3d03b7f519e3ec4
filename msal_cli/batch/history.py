"""What the manifests of a folder say of earlier runs, and the lines by which runs say it."""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msal_cli.batch.manifest import (
    FORMAT,
    LogView,
    ManifestEntry,
    merge_entries,
    read_view,
    read_views,
)
from msal_cli.batch.shard import Shard
from msal_cli.job.plain_data import from_data
from msal_cli.job.records import MeshRecord
from msal_cli.structs import dataclass
from msal_cli.version import __version__

if TYPE_CHECKING:
    from msal_cli.batch.plan import Plan
    from msal_cli.job.settings import Settings


@dataclass(frozen=True)
class RunEntry:
    """A run as its manifest describes it.

    ``at`` orders runs (see `manifest`).  ``started`` and ``finished`` are UTC, ISO 8601, to
    the millisecond, and ``seconds`` lie between them.  A run without an end, because it was killed
    or is still at work, is ``interrupted`` and finished when it wrote its last line.  ``files`` is
    how many it had to process.
    """

    version: str
    command: tuple[str, ...]
    settings: Mapping[str, Any]
    started: str
    shard: Shard | None = None
    pid: int = 0
    host: str = ""
    files: int = 0
    at: int = 0
    finished: str = ""
    seconds: float = 0.0
    interrupted: bool = True
    clock_s: float = field(default=0.0, compare=False)

    @classmethod
    def start(cls, plan: Plan, settings: Settings, command: tuple[str, ...]) -> RunEntry:
        """A run of this process that starts now."""
        return cls(
            version=__version__,
            command=command,
            settings=asdict(settings),
            shard=plan.shard,
            started=iso_timestamp(time.time_ns()),
            pid=os.getpid(),
            host=platform.node(),
            files=len(plan.tasks),
            clock_s=time.monotonic(),
        )

    @property
    def configuration(self) -> tuple[str, str]:
        """Version and settings; runs that have both in common did the same work."""
        return self.version, json.dumps(self.settings, sort_keys=True, default=repr)

    def start_line(self) -> dict[str, Any]:
        """The manifest's line for the start of the run."""
        names = ("version", "settings", "started", "pid", "host", "files")
        return {
            "kind": "run",
            "format": FORMAT,
            "command": list(self.command),
            "shard": None if self.shard is None else [self.shard.number, self.shard.count],
            **{name: getattr(self, name) for name in names},
        }

    def end_line(self, *, interrupted: bool) -> dict[str, Any]:
        """The manifest's line for its end, which is now."""
        return {
            "kind": "end",
            "format": FORMAT,
            "finished": iso_timestamp(time.time_ns()),
            "seconds": round(time.monotonic() - self.clock_s, 3),
            "interrupted": interrupted,
        }


@dataclass(frozen=True)
class FileRow:
    """What is known of one file: its record, and when that was made (see `manifest`).

    ``input`` and ``output`` are the paths that the run had; the record of a failure has no output.
    """

    at: int
    input: str
    output: str
    record: MeshRecord


@dataclass(frozen=True)
class RunHistory:
    """All runs that manifests know of, in their order, and the newest row of every file."""

    runs: tuple[RunEntry, ...]
    rows: tuple[FileRow, ...]


def read_place(place: str) -> RunHistory | None:
    """What all manifests in a folder, or a folder of a store, say; None if there is none.

    A file that a run began and did not finish has a record that is ``planned``.
    Raises OutputError if a manifest cannot be read.
    """
    views = read_views(place)
    return _history(views, place) if views else None


def read_file(path: Path) -> RunHistory:
    """What one manifest of a folder says; OutputError if it cannot be read."""
    return _history([read_view(path)], str(path.parent))


def iso_timestamp(time_ns: int) -> str:
    """A time in nanoseconds since 1970 in UTC, ISO 8601, to the millisecond."""
    try:
        when = datetime.fromtimestamp(time_ns / 1e9, UTC)
    except (OverflowError, ValueError, OSError):
        when = datetime.fromtimestamp(0, UTC)
    return when.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _history(views: Sequence[LogView], place: str) -> RunHistory:
    runs = [run for view in views for run in _parse_runs(view)]
    entries = merge_entries(views).values()
    return RunHistory(
        tuple(sorted(runs, key=lambda run: run.at)), tuple(_row(entry, place) for entry in entries)
    )


def _parse_runs(view: LogView) -> list[RunEntry]:
    runs: list[RunEntry] = []
    for run_line in view.run_lines:
        try:
            data = json.loads(run_line.line)
            if data["kind"] == "run":
                runs.append(_parse_start(data, run_line.last_at))
            elif runs:
                runs[-1] = replace(
                    runs[-1],
                    finished=str(data["finished"]),
                    seconds=float(data["seconds"]),
                    interrupted=bool(data["interrupted"]),
                )
        except (ValueError, KeyError, TypeError, RecursionError):
            continue
    return runs


def _parse_start(data: Mapping[str, Any], last_at: int) -> RunEntry:
    """A run from its first line, as if it had ended with its last entry."""
    shard, at = data["shard"], int(data["at"])
    entry: RunEntry = from_data(
        RunEntry, {**data, "shard": shard and {"number": shard[0], "count": shard[1]}}
    )
    finished = iso_timestamp(last_at) if last_at > at else entry.started
    return replace(entry, finished=finished, seconds=max(0, last_at - at) / 1e9)


def _row(entry: ManifestEntry, place: str) -> FileRow:
    record = entry.record() if entry.is_done else None
    try:
        source, target = map(str, entry.data()["paths"])
    except (KeyError, TypeError, ValueError):
        source, target = entry.name, ""
    target = target or str(Path(place) / entry.name)
    if record is None:
        record = MeshRecord(input=source, status="planned", output=target)
    return FileRow(entry.at, source, target, record)
