"""The manifests of an output folder: what was written there, from what, with which settings.

``.msal-manifest.jsonl`` (see `manifest_lines`) only ever grows at its end, so a run that is killed
loses at most its last line.  Each shard writes a manifest of its own,
``.msal-manifest-K-of-N.jsonl``; all manifests of a folder are read.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import re
import time
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from msal_cli.batch.manifest_lines import (
    LineSpan,
    LogView,
    ManifestEntry,
    encode_line,
    manifest_error,
    merge_entries,
    parse_line,
    read_lines,
)
from msal_cli.batch.shard import Shard
from msal_cli.storage.atomic import flush_folder, write_whole
from msal_cli.storage.regular import is_regular, open_regular

NAME = ".msal-manifest.jsonl"
_ANY_NAME = re.compile(r"\.msal-manifest(?:-\d{1,9}-of-\d{1,9})?\.jsonl")

# Lines that no longer count are dropped at the start of a run once there are this many of them
# and more than there are lines that count.
_SPARE_LINES = 1000

RUN_LINES_KEPT = 100
"""Lines about runs are kept for reports, but not without end."""

_log = logging.getLogger("msal.batch")


class Manifest:
    """All manifests of one place, of which one is written; `FolderManifest` or `ObjectManifest`."""

    def __init__(self, home: str, views: Collection[LogView]) -> None:
        self.home = home
        self._entries = merge_entries(views)
        self._newest = max((entry.at for entry in self._entries.values()), default=0)

    def get(self, name: str) -> ManifestEntry | None:
        """What is known of an output."""
        return self._entries.get(name)

    def names(self) -> frozenset[str]:
        """Every output that some run wrote or began to write here."""
        return frozenset(self._entries)

    def append(self, lines: Iterable[Mapping[str, Any]]) -> None:
        """Add lines made by ``intent_line``, ``done_line`` and the like.

        On return they are on the disk.  A store has those of intents, and gets all others soon.
        Raises OutputError if they cannot be written.
        """
        some = list(lines)
        if not some:
            return
        self._newest = at = max(time.time_ns(), self._newest + 1)
        encoded = [encode_line({**line, "at": at}) for line in some]
        self._write_lines(encoded, at_once=any(line["kind"] == "intent" for line in some))

    def open(self) -> None:
        """Prepare to append; drop lines that no longer count.  OutputError if that fails.

        Harmless if it is open.
        """
        raise NotImplementedError

    def close(self) -> None:
        """Finish writing; harmless if it is not open.  OutputError if lines cannot be written."""
        raise NotImplementedError

    def _write_lines(self, lines: list[bytes], *, at_once: bool) -> None:
        raise NotImplementedError


class FolderManifest(Manifest):
    """The manifests of a folder; written is that of ``shard``, or that of runs that are no shards.

    Raises OutputError if one is there but cannot be read.
    """

    def __init__(self, folder: str, shard: Shard | None = None) -> None:
        self._path = Path(folder) / manifest_name(shard)
        views = {path: read_view(path) for path in list_manifests(folder)}
        super().__init__(folder, views.values())
        self._own = views.get(self._path, LogView())
        self._file: BinaryIO | Any = None

    def open(self) -> None:
        """Prepare to append, under the folder's lock: repair a torn end, drop what is outdated."""
        if self._file is not None:
            return
        try:
            n_kept = len(self._own.entries) + min(len(self._own.run_lines), RUN_LINES_KEPT)
            if self._own.n_lines - n_kept > max(_SPARE_LINES, n_kept):
                self._compact()
                _log.debug("manifest of %r: %d lines are left", self.home, n_kept)
            if self._path.is_symlink():
                # Its target may be outside of the output folder.
                raise OSError(errno.ELOOP, "it is a link")
            is_new = not self._path.exists()
            if not is_new and not is_regular(self._path):
                # To open a pipe would wait for a reader.
                raise OSError(errno.EINVAL, "it is not a regular file")
            # With a buffer, what did not fit on a full disk would be tried again at the end.
            self._file = self._path.open("ab", buffering=0)
            if is_new:
                flush_folder(self._path.parent)
            if self._file.tell() and not _ends_with_newline(self._path):
                self._write_all(b"\n")
        except OSError as error:
            raise manifest_error(str(self._path), error) from None

    def close(self) -> None:
        """Close the file; harmless if it is not open."""
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
        # One that stays open for several runs tells the next of them what the last one did; what
        # was only begun does not hide what this run may still ask of the one before.
        for line in lines:
            entry = parse_line(line[:-1], LineSpan(self._path, start, len(line) - 1))
            if isinstance(entry, ManifestEntry) and entry.is_done:
                self._entries[entry.name] = entry
            start += len(line)

    def _write_all(self, text: bytes) -> None:
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

    def _compact(self) -> None:
        """Rewrite the manifest with the lines that count; whole or not at all."""
        counting = {entry.line for entry in self._own.entries.values()}

        def lines() -> Iterator[bytes]:
            for run in self._own.run_lines[-RUN_LINES_KEPT:]:
                yield run.line + b"\n"
            for line, span in read_lines(self._path):
                if span in counting:
                    yield line + b"\n"

        write_whole(self._path, lines())


def manifest_name(shard: Shard | None) -> str:
    """The name of a shard's manifest, or of that of runs that are no shards."""
    return NAME if shard is None else f".msal-manifest-{shard.file_part}.jsonl"


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


def read_view(path: Path) -> LogView:
    """What one manifest says; OutputError if it cannot be read."""
    return LogView.of(read_lines(path))


def _ends_with_newline(path: Path) -> bool:
    with open_regular(path) as file:
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"
