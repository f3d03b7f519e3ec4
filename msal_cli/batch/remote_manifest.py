"""The manifest of outputs in a store: parts, because nothing can be appended to an object.

``.msal-manifest/RUN-00001.jsonl`` and so on hold the same lines as the manifest of a folder, RUN
being the time at which the run began and eight random digits.  A part is written whole and never
again.  ``intent`` lines are there before the work starts; ``done`` lines follow every few seconds,
so a run that is killed forgets what it finished in the last of them, and those files are done
again.  Many parts are merged into one: first the new part is written, then the old ones go, so
that at any moment every line is in some part.
"""

from __future__ import annotations

import logging
import os
import re
import sys
import threading
import time
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from typing import Any

from msal_cli.batch.manifest import RUN_KINDS, RUN_LINES_KEPT, Manifest, entry_of, kind_of, line_of
from msal_cli.batch.shard import Shard
from msal_cli.errors import InputError, MsalError, OutputError
from msal_cli.storage import objects as remote
from msal_cli.storage import urls

FOLDER = ".msal-manifest"

BETWEEN_PARTS_S = 3.0
"""Seconds that a line may wait for others before it is written."""

MOST_PARTS = 50
"""Parts beyond which the next run merges them; each costs a request at every start."""

_MOST_FAILURES = 10
_LAST_CHANCE_S = 1.5
_PART = re.compile(r"\d{8}T\d{6}\.\d{6}Z-[0-9a-f]{8}-\d{5,}\.jsonl")

_log = logging.getLogger("msal.batch")


class RemoteManifest(Manifest):
    """The manifest of one folder of a store; the interface is that of ``Manifest``.

    Shards need no names of their own: every run writes its own parts.
    """

    def __init__(self, folder: str, shard: Shard | None = None) -> None:
        super().__init__(folder, shard)
        moment = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
        # Of shards that start together one merges: else each would write a copy of everything.
        self._merges = shard is None or shard.number == 1
        self._run = f"{moment}-{os.urandom(4).hex()}"
        self._parts: list[str] = []
        self._n_written = 0
        self._n_failures = 0
        self._failure: MsalError | None = None
        self._waiting: list[bytes] = []
        self._lock = threading.Lock()
        self._writing = threading.Lock()
        self._is_closed = threading.Event()
        self._has_lines = threading.Event()
        self._thread: threading.Thread | None = None

    @classmethod
    def read(cls, folder: str, shard: Shard | None = None) -> RemoteManifest:
        """The manifest of ``folder``; an empty one where there is none.

        Raises OutputError if the store does not answer.
        """
        manifest = cls(folder, shard)
        parts = parts_of(folder)
        manifest._parts = list(parts)
        for text in parts.values():
            for line in filter(None, text.split(b"\n")):
                manifest._take(line)
        return manifest

    def _take(self, line: bytes) -> None:
        entry = entry_of(line)
        if entry is None:
            if kind_of(line) in RUN_KINDS:
                self._own_runs.append(line)
            return
        self._newest = max(self._newest, entry.at)
        other = self._entries.get(entry.name)
        if other is None or (entry.at, entry.is_done) >= (other.at, other.is_done):
            self._entries[entry.name] = entry

    def open(self) -> None:
        """Get ready to append; merge what is in many parts.

        Raises OutputError if the store does not take it.
        """
        if self._merges and len(self._parts) > MOST_PARTS:
            self._merge()
        self._thread = threading.Thread(target=self._write_on, name="msal-manifest", daemon=True)
        self._thread.start()

    def append(self, lines: Iterable[Mapping[str, Any]]) -> None:
        """Add lines: those made by ``intent`` are in the store when this returns, all others will
        be within ``BETWEEN_PARTS_S``.

        Raises OutputError if the store takes nothing any more.
        """
        some = list(lines)
        if not some:
            return
        self._newest = at = max(time.time_ns(), self._newest + 1)
        with self._lock:
            self._waiting.extend(line_of({**line, "at": at}) for line in some)
        if any(line["kind"] == "intent" for line in some):
            self._flush()
            return
        self._has_lines.set()
        if self._failure is not None and self._n_failures >= _MOST_FAILURES:
            raise _unusable(self.folder, self._failure)

    def close(self) -> None:
        """Write what is left; harmless if it is not open.

        Raises OutputError if that cannot be done; while another error is on its way, that is only
        logged, and not waited for long.
        """
        if self._thread is None:
            return
        self._is_closed.set()
        self._has_lines.set()
        is_failing = sys.exc_info()[0] is not None
        thread, self._thread = self._thread, None
        thread.join(_LAST_CHANCE_S if is_failing else None)
        if not self._waiting:
            return
        if is_failing:
            _log.warning("the last lines of the manifest of %r could not be written", self.folder)
            return
        self._flush()

    def _write_on(self) -> None:
        while not self._is_closed.is_set():
            self._has_lines.wait()
            self._has_lines.clear()
            self._is_closed.wait(BETWEEN_PARTS_S)
            try:
                self._flush()
                self._n_failures = 0
            except MsalError as error:
                # The lines wait for the next time: a store may be out of reach for a moment.
                self._failure = error
                self._n_failures += 1
                self._has_lines.set()

    def _flush(self) -> None:
        """Write the lines that wait as a part; they wait on if that fails."""
        with self._writing:
            with self._lock:
                text, n_lines = b"".join(self._waiting), len(self._waiting)
            if not text:
                return
            self._write(self._n_written + 1, text)
            self._n_written += 1
            with self._lock:
                del self._waiting[:n_lines]

    def _write(self, number: int, text: bytes) -> None:
        try:
            remote.write_whole(_url(self.folder, f"{self._run}-{number:05d}.jsonl"), text)
        except OutputError as error:
            raise _unusable(self.folder, error) from None

    def _merge(self) -> None:
        """One part in the place of all that were read."""
        lines = self._own_runs[-RUN_LINES_KEPT:] + [one.text for one in self._entries.values()]
        self._write(0, b"".join(line + b"\n" for line in lines))
        remote.removed([_url(self.folder, name) for name in self._parts])
        _log.debug("manifest of %r: %d parts became one", self.folder, len(self._parts))


def parts_of(folder: str) -> dict[str, bytes]:
    """The parts of a manifest by name, those of one run after another; empty if there is none.

    Raises OutputError if the store does not answer.
    """
    for is_last in (False, False, True):
        try:
            there = remote.listed(_url(folder))
            names = sorted(filter(_is_part, there))
            texts = remote.read_many({_url(folder, name): there[name] for name in names})
        except InputError as error:
            # Another run may just be merging what was listed.
            if is_last:
                raise _unusable(folder, error) from None
        else:
            return dict(zip(names, texts, strict=True))
    return {}


def _url(folder: str, name: str = "") -> str:
    return urls.joined(folder, f"{FOLDER}/{name}")


def _is_part(name: str) -> bool:
    return _PART.fullmatch(name) is not None


def _unusable(folder: str, error: MsalError) -> OutputError:
    return OutputError(
        f"the manifest in {folder!r} cannot be used: {error.message}",
        hint=error.hint,
        path=folder,
    )
