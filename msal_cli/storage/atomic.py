"""Files that appear whole or not at all, and the removal of temporary files of dead processes.

Every temporary file of msal is named ``.<anything>.msal-<process>-<machine><random>.tmp``, where
the machine and the random part are eight hexadecimal digits each.
"""

import contextlib
import errno
import functools
import os
import platform
import re
import stat
import sys
import time
import zlib
from collections.abc import Iterable
from pathlib import Path

from msal_cli.errors import OutputError
from msal_cli.machine import is_alive
from msal_cli.storage.regular import Buffer
from msal_cli.storage.urls import ObjectMark, is_url

MAX_NAME_BYTES = 140
"""Bytes in the name of a temporary file; some encrypting file systems allow only 143."""

Sources = Iterable["str | os.PathLike[str] | int"]

_PIECE = 64 << 20

_OWN_FILES = ".msal-"
_TEMPORARY = re.compile(
    r"\..*\.msal-(?P<pid>\d{1,10})-(?P<machine>[0-9a-f]{8})[0-9a-f]{8}\.tmp", re.DOTALL
)

# A process id may have been reused, and processes of other machines are not visible here.  But
# no writer takes this long without changing the time of its file.
_STALE_AFTER_S = 24 * 3600.0

_HINTS = {
    errno.ENOSPC: "the disk is full; free some space and run again",
    errno.EDQUOT: "your disk quota is used up; free some space and run again",
    errno.EFBIG: "the file system or a limit does not allow files of this size",
    errno.EACCES: "check the permissions of the output folder",
    errno.EPERM: "check the permissions of the output folder",
    errno.EROFS: "the file system is read-only; choose another output folder",
    errno.ENOENT: "the output folder does not exist",
    errno.ENOTDIR: "a part of the output path is a file, not a folder",
    errno.ENAMETOOLONG: "choose a shorter output name",
}


def write_whole(
    path: str | os.PathLike[str], buffers: Buffer | Iterable[Buffer], *, sources: Sources = ()
) -> ObjectMark | None:
    """Write a file so that it is seen whole or not at all, even after a crash.

    The bytes go to a temporary file in the same folder, are flushed to the disk and counted, and
    the file is then moved to its name; on any failure, or an interrupt, it is removed.

    A replaced file passes its permission bits on, a new one gets those that the umask leaves, and
    neither grants more than each of its ``sources``.  A symbolic link itself is replaced, never its
    target, because that could be an input: to write through a link, resolve it first.

    Parameters
    ----------
    path : the file to write; its folder must exist.  A URL is an object, see ``objects``.
    buffers : the content, in one piece or in several.
    sources : files, by path or open, whose content is in it; URLs and pipes are ignored.

    Returns the mark of an object, None for a file.  Raises OutputError, with the reason, if the
    system refuses.
    """
    if isinstance(path, str) and is_url(path):
        from msal_cli.storage import objects as remote

        return remote.write_whole(path, buffers)
    _write(path, buffers, sources)
    return None


def write_new(
    path: str | os.PathLike[str], buffers: Buffer | Iterable[Buffer], *, sources: Sources = ()
) -> bool:
    """Write a file whole unless it exists already; returns whether it was written.

    If several processes write the same new file, one succeeds, and the others find it whole.

    Raises OutputError, with the reason, if the system refuses.
    """
    return _write(path, buffers, sources, is_new=True)


def make_folder(folder: str) -> None:
    """Make a folder and its parents, unless they exist; OutputError if that fails."""
    try:
        os.makedirs(folder, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"the output folder {folder!r} cannot be made: {error.strerror}",
            hint="choose another output, or mend the permissions",
            path=folder,
        ) from None


def _write(
    path: str | os.PathLike[str],
    buffers: Buffer | Iterable[Buffer],
    sources: Sources,
    *,
    is_new: bool = False,
) -> bool:
    """Write a temporary file and give it its name; returns whether that was done (``_place``)."""
    if isinstance(buffers, bytes | bytearray | memoryview):
        buffers = (buffers,)
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
    # Windows would translate line ends and let child processes inherit the handle.
    flags |= getattr(os, "O_BINARY", 0) | getattr(os, "O_NOINHERIT", 0)
    try:
        target = Path(path)
        widest, is_replacement = _choose_mode(target, sources)
        temporary = target.with_name(temporary_name(target.name))
        # Never wider than at the end: who can open it for a moment can keep it open.
        handle = os.open(temporary, flags, widest & 0o666 | 0o200)
        try:
            try:
                expected = 0
                for buffer in buffers:
                    view = memoryview(buffer).cast("B")
                    expected += len(view)
                    while len(view):
                        view = view[os.write(handle, view[:_PIECE]) :]
                now = os.fstat(handle).st_mode & 0o777
                wanted = widest if is_replacement else widest & now
                if wanted != now:
                    os.chmod(handle if hasattr(os, "fchmod") else temporary, wanted)
                os.fsync(handle)
                written = os.fstat(handle).st_size
                if written != expected:
                    raise OSError(errno.EIO, f"{written:,} of {expected:,} bytes are on the disk")
            finally:
                os.close(handle)
            is_placed = _place(temporary, target, is_new)
        finally:
            with contextlib.suppress(OSError):
                temporary.unlink()
    except (OSError, ValueError) as failure:
        reason = getattr(failure, "strerror", None) or str(failure)
        raise OutputError(
            f"the file cannot be written: {reason}",
            path=os.fspath(path),
            hint=_HINTS.get(getattr(failure, "errno", None) or 0, ""),
        ) from failure
    if is_placed:
        flush_folder(target.parent)
    return is_placed


def _choose_mode(target: Path, sources: Sources) -> tuple[int, bool]:
    """The widest permission bits for the new file, and whether it replaces one, in which case the
    umask does not apply; OSError for what must not be replaced."""
    group = _group_of_new_file(target.parent)
    widest = 0o777
    for source in sources:
        if isinstance(source, str) and is_url(source):
            continue
        try:
            status = os.stat(source)
        except OSError:
            # The source may have been removed.
            widest &= 0o600
        else:
            widest &= _bits_for_group(status, group) if stat.S_ISREG(status.st_mode) else 0o777
    try:
        present = target.stat()
    except FileNotFoundError:
        return widest & 0o666, False
    if stat.S_ISDIR(present.st_mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder")
    if not stat.S_ISREG(present.st_mode):
        # Moving a file onto /dev/null would destroy the device.
        raise OSError(errno.EINVAL, "it is a device or a pipe, not a file")
    return widest & _bits_for_group(present, group), not target.is_symlink()


def _bits_for_group(status: os.stat_result, group: int | None) -> int:
    """Permission bits; if ``group`` is not that of the file, it may do what all others may."""
    bits = status.st_mode & 0o777
    if group is None or status.st_gid == group:
        return bits
    return bits & (0o707 | (bits & 0o007) << 3)


def _group_of_new_file(folder: Path) -> int | None:
    """The group of a new file in ``folder``; None where the system has no groups."""
    if os.name != "posix":
        return None
    status = folder.stat()
    inherits = status.st_mode & stat.S_ISGID or sys.platform != "linux"
    return status.st_gid if inherits else os.getegid()


def temporary_name(name: str) -> str:
    """A name that identifies its owner: process, machine, and eight random digits."""
    suffix = f".msal-{os.getpid()}-{machine_tag()}{os.urandom(4).hex()}.tmp"
    room = MAX_NAME_BYTES - 1 - len(suffix)
    while len(os.fsencode(name)) > room:
        name = name[:-1]
    return f".{name}{suffix}"


@functools.cache
def machine_tag() -> str:
    """Eight hexadecimal digits that distinguish machines that share a file system.

    Containers may share a host name without seeing each other's processes.
    """
    try:
        processes = os.readlink("/proc/self/ns/pid")
    except OSError:
        processes = ""
    return f"{zlib.crc32((platform.node() + processes).encode('utf-8', 'replace')):08x}"


def _place(temporary: Path, target: Path, is_new: bool) -> bool:
    """Give a temporary file its name; False if it must be a new file and the name is taken."""
    if is_new:
        try:
            if os.name == "nt":
                temporary.rename(target)  # which does not replace there
            else:
                os.link(temporary, target)
            return True
        except FileExistsError:
            return False
        except OSError:
            # A file system without hard links: this check is the best that is possible.
            if os.name == "nt":
                raise
            if os.path.lexists(target):
                return False
    # On Windows a virus scanner may delay it by reading the file.
    for wait_s in (0.05, 0.2, 0.8) if os.name == "nt" else ():
        try:
            temporary.replace(target)
            return True
        except PermissionError:
            time.sleep(wait_s)
    temporary.replace(target)
    return True


def flush_folder(folder: Path) -> None:
    """Make new names in a folder durable, where the system can; the files already are.

    A failure is ignored, because the file is in place: the next run compares files by content, and
    would notice what was lost in a power cut.
    """
    if os.name != "posix":
        return
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


# Files that dead processes left


def is_own(name: str) -> bool:
    """Whether a file of this name is msal's own (manifest, lock, temporary), never an input."""
    return name.startswith(_OWN_FILES) or _TEMPORARY.fullmatch(name) is not None


def is_manifest(name: str) -> bool:
    """Whether a file of this name is a manifest: msal has written results into its folder."""
    return name.startswith(_OWN_FILES) and name.endswith(".jsonl")


def sweep(folders: Iterable[str | Path], ended: int | None = None) -> int:
    """Remove temporary files of dead processes in these folders (not below them), or those of the
    process ``ended``, which is known to be dead; returns their number."""
    count = 0
    for folder in folders:
        names: list[str] = []
        with contextlib.suppress(OSError), os.scandir(folder) as entries:
            names = [entry.name for entry in entries if entry.name.startswith(".")]
        for match in filter(None, map(_TEMPORARY.fullmatch, names)):
            path = Path(folder) / match[0]
            # Another process may have removed it, or it may be locked; both are harmless.
            with contextlib.suppress(OSError):
                is_here, pid = match["machine"] == machine_tag(), int(match["pid"])
                is_left = is_here and (pid == ended if ended is not None else not is_alive(pid))
                if ended is None and not is_left:
                    is_left = time.time() - path.lstat().st_mtime > _STALE_AFTER_S
                if is_left:
                    path.unlink()
                    count += 1
    return count
