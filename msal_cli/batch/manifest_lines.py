"""The lines of a manifest: how they are written and what they say.

A manifest has one JSON object a line.  There are four kinds of line:

``run``     when a run starts: version, command, settings, shard, process and machine.
``intent``  before a run starts on a file: an output of this name is ours.
``done``    after the output was moved into place (or the file failed): hashes and the record.
``end``     when a run ends in good order, or by a signal.

Of the lines for a name the newest counts: within a manifest the last, between manifests the one
with the greatest ``at``.  That is the time in nanoseconds when the line was made, but always more
than that of every line that was read before, so that clocks of several machines need not agree.
"""

from __future__ import annotations

import errno
import json
import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from msal_cli.errors import OutputError
from msal_cli.job.plain_data import as_data, from_data
from msal_cli.job.records import MeshRecord, ObjectMark
from msal_cli.storage.regular import open_regular
from msal_cli.version import __version__

FORMAT = 1
RUN_KINDS = ("run", "end")
_ENTRY_KINDS = ("intent", "done")

# Parsing the records, which are rarely needed, would take half of the time of reading.
_USUAL_DONE = re.compile(
    rb'(\{"kind":"done",.*?),"record":\{.*\},"at":([1-9]\d{0,29})\}', re.DOTALL
)

_USUAL_NAME = re.compile(
    rb'\{"kind":"(?:done|intent)","name":("(?:[^"\\]|\\.)*"),"format":1,.*\}$', re.DOTALL
)

LONGEST_LINE = 16 << 20
"""Bytes that a line may have.  Lines of msal have some kilobytes; a longer one is damage, and a
file with a hole would be one line as long as the hole."""


@dataclass(frozen=True, slots=True)
class FileStat:
    """Size in bytes and time of change in nanoseconds: fast to read, and only a hint."""

    size: int
    mtime_ns: int

    @staticmethod
    def of(path: str) -> FileStat | None:
        """The values of a file now; None where they cannot be read."""
        try:
            # os.stat: constructing a Path costs more than the call itself.
            status = os.stat(path)
        except (OSError, ValueError):
            return None
        return FileStat(status.st_size, status.st_mtime_ns)


@dataclass(frozen=True, slots=True)
class LineSpan:
    """A line in a file: where it begins, and how long it is without its end, in bytes."""

    path: Path
    start: int
    length: int

    def read(self) -> bytes:
        """The line as it is now; OSError if the file cannot be read."""
        with open_regular(self.path, buffering=0) as file:
            file.seek(self.start)
            return file.read(self.length)


@dataclass(frozen=True, slots=True)
class ManifestEntry:
    """What the manifest says of one output.

    ``name`` is the output below the folder of the manifest, written with ``/``.  An entry that is
    not ``is_done`` says only that a run began to write this output.  ``input_version`` and
    ``output_version`` are what the files were when the line was written: a stat, or size and tag
    of an object in a store.  ``at`` orders entries, 0 where the line has none (see above).
    ``line`` is the whole line, or where it is in a file, because all lines of a large manifest
    take more memory than everything else in a run.
    """

    name: str
    is_done: bool
    at: int = 0
    settings: str = ""
    status: str = ""
    input_sha256: str = ""
    output_sha256: str = ""
    input_version: FileStat | ObjectMark | None = None
    output_version: FileStat | ObjectMark | None = None
    line: bytes | LineSpan = b""

    def record(self) -> MeshRecord | None:
        """The record of the run that wrote the output; None if it cannot be read."""
        try:
            record: MeshRecord = from_data(MeshRecord, self.data().get("record"))
        except TypeError:
            return None
        return record

    def data(self) -> dict[str, Any]:
        """All that the line says; empty if it cannot be read (any more)."""
        try:
            data = json.loads(self.line.read() if isinstance(self.line, LineSpan) else self.line)
            # The file may have been rewritten by the shard that it belongs to.
            return data if data["name"] == self.name and data.get("at", 0) == self.at else {}
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return {}


@dataclass(slots=True)
class RunLine:
    """A line about a run, and the greatest ``at`` of the entries between it and the next one."""

    line: bytes
    last_at: int = 0


@dataclass(slots=True)
class LogView:
    """What one manifest says: the line that counts for each name, and the lines about runs."""

    entries: dict[str, ManifestEntry] = field(default_factory=dict)
    run_lines: list[RunLine] = field(default_factory=list)
    n_lines: int = 0

    @classmethod
    def of(cls, lines: Iterable[tuple[bytes, LineSpan | None]]) -> LogView:
        """Read lines in their order; a line that is torn or makes no sense is skipped."""
        view = cls()
        for line, span in lines:
            view.n_lines += 1
            parsed = parse_line(line, span)
            if isinstance(parsed, ManifestEntry):
                other = view.entries.get(parsed.name)
                if other is None or parsed.at >= other.at:
                    view.entries[parsed.name] = parsed
                if view.run_lines:
                    view.run_lines[-1].last_at = max(view.run_lines[-1].last_at, parsed.at)
            elif parsed in RUN_KINDS:
                view.run_lines.append(RunLine(line))
        return view


def merge_entries(views: Iterable[LogView]) -> dict[str, ManifestEntry]:
    """Of several manifests the entry that counts for each name."""
    merged: dict[str, ManifestEntry] = {}
    for view in views:
        for name, entry in view.entries.items():
            other = merged.get(name)
            if other is None or (entry.at, entry.is_done) >= (other.at, other.is_done):
                merged[name] = entry
    return merged


# Reading


def read_lines(path: Path) -> Iterator[tuple[bytes, LineSpan]]:
    """The lines of a manifest without their ends and where they are, empty ones left out.

    Raises OutputError if it cannot be read; a file that is not there has no lines.
    """
    try:
        with open_regular(path) as file:
            start = 0
            while line := file.readline(LONGEST_LINE + 1):
                if len(line) > LONGEST_LINE:
                    raise OSError(errno.EFBIG, f"a line has more than {LONGEST_LINE:,} bytes")
                if plain := line.rstrip(b"\n"):
                    yield plain, LineSpan(path, start, len(plain))
                start += len(line)
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        raise manifest_error(str(path), error) from None


def read_output_names(path: Path) -> Iterator[str]:
    """Every output that some run wrote or began to write; errors as of ``read_lines``."""
    for line, _ in read_lines(path):
        if usual := _USUAL_NAME.match(line):
            yield json.loads(usual[1])
        elif isinstance(entry := parse_line(line), ManifestEntry):
            yield entry.name


def parse_line(line: bytes, span: LineSpan | None = None) -> ManifestEntry | str | None:
    """The entry in a line, the kind of a line that is about a run, or None if it makes no sense."""
    try:
        data = _load_json(line)
        kind = data["kind"]
        if kind not in _ENTRY_KINDS or data.get("format", FORMAT) != FORMAT:
            return kind if kind in RUN_KINDS else None
        output = data.get("output") or {}
        at = data.get("at", 0)
        entry = ManifestEntry(
            name=data["name"],
            is_done=kind == "done",
            at=at if type(at) is int else 0,
            # Equal texts in many lines share one object.
            settings=sys.intern(data.get("settings", "")),
            status=sys.intern(data.get("status", "")),
            input_sha256=data["input"]["sha256"],
            output_sha256=output.get("sha256", ""),
            input_version=_parse_version(data["input"]),
            output_version=_parse_version(output),
            line=line if span is None else span,
        )
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    texts = (entry.name, entry.input_sha256, entry.output_sha256)
    return entry if all(isinstance(text, str) for text in texts) else None


def _load_json(line: bytes) -> Any:
    """What a line says, without the record where that can be left out; errors as of JSON."""
    usual = _USUAL_DONE.fullmatch(line)
    if usual is None:
        return json.loads(line)
    # In a string the quotes would have backslashes, so this is where the record begins.
    return json.loads(usual[1] + b"}") | {"at": int(usual[2])}


def _parse_version(data: Mapping[str, Any]) -> FileStat | ObjectMark | None:
    size, mtime_ns, tag = data.get("size"), data.get("mtime_ns"), data.get("tag")
    if not isinstance(size, int):
        return None
    if isinstance(tag, str):
        return ObjectMark(size, tag)
    return FileStat(size, mtime_ns) if isinstance(mtime_ns, int) else None


# Writing


def intent_line(name: str, input_path: str, output_path: str = "") -> dict[str, Any]:
    """The line that says: a run is about to write the output ``name`` from this input."""
    return {
        "kind": "intent",
        "name": name,
        "format": FORMAT,
        "input": _version_fields(FileStat.of(input_path), ""),
        "paths": [input_path, output_path],
    }


def done_line(
    name: str, settings: str, record: MeshRecord, input_path: str, output_path: str = ""
) -> dict[str, Any]:
    """The line for a finished or failed file; ``settings`` is their hash."""
    output = None
    if record.error is None and record.output is not None:
        version = record.output_object or FileStat.of(record.output)
        output = _version_fields(version, record.output_sha256)
    return {
        "kind": "done",
        "name": name,
        "format": FORMAT,
        "version": __version__,
        "settings": settings,
        "status": record.status,
        "input": _version_fields(
            record.input_object or FileStat.of(input_path), record.input_sha256
        ),
        "output": output,
        "paths": [input_path, output_path],
        "record": as_data(record),
    }


def _version_fields(version: FileStat | ObjectMark | None, sha256: str | None) -> dict[str, Any]:
    fields: dict[str, Any] = {"sha256": sha256 or ""}
    if isinstance(version, ObjectMark):
        fields |= {"size": version.size, "tag": version.tag}
    elif version is not None:
        fields |= {"size": version.size, "mtime_ns": version.mtime_ns}
    return fields


def encode_line(data: Mapping[str, Any]) -> bytes:
    """The line for what ``intent_line`` or ``done_line`` made, with its end."""
    # ASCII with escapes carries names that are not valid Unicode, and no name can break a line.
    text = json.dumps(data, separators=(",", ":"), default=to_builtin)
    return text.encode("ascii") + b"\n"


def to_builtin(value: Any) -> Any:
    """For JSON: a parameter may be a numpy scalar, which must count as the number that it is."""
    return value.item() if hasattr(value, "item") else repr(value)


def manifest_error(path: str, error: OSError) -> OutputError:
    """The error for a manifest that the system does not let us read or write."""
    return OutputError(
        f"the manifest {path!r} cannot be used: {error.strerror}",
        hint="free some space and run again"
        if error.errno in (errno.ENOSPC, errno.EDQUOT)
        else "the output folder must be writable",
        path=path,
    )
