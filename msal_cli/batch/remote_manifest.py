"""The manifest of outputs in a store: parts, because nothing can be appended to an object.

``.msal-manifest/RUN-00001.jsonl`` and so on hold the same lines as the manifest of a folder, RUN
being the time at which the run began and eight random digits.  A part is written whole and never
again.  ``intent`` lines are there before the work starts; ``done`` lines follow every few seconds,
so a run that is killed forgets what it finished in the last of them, and those files are done
again.  Many parts are merged into one: first the new part is written, then the old ones are
removed, so that at any moment every line is in some part.
"""

from __future__ import annotations

import logging
import os
import re
import sys
import threading
from datetime import UTC, datetime

from msal_cli.batch.manifest import RUN_LINES_KEPT, Manifest
from msal_cli.batch.manifest_lines import LogView
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


class ObjectManifest(Manifest):
    """The manifest of one folder of a store; every run, shard or not, writes its own parts.

    Raises OutputError if the store does not answer.
    """

    def __init__(self, home: str, shard: Shard | None = None) -> None:
        started = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
        self._run = f"{started}-{os.urandom(4).hex()}"
        parts = read_parts(home)
        self._parts = list(parts)
        self._view = view_of_parts(parts)
        super().__init__(home, [self._view])
        # Of shards that start together one merges: else each would write a copy of everything.
        self._merges = shard is None or shard.number == 1
        self._n_written = 0
        self._n_failures = 0
        self._failure: MsalError | None = None
        self._waiting: list[bytes] = []
        self._lock = threading.Lock()
        self._writing = threading.Lock()
        self._is_closed = threading.Event()
        self._has_lines = threading.Event()
        self._thread: threading.Thread | None = None

    def open(self) -> None:
        """Prepare to append; merge what is in many parts."""
        if self._merges and len(self._parts) > MOST_PARTS:
            self._merge()
        self._thread = threading.Thread(target=self._write_loop, name="msal-manifest", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Write what is left; harmless if it is not open.

        Raises OutputError if that fails; while another exception is being handled, that is only
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
            _log.warning("the last lines of the manifest of %r could not be written", self.home)
            return
        self._flush()

    def _write_lines(self, lines: list[bytes], *, at_once: bool) -> None:
        with self._lock:
            self._waiting.extend(lines)
        if at_once:
            self._flush()
            return
        self._has_lines.set()
        if self._failure is not None and self._n_failures >= _MOST_FAILURES:
            raise _manifest_error(self.home, self._failure)

    def _write_loop(self) -> None:
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
            self._write_part(self._n_written + 1, text)
            self._n_written += 1
            with self._lock:
                del self._waiting[:n_lines]

    def _write_part(self, number: int, text: bytes) -> None:
        try:
            remote.write_whole(_url(self.home, f"{self._run}-{number:05d}.jsonl"), text)
        except OutputError as error:
            raise _manifest_error(self.home, error) from None

    def _merge(self) -> None:
        """One part in the place of all that were read."""
        lines = [run.line for run in self._view.run_lines[-RUN_LINES_KEPT:]]
        lines += [entry.line for entry in self._entries.values() if isinstance(entry.line, bytes)]
        self._write_part(0, b"".join(line + b"\n" for line in lines))
        remote.remove_object([_url(self.home, name) for name in self._parts])
        _log.debug("manifest of %r: %d parts became one", self.home, len(self._parts))


def view_of_parts(parts: dict[str, bytes]) -> LogView:
    """What the parts of a manifest say together."""
    return LogView.of((line, None) for text in parts.values() for line in text.split(b"\n") if line)


def read_parts(home: str) -> dict[str, bytes]:
    """The parts of a manifest by name, those of one run after another; empty if there is none.

    Raises OutputError if the store does not answer.
    """
    for is_last in (False, False, True):
        try:
            objects = remote.list_objects(_url(home))
            names = sorted(filter(_PART.fullmatch, objects))
            texts = remote.read_many({_url(home, name): objects[name] for name in names})
        except InputError as error:
            # Another run may be merging what was listed.
            if is_last:
                raise _manifest_error(home, error) from None
        else:
            return dict(zip(names, texts, strict=True))
    return {}


def _url(home: str, name: str = "") -> str:
    return urls.join_url(home, f"{FOLDER}/{name}")


def _manifest_error(home: str, error: MsalError) -> OutputError:
    return OutputError(
        f"the manifest in {home!r} cannot be used: {error.message}", hint=error.hint, path=home
    )
