"""The manifest of a folder or URL: the outputs there, from which inputs, with which settings.

A manifest has one JSON object per line.  There are four kinds of line:

``run``     when a run starts: version, command, settings, shard, process and machine.
``intent``  before a run starts on a file: the output of this name is msal's own.
``done``    after the output was moved into place (or the file failed): hashes and the record.
``end``     when a run ends normally, or by a signal.

Of the lines for one name the one with the greatest ``at`` counts, of equal ones the last.  ``at``
is the time in nanoseconds when the line was made, but always greater than that of every line read
before, so that the clocks of several machines need not agree.

In a folder, lines are only appended to ``.msal-manifest.jsonl``, so a run that is killed loses at
most its last line.  Each shard writes its own manifest, ``.msal-manifest-K-of-N.jsonl``; all
manifests of a folder are read.

Objects of a store cannot be appended to, so a manifest there consists of parts,
``.msal-manifest/RUN-00001.jsonl`` and so on, where RUN is the start time of the run and eight
random hexadecimal digits.  A part is written once.  ``intent`` lines are written before the work
starts; ``done`` lines are collected for some seconds, so a run that is killed may lose those of its
last files, which are then done again.  Many parts are merged into one: the new part is written
before the old ones are removed, so that no line is ever missing.
"""

from __future__ import annotations

import contextlib
import errno
import json
import logging
import os
import re
import sys
import time
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

from msal_cli.batch.lock import FolderLock, Shard
from msal_cli.errors import InputError, MsalError, OutputError
from msal_cli.job.display_names import map_texts
from msal_cli.job.records import MeshRecord, as_data, from_data
from msal_cli.light_dataclass import dataclass, field
from msal_cli.storage import urls
from msal_cli.storage.atomic import flush_folder, make_folder, write_whole
from msal_cli.storage.regular import open_own, open_regular
from msal_cli.storage.urls import ObjectMark, is_url
from msal_cli.version import __version__

NAME = ".msal-manifest.jsonl"
PARTS_FOLDER = ".msal-manifest"
_ANY_NAME = re.compile(r"\.msal-manifest(?:-\d{1,9}-of-\d{1,9})?\.jsonl")
_PART = re.compile(r"\d{8}T\d{6}\.\d{6}Z-[0-9a-f]{8}-\d{5,}\.jsonl")

FORMAT = 1
_IS_UTF8 = sys.getfilesystemencoding() == "utf-8"
RUN_KINDS = ("run", "end")

# Lines that no longer count are dropped when a run starts, once they are more than this many and
# more than the lines that count.
_SPARE_LINES = 1000

MAX_RUN_LINES = 100  # lines about runs that are kept for reports; older ones are dropped

SECONDS_BETWEEN_PARTS = 3.0
"""Seconds that a line may wait for others before it is written to a store."""

MAX_PARTS = 50
"""With more parts than this the next run merges them; each costs a request at every start."""

_MAX_FAILURES = 10

# The records are rarely needed, and parsing them would take half of the time of reading.
_USUAL_DONE = re.compile(
    rb'(\{"kind":"done",.*?),"record":\{.*\},"at":([1-9]\d{0,29})\}', re.DOTALL
)

_log = logging.getLogger("msal.batch")

MAX_LINE_BYTES = 16 << 20
"""Bytes that a line may have.  Lines of msal have some kilobytes; a longer one is damage, such as a
hole in the file, which would be one line of its size."""


@dataclass(frozen=True, slots=True)
class FileStat:
    """Size in bytes and modification time in nanoseconds: fast to read, and only a hint."""

    size: int
    mtime_ns: int

    @staticmethod
    def of(path: str) -> FileStat | None:
        """The stat of a file; None if it cannot be read."""
        try:
            # Constructing a Path costs more than the call itself.
            status = os.stat(path)
        except (OSError, ValueError):
            return None
        return FileStat(status.st_size, status.st_mtime_ns)


@dataclass(frozen=True, slots=True)
class LineSpan:
    """A line in a file: its offset, and its length without the line end, in bytes."""

    path: Path
    start: int
    length: int


@dataclass(frozen=True, slots=True)
class ManifestEntry:
    """What a manifest says of one output.

    ``name`` is the path of the output below the folder of the manifest, with ``/``.  An entry that
    is not ``is_done`` says only that a run began to write this output.  ``input_version`` and
    ``output_version`` are the stats of the files when the line was written, or size and tag of
    objects in a store.  ``at`` orders entries, 0 where the line has none (see above).  ``line`` is
    the whole line, or its place in a file: the lines of a large manifest would take more memory
    than everything else in a run.
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

    def read_line(self) -> bytes:
        """The line; OSError if the file cannot be read."""
        if isinstance(self.line, bytes):
            return self.line
        with open_regular(self.line.path, buffering=0) as file:
            file.seek(self.line.start)
            return file.read(self.line.length)

    def record(self) -> MeshRecord | None:
        """The record in the line; None if it cannot be read."""
        try:
            record: MeshRecord = from_data(MeshRecord, self.data().get("record"))
        except TypeError:
            return None
        return record

    def data(self) -> dict[str, Any]:
        """The parsed line; empty if it cannot be read any more."""
        try:
            data = json.loads(self.read_line())
            if not (_IS_UTF8 or isinstance(self.line, bytes)):
                data = map_texts(data, _to_locale)
            # The shard that owns the file may have rewritten it.
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
    """The line that counts for each name, and the lines about runs, of one manifest."""

    entries: dict[str, ManifestEntry] = field(default_factory=dict)
    run_lines: list[RunLine] = field(default_factory=list)
    n_lines: int = 0

    @classmethod
    def of(cls, lines: Iterable[tuple[bytes, LineSpan | None]]) -> LogView:
        """Read lines in order; a torn or invalid line is skipped."""
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

    def counting_lines(self) -> Iterator[bytes]:
        """The lines that count, with line ends; OSError if they cannot be read again."""
        for run in self.run_lines[-MAX_RUN_LINES:]:
            yield run.line + b"\n"
        for entry in self.entries.values():
            yield entry.read_line() + b"\n"


def merge_entries(views: Iterable[LogView]) -> dict[str, ManifestEntry]:
    """The entry that counts for each name, of all entries of several manifests."""
    merged: dict[str, ManifestEntry] = {}
    for view in views:
        for name, entry in view.entries.items():
            other = merged.get(name)
            if other is None or (entry.at, entry.is_done) >= (other.at, other.is_done):
                merged[name] = entry
    return merged


# Reading


def read_lines(path: Path) -> Iterator[tuple[bytes, LineSpan]]:
    """The non-empty lines of a manifest, without line ends, and their places.

    Raises OutputError if it cannot be read; a missing manifest has no lines.
    """
    try:
        with open_regular(path) as file:
            start = 0
            while line := file.readline(MAX_LINE_BYTES + 1):
                if len(line) > MAX_LINE_BYTES:
                    raise OSError(errno.EFBIG, f"a line has more than {MAX_LINE_BYTES:,} bytes")
                if plain := line.rstrip(b"\n"):
                    yield plain, LineSpan(path, start, len(plain))
                start += len(line)
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        raise manifest_error(str(path), error) from None


def parse_line(line: bytes, span: LineSpan | None = None) -> ManifestEntry | str | None:
    """The entry in a line, the kind of a line about a run, or None for an invalid line."""
    try:
        # Leave the record out if possible.  Within a string the quotes would be escaped, so the
        # record can begin nowhere else.
        usual = _USUAL_DONE.fullmatch(line)
        data = json.loads(b'%b,"at":%b}' % usual.groups() if usual else line)
        kind = data["kind"]
        if kind not in ("intent", "done") or data.get("format", FORMAT) != FORMAT:
            return kind if kind in RUN_KINDS else None
        output = data.get("output") or {}
        at = data.get("at", 0)
        entry = ManifestEntry(
            name=data["name"] if _IS_UTF8 or span is None else _to_locale(data["name"]),
            is_done=kind == "done",
            at=at if type(at) is int else 0,
            # Equal texts of many lines share one object.
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


def _parse_version(data: Mapping[str, Any]) -> FileStat | ObjectMark | None:
    size, mtime_ns, tag = data.get("size"), data.get("mtime_ns"), data.get("tag")
    if not isinstance(size, int):
        return None
    if isinstance(tag, str):
        return ObjectMark(size, tag)
    return FileStat(size, mtime_ns) if isinstance(mtime_ns, int) else None


# Writing


def intent_line(name: str, input_path: str, output_path: str = "") -> dict[str, Any]:
    """The line that a run writes before it makes the output ``name`` from this input."""
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
    """The line for a finished or failed file; ``settings`` is the hash of the settings."""
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
    return {"sha256": sha256 or ""} | ({} if version is None else asdict(version))


def encode_line(data: Mapping[str, Any]) -> bytes:
    """Encode the fields of a line, as ``intent_line`` or the like returns them, with a line end."""
    # ASCII with escapes carries names that are not valid Unicode, and no name can break a line.
    text = json.dumps(data, separators=(",", ":"), default=to_builtin)
    return text.encode("ascii") + b"\n"


# Names of files are written as a UTF-8 locale has them, so that a run in any other can go on.


def _to_utf8(name: str) -> str:
    try:
        return os.fsencode(name).decode("utf-8", "surrogateescape")
    except UnicodeError:
        return name  # another text


def _to_locale(name: str) -> str:
    return os.fsdecode(name.encode("utf-8", "surrogateescape"))


def to_builtin(value: Any) -> Any:
    """For JSON: the number that a numpy scalar is, and the ``repr`` of anything else."""
    return value.item() if hasattr(value, "item") else repr(value)


def manifest_error(path: str, error: OSError) -> OutputError:
    return OutputError(
        f"the manifest {path!r} cannot be used: {error.strerror}",
        hint="free some space and run again"
        if error.errno in (errno.ENOSPC, errno.EDQUOT)
        else "the folder must be readable and writable",
        path=path,
    )


# Places


class Manifest:
    """All manifests of a folder or URL, one of which this run writes."""

    def __init__(self, place: str, views: Collection[LogView]) -> None:
        self.place = place
        self._entries = merge_entries(views)
        self._newest = max((entry.at for entry in self._entries.values()), default=0)

    def get(self, name: str) -> ManifestEntry | None:
        return self._entries.get(name)

    def append(self, lines: Iterable[Mapping[str, Any]]) -> None:
        """Append lines made by ``intent_line``, ``done_line`` and the like.

        On return they are on the disk; in a store only intents are, and other lines follow soon.
        Raises OutputError if they cannot be written.
        """
        new = list(lines)
        if not new:
            return
        self._newest = max(time.time_ns(), self._newest + 1)
        stamped = ({**line, "at": self._newest} for line in new)
        if not (_IS_UTF8 or is_url(self.place)):
            stamped = (map_texts(line, _to_utf8) for line in stamped)
        encoded = list(map(encode_line, stamped))
        self._write_lines(encoded, at_once=any(line["kind"] == "intent" for line in new))

    def open(self) -> None:
        """Prepare to append, and drop lines that no longer count; does nothing if it is open.

        Raises OutputError if that fails.
        """

    def close(self) -> None:
        """Finish writing, if it is open; OutputError if lines cannot be written."""

    def _write_lines(self, lines: list[bytes], *, at_once: bool) -> None:
        """Write encoded lines; a store may delay them unless ``at_once``."""


class FolderManifest(Manifest):
    """The manifests of a folder; the one of ``shard`` is written."""

    def __init__(self, folder: str, shard: Shard | None = None) -> None:
        own_name = NAME if shard is None else f".msal-manifest-{shard.file_part}.jsonl"
        self._path = Path(folder) / own_name
        views = {path: LogView.of(read_lines(path)) for path in list_manifests(folder)}
        super().__init__(folder, views.values())
        self._own = views.get(self._path, LogView())
        self._file: BinaryIO | Any = None

    def open(self) -> None:
        """As for any manifest; the folder must be locked.  A torn last line gets its end."""
        if self._file is not None:
            return
        try:
            n_kept = len(self._own.entries) + min(len(self._own.run_lines), MAX_RUN_LINES)
            if self._own.n_lines - n_kept > max(_SPARE_LINES, n_kept):
                write_whole(self._path, self._own.counting_lines())
                _log.debug("manifest of %r: %d lines are left", self.place, n_kept)
            # Unbuffered: a buffer would retry what did not fit on a full disk when it is closed.
            handle = open_own(self._path, os.O_CREAT | os.O_APPEND)
            self._file = os.fdopen(handle, "a+b", buffering=0)
            flush_folder(self._path.parent)
            if self._file.tell():
                self._file.seek(-1, os.SEEK_END)
                if self._file.read(1) != b"\n":
                    self._write_all(b"\n")
        except OSError as error:
            raise manifest_error(str(self._path), error) from None

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    def _write_lines(self, lines: list[bytes], *, at_once: bool) -> None:
        try:
            start = os.fstat(self._file.fileno()).st_size
            self._write_all(b"".join(lines))
            os.fsync(self._file.fileno())
        except OSError as error:
            raise manifest_error(str(self._path), error) from None
        # A manifest may stay open for several runs, and the next one must find these entries.
        # Intents must not hide the entries of the run before.
        for line in lines:
            entry = parse_line(line[:-1], LineSpan(self._path, start, len(line) - 1))
            if isinstance(entry, ManifestEntry) and entry.is_done:
                self._entries[entry.name] = entry
            start += len(line)

    def _write_all(self, text: bytes) -> None:
        """Append all of ``text``, or nothing: half a line would spoil the next one."""
        size = os.fstat(self._file.fileno()).st_size
        rest = memoryview(text)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError:
            with contextlib.suppress(OSError):
                self._file.truncate(size)
            raise


def list_manifests(folder: str) -> list[Path]:
    """The manifests in a folder, by name; OutputError if the folder cannot be listed."""
    try:
        with os.scandir(folder) as entries:
            names = sorted(entry.name for entry in entries if _ANY_NAME.fullmatch(entry.name))
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        raise manifest_error(folder, error) from None
    return [Path(folder) / name for name in names]


# In a store


class ObjectManifest(Manifest):
    """The manifest of one folder of a store; every run, shard or not, writes its own parts."""

    def __init__(self, url: str, shard: Shard | None = None) -> None:
        started = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
        self._run = f"{started}-{os.urandom(4).hex()}"
        parts = _read_parts(url)
        self._parts = list(parts)
        self._view = _view_of_parts(parts)
        super().__init__(url, [self._view])
        # Only one of the shards merges: else each would write a copy of everything.
        self._merges = shard is None or shard.number == 1
        self._n_written = self._n_failures = 0
        # The line of the start waits for the intents: they become one part.
        self._next_part = time.monotonic() + SECONDS_BETWEEN_PARTS
        self._waiting: list[bytes] = []

    def open(self) -> None:
        if self._merges and len(self._parts) > MAX_PARTS:
            from msal_cli.storage import objects

            self._write_part(0, b"".join(self._view.counting_lines()))
            objects.remove_objects([_part_url(self.place, name) for name in self._parts])
            _log.debug("manifest of %r: %d parts became one", self.place, len(self._parts))

    def close(self) -> None:
        """Write the last lines; a failure is only logged while another exception is handled."""
        is_failing = sys.exc_info()[0] is not None
        try:
            self._flush()
        except OutputError:
            if not is_failing:
                raise
            _log.warning("the last lines of the manifest of %r could not be written", self.place)

    def _write_lines(self, lines: list[bytes], *, at_once: bool) -> None:
        self._waiting += lines
        if not at_once and time.monotonic() < self._next_part:
            return
        try:
            self._flush()
            self._n_failures = 0
        except OutputError:
            # The lines are kept for the next time: a store may be out of reach for a moment.
            self._n_failures += 1
            if at_once or self._n_failures >= _MAX_FAILURES:
                raise
        self._next_part = time.monotonic() + SECONDS_BETWEEN_PARTS

    def _flush(self) -> None:
        """Write the waiting lines as a part; they are kept if that fails."""
        if self._waiting:
            self._write_part(self._n_written + 1, b"".join(self._waiting))
            self._n_written += 1
            self._waiting.clear()

    def _write_part(self, number: int, text: bytes) -> None:
        from msal_cli.storage import objects

        try:
            objects.write_whole(_part_url(self.place, f"{self._run}-{number:05d}.jsonl"), text)
        except OutputError as error:
            raise _store_error(self.place, error) from None


def _view_of_parts(parts: dict[str, bytes]) -> LogView:
    return LogView.of((line, None) for text in parts.values() for line in text.split(b"\n") if line)


def _read_parts(url: str) -> dict[str, bytes]:
    """The parts of a manifest by name, in the order of their runs."""
    from msal_cli.storage import objects

    for is_last in (False, False, True):
        try:
            listed = objects.list_objects(_part_url(url))
            names = sorted(filter(_PART.fullmatch, listed))
            texts = objects.read_many({_part_url(url, name): listed[name] for name in names})
        except InputError as error:
            # Another run may have merged the listed parts.
            if is_last:
                raise _store_error(url, error) from None
        else:
            return dict(zip(names, texts, strict=True))
    return {}


def _part_url(url: str, name: str = "") -> str:
    return f"{urls.folder(url)}{PARTS_FOLDER}/{name}"


def _store_error(url: str, error: MsalError) -> OutputError:
    return OutputError(
        f"the manifest in {url!r} cannot be used: {error.message}", hint=error.hint, path=url
    )


# Any place


def read_views(place: str) -> list[LogView]:
    """Read every manifest of a folder or URL; OutputError if one cannot be read."""
    if not is_url(place):
        return [LogView.of(read_lines(path)) for path in list_manifests(place)]
    parts = _read_parts(place)
    return [_view_of_parts(parts)] if parts else []


def open_manifest(place: str, shard: Shard | None = None) -> Manifest:
    """Read the manifests of a place, one of which can be appended to; OutputError if that fails."""
    return ObjectManifest(place, shard) if is_url(place) else FolderManifest(place, shard)


def open_folder(place: str, stack: ExitStack, shard: Shard | None = None) -> Manifest:
    """Make and lock a folder (see `FolderLock`) and read its manifests; ``stack`` releases both.

    A store has neither folders nor locks: two runs may overwrite each other's objects, each whole.

    Raises UsageError if another run has locked the folder, OutputError if it cannot be made.
    """
    if not is_url(place):
        make_folder(place)
        stack.enter_context(FolderLock(place, shard))
    manifest = open_manifest(place, shard)
    stack.callback(manifest.close)
    return manifest
