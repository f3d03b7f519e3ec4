"""One run at a time on an output folder, or the shards of one N together.

A run that is no shard locks the folder's ``.msal-lock`` exclusively.  A shard locks a file of its
own, ``.msal-lock-K-of-N``, and the folder's in shared mode.  A run that has its locks then looks
for runs that it conflicts with, and releases its locks if there is one.  As all lock before they
look, of two runs in conflict at least one sees the other.  Two that start in the same instant may
both give up; so each tries again a few times, after pauses of random length.

The locks are the system's own locks on open files, so they end with the process that has them,
however that ends; nothing stale can stay behind.  The files also contain who has them.  Where locks
cannot be shared (Windows), a shard locks its own file only, and the look alone keeps shards and
whole runs apart.  On a file system without locks the text in the file is all there is: it counts
while its process lives, and texts of other machines do not count.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import logging
import os
import platform
import random
import re
import stat
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from msal_cli.batch.shard import Shard
from msal_cli.errors import OutputError, UsageError
from msal_cli.machine import is_alive

NAME = ".msal-lock"
_OF_SHARD = re.compile(re.escape(NAME) + r"-(\d{1,9})-of-(\d{1,9})")

_CAN_SHARE: bool = os.name != "nt"

# Windows keeps others from reading what is locked, so there a byte far behind the text is locked.
_WINDOWS_LOCK_AT = 1 << 30

# A lock that was taken only to look is free again at once.
_TRIES = 5
_PAUSE_S = (0.02, 0.1)

_log = logging.getLogger("msal.batch")


class FolderLock(contextlib.AbstractContextManager["FolderLock"]):
    """Lock a folder for this process; use it with ``with`` or call ``release``.

    ``shard`` shares the folder with the other shards of the same N.

    Raises UsageError (``E_LOCKED``), which names the process, if another run has locked the folder,
    and OutputError if a lock file cannot be opened.
    """

    def __init__(self, folder: str, shard: Shard | None = None) -> None:
        self._folder = Path(folder)
        self._shard = shard
        self._locks: list[_LockFile] = []
        for tries_left in reversed(range(_TRIES)):
            try:
                rival = self._acquire()
            except BaseException:
                self.release()
                raise
            if rival is None:
                return
            self.release()
            if not tries_left:
                raise UsageError(
                    f"{rival} is already working on the folder {folder!r}",
                    hint="wait until it is done, stop it, or choose another output folder",
                    path=folder,
                    code="E_LOCKED",
                )
            time.sleep(random.uniform(*_PAUSE_S))

    def __exit__(self, *failure: object) -> None:
        self.release()

    def release(self) -> None:
        """Release the folder; harmless if that has been done."""
        while self._locks:
            self._locks.pop().release()

    def _acquire(self) -> _LockOwner | None:
        """Lock what this run needs; None, or the owner of a lock in its way."""
        whole = self._folder / NAME
        if self._shard is None:
            # While shards share the folder's lock, its text may be old.
            owner = self._lock(whole)
            return self._conflicting_shard() or owner
        owner = self._lock(self._folder / f"{NAME}-{self._shard.file_part}")
        if owner is None:
            owner = self._lock(whole, is_shared=True) if _CAN_SHARE else _probe_lock(whole)
        return owner or self._conflicting_shard()

    def _lock(self, path: Path, *, is_shared: bool = False) -> _LockOwner | None:
        """Open and lock a file and keep it so; None, or the owner of its lock."""
        while True:
            file = _LockFile.open(path)
            with contextlib.ExitStack() as stack:
                stack.callback(os.close, file.handle)
                if not file.try_lock(is_shared=is_shared):
                    return file.owner()
                # Its last owner may have removed it while we waited for it.
                if not file.has_name():
                    continue
                if not is_shared:
                    file.write_owner()
                self._locks.append(file)
                stack.pop_all()
                return None

    def _conflicting_shard(self) -> _LockOwner | None:
        """The owner of a shard's lock that this run conflicts with."""
        for path, count in _shard_locks(self._folder):
            if self._shard is None or count != self._shard.count:
                owner = _probe_lock(path, is_removed=self._shard is None)
                if owner is not None:
                    return owner
        return None


def lock_owners(folder: str) -> tuple[str, ...]:
    """Who works on a folder now, in words such as ``process 17 on host``; touches nothing."""
    owners = []
    for path in (Path(folder) / NAME, *(path for path, _ in _shard_locks(Path(folder)))):
        with contextlib.suppress(OutputError):
            owners.append(_probe_lock(path))
    return tuple(str(owner) for owner in owners if owner is not None)


@dataclass(frozen=True, slots=True)
class _LockOwner:
    """Process id and machine of a lock's owner, empty where they are not known."""

    pid: str
    host: str
    shard: str

    def __str__(self) -> str:
        who = f"process {self.pid}" if self.pid else "another process"
        if self.host and self.host != platform.node():
            who += f" on {self.host}"
        return who + (f" (shard {self.shard})" if self.shard else "")

    def is_alive(self) -> bool:
        """Whether it is a process of this machine that lives."""
        is_here = self.host == platform.node() and self.pid.isdigit()
        return is_here and is_alive(int(self.pid))


@dataclass(slots=True)
class _LockFile:
    """A lock file that is open."""

    path: Path
    handle: int
    is_shared: bool = False

    @classmethod
    def open(cls, path: Path, flags: int = os.O_CREAT) -> _LockFile:
        flags |= os.O_RDWR | getattr(os, "O_NOFOLLOW", 0)
        try:
            # Without it, opening a pipe would wait for a writer.
            handle = os.open(path, flags | getattr(os, "O_NONBLOCK", 0), 0o644)
            if not stat.S_ISREG(os.fstat(handle).st_mode):
                os.close(handle)
                raise OSError(errno.EINVAL, "it is not a regular file")
        except OSError as error:
            raise OutputError(
                f"the lock file {str(path)!r} cannot be opened: {error.strerror}",
                hint="the output folder must be writable",
                path=str(path),
            ) from error
        return cls(path, handle)

    def try_lock(self, *, is_shared: bool) -> bool:
        """Lock it, or where that is impossible see whether the process in its text is gone."""
        self.is_shared = is_shared
        try:
            return _flock(self.handle, is_shared=is_shared)
        except OSError as error:
            _warn_once(str(self.path.parent), str(error))
            return not self.owner().is_alive()

    def owner(self) -> _LockOwner:
        os.lseek(self.handle, 0, os.SEEK_SET)
        pid, _, host = os.read(self.handle, 300).decode(errors="replace").strip().partition(" ")
        shard = _OF_SHARD.fullmatch(self.path.name)
        return _LockOwner(pid, host, f"{shard[1]}/{shard[2]}" if shard else "")

    def write_owner(self) -> None:
        """Make this process the owner in the text."""
        try:
            os.truncate(self.handle, 0)
            os.lseek(self.handle, 0, os.SEEK_SET)
            os.write(self.handle, f"{os.getpid()} {platform.node()}\n".encode())
        except OSError as error:
            raise OutputError(
                f"the lock file {str(self.path)!r} cannot be written: {error.strerror}",
                hint="the output folder must be writable, and its disk not be full",
                path=str(self.path),
            ) from None

    def has_name(self) -> bool:
        """Whether the open file is still the one of this name."""
        try:
            return os.path.samestat(os.fstat(self.handle), self.path.stat())
        except OSError:
            return False

    def release(self) -> None:
        if os.name == "nt":
            os.close(self.handle)
            _remove(self.path)
            return
        # It is removed under an exclusive lock: a process that opened it meanwhile sees that it is
        # gone and starts again.
        with contextlib.suppress(OSError):
            if not self.is_shared or _flock(self.handle):
                _remove(self.path)
        # After an error of the system it is closed, too, and its content does not matter.
        with contextlib.suppress(OSError):
            os.close(self.handle)


def _probe_lock(path: Path, *, is_removed: bool = False) -> _LockOwner | None:
    """The owner of a lock file; None if it is free, and then it can be removed."""
    try:
        file = _LockFile.open(path, 0)
    except OutputError as error:
        if isinstance(error.__cause__, FileNotFoundError | NotADirectoryError):
            return None
        raise
    try:
        # A shared lock lets others probe at the same time.
        if not file.try_lock(is_shared=_CAN_SHARE and not is_removed):
            return file.owner()
        if is_removed:
            _remove(path)
        return None
    finally:
        os.close(file.handle)


@functools.cache
def _warn_once(folder: str, reason: str) -> None:
    _log.warning("the folder %r cannot be locked: %s", folder, reason)


def _remove(path: Path) -> None:
    # A free lock file that stays is no obstacle to the next run.
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)


def _shard_locks(folder: Path) -> Iterator[tuple[Path, int]]:
    """The lock files of shards in a folder, each with its N."""
    try:
        with os.scandir(folder) as entries:
            names = sorted(entry.name for entry in entries if entry.name.startswith(NAME))
    except OSError:
        return
    for name in names:
        if shard := _OF_SHARD.fullmatch(name):
            yield folder / name, int(shard[2])


def _flock(handle: int, *, is_shared: bool = False) -> bool:
    """Try to lock; False if another process has the lock; OSError if there are no locks.

    Where there are no shared locks it is always exclusive."""
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
