"""The places that have a manifest: folders of this machine, and folders of a store."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path

from msal_cli.batch.lock import FolderLock
from msal_cli.batch.manifest import FolderManifest, Manifest, list_manifests, read_view
from msal_cli.batch.manifest_lines import LogView, read_output_names
from msal_cli.batch.shard import Shard
from msal_cli.errors import InputError, OutputError
from msal_cli.job.records import ObjectMark
from msal_cli.job.settings import Task
from msal_cli.storage import urls
from msal_cli.storage.urls import is_url


def open_manifest(home: str, shard: Shard | None = None) -> Manifest:
    """What is known of a home so far; OutputError if it cannot be read."""
    if not is_url(home):
        return FolderManifest(home, shard)
    from msal_cli.batch.remote_manifest import ObjectManifest

    return ObjectManifest(home, shard)


def read_views(home: str) -> list[LogView]:
    """What each manifest of a home says; OutputError if one cannot be read."""
    if not is_url(home):
        return [read_view(path) for path in list_manifests(home)]
    from msal_cli.batch.remote_manifest import read_parts, view_of_parts

    parts = read_parts(home)
    return [view_of_parts(parts)] if parts else []


def written_names(home: str) -> frozenset[str]:
    """Every output that some run wrote or began to write; OutputError if that cannot be read."""
    if is_url(home):
        return frozenset(name for view in read_views(home) for name in view.entries)
    paths = list_manifests(home)
    return frozenset(name for path in paths for name in read_output_names(path))


def lock_folder(home: str, stack: ExitStack, shard: Shard | None = None) -> None:
    """Make a folder and lock it, for a shard beside other shards, until ``stack`` ends.

    A store has neither folders nor locks; there two runs write the same objects, each whole.

    Raises UsageError if another run has locked the folder, OutputError if it cannot be made.
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


def open_folder(home: str, stack: ExitStack, shard: Shard | None = None) -> Manifest:
    """Make and lock a folder, and read its manifests, until ``stack`` ends; errors of both."""
    lock_folder(home, stack, shard)
    manifest = open_manifest(home, shard)
    stack.callback(manifest.close)
    return manifest


def output_folders(tasks: Iterable[Task]) -> set[Path]:
    """The folders of this machine that tasks write to."""
    return {Path(task.output).parent for task in tasks if not is_url(task.output)}


def list_objects(home: str, tasks: Iterable[Task]) -> dict[str, ObjectMark]:
    """Size and tag of the outputs that are in a store already, by URL, from one listing.

    Raises OutputError if the store does not answer.
    """
    from msal_cli.storage import objects as remote

    try:
        marks = remote.list_objects(home)
    except InputError as error:
        raise OutputError(error.message, hint=error.hint, path=home) from None
    start = urls.folder(home)
    found = ((task.output, marks.get(task.output.removeprefix(start))) for task in tasks)
    return {url: ObjectMark(*mark) for url, mark in found if mark is not None}
