"""Tasks that several processes share through one scratch folder: who does what, by files.

A process claims a task by creating a file that must not exist yet, and touches it while it works.
A claim that has not been touched for a while is that of a process that is gone, and is taken over.
A task writes the same bytes in every process, so that one that is done twice does no harm.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from msal_cli.batch.process_status import is_alive
from msal_cli.batch.tile_tasks import TileResult, TileTask, run_tile_task
from msal_cli.storage.atomic import machine_tag

if TYPE_CHECKING:
    from msal_cli.tiles.scratch import Scratch

TOUCHED_EVERY_S = 5.0
STALE_S = 60.0
"""Seconds after which a claim that was not touched is taken over."""

_CLAIMS = "claims"


@contextmanager
def claim(scratch: Path, stage: str, name: str) -> Iterator[bool]:
    """Whether this process has the task until the end of the block."""
    path = scratch / _CLAIMS / stage / name
    if not _take(path):
        yield False
        return
    is_over = threading.Event()
    thread = threading.Thread(target=_keep_alive, args=(path, is_over), daemon=True)
    thread.start()
    try:
        yield True
    finally:
        is_over.set()
        thread.join()
        with contextlib.suppress(OSError):
            path.unlink()


def run_claimed_task(task: TileTask, common: object, on_progress: object) -> TileResult:
    """Run one task in a worker, unless another process is at it or has done it."""
    with claim(Path(task.scratch), task.stage, str(task.index)) as is_mine:
        if is_mine:
            return run_tile_task(task, common, on_progress)
    return TileResult(None, 0.0, os.getpid(), 0)


@contextmanager
def claim_reduction(scratch: Scratch, stage: str) -> Iterator[bool]:
    """Whether this process is to reduce a stage."""
    with claim(scratch.path, stage, "reduce") as is_mine:
        yield is_mine and scratch.stage_result(stage) is None


def _take(path: Path) -> bool:
    try:
        # Not the scratch folder itself, which is removed when the file is done.
        for folder in (path.parent.parent, path.parent):
            with contextlib.suppress(FileExistsError):
                folder.mkdir()
        if _create(path):
            return True
        if not _is_stale(path):
            return False
        # Of several processes that take a stale claim over, one can rename it.
        aside = path.with_name(f"{path.name}.{secrets.token_hex(4)}")
        path.rename(aside)
        aside.unlink()
        return _create(path)
    except OSError:
        # The run has ended, and its folder is gone; or another process was faster.
        return False


def _create(path: Path) -> bool:
    try:
        handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644)
    except FileExistsError:
        return False
    with open(handle, "w", encoding="utf-8") as file:
        file.write(f"{machine_tag()} {os.getpid()}")
    return True


def _is_stale(path: Path) -> bool:
    """Whether a claim is that of a dead process of this machine, or old by the clock of the file
    system, which machines share."""
    owner = path.read_text(encoding="utf-8").split()
    if len(owner) == 2 and owner[0] == machine_tag() and not is_alive(int(owner[1])):
        return True
    probe = path.with_name(f"now.{secrets.token_hex(4)}")
    _create(probe)
    try:
        return probe.stat().st_mtime - path.stat().st_mtime > STALE_S
    finally:
        probe.unlink()


def _keep_alive(path: Path, is_over: threading.Event) -> None:
    while not is_over.wait(TOUCHED_EVERY_S):
        with contextlib.suppress(OSError):
            os.utime(path)
