"""Files that arrive in a folder: which of them are complete, in the order in which they came."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from msal_cli.batch.inputs import DiscoveredInput
from msal_cli.batch.manifest_lines import FileStat

_UNFINISHED_ENDS = (".part", ".partial", ".filepart", ".crdownload", ".download", ".tmp", "~")


def is_unfinished_name(name: str) -> bool:
    """Whether programs give such a name to files that they still write; hidden files have one."""
    return name.startswith((".", "~")) or name.lower().endswith(_UNFINISHED_ENDS)


def is_renamed_from(earlier: str, name: str) -> bool:
    """Whether ``earlier`` is the unfinished name of a file called ``name``, as in
    ``scan.ply.part`` or ``.scan.ply.Xy12``."""
    return is_unfinished_name(earlier) and name in earlier and name != earlier


@dataclass(slots=True)
class _Arrival:
    """A file that is not complete; its size and time have stood still since ``since`` (s)."""

    file: DiscoveredInput
    stat: FileStat
    since: float


class Arrivals:
    """Each file once per content: a file that changes after it was taken arrives again.

    ``settle_s`` is for how many seconds the size and the time of a file must stand still.
    Times are those of a monotonic clock, given by the caller.
    """

    def __init__(self, settle_s: float) -> None:
        self._settle_s = settle_s
        self._arriving: dict[str, _Arrival] = {}
        self._taken: dict[str, FileStat] = {}

    def note(self, file: DiscoveredInput, now: float, *, is_complete: bool = False) -> None:
        """Note a file that is new or may have changed; with ``is_complete`` it need not settle."""
        stat = FileStat.of(file.path)
        if stat is None:
            self.forget(file.path)
        elif self._taken.get(file.path) != stat:
            known = self._arriving.get(file.path)
            if known is None or known.stat != stat:
                # A place in the order is kept while the file is being written.
                self._arriving[file.path] = _Arrival(file, stat, now)
            if is_complete:
                self._arriving[file.path].since = now - self._settle_s

    def note_all(self, files: Iterable[DiscoveredInput], now: float) -> None:
        """Note all files that are there, new ones by their times of change; forget all others."""
        files = list(files)
        present = {file.path for file in files}
        for path in (self._arriving.keys() | self._taken.keys()) - present:
            self.forget(path)
        new = []
        for file in files:
            stat = FileStat.of(file.path)
            if stat is not None and self._taken.get(file.path) != stat:
                new.append((stat.mtime_ns, file))
        for _, file in sorted(new, key=lambda item: item[0]):
            self.note(file, now)

    def forget(self, path: str) -> None:
        """Forget a file that is not there any more."""
        self._arriving.pop(path, None)
        self._taken.pop(path, None)

    def pop_complete(self, now: float) -> list[DiscoveredInput]:
        """The files that are complete, in the order of their arrival; each is given once."""
        complete = []
        for path, arrival in list(self._arriving.items()):
            if now - arrival.since < self._settle_s:
                continue
            stat = FileStat.of(path)
            if stat is None:
                self.forget(path)
            elif stat != arrival.stat:
                arrival.stat, arrival.since = stat, now
            else:
                del self._arriving[path]
                self._taken[path] = stat
                complete.append(arrival.file)
        return complete

    def __len__(self) -> int:
        """How many files are not complete."""
        return len(self._arriving)
