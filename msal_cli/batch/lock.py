"""One run at a time on an output folder, or the shards of one N together.

A run that is no shard holds the folder's lock ``.msal-lock`` alone.  A shard holds a lock of its
own, ``.msal-lock-K-of-N``, and shares the folder's.  Whoever holds what it needs then looks for
others that it does not get along with, and gives up what it holds if it finds one.  As everybody
takes before looking, of two that do not get along at least one sees the other.  Two that start in
the same instant may both give up; so each tries again a few times, after pauses of random length.

The locks are the system's own locks on open files, so they end with the process that holds them,
however that ends; nothing stale can stay behind.  The files also tell who holds them.  Where locks
cannot be shared (Windows), a shard holds its own lock only, and the looking alone keeps shards and
whole runs apart.  On a file system without locks the word in the file is all there is: it counts
while its process lives, and words of other machines do not count.
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
from types import TracebackType

from msal_cli.batch.process_status import is_alive
from msal_cli.batch.shard import Shard
from msal_cli.errors import OutputError, UsageError

NAME = ".msal-lock"
_OF_SHARD = re.compile(re.escape(NAME) + r"-(\d{1,9})-of-(\d{1,9})")

_CAN_SHARE: bool = os.name != "nt"

# Windows keeps others from reading what is locked, so there a byte far behind the text is locked.
_WINDOWS_LOCK_AT = 1 << 30

# A lock that somebody took only to look is free again at once.
_TRIES = 5
_PAUSE_S = (0.02, 0.1)

_log = logging.getLogger("msal.batch")


class FolderLock:
    """Hold a folder for this process; use it with ``with`` or call ``release``.

    ``shard`` shares the folder with the other shards of the same N.

    Raises
    ------
    UsageError : another run holds the folder (code ``E_LOCKED``); its process id is in the message.
    OutputError : a lock file cannot be opened.
    """

    def __init__(self, folder: str, shard: Shard | None = None) -> None:
        self._folder = Path(folder)
        self._shard = shard
        self._held: list[_Held] = []
        for left in reversed(range(_TRIES)):
            try:
                rival = self._rival()
            except BaseException:
                self.release()
                raise
            if rival is None:
                return
            self.release()
            if not left:
                raise self._refusal(rival)
            time.sleep(random.uniform(*_PAUSE_S))

    def __enter__(self) -> FolderLock:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.release()

    def release(self) -> None:
        """Give the folder back; harmless if that has been done."""
        while self._held:
            self._held.pop().release()

    def _rival(self) -> _Holder | None:
        """Take what this run needs; None, or who is in the way."""
        whole = self._folder / NAME
        if self._shard is None:
            # What the folder's lock says may be old while shards share it.
            holder = self._taken(whole)
            return self._shard_at_work() or holder
        own = self._folder / f"{NAME}-{self._shard.file_part}"
        holder = self._taken(own)
        if holder is None:
            holder = self._taken(whole, is_shared=True) if _CAN_SHARE else _looked_at(whole)
        return holder or self._shard_at_work()

    def _taken(self, path: Path, *, is_shared: bool = False) -> _Holder | None:
        """Open and lock a file and keep it so; None, or who holds it."""
        while True:
            handle = _opened(path)
            is_kept = False
            try:
                if not _is_free(handle, path, is_shared=is_shared):
                    return _holder(handle, path)
                # Its last holder may have removed it while we waited for it.
                is_kept = _is_still_there(handle, path)
                if is_kept:
                    if not is_shared:
                        _say_who(handle, path)
                    self._held.append(_Held(path, handle, is_shared))
                    return None
            except BaseException:
                is_kept = False
                raise
            finally:
                if not is_kept:
                    os.close(handle)

    def _shard_at_work(self) -> _Holder | None:
        """Who works on a shard that this run does not get along with."""
        for path, count in _shard_locks(self._folder):
            if self._shard is None or count != self._shard.count:
                holder = _looked_at(path, is_removed=self._shard is None)
                if holder is not None:
                    return holder
        return None

    def _refusal(self, rival: _Holder) -> UsageError:
        return UsageError(
            f"{rival} is already working on the folder {str(self._folder)!r}",
            hint="wait until it is done, stop it, or choose another output folder",
            path=str(self._folder),
            code="E_LOCKED",
        )


def who_works(folder: str) -> tuple[str, ...]:
    """Who works on a folder now, in words such as ``process 17 on host``; touches nothing."""
    paths = [Path(folder) / NAME, *(path for path, _ in _shard_locks(Path(folder)))]
    found = []
    for path in paths:
        try:
            holder = _looked_at(path)
        except OutputError:
            continue
        # Of the folder's own lock, while shards share it, nobody is the holder.
        if holder is not None:
            found.append(str(holder))
    return tuple(found)


@dataclass(frozen=True, slots=True)
class _Holder:
    """Process id and machine of who holds a lock, empty where that is not told."""

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


@dataclass(frozen=True, slots=True)
class _Held:
    """A lock file that this process holds open and locked."""

    path: Path
    handle: int
    is_shared: bool

    def release(self) -> None:
        if os.name == "nt":
            os.close(self.handle)
            _remove(self.path)
            return
        # Removed while held alone: who opened it meanwhile sees that it is gone and starts again.
        if not self.is_shared or self._is_last():
            _remove(self.path)
        # Closed it is, whatever the system says about it, and nothing in it is of worth.
        with contextlib.suppress(OSError):
            os.close(self.handle)

    def _is_last(self) -> bool:
        try:
            return _is_locked_by_us(self.handle)
        except OSError:
            return False


def _looked_at(path: Path, *, is_removed: bool = False) -> _Holder | None:
    """Who holds a lock file; None if nobody does.  A file that nobody holds can be removed."""
    handle = _opened(path, is_made=False)
    if handle < 0:
        return None
    try:
        # Looking with a shared lock leaves others free to do the same.
        if not _is_free(handle, path, is_shared=_CAN_SHARE and not is_removed):
            return _holder(handle, path)
        if is_removed:
            _remove(path)
        return None
    finally:
        os.close(handle)


def _opened(path: Path, *, is_made: bool = True) -> int:
    flags = os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | (os.O_CREAT if is_made else 0)
    try:
        # To read who holds it would wait for a pipe.
        handle = os.open(path, flags | getattr(os, "O_NONBLOCK", 0), 0o644)
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            os.close(handle)
            raise OSError(errno.EINVAL, "it is not a regular file")
        return handle
    except OSError as error:
        if isinstance(error, FileNotFoundError | NotADirectoryError) and not is_made:
            return -1
        raise OutputError(
            f"the lock file {str(path)!r} cannot be opened: {error.strerror}",
            hint="the output folder must be writable",
            path=str(path),
        ) from None


def _is_free(handle: int, path: Path, *, is_shared: bool) -> bool:
    """Lock an open file, or else see whether the process that it names is gone."""
    try:
        return _is_locked_by_us(handle, is_shared=is_shared)
    except OSError as error:
        _warn(str(path.parent), str(error))
        return not _holder(handle, path).is_alive()


@functools.cache
def _warn(folder: str, reason: str) -> None:
    """Said once; a lock is tried several times."""
    _log.warning("the folder %r cannot be locked: %s", folder, reason)


def _holder(handle: int, path: Path) -> _Holder:
    os.lseek(handle, 0, os.SEEK_SET)
    pid, _, host = os.read(handle, 300).decode(errors="replace").strip().partition(" ")
    named = _OF_SHARD.fullmatch(path.name)
    return _Holder(pid, host, f"{named[1]}/{named[2]}" if named else "")


def _say_who(handle: int, path: Path) -> None:
    """Write into a lock file who holds it."""
    try:
        os.truncate(handle, 0)
        os.lseek(handle, 0, os.SEEK_SET)
        os.write(handle, f"{os.getpid()} {platform.node()}\n".encode())
    except OSError as error:
        raise OutputError(
            f"the lock file {str(path)!r} cannot be written: {error.strerror}",
            hint="the output folder must be writable, and its disk not be full",
            path=str(path),
        ) from None


def _is_still_there(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except OSError:
        return False


def _remove(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError:
        # A lock file that nobody holds is no obstacle to the next run.
        return


def _shard_locks(folder: Path) -> Iterator[tuple[Path, int]]:
    """The lock files of shards in a folder, each with its N."""
    try:
        with os.scandir(folder) as entries:
            names = sorted(entry.name for entry in entries if entry.name.startswith(NAME))
    except OSError:
        return
    for name in names:
        if found := _OF_SHARD.fullmatch(name):
            yield folder / name, int(found[2])


def _is_locked_by_us(handle: int, *, is_shared: bool = False) -> bool:
    """Try to lock; False if another process is in the way; OSError if there are no locks.

    Where there are no shared locks it is always locked alone."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(handle, _WINDOWS_LOCK_AT, os.SEEK_SET)
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
            os.lseek(handle, 0, os.SEEK_SET)
        else:
            import fcntl

            kind = fcntl.LOCK_SH if is_shared else fcntl.LOCK_EX
            fcntl.flock(handle, kind | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EAGAIN, errno.EWOULDBLOCK, errno.EDEADLK):
            return False
        raise
    return True
