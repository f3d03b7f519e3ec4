"""Where a run keeps its memory: beside the outputs, in a folder or in a store."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path

from msal_cli.batch.lock import FolderLock
from msal_cli.batch.manifest import Manifest
from msal_cli.batch.shard import Shard
from msal_cli.errors import InputError, OutputError
from msal_cli.job.records import ObjectMark
from msal_cli.job.settings import Task
from msal_cli.storage import urls
from msal_cli.storage.urls import is_url


def manifest_of(home: str, shard: Shard | None = None) -> Manifest:
    """What is known of a home so far; OutputError if it cannot be read."""
    if not is_url(home):
        return Manifest.read(home, shard)
    from msal_cli.batch.remote_manifest import RemoteManifest

    return RemoteManifest.read(home, shard)


def hold(home: str, stack: ExitStack, shard: Shard | None = None) -> None:
    """Make a folder and lock it, for a shard beside other shards, until ``stack`` ends.

    A store has neither folders nor locks; there two runs write the same objects, each whole.

    Raises UsageError if another run holds the folder, OutputError if it cannot be made.
    """
    if is_url(home):
        return
    try:
        Path(home).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"the output folder {home!r} cannot be made: {error.strerror}", path=home
        ) from None
    stack.enter_context(FolderLock(home, shard))


def folders(tasks: Iterable[Task], homes: Iterable[str] = ()) -> set[Path]:
    """The folders of this machine that tasks write to, and those of ``homes``."""
    written = {Path(task.output).parent for task in tasks if not is_url(task.output)}
    return written.union(Path(home) for home in homes if not is_url(home))


def objects_at(home: str, tasks: Iterable[Task]) -> dict[str, ObjectMark]:
    """The marks of the outputs that are in a store already, by URL, from one listing.

    Raises OutputError if the store does not answer.
    """
    from msal_cli.storage import objects as remote

    try:
        there = remote.listed(home)
    except InputError as error:
        raise OutputError(error.message, hint=error.hint, path=home) from None
    start = urls.folder(home)
    found = ((task.output, there.get(task.output.removeprefix(start))) for task in tasks)
    return {url: ObjectMark(*mark) for url, mark in found if mark is not None}
