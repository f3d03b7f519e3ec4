"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import functools
import logging
import os
import platform
import stat
import time
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from msal_cli.errors import OutputError
from msal_cli.storage.buffers import Buffer
from msal_cli.storage.urls import is_url

LONGEST_NAME = 140
"""Bytes in the name of a temporary file; some encrypting file systems allow only 143."""

_PIECE = 64 << 20
_log = logging.getLogger("msal.files")

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
    path: str | os.PathLike[str],
    buffers: Buffer | Iterable[Buffer],
    *,
    mode_like: str | os.PathLike[str] | None = None,
) -> tuple[int, str] | None:
    """Write a file so that it is seen whole or not at all, even after a crash.

    The bytes go to a temporary file in the same folder, are flushed to the disk and counted, and
    the file is then moved to its name; on any failure, and on an interrupt, it is removed.

    A file that is replaced hands down its permission bits; a new one gets those of ``mode_like``
    or else what the umask leaves.  A symbolic link is itself replaced, never the file that it
    leads to, because that could be an input: who wants to write through a link resolves it first.

    Parameters
    ----------
    path : the file to write; its folder must exist.  A URL is an object, see ``remote``.
    buffers : the content, in one piece or in several.
    mode_like : an existing file whose permission bits a new file gets.

    Returns
    -------
    Size and entity tag of an object; nothing for a file.

    Raises
    ------
    OutputError
        if the system refuses, with the reason.
    """
    if isinstance(path, str) and is_url(path):
        from msal_cli.storage import objects as remote

        return remote.write_whole(path, buffers)
    try:
        _write(Path(path), _pieces(buffers), mode_like, _move)
    except (OSError, ValueError) as failure:
        raise _not_written(path, failure) from failure
    return None


def write_new(
    path: str | os.PathLike[str],
    buffers: Buffer | Iterable[Buffer],
    *,
    mode_like: str | os.PathLike[str] | None = None,
) -> bool:
    """Write a file whole unless there is one already; whether it was written.

    Of several processes that write the same new file one succeeds, and the others find it whole.

    Raises
    ------
    OutputError
        if the system refuses, with the reason.
    """
    try:
        _write(Path(path), _pieces(buffers), mode_like, _place)
    except FileExistsError:
        return False
    except (OSError, ValueError) as failure:
        raise _not_written(path, failure) from failure
    return True


def publish(
    source: str | os.PathLike[str],
    path: str | os.PathLike[str],
    size: int,
    *,
    mode_like: str | os.PathLike[str] | None = None,
) -> tuple[int, str] | None:
    """Give a file that was written in parts, ``source``, its name, as ``write_whole`` does.

    It is flushed to the disk, its ``size`` bytes are counted, and it is moved, or copied where the
    name is on another file system or in a store; then ``source`` is no longer there.
    Permission bits, links and what is returned are those of ``write_whole``.

    Raises
    ------
    OutputError
        if the system refuses, with the reason.
    """
    if isinstance(path, str) and is_url(path):
        known = write_whole(path, _read_pieces(source))
        os.unlink(source)
        return known
    target = Path(path)
    try:
        mode = _permissions(target, mode_like)
        with open(source, "r+b") as file:
            os.fsync(file.fileno())
            _require_size(os.fstat(file.fileno()).st_size, size)
        try:
            if mode is not None:
                Path(source).chmod(mode)
            _move(Path(source), target)
        except OSError as failure:
            if failure.errno != errno.EXDEV:
                raise
            _write(target, _read_pieces(source), mode_like, _move)
            os.unlink(source)
        else:
            flush_folder(target.parent)
    except (OSError, ValueError) as failure:
        raise _not_written(path, failure) from failure
    return None


def make_folders(folder: str | os.PathLike[str]) -> None:
    """Make a folder and all above it that are missing, however deep; OSError if that fails.

    ``os.makedirs`` calls itself for every folder above, and ends at a depth of a thousand.
    """
    path = Path(folder)
    missing: list[Path] = []
    while not path.is_dir():
        missing.append(path)
        if path == path.parent:
            break
        path = path.parent
    for one in reversed(missing):
        one.mkdir(exist_ok=True)


def _not_written(path: str | os.PathLike[str], failure: OSError | ValueError) -> OutputError:
    reason = getattr(failure, "strerror", None) or str(failure)
    return OutputError(
        f"the file cannot be written: {reason}",
        path=os.fspath(path),
        hint=_HINTS.get(getattr(failure, "errno", None) or 0, ""),
    )


def _pieces(buffers: Buffer | Iterable[Buffer]) -> Iterable[Buffer]:
    if isinstance(buffers, bytes | bytearray | memoryview):
        return (buffers,)
    return buffers


def _write(
    target: Path,
    buffers: Iterable[Buffer],
    mode_like: str | os.PathLike[str] | None,
    publish: Callable[[Path, Path], None],
) -> None:
    mode = _permissions(target, mode_like)
    temporary = target.with_name(temporary_name(target.name))
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
    # Windows would translate line ends and hand the handle down to children.
    flags |= getattr(os, "O_BINARY", 0) | getattr(os, "O_NOINHERIT", 0)
    handle = os.open(temporary, flags, 0o666)
    try:
        try:
            expected = 0
            for buffer in buffers:
                view = memoryview(buffer).cast("B")
                expected += len(view)
                while len(view):
                    view = view[os.write(handle, view[:_PIECE]) :]
            os.fsync(handle)
            _require_size(os.fstat(handle).st_size, expected)
        finally:
            os.close(handle)
        if mode is not None:
            temporary.chmod(mode)
        publish(temporary, target)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise
    flush_folder(target.parent)


def _require_size(written: int, expected: int) -> None:
    if written != expected:
        raise OSError(errno.EIO, f"{written} of {expected} bytes arrived on the disk")


def _read_pieces(path: str | os.PathLike[str]) -> Iterator[bytes]:
    with open(path, "rb", buffering=0) as file:
        while piece := file.read(_PIECE):
            yield piece


def _permissions(target: Path, mode_like: str | os.PathLike[str] | None) -> int | None:
    """Permission bits for the new file, None for the umask's; refuses what must not be replaced."""
    try:
        present = target.stat()
    except FileNotFoundError:
        return None if mode_like is None else Path(mode_like).stat().st_mode & 0o777
    if stat.S_ISDIR(present.st_mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder")
    if not stat.S_ISREG(present.st_mode):
        # Moving a file onto /dev/null would destroy the device.
        raise OSError(errno.EINVAL, "it is a device or a pipe, not a file")
    return present.st_mode & 0o777


def temporary_name(name: str) -> str:
    """A name that says whose it is: process, machine, and eight random digits."""
    suffix = f".msal-{os.getpid()}-{machine_tag()}{os.urandom(4).hex()}.tmp"
    room = LONGEST_NAME - 1 - len(suffix)
    while len(os.fsencode(name)) > room:
        name = name[:-1]
    return f".{name}{suffix}"


@functools.cache
def machine_tag() -> str:
    """Eight hexadecimal digits that distinguish machines that share a file system.

    Containers may have one host name and yet not see each other's processes.
    """
    try:
        processes = os.readlink("/proc/self/ns/pid")
    except OSError:
        processes = ""
    return f"{zlib.crc32((platform.node() + processes).encode('utf-8', 'replace')):08x}"


def _move(temporary: Path, target: Path) -> None:
    """Rename over ``target``; on Windows a scanner that just looks at the file may delay it."""
    for wait_s in (0.05, 0.2, 0.8) if os.name == "nt" else ():
        try:
            temporary.replace(target)
            return
        except PermissionError:
            time.sleep(wait_s)
    temporary.replace(target)


def _place(temporary: Path, target: Path) -> None:
    """Give the file its name, or raise FileExistsError if the name is taken."""
    if os.name == "nt":
        temporary.rename(target)  # which does not replace there
        return
    try:
        os.link(temporary, target)
    except FileExistsError:
        raise
    except OSError:
        # A file system without hard links; then two processes can only be kept apart this far.
        if os.path.lexists(target):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST)) from None
        temporary.replace(target)
    else:
        temporary.unlink()


def flush_folder(folder: Path) -> None:
    """Make the new name durable where the system can; the file itself already is.

    The file is in its place, so a system that cannot do this gets a warning and no failure: the
    next run compares files by their content, and would find after a power cut what was lost.
    """
    if os.name != "posix":
        return
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:
        return  # a folder that may be written but not read
    try:
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
    except OSError as failure:
        if failure.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EBADF, errno.EACCES):
            _log.warning("the folder %r cannot be synced: %s", str(folder), failure.strerror)
