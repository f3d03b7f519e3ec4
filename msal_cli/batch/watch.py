"""A folder that is watched: its mesh files, each as soon as it is complete.

The folder is listed again and again, as for a run, on network disks and all others alike.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Sequence

from msal_cli.batch.inputs import DiscoveredInput, NothingMatched, discover_inputs
from msal_cli.batch.manifest import FileStat
from msal_cli.errors import UsageError

_UNFINISHED_ENDS = (".part", ".partial", ".filepart", ".crdownload", ".download", ".tmp", "~")
_LISTED_EVERY_S = 2.0

# Listing takes no more than this part of the time, however many files there are.
_SHARE_OF_LISTING = 0.1

_log = logging.getLogger("msal.batch")


class Inbox:
    """The mesh files of a folder and its subfolders, as ``discover_inputs`` finds them, each once
    per content; files with names of unfinished files are passed over.

    Parameters
    ----------
    output : the folder that gets the outputs; nothing below it is taken.
    settle_s : seconds for which size and time of a file must stand still.
    """

    def __init__(
        self,
        folder: str,
        output: str,
        include: Sequence[str] = (),
        exclude: Sequence[str] = (),
        *,
        settle_s: float,
    ) -> None:
        self._folder = folder
        self._output = output
        self._patterns = include, exclude
        self._settle_s = settle_s
        # Since when (s) size and time of a file have stood still; None once it is taken.
        self._known: dict[str, tuple[FileStat, float | None]] = {}
        self._is_listable = True
        self._next_listing = 0.0

    @property
    def is_quiet(self) -> bool:
        """Whether no file is on its way."""
        return all(since is None for _, since in self._known.values())

    def take_complete(self) -> list[DiscoveredInput]:
        """The files that have become complete, in the order of their times of change.

        Empty, and quick, between two listings.
        """
        now = time.monotonic()
        if now < self._next_listing:
            return []
        files = self._list()
        known: dict[str, tuple[FileStat, float | None]] = {}
        complete: list[tuple[int, DiscoveredInput]] = []
        for file in files:
            stat = FileStat.of(file.path)
            if stat is None or is_unfinished_name(os.path.basename(file.path)):
                continue
            before, since = self._known.get(file.path, (None, now))
            if before != stat:
                since = now
            elif since is not None and now - since >= self._settle_s:
                complete.append((stat.mtime_ns, file))
                since = None
            known[file.path] = stat, since
        if self._is_listable:
            self._known = known
        wait_s = min(_LISTED_EVERY_S, max(self._settle_s, 0.1))
        spent = time.monotonic() - now
        self._next_listing = now + spent + max(wait_s, spent / _SHARE_OF_LISTING)
        return [file for _, file in sorted(complete, key=lambda item: (item[0], item[1].path))]

    def _list(self) -> Sequence[DiscoveredInput]:
        try:
            found = discover_inputs([self._folder], *self._patterns, output=self._output)
        except NothingMatched:
            found = ()
        except UsageError as error:
            # A disk that is away may come back.
            if self._is_listable:
                _log.warning("%s; msal waits for it", error.message)
            self._is_listable = False
            return ()
        self._is_listable = True
        return found


def is_unfinished_name(name: str) -> bool:
    """Whether programs give such a name to files that they still write."""
    return name.startswith("~") or name.lower().endswith(_UNFINISHED_ENDS)
