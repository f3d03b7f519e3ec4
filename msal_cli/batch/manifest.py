"""The memory of an output folder: what was written there, from what, with which settings.

``.msal-manifest.jsonl`` holds one JSON object a line and only ever grows at its end, so a run
that is killed costs at most its last line.  There are two kinds of line:

``intent``  before a run starts on a file: whatever appears under this name is ours.
``done``    after the output was moved into place (or the file failed): hashes and the record.

The last line for a name counts.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from msal_cli import __version__
from msal_cli.batch.temporaries import temporary_name
from msal_cli.errors import OutputError
from msal_cli.pipeline import Settings
from msal_cli.records import MeshRecord, ObjectMark, as_data, from_data

NAME = ".msal-manifest.jsonl"
FORMAT = 1

# Lines that no longer count are dropped at the start of a run once there are this many of them
# and more than there are lines that count.
_SPARE_LINES = 1000

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
            status = Path(path).stat()
        except (OSError, ValueError):
            return None
        return FileMark(status.st_size, status.st_mtime_ns)


@dataclass(frozen=True, slots=True)
class Entry:
    """What the manifest knows of one output.

    ``name`` is the output below the folder of the manifest, written with ``/``.  An entry that is
    not ``is_done`` tells only that a run set out to write this output, from an input that then had
    the mark ``input_mark``.  Objects in a store have an ``input_object`` or ``output_object``
    instead of a mark.  ``text`` is the whole line, for the record in it.
    """

    name: str
    is_done: bool
    settings: str = ""
    status: str = ""
    input_sha256: str = ""
    output_sha256: str = ""
    input_mark: FileMark | None = None
    output_mark: FileMark | None = None
    input_object: ObjectMark | None = None
    output_object: ObjectMark | None = None
    text: bytes = b""

    def record(self) -> MeshRecord | None:
        """The record of the run that wrote the output; None if it cannot be read."""
        try:
            record: MeshRecord = from_data(MeshRecord, json.loads(self.text)["record"])
        except (ValueError, KeyError, TypeError):
            return None
        return record


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
        with open(path, "rb", buffering=0) as file:
            # A block of full size for each of many small files would cost more than the hashing.
            block = bytearray(min(_LARGEST_BLOCK, os.fstat(file.fileno()).st_size + 1))
            view = memoryview(block)
            while length := file.readinto(view):
                if is_stopped():
                    return ""
                digest.update(view[:length])
    except (OSError, ValueError):
        return ""
    return digest.hexdigest()


class Manifest:
    """The manifest of one folder."""

    def __init__(self, folder: str) -> None:
        self.folder = folder
        self._path = Path(folder) / NAME
        self._entries: dict[str, Entry] = {}
        self._n_lines = 0
        self._file: Any = None

    @classmethod
    def read(cls, folder: str) -> Manifest:
        """The manifest of ``folder``; an empty one where there is none.

        A line that is torn or makes no sense is passed over: its file is done again.

        Raises OutputError if it is there but cannot be read.
        """
        manifest = cls(folder)
        try:
            text = manifest._path.read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return manifest
        except OSError as error:
            raise _unwritable(manifest._path, error) from None
        for line in text.split(b"\n"):
            if not line:
                continue
            manifest._n_lines += 1
            entry = entry_of(line)
            if entry is not None:
                manifest._entries[entry.name] = entry
        return manifest

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
            if self._n_lines - len(self._entries) > max(_SPARE_LINES, len(self._entries)):
                self._compact()
            is_new = not self._path.exists()
            self._file = self._path.open("ab")
            if is_new:
                _sync_folder(self._path.parent)
            if self._file.tell() and not _ends_with_newline(self._path):
                self._file.write(b"\n")
                self._file.flush()
        except OSError as error:
            raise _unwritable(self._path, error) from None

    def append(self, lines: Iterable[Mapping[str, Any]]) -> None:
        """Add lines made by ``intent`` and ``done``; they are on the disk when this returns.

        Raises OutputError if they cannot be written.
        """
        text = b"".join(line_of(line) for line in lines)
        if not text:
            return
        try:
            self._file.write(text)
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise _unwritable(self._path, error) from None
        self._n_lines += text.count(b"\n")

    def close(self) -> None:
        """Let go of the file; harmless if it is not open."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _compact(self) -> None:
        """Rewrite the manifest with the lines that count; whole or not at all."""
        temporary = self._path.with_name(temporary_name("manifest"))
        try:
            with temporary.open("xb") as file:
                file.write(b"".join(entry.text + b"\n" for entry in self._entries.values()))
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(self._path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        _log.debug(
            "manifest of %r: %d lines became %d", self.folder, self._n_lines, len(self._entries)
        )
        self._n_lines = len(self._entries)


def intent(name: str, input_path: str) -> dict[str, Any]:
    """The line that says: a run is about to write the output ``name`` from this input."""
    mark = _mark_data(FileMark.of(input_path), "")
    return {"kind": "intent", "name": name, "format": FORMAT, "input": mark}


def done(name: str, settings: str, record: MeshRecord, input_path: str) -> dict[str, Any]:
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
    return json.dumps(data, separators=(",", ":")).encode("ascii") + b"\n"


def entry_of(line: bytes) -> Entry | None:
    """What a line says; None if it is torn or makes no sense."""
    try:
        data = json.loads(line)
        if data["kind"] not in ("intent", "done") or data.get("format", FORMAT) != FORMAT:
            return None
        output = data.get("output") or {}
        entry = Entry(
            name=data["name"],
            is_done=data["kind"] == "done",
            settings=data.get("settings", ""),
            status=data.get("status", ""),
            input_sha256=data["input"]["sha256"],
            output_sha256=output.get("sha256", ""),
            input_mark=_mark(data["input"]),
            output_mark=_mark(output),
            input_object=_object_mark(data["input"]),
            output_object=_object_mark(output),
            text=line,
        )
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    words = (entry.name, entry.settings, entry.status, entry.input_sha256, entry.output_sha256)
    return entry if all(isinstance(word, str) for word in words) else None


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
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"


def _unwritable(path: Path, error: OSError) -> OutputError:
    return OutputError(
        f"the manifest {str(path)!r} cannot be used: {error.strerror}",
        hint="the output folder must be writable",
        path=str(path),
    )
