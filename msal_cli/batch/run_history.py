"""What the manifests of a folder tell of earlier runs, and the lines by which runs tell it."""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msal_cli import __version__
from msal_cli.batch.manifest import FORMAT, NAME, Entry, entry_of, lines_of, paths_in
from msal_cli.batch.shard import Shard
from msal_cli.job.records import MeshRecord
from msal_cli.storage.urls import is_url

if TYPE_CHECKING:
    from msal_cli.batch.plan import Plan
    from msal_cli.job.settings import Settings


@dataclass(frozen=True)
class RunNote:
    """A run as its manifest tells of it.

    ``at`` orders runs (see ``manifest``).  ``started`` and ``finished`` are UTC, ISO 8601, to the
    millisecond, and ``seconds`` lie between them.  A run that came to no end, because it was killed
    or is still at work, is ``interrupted`` and finished when it wrote its last line.  ``files`` is
    how many it had to deal with.
    """

    version: str
    command: tuple[str, ...]
    settings: Mapping[str, Any]
    shard: Shard | None
    started: str
    pid: int
    host: str
    files: int
    at: int = 0
    finished: str = ""
    seconds: float = 0.0
    interrupted: bool = True
    clock_s: float = field(default=0.0, compare=False)

    @classmethod
    def now(cls, plan: Plan, settings: Settings, command: tuple[str, ...]) -> RunNote:
        """The note of a run of this process that starts now."""
        return cls(
            version=__version__,
            command=command,
            settings=asdict(settings),
            shard=plan.shard,
            started=moment(time.time_ns()),
            pid=os.getpid(),
            host=platform.node(),
            files=len(plan.tasks),
            clock_s=time.monotonic(),
        )

    def line(self) -> dict[str, Any]:
        """The manifest's line for the start of the run."""
        return {
            "kind": "run",
            "format": FORMAT,
            "version": self.version,
            "command": list(self.command),
            "settings": dict(self.settings),
            "shard": None if self.shard is None else [self.shard.number, self.shard.count],
            "started": self.started,
            "pid": self.pid,
            "host": self.host,
            "files": self.files,
        }

    def end(self, *, interrupted: bool) -> dict[str, Any]:
        """The manifest's line for its end, which is now."""
        return {
            "kind": "end",
            "format": FORMAT,
            "finished": moment(time.time_ns()),
            "seconds": round(time.monotonic() - self.clock_s, 3),
            "interrupted": interrupted,
        }


@dataclass(frozen=True)
class Row:
    """What is known of one file: its record, and when that was made (see ``manifest``).

    ``input`` and ``output`` are the paths that the run had; the record of a failure has no output.
    """

    at: int
    input: str
    output: str
    record: MeshRecord


@dataclass(frozen=True)
class History:
    """All runs that manifests tell of, in their order, and the newest row of every file."""

    runs: tuple[RunNote, ...]
    rows: tuple[Row, ...]


def read(paths: list[Path]) -> History:
    """What manifests of one folder tell.

    A file that a run set out to write and did not finish has a record that is ``planned``.
    Raises OutputError if one cannot be read.
    """
    runs: list[RunNote] = []
    entries: dict[str, Entry] = {}
    for path in paths:
        some: dict[str, Entry] = {}
        runs += _runs(path, some)
        for name, entry in some.items():
            other = entries.get(name)
            if other is None or (entry.at, entry.is_done) >= (other.at, other.is_done):
                entries[name] = entry
    runs.sort(key=lambda one: one.at)
    folder = paths[0].parent if paths else Path()
    return History(tuple(runs), tuple(_row(entry, folder) for entry in entries.values()))


def of_folder(folder: str) -> History | None:
    """What all manifests in a folder, or a folder of a store, tell; None if there is none."""
    if is_url(folder):
        return _of_store(folder)
    paths = paths_in(folder)
    return read(paths) if paths else None


def _of_store(folder: str) -> History | None:
    import tempfile

    from msal_cli.batch.remote_manifest import parts_of

    parts = parts_of(folder)
    if not parts:
        return None
    with tempfile.TemporaryDirectory(prefix="msal-") as here:
        # The lines of one run stand in several parts, one after the other.
        path = Path(here) / NAME
        path.write_bytes(b"".join(parts.values()))
        return read([path])


def moment(time_ns: int) -> str:
    """A time in nanoseconds since 1970 in UTC, ISO 8601, to the millisecond."""
    try:
        when = datetime.fromtimestamp(time_ns / 1e9, UTC)
    except (OverflowError, ValueError, OSError):
        when = datetime.fromtimestamp(0, UTC)
    return when.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _runs(path: Path, entries: dict[str, Entry]) -> Iterator[RunNote]:
    """The runs of one manifest; ``entries`` is filled with the last entry for every name."""
    run: RunNote | None = None
    for place, line in lines_of(path):
        entry = entry_of(line, place)
        if entry is not None:
            entries[entry.name] = entry
            if run is not None and run.interrupted and entry.at > run.at:
                run = _lasting_until(run, entry.at)
            continue
        try:
            data = json.loads(line)
            kind = data["kind"]
            if kind == "run":
                if run is not None:
                    yield run
                run = _run(data)
            elif kind == "end" and run is not None:
                run = replace(
                    run,
                    finished=str(data["finished"]),
                    seconds=float(data["seconds"]),
                    interrupted=bool(data["interrupted"]),
                )
        except (ValueError, KeyError, TypeError, RecursionError):
            continue
    if run is not None:
        yield run


def _lasting_until(run: RunNote, at: int) -> RunNote:
    return replace(run, finished=moment(at), seconds=(at - run.at) / 1e9)


def _run(data: Mapping[str, Any]) -> RunNote:
    shard = data.get("shard")
    settings = data["settings"]
    if not isinstance(settings, dict):
        raise TypeError("settings")
    return RunNote(
        version=str(data["version"]),
        command=tuple(str(word) for word in data["command"]),
        settings=settings,
        shard=None if shard is None else Shard(int(shard[0]), int(shard[1])),
        started=str(data["started"]),
        pid=int(data["pid"]),
        host=str(data["host"]),
        files=int(data["files"]),
        at=int(data["at"]),
        finished=str(data["started"]),
    )


def _row(entry: Entry, folder: Path) -> Row:
    record = entry.record() if entry.is_done else None
    paths = entry.data().get("paths")
    if isinstance(paths, list) and len(paths) == 2 and all(isinstance(one, str) for one in paths):
        source, target = paths
    else:
        # As manifests of older versions are.
        source, target = (record.input, record.output) if record is not None else (entry.name, None)
    target = target or str(folder / entry.name)
    if record is None:
        record = MeshRecord(input=source, status="planned", output=target)
    return Row(entry.at, source, target, record)
