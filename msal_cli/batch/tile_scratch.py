"""The scratch folder of a mesh that is denoised by tiles: its place, its lock, what it holds.

Its name comes from the path of the output, so that the same command finds it again after a run
that was killed.  What it holds is used if input, settings, output and version are the same as when
it was begun, and is removed otherwise.

The name can be foreseen, so a folder or a link that has it may come from another user or with a
repository.  Only a folder that this user made with msal is used: private, and with a mark that
holds its inode number, which neither an archive nor a copy can bring along.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msal_cli import machine
from msal_cli.batch.lock import NAME as LOCK_NAME
from msal_cli.batch.lock import FolderLock
from msal_cli.errors import OutputError
from msal_cli.machine import megabytes
from msal_cli.storage.atomic import LONGEST_NAME, machine_tag, make_folders, write_whole
from msal_cli.storage.limits import LOOKED_AT
from msal_cli.storage.regular import open_regular
from msal_cli.tiles import source as sources
from msal_cli.tiles.scratch import Scratch
from msal_cli.version import __version__

if TYPE_CHECKING:
    from msal_cli.job.settings import Settings, Task
    from msal_cli.tiles.estimates import TileEstimate

PREFIX = ".msal-tiles-"
IDENTITY = "identity.json"
_BOOTS = "boots.json"
_MARK = "made-by-msal"


def scratch_path(output: str, folder: str | None) -> Path:
    """Where the scratch folder for an output lies: in ``folder``, or else beside the output."""
    whole = os.path.abspath(output)
    digest = hashlib.sha256(os.fsencode(whole)).hexdigest()[:12]
    name = os.path.basename(whole)
    while len(os.fsencode(name)) > LONGEST_NAME - len(PREFIX) - len(digest) - 1:
        name = name[:-1]
    return Path(folder or os.path.dirname(whole)) / f"{PREFIX}{name}-{digest}"


@contextmanager
def lock_scratch(path: Path) -> Iterator[Scratch]:
    """The scratch folder, made where it is not there, for this process alone.

    Raises
    ------
    UsageError
        if another run uses it (``E_LOCKED``).
    OutputError
        if it cannot be made, or what has its name is not of this user's own making.
    """
    refuse_foreign(path)
    try:
        make_folders(path.parent)
        with suppress(FileExistsError):
            path.mkdir(0o700)
        refuse_foreign(path)
        write_whole(path / _MARK, _describe_folder(path))
    except OSError as error:
        raise OutputError(
            f"the scratch folder {str(path)!r} cannot be made: {error.strerror}",
            hint="name another place with --scratch",
            path=str(path),
        ) from None
    with FolderLock(str(path)):
        yield Scratch(path)


def is_own(path: Path) -> bool:
    """Whether this is a folder that a run of this user made, or an empty one, in which no other
    user can write."""
    try:
        status = os.lstat(path)
        if not stat.S_ISDIR(status.st_mode):
            return False
        if hasattr(os, "geteuid") and (status.st_uid != os.geteuid() or status.st_mode & 0o077):
            return False
        if not os.listdir(path):
            return True
        with open_regular(path / _MARK) as file:
            return file.read(100) == _describe_folder(path)
    except OSError:
        return False


def refuse_foreign(path: Path) -> None:
    """Refuse a link, and a folder that is not ``is_own``, in the place of the scratch folder."""
    if os.path.lexists(path) and not is_own(path):
        raise OutputError(
            f"{str(path)!r} is not a scratch folder that you made with msal, and is left as it is",
            hint="move it away, or name another place with --scratch",
            path=str(path),
        )


def _describe_folder(path: Path) -> bytes:
    return b"inode %d\n" % os.lstat(path).st_ino


def identify(
    task: Task, settings: Settings, source: dict[str, Any], estimate: TileEstimate
) -> dict[str, Any]:
    """What a run must have in common with the one before to go on with its tasks."""
    return {
        "version": __version__,
        "input": sources.identify(source),
        "header": _hash_header(task.input),
        "output": os.path.abspath(task.output),
        # As JSON gives them back.
        "settings": json.loads(json.dumps(asdict(settings))),
        "tile_vertices": estimate.tile_vertices,
    }


def can_go_on(scratch: Scratch, identity: dict[str, Any]) -> bool:
    """Whether what is in the scratch folder is of the same run; its tiles may be smaller than they
    would be now."""
    if not is_of_run(scratch, identity):
        return False
    is_fit: bool = scratch.read_json(IDENTITY)["tile_vertices"] <= identity["tile_vertices"]
    return is_fit


def is_of_run(scratch: Scratch, identity: dict[str, Any]) -> bool:
    """Whether what is in the scratch folder is of the same run, whatever the size of its tiles."""
    known: dict[str, Any] | None = scratch.read_json(IDENTITY)
    if known is None or _may_have_lost_data(scratch):
        return False
    return known | {"tile_vertices": 0} == identity | {"tile_vertices": 0}


def begin(scratch: Scratch, identity: dict[str, Any]) -> None:
    """Record whose tasks the scratch folder holds from now on, and since which start of this
    machine."""
    scratch.write_json(_BOOTS, _read_boots(scratch) | {machine_tag(): machine.boot_id()})
    scratch.write_json(IDENTITY, identity)


def _may_have_lost_data(scratch: Scratch) -> bool:
    """Whether this machine was started anew since.  Tasks do not wait until what they write is on
    the disk: a killed process loses nothing, a power cut may."""
    return _read_boots(scratch).get(machine_tag(), machine.boot_id()) != machine.boot_id()


def _read_boots(scratch: Scratch) -> dict[str, str]:
    return scratch.read_json(_BOOTS) or {}


def clear(scratch: Scratch, keep: str = LOCK_NAME) -> None:
    """Remove all that is in the scratch folder, but for its lock, its mark and ``keep``."""
    for one in scratch.path.iterdir():
        if one.name in (LOCK_NAME, _MARK, keep):
            continue
        if one.is_dir() and not one.is_symlink():
            shutil.rmtree(one)
        else:
            one.unlink()


def used_bytes(path: Path) -> int:
    """Bytes that a folder takes on its disk; files may have holes."""
    total = 0
    for folder, _, names in os.walk(path):
        for name in names:
            status = os.lstat(os.path.join(folder, name))
            # Where the system does not count blocks, holes count.
            total += 512 * status.st_blocks if hasattr(status, "st_blocks") else status.st_size
    return total


def check_space(path: Path, output: str, estimate: TileEstimate) -> None:
    """Refuse to begin where there is not enough space; OutputError."""
    check_scratch_room(path, estimate.scratch_bytes)
    folder = Path(os.path.abspath(output)).parent
    if _device(path) != _device(folder) and estimate.output_bytes > free_bytes(folder):
        raise _no_room(f"the output {output!r}", estimate.output_bytes, free_bytes(folder))


def check_scratch_room(path: Path, needed: int) -> None:
    """Refuse to begin where a scratch folder has no space for so many bytes, or is not ours;
    OutputError."""
    refuse_foreign(path)
    room = free_bytes(path) + used_bytes(path)
    if needed > room:
        raise _no_room(f"the scratch folder {str(path)!r}", needed, room)


def free_bytes(path: Path) -> int:
    """Bytes that are free where ``path`` is, or is to be."""
    return shutil.disk_usage(_existing(path)).free


def _device(path: Path) -> int:
    return os.stat(_existing(path)).st_dev


def _existing(path: Path) -> Path:
    """The folder, or the nearest one above it that exists."""
    path = path.absolute()
    while not path.is_dir() and path != path.parent:
        path = path.parent
    return path


def _no_room(what: str, needed: int, free: int) -> OutputError:
    return OutputError(
        f"{what} needs {megabytes(needed)}, and {megabytes(free, rounded_up=False)} are free there",
        hint="free some space, or name another place with --scratch; nothing was begun",
    )


def _hash_header(path: str) -> str:
    with open(path, "rb") as file:
        return hashlib.sha256(file.read(LOOKED_AT)).hexdigest()
