"""A folder that is watched: its mesh files, each as soon as it is complete.

Changes are reported by the system (watchfiles).  Now and then, and where the system does not report
what other machines do, the folder is listed as for a run.  So an event that is lost costs time, but
no file.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Iterator, Sequence, Set
from pathlib import Path

from msal_cli.batch.arrivals import Arrivals, is_renamed_from, is_unfinished_name
from msal_cli.batch.inputs import DiscoveredInput, NothingMatched, discover_inputs, resolve
from msal_cli.batch.network_folders import is_on_network
from msal_cli.batch.patterns import Patterns
from msal_cli.errors import ResourceError, UsageError, install_hint
from msal_cli.job.settings import is_mesh_name

_STEP_S = 0.1
_LISTED_EVERY_S = 60.0
_POLLED_EVERY_S = 1.0

# Listing takes no more than this part of the time, however many files there are.
_SHARE_OF_LISTING = 0.1

_log = logging.getLogger("msal.batch")


class Inbox:
    """The mesh files of a folder and all its subfolders, as `discover_inputs` finds them.

    Files with names of unfinished files (see `arrivals.is_unfinished_name`) are passed over.

    Parameters
    ----------
    output : the folder that gets the outputs; nothing below it is taken.
    settle_s : seconds for which size and time of a file must stand still.
    is_polled : list the folder again and again; without it only on network folders.

    Raises
    ------
    UsageError : the folder cannot be listed.
    ResourceError : watchfiles is not installed, and the folder is not polled.
    """

    def __init__(
        self,
        folder: str,
        output: str,
        include: Sequence[str] = (),
        exclude: Sequence[str] = (),
        *,
        settle_s: float,
        is_polled: bool = False,
    ) -> None:
        self._folder = str(Path(folder))
        self._real = str(resolve(Path(folder)))
        self._output = output
        self._patterns = include, exclude
        self._included, self._excluded = Patterns(include), Patterns(exclude)
        own = resolve(Path(output))
        is_within = own != Path(self._real) and own.is_relative_to(self._real)
        self._own = own.relative_to(self._real).parts if is_within else None
        self._arrivals = Arrivals(settle_s)
        self._listed_every_s = _LISTED_EVERY_S
        # Before the first listing, so that nothing is missed between the two.
        self._changes = self._poll() if is_polled or self._must_poll() else self._start_watching()
        self._is_listable = True
        self._list(is_first=True)

    def wait(self) -> None:
        """Wait for changes for a fraction of a second, and note them."""
        events = next(self._changes, set())
        now = time.monotonic()
        gone = {path for kind, path in events if kind == "deleted"}
        for kind, path in sorted(events, key=lambda event: event[1]):
            if kind != "deleted":
                self._note(kind, path, gone, events, now)
        if now >= (self._earliest_listing if self._is_listing_wanted else self._next_listing):
            self._list()

    def pop_complete(self) -> list[DiscoveredInput]:
        """The files that are complete, in the order of their arrival; each once per content."""
        return self._arrivals.pop_complete(time.monotonic())

    def is_quiet(self) -> bool:
        """Whether no file is on its way."""
        return not len(self._arrivals)

    # Changes: sets of what happened (added, modified or deleted) and a path below the real folder

    def _must_poll(self) -> bool:
        if not is_on_network(self._folder):
            return False
        _log.info("the folder %r is on a network, so it is polled", self._folder)
        return True

    def _poll(self) -> Iterator[set[tuple[str, str]]]:
        self._listed_every_s = _POLLED_EVERY_S
        self._is_listing_wanted = True
        while True:
            time.sleep(_STEP_S)
            yield set()

    def _start_watching(self) -> Iterator[set[tuple[str, str]]]:
        try:
            import watchfiles
        except ImportError:
            raise ResourceError(
                "watching needs the package watchfiles",
                hint=f"{install_hint('watch')}, or give --poll",
                code="E_UNSUPPORTED",
            ) from None
        step_ms = int(1000 * _STEP_S)
        changes = watchfiles.watch(
            self._real,
            watch_filter=None,
            debounce=step_ms,
            step=step_ms // 2,
            rust_timeout=step_ms,
            yield_on_timeout=True,
            raise_interrupt=False,
            ignore_permission_denied=True,
        )
        # The first step begins the watch.
        first = self._poll_after(changes)
        next(first)
        return first

    def _poll_after(
        self, changes: Iterator[Set[tuple[object, str]]]
    ) -> Iterator[set[tuple[str, str]]]:
        """The changes of watchfiles; once it fails the folder is polled."""
        try:
            for some in changes:
                yield {(getattr(kind, "name", ""), path) for kind, path in some}
        except (OSError, RuntimeError) as error:
            _log.warning("the folder %r is polled: %s", self._folder, error)
        yield from self._poll()

    def _note(
        self, kind: str, path: str, gone: set[str], events: set[tuple[str, str]], now: float
    ) -> None:
        relative = os.path.relpath(path, self._real)
        if os.path.isdir(path) or os.path.islink(path):
            # Files may be in a new folder before it is watched; links have rules of their own.
            self._is_listing_wanted = True
        elif self._is_selected(relative):
            folder, name = os.path.split(path)
            is_renamed = kind == "added" and ("modified", path) not in events
            is_complete = is_renamed and any(
                os.path.dirname(one) == folder and is_renamed_from(os.path.basename(one), name)
                for one in gone
            )
            file = DiscoveredInput(
                os.path.join(self._folder, relative),
                relative.replace(os.sep, "/"),
                self._folder,
            )
            self._arrivals.note(file, now, is_complete=is_complete)

    def _is_selected(self, relative: str) -> bool:
        """Whether `discover_inputs` takes a file of this path, and its name is a finished one."""
        parts = Path(relative).parts
        name = "/".join(parts)
        is_own = self._own is not None and parts[: len(self._own)] == self._own
        is_hidden = any(part.startswith(".") for part in parts)
        return not (
            is_own
            or is_hidden
            or is_unfinished_name(parts[-1])
            or not is_mesh_name(parts[-1])
            or (self._included and not self._included.matches(name))
            or self._excluded.matches(name)
        )

    def _list(self, *, is_first: bool = False) -> None:
        start = time.monotonic()
        try:
            self._arrivals.note_all(self._discover(), start)
            self._is_listable = True
        except UsageError as error:
            if is_first:
                raise
            # A disk that is away may come back.
            if self._is_listable:
                _log.warning("%s; msal waits for it", error.message)
            self._is_listable = False
        now = time.monotonic()
        self._is_listing_wanted = False
        self._earliest_listing = now + (now - start) / _SHARE_OF_LISTING
        self._next_listing = max(self._earliest_listing, now + self._listed_every_s)

    def _discover(self) -> list[DiscoveredInput]:
        try:
            found = discover_inputs([self._folder], *self._patterns, output=self._output)
        except NothingMatched:
            return []
        return [one for one in found if not is_unfinished_name(os.path.basename(one.path))]
