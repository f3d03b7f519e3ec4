"""How the tasks of a run open its input: a file, or a set of files as one mesh."""

from __future__ import annotations

import os
from typing import Any

from msal_cli.codecs.streamed_mesh import StreamedMesh

FILE, SET = "file", "set"

TEXT = "text"
"""In the scratch folder: the numbers of a text, and what a compressed file expands to."""


def open_source(description: dict[str, Any]) -> StreamedMesh:
    """Open what ``TilePlan.source`` describes: ``{"kind": "file", "path": ..., "format": ...}``,
    with the ``folder`` for the numbers of a text, or ``{"kind": "set", ...}``.

    Raises
    ------
    InputError
        if it cannot be read piece by piece.
    """
    if description["kind"] == SET:
        from msal_cli.tiles.file_set import open_set

        return open_set(description)
    from msal_cli.codecs.streamed import open_streamed

    path, format = description["path"], description["format"]
    return open_streamed(path, format, description.get("folder"))


def identify(description: dict[str, Any]) -> dict[str, Any]:
    """What changes when the input does: names, sizes and times of its files."""
    paths = description["paths"] if description["kind"] == SET else [description["path"]]
    files = []
    for path in paths:
        stat = os.stat(path)
        files.append([os.path.abspath(path), stat.st_size, stat.st_mtime_ns])
    return {"files": files}
