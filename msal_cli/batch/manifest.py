"""The memory of an output folder: what was written there, from what, with which settings.

``.msal-manifest.jsonl`` holds one JSON object a line and only ever grows at its end, so a run
that is killed costs at most its last line.  Each shard writes a manifest of its own,
``.msal-manifest-K-of-N.jsonl``.  There are four kinds of line:

``run``     when a run starts: version, command, settings, shard, process and machine.
``intent``  before a run starts on a file: whatever appears under this name is ours.
``done``    after the output was moved into place (or the file failed): hashes and the record.
``end``     when a run ends in good order, or by a signal.

All manifests of a folder are read, whoever wrote them.  Of the lines for a name the newest counts:
within a manifest the last, between manifests the one with the greatest ``at``.  That is the time
in nanoseconds when the line was made, but always more than that of every line that was read before,
so that clocks of several machines need not agree.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import logging
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from msal_cli import __version__
from msal_cli.batch.shard import Shard
from msal_cli.batch.temporary_files import temporary_name
from msal_cli.errors import OutputError
from msal_cli.job.records import MeshRecord, ObjectMark, as_data, from_data
from msal_cli.job.settings import Settings
from msal_cli.storage.regular import is_regular, open_regular

NAME = ".msal-manifest.jsonl"
_ANY = re.compile(r"\.msal-manifest(?:-\d{1,9}-of-\d{1,9})?\.jsonl")
FORMAT = 1

# Half of the time that reading takes would go into records that nobody looks at yet.
_USUAL_DONE = re.compile(
    rb'(\{"kind":"done",.*?),"record":\{.*\},"at":([1-9]\d{0,29})\}', re.DOTALL
)

_USUAL_NAME = re.compile(
    rb'\{"kind":"(?:done|intent)","name":("(?:[^"\\]|\\.)*"),"format":1,.*\}$', re.DOTALL
)

# Lines that no longer count are dropped at the start of a run once there are this many of them
# and more than there are lines that count.
_SPARE_LINES = 1000

RUN_KINDS = ("run", "end")
RUN_LINES_KEPT = 100
"""Lines about runs are kept for reports, but not without end."""

LONGEST_LINE = 16 << 20
"""Bytes that a line may have.  Lines of msal have some kilobytes; a longer one is damage, and a
file with a hole would be one line as long as the hole."""

_LARGEST_BLOCK = 1 << 20

_log = logging.getLogger("msal.batch")


@dataclass(frozen=True, slots=True)
class FileMark:
    """Size in bytes and time of change in nanoseconds: cheap to ask, and only a hint."""

    size: int
    mtime_ns: int

    @staticmethod
    def of(path: str) -> FileMark | None:
        """The mark of a file now; None where it cannot be asked."""
        try:
            # A Path for each of many files would cost more than the question.
            status = os.stat(path)
        except (OSError, ValueError):
            return None
        return FileMark(status.st_size, status.st_mtime_ns)


@dataclass(frozen=True, slots=True)
class Entry:
    """What the manifest knows of one output.

    ``name`` is the output below the folder of the manifest, written with ``/``.  An entry that is
    not ``is_done`` tells only that a run set out to write this output, from an input that then had
    the mark ``input_mark``.  Objects in a store have an ``input_object`` or ``output_object``
    instead of a mark.  ``at`` orders entries, 0 where that is not told (see above).  ``text`` is
    the whole line, for the record in it; where it stands in a file, ``place`` says where instead,
    because all lines of a large manifest take more memory than everything else in a run.
    """

    name: str
    is_done: bool
    at: int = 0
    settings: str = ""
    status: str = ""
    input_sha256: str = ""
    output_sha256: str = ""
    input_mark: FileMark | None = None
    output_mark: FileMark | None = None
    input_object: ObjectMark | None = None
    output_object: ObjectMark | None = None
    text: bytes = b""
    place: Place | None = None

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
            data = json.loads(self.place.line() if self.place is not None else self.text)
            # The file may have been rewritten by the shard that it belongs to.
            return data if data["name"] == self.name and data.get("at", 0) == self.at else {}
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return {}


@dataclass(frozen=True, slots=True)
class Place:
    """A line in a file: where it begins, and how long it is without its end, in bytes."""

    path: Path
    start: int
    length: int

    def line(self) -> bytes:
        """The line as it is now; OSError if the file cannot be read."""
        with open_regular(self.path, buffering=0) as file:
            file.seek(self.start)
            return file.read(self.length)


def settings_hash(settings: Settings) -> str:
    """SHA-256 of all that decides an output's bytes beside its input: the settings and msal's
    version, in canonical JSON."""
    said = {"version": __version__, "settings": asdict(settings)}
    text = json.dumps(said, sort_keys=True, separators=(",", ":"), default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()


def _plain(value: Any) -> Any:
    # A parameter may be a numpy scalar, which must count as the number that it is.
    return value.item() if hasattr(value, "item") else repr(value)


def file_sha256(path: str, is_stopped: Callable[[], bool] = lambda: False) -> str:
    """SHA-256 of a file; an empty string if it cannot be read or ``is_stopped`` became true."""
    digest = hashlib.sha256()
    try:
        with open_regular(path, buffering=0) as file:
            # A block of full size for each of many small files would cost more than the hashing.
            block = bytearray(min(_LARGEST_BLOCK, os.fstat(file.fileno()).st_size + 1))
            view = memoryview(block)
            while length := file.readinto(view):  # type: ignore[attr-defined]
                if is_stopped():
                    return ""
                digest.update(view[:length])
    except (OSError, ValueError):
        return ""
    return digest.hexdigest()


class Manifest:
    """The manifests of one folder, all to be read and one to be written.

    ``shard`` says whose is written; without it, it is that of runs that are no shards.
    """

    def __init__(self, folder: str, shard: Shard | None = None) -> None:
        self.folder = folder
        self._path = Path(folder) / name_for(shard)
        self._entries: dict[str, Entry] = {}
        # What counts within the manifest that is written, whatever others say since.
        self._own: dict[str, Entry] = {}
        self._own_runs: list[bytes] = []
        self._n_lines = 0
        self._newest = 0
        self._file: Any = None

    @classmethod
    def read(cls, folder: str, shard: Shard | None = None) -> Manifest:
        """What the manifests of ``folder`` say; nothing where there are none.

        A line that is torn or makes no sense is passed over: its file is done again.

        Raises OutputError if one is there but cannot be read.
        """
        manifest = cls(folder, shard)
        for path in paths_in(folder):
            manifest._take_in(path)
        return manifest

    def _take_in(self, path: Path) -> None:
        is_own = path == self._path
        some: dict[str, Entry] = {}
        for place, line in lines_of(path):
            self._n_lines += is_own
            entry = entry_of(line, place)
            if entry is not None:
                some[entry.name] = entry
                self._newest = max(self._newest, entry.at)
            elif is_own and kind_of(line) in RUN_KINDS:
                self._own_runs.append(line)
        if is_own:
            self._own = some
        if not self._entries:
            self._entries = dict(some) if is_own else some
            return
        for name, entry in some.items():
            other = self._entries.get(name)
            if other is None or (entry.at, entry.is_done) >= (other.at, other.is_done):
                self._entries[name] = entry

    def get(self, name: str) -> Entry | None:
        """What is known of an output."""
        return self._entries.get(name)

    def names(self) -> frozenset[str]:
        """Every output that some run wrote or set out to write here."""
        return frozenset(self._entries)

    def open(self) -> None:
        """Get ready to append, under the folder's lock: mend a torn end, drop what is outdated.

        Raises OutputError if the manifest cannot be written.
        """
        try:
            n_kept = len(self._own) + min(len(self._own_runs), RUN_LINES_KEPT)
            if self._n_lines - n_kept > max(_SPARE_LINES, n_kept):
                self._compact()
            if self._path.is_symlink():
                # It would grow where nobody asked for anything to be written.
                raise OSError(errno.ELOOP, "it is a link")
            is_new = not self._path.exists()
            if not is_new and not is_regular(self._path):
                # To open a pipe would wait for a reader.
                raise OSError(errno.EINVAL, "it is not a regular file")
            # With a buffer, what did not fit on a full disk would be tried again at the end.
            self._file = self._path.open("ab", buffering=0)
            if is_new:
                _sync_folder(self._path.parent)
            if self._file.tell() and not _ends_with_newline(self._path):
                self._add(b"\n")
        except OSError as error:
            raise _unwritable(self._path, error) from None

    def append(self, lines: Iterable[Mapping[str, Any]]) -> None:
        """Add lines made by ``intent``, ``done`` and the like; they are on the disk on return.

        Raises OutputError if they cannot be written.
        """
        at = max(time.time_ns(), self._newest + 1)
        text = b"".join(line_of({**line, "at": at}) for line in lines)
        if not text:
            return
        try:
            self._add(text)
            os.fsync(self._file.fileno())
        except OSError as error:
            raise _unwritable(self._path, error) from None
        self._newest = at
        self._n_lines += text.count(b"\n")

    def _add(self, text: bytes) -> None:
        """Add all of ``text``, or nothing: half a line would spoil the next one."""
        size = os.fstat(self._file.fileno()).st_size
        rest = memoryview(text)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError:
            with contextlib.suppress(OSError):
                self._file.truncate(size)
            raise

    def close(self) -> None:
        """Let go of the file; harmless if it is not open."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _compact(self) -> None:
        """Rewrite the manifest with the lines that count; whole or not at all."""
        temporary = self._path.with_name(temporary_name("manifest"))
        runs = self._own_runs[-RUN_LINES_KEPT:]
        try:
            with temporary.open("xb") as file:
                for line in runs:
                    file.write(line + b"\n")
                counting = {entry.place for entry in self._own.values()}
                for place, line in lines_of(self._path):
                    if place in counting:
                        file.write(line + b"\n")
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(self._path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        n_kept = len(runs) + len(self._own)
        _log.debug("manifest of %r: %d lines became %d", self.folder, self._n_lines, n_kept)
        self._own_runs = runs
        self._n_lines = n_kept


def name_for(shard: Shard | None) -> str:
    """The name of a shard's manifest, or of that of runs that are no shards."""
    return NAME if shard is None else f".msal-manifest-{shard.file_part}.jsonl"


def paths_in(folder: str) -> list[Path]:
    """The manifests in a folder, by name; OutputError if the folder cannot be listed."""
    try:
        with os.scandir(folder) as entries:
            names = sorted(entry.name for entry in entries if _ANY.fullmatch(entry.name))
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        raise _unwritable(Path(folder), error) from None
    return [Path(folder) / name for name in names]


def lines_of(path: Path) -> Iterator[tuple[Place, bytes]]:
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
                    yield Place(path, start, len(plain)), plain
                start += len(line)
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        raise _unwritable(path, error) from None


def names_in(folder: str) -> frozenset[str]:
    """Every output that some run wrote or set out to write in a folder; errors as of ``read``."""
    names = set()
    for path in paths_in(folder):
        for _, line in lines_of(path):
            if usual := _USUAL_NAME.match(line):
                names.add(json.loads(usual[1]))
            elif entry := entry_of(line):
                names.add(entry.name)
    return frozenset(names)


def kind_of(line: bytes) -> str:
    """What a line says that it is; empty if it makes no sense."""
    try:
        kind = json.loads(line)["kind"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return ""
    return kind if isinstance(kind, str) else ""


def intent(name: str, input_path: str, output_path: str = "") -> dict[str, Any]:
    """The line that says: a run is about to write the output ``name`` from this input."""
    mark = _mark_data(FileMark.of(input_path), "")
    return {
        "kind": "intent",
        "name": name,
        "format": FORMAT,
        "input": mark,
        "paths": [input_path, output_path],
    }


def done(
    name: str, settings: str, record: MeshRecord, input_path: str, output_path: str = ""
) -> dict[str, Any]:
    """The line for a finished or failed file; ``settings`` is their hash."""
    output = None if record.error is not None or record.output is None else record.output
    return {
        "kind": "done",
        "name": name,
        "format": FORMAT,
        "version": __version__,
        "settings": settings,
        "status": record.status,
        "input": _mark_data(
            record.input_object or FileMark.of(input_path), record.input_sha256 or ""
        ),
        "output": (
            None
            if output is None
            else _mark_data(record.output_object or FileMark.of(output), record.output_sha256 or "")
        ),
        "paths": [input_path, output_path],
        "record": as_data(record),
    }


def _mark_data(mark: FileMark | ObjectMark | None, sha256: str) -> dict[str, Any]:
    data: dict[str, Any] = {"sha256": sha256}
    if isinstance(mark, ObjectMark):
        data |= {"size": mark.size, "tag": mark.tag}
    elif mark is not None:
        data |= {"size": mark.size, "mtime_ns": mark.mtime_ns}
    return data


def line_of(data: Mapping[str, Any]) -> bytes:
    """The line for what ``intent`` or ``done`` made, with its end."""
    # ASCII with escapes carries names that are not valid Unicode, and no name can break a line.
    return json.dumps(data, separators=(",", ":"), default=_plain).encode("ascii") + b"\n"


def entry_of(line: bytes, place: Place | None = None) -> Entry | None:
    """What a line tells of an output; None if it does not, or makes no sense."""
    try:
        data = _parsed(line)
        if data["kind"] not in ("intent", "done") or data.get("format", FORMAT) != FORMAT:
            return None
        output = data.get("output") or {}
        at = data.get("at", 0)
        entry = Entry(
            name=data["name"],
            is_done=data["kind"] == "done",
            at=at if type(at) is int else 0,
            # The same words stand in many lines.
            settings=sys.intern(data.get("settings", "")),
            status=sys.intern(data.get("status", "")),
            input_sha256=data["input"]["sha256"],
            output_sha256=output.get("sha256", ""),
            input_mark=_mark(data["input"]),
            output_mark=_mark(output),
            input_object=_object_mark(data["input"]),
            output_object=_object_mark(output),
            text=line if place is None else b"",
            place=place,
        )
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    words = (entry.name, entry.settings, entry.status, entry.input_sha256, entry.output_sha256)
    return entry if all(isinstance(word, str) for word in words) else None


def _parsed(line: bytes) -> Any:
    """What a line says, without the record where that can be left out; errors as of JSON."""
    usual = _USUAL_DONE.fullmatch(line)
    if usual is None:
        return json.loads(line)
    # In a string the quotes would have backslashes, so this is where the record begins.
    return json.loads(usual[1] + b"}") | {"at": int(usual[2])}


def _mark(data: Mapping[str, Any]) -> FileMark | None:
    size, mtime_ns = data.get("size"), data.get("mtime_ns")
    return FileMark(size, mtime_ns) if isinstance(size, int) and isinstance(mtime_ns, int) else None


def _object_mark(data: Mapping[str, Any]) -> ObjectMark | None:
    size, tag = data.get("size"), data.get("tag")
    return ObjectMark(size, tag) if isinstance(size, int) and isinstance(tag, str) else None


def _sync_folder(folder: Path) -> None:
    """Make a new name in a folder outlive a power cut, where the system lets us."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    except OSError:
        # Some network file systems refuse this; there the server takes care of it.
        pass
    finally:
        os.close(handle)


def _ends_with_newline(path: Path) -> bool:
    with open_regular(path) as file:
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"


def _unwritable(path: Path, error: OSError) -> OutputError:
    return OutputError(
        f"the manifest {str(path)!r} cannot be used: {error.strerror}",
        hint="free some space and run again"
        if error.errno in (errno.ENOSPC, errno.EDQUOT)
        else "the output folder must be writable",
        path=str(path),
    )
