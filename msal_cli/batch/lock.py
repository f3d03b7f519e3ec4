"""Lock an output folder for one run, or for all shards of one N.

A shard is the part of a plan that one of N processes does, on one machine or on many.  A hash of
its relative path assigns a file to a shard: the processes need not communicate, and a file keeps
its shard whatever other files are added or removed.  Only another N changes the assignment.

A run locks a file of its own in the folder, ``.msal-lock`` or that of its shard,
``.msal-lock-K-of-N``, and then checks whether a conflicting run has locked another; if so, it
releases its own.  As every run locks before it checks, at least one of two conflicting runs sees
the other.  Two that start at the same instant may both give up, so each tries a few times, after
random pauses.

The locks are system locks on open files.  They end with the process that has them, however that
ends, so that no lock is ever stale.  The files also name their owner.  On a file system without
locks only this text is used: it counts while its process lives, if that is on this machine.
"""

import contextlib
import errno
import functools
import hashlib
import logging
import os
import platform
import random
import re
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from msal_cli.errors import OutputError, UsageError
from msal_cli.light_dataclass import dataclass
from msal_cli.machine import is_alive
from msal_cli.storage.regular import open_own

NAME = ".msal-lock"
_ANY_NAME = re.compile(re.escape(NAME) + r"(?:-(\d{1,9})-of-(\d{1,9}))?")

# On Windows others cannot read locked bytes, so a byte far after the text is locked there.
_WINDOWS_LOCK_AT = 1 << 30

# Another process may have a lock for a moment, only to check it.
_TRIES = 5
_PAUSE_S = (0.02, 0.1)

MAX_SHARDS = 1_000_000
"""A larger N would give less than one file to a shard, even of the largest folders."""

_log = logging.getLogger("msal.batch")


@dataclass(frozen=True, slots=True)
class Shard:
    """The ``number``-th of ``count`` shards; the first is 1."""

    number: int
    count: int

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    @property
    def file_part(self) -> str:
        """The part of the shard's file names that identifies it: ``2-of-4``."""
        return f"{self.number}-of-{self.count}"

    def has(self, relative: str) -> bool:
        """Whether the file of this relative path (with ``/``) belongs to this shard: by the first
        eight bytes of the path's SHA-256, big-endian, modulo ``count``."""
        try:
            name = os.fsencode(relative)
        except UnicodeEncodeError:
            # No file has such a name, but a URL may.
            name = relative.encode("utf-8", "surrogatepass")
        digest = hashlib.sha256(name).digest()
        return int.from_bytes(digest[:8], "big") % self.count == self.number - 1


def parse_shard(text: str) -> Shard:
    """The shard ``K/N``; UsageError for anything else."""
    match = re.fullmatch(r"(?a)(\d{1,9})/(\d{1,9})", text)
    number, count = map(int, match.groups()) if match else (0, 0)
    if not 1 <= number <= count <= MAX_SHARDS:
        raise UsageError(
            f"--shard {text}: a shard is K/N with 1 <= K <= N <= {MAX_SHARDS}",
            hint="four processes take --shard 1/4, 2/4, 3/4 and 4/4",
        )
    return Shard(number, count)


class FolderLock(contextlib.AbstractContextManager["FolderLock"]):
    """A lock on a folder for this process; use it with ``with`` or call ``release``.

    With a ``shard``, the other shards of the same N may lock the folder, too.

    Raises UsageError (``E_LOCKED``), which names the process, if another run has locked the folder,
    and OutputError if a lock file cannot be opened.
    """

    def __init__(self, folder: str, shard: Shard | None = None) -> None:
        own_name = NAME if shard is None else f"{NAME}-{shard.file_part}"
        self._path = Path(folder) / own_name
        self._handle: int | None = None
        for tries_left in reversed(range(_TRIES)):
            try:
                rival = self._lock() or self._find_rival(shard)
            except BaseException:
                self.release()
                raise
            if rival is None:
                return
            self.release()
            if not tries_left:
                raise _locked(folder, rival)
            time.sleep(random.uniform(*_PAUSE_S))

    def __exit__(self, *failure: object) -> None:
        self.release()

    def release(self) -> None:
        """Release the folder; does nothing if that has been done."""
        if self._handle is None:
            return
        close, remove = functools.partial(os.close, self._handle), self._path.unlink
        self._handle = None
        # Remove it while it is locked: a process that opened it meanwhile sees that it is gone.
        # Windows removes no open file.  An unlocked file that stays does no harm.
        for step in (close, remove) if os.name == "nt" else (remove, close):
            with contextlib.suppress(OSError):
                step()

    def _lock(self) -> str | None:
        """Lock the file of this run; return None, or the owner if another has locked it."""
        while self._handle is None:
            with _convert_os_errors(self._path):
                handle = open_own(self._path, os.O_CREAT)
            try:
                if not _try_lock(handle, self._path):
                    return _describe_owner(handle, self._path)
                # Its last owner may have removed it after we opened it.
                if _has_name(handle, self._path):
                    with _convert_os_errors(self._path):
                        os.truncate(handle, 0)
                        os.lseek(handle, 0, os.SEEK_SET)
                        os.write(handle, f"{os.getpid()} {platform.node()}\n".encode())
                    self._handle = handle
            finally:
                if self._handle is None:
                    os.close(handle)
        return None

    def _find_rival(self, shard: Shard | None) -> str | None:
        """The owner of another lock that this run conflicts with, if any."""
        for path, count in _lock_files(self._path.parent):
            is_sibling = shard is not None and count == shard.count
            if not is_sibling and path != self._path and (owner := _find_owner(path)):
                return owner
        return None


def lock_owners(folder: str) -> tuple[str, ...]:
    """The owners of locks on a folder, such as ``process 17 on host``; changes nothing."""
    owners = []
    for path, _ in _lock_files(Path(folder)):
        with contextlib.suppress(OutputError):
            owners.append(_find_owner(path))
    return tuple(filter(None, owners))


def refuse_locked(folders: Iterable[str]) -> None:
    """Refuse folders that another run has locked; UsageError (``E_LOCKED``)."""
    for folder in folders:
        for owner in lock_owners(folder):
            raise _locked(folder, owner)


def _locked(folder: str, owner: str) -> UsageError:
    return UsageError(
        f"{owner} is already working on the folder {folder!r}",
        hint="wait until it is done, stop it, or choose another output folder",
        path=folder,
        code="E_LOCKED",
    )


def _read_owner(handle: int) -> tuple[str, str]:
    """Process id and machine in the text of an open lock file, empty where they are not known."""
    os.lseek(handle, 0, os.SEEK_SET)
    pid, _, host = os.read(handle, 300).decode(errors="replace").strip().partition(" ")
    return pid, host


def _describe_owner(handle: int, path: Path) -> str:
    """The owner of an open lock file in words, such as ``process 17 on host (shard 1/4)``."""
    pid, host = _read_owner(handle)
    who = f"process {pid}" if pid else "another process"
    if host and host != platform.node():
        who += f" on {host}"
    name = _ANY_NAME.fullmatch(path.name)
    return who + (f" (shard {name[1]}/{name[2]})" if name and name[1] else "")


def _lock_files(folder: Path) -> Iterator[tuple[Path, int]]:
    """The lock files in a folder, each with the N of its shard, 0 for that of a whole run."""
    try:
        names = sorted(name for name in os.listdir(folder) if name.startswith(NAME))
    except OSError:
        return
    for name in names:
        if match := _ANY_NAME.fullmatch(name):
            yield folder / name, int(match[2] or 0)


@contextlib.contextmanager
def _convert_os_errors(path: Path) -> Iterator[None]:
    """Raise OutputError if this lock file cannot be opened or written."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"the lock file {str(path)!r} cannot be used: {error.strerror}",
            hint="the output folder must be writable, and its disk not be full",
            path=str(path),
        ) from None


def _has_name(handle: int, path: Path) -> bool:
    """Whether an open file is still the one of this name."""
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except OSError:
        return False


def _find_owner(path: Path) -> str | None:
    """The owner of a lock file; None if it is free."""
    with _convert_os_errors(path):
        try:
            handle = open_own(path)
        except FileNotFoundError:
            return None
    try:
        # A shared lock lets others look at the same time.
        is_free = _try_lock(handle, path, is_shared=True)
        return None if is_free else _describe_owner(handle, path)
    finally:
        os.close(handle)


def _try_lock(handle: int, path: Path, *, is_shared: bool = False) -> bool:
    """Try to lock a file; without system locks, whether the process named in it is gone."""
    try:
        return _flock(handle, is_shared=is_shared)
    except OSError as error:
        _warn_once(str(path.parent), str(error))
        pid, host = _read_owner(handle)
        is_here = host == platform.node() and pid.isdigit()
        return not (is_here and is_alive(int(pid)))


@functools.cache
def _warn_once(folder: str, reason: str) -> None:
    _log.warning("the folder %r cannot be locked: %s", folder, reason)


def _flock(handle: int, *, is_shared: bool = False) -> bool:
    """Try to lock; False if another process has the lock, OSError if the file system has no locks.

    On Windows the lock is always exclusive."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(handle, _WINDOWS_LOCK_AT, os.SEEK_SET)
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
            os.lseek(handle, 0, os.SEEK_SET)
        else:
            import fcntl

            operation = fcntl.LOCK_SH if is_shared else fcntl.LOCK_EX
            fcntl.flock(handle, operation | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EAGAIN, errno.EWOULDBLOCK, errno.EDEADLK):
            return False
        raise
    return True
