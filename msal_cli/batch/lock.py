"""One run at a time on an output folder.

The lock is the system's own lock on an open file, so it ends with the process that holds it,
however that ends; nothing stale can stay behind.  The file also tells who holds it.  On a file
system without locks that word is all there is: it counts while its process lives.
"""

from __future__ import annotations

import errno
import logging
import os
import socket
import sys
from pathlib import Path
from types import TracebackType

from msal_cli.batch.processes import is_alive
from msal_cli.errors import OutputError, UsageError

NAME = ".msal-lock"

# Windows keeps others from reading what is locked, so there a byte far behind the text is locked.
_WINDOWS_LOCK_AT = 1 << 30

_log = logging.getLogger("msal.batch")


class FolderLock:
    """Hold a folder for this process; use it with ``with`` or call ``release``.

    Raises
    ------
    UsageError : another run holds the folder (code ``E_LOCKED``); its process id is in the message.
    OutputError : the lock file cannot be created.
    """

    def __init__(self, folder: str) -> None:
        self._path = Path(folder) / NAME
        self._handle = -1
        while self._handle < 0:
            self._handle = self._taken()

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
        if self._handle < 0:
            return
        handle, self._handle = self._handle, -1
        if os.name == "nt":
            os.close(handle)
            self._remove()
        else:
            # Removed while held: who opened it meanwhile sees that it is gone and starts again.
            self._remove()
            os.close(handle)

    def _remove(self) -> None:
        try:
            self._path.unlink(missing_ok=True)
        except OSError:
            # A lock file that nobody holds is no obstacle to the next run.
            return

    def _taken(self) -> int:
        """The open and locked file, or -1 if its last holder removed it meanwhile."""
        try:
            handle = os.open(
                self._path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644
            )
        except OSError as error:
            raise OutputError(
                f"the lock file {str(self._path)!r} cannot be opened: {error.strerror}",
                hint="the output folder must be writable",
                path=str(self._path),
            ) from None
        try:
            try:
                is_ours = _is_locked_by_us(handle)
            except OSError as error:
                _log.warning("the folder %r cannot be locked: %s", str(self._path.parent), error)
                is_ours = not self._is_holder_alive(handle)
            if not is_ours:
                raise self._refusal(handle)
            if not self._is_still_there(handle):
                os.close(handle)
                return -1
            os.truncate(handle, 0)
            os.write(handle, f"{os.getpid()} {socket.gethostname()}\n".encode())
        except BaseException:
            os.close(handle)
            raise
        return handle

    def _is_still_there(self, handle: int) -> bool:
        try:
            return os.path.samestat(os.fstat(handle), self._path.stat())
        except OSError:
            return False

    def _holder(self, handle: int) -> tuple[str, str]:
        """Process id and machine of who holds the lock, empty where that is not told."""
        os.lseek(handle, 0, os.SEEK_SET)
        pid, _, host = os.read(handle, 300).decode(errors="replace").strip().partition(" ")
        return pid, host

    def _is_holder_alive(self, handle: int) -> bool:
        pid, host = self._holder(handle)
        return host == socket.gethostname() and pid.isdigit() and is_alive(int(pid))

    def _refusal(self, handle: int) -> UsageError:
        pid, host = self._holder(handle)
        who = f"process {pid}" if pid else "another process"
        if host and host != socket.gethostname():
            who += f" on {host}"
        return UsageError(
            f"{who} is already working on the folder {str(self._path.parent)!r}",
            hint="wait until it is done, stop it, or choose another output folder",
            path=str(self._path.parent),
            code="E_LOCKED",
        )


def _is_locked_by_us(handle: int) -> bool:
    """Try to lock; False if another process holds the lock; OSError if there are no locks."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(handle, _WINDOWS_LOCK_AT, os.SEEK_SET)
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
            os.lseek(handle, 0, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EAGAIN, errno.EWOULDBLOCK, errno.EDEADLK):
            return False
        raise
    return True
