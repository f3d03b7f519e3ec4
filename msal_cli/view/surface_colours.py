"""Surfaces with the colours of their files, for pictures.

What cannot be read is a note, never an error: a picture of clay is better than none.
"""

from __future__ import annotations

import logging
from dataclasses import replace

from msal_cli.codecs import colours
from msal_cli.codecs.colours import SurfaceColours
from msal_cli.codecs.mesh_file import MeshFile
from msal_cli.job import comparison
from msal_cli.job.comparison import Surface

log = logging.getLogger("msal")

_DARKEST = 16
"""One colour of all vertices that is darker hides the shape; programs write it where none is
meant."""


def open_coloured_surface(path: str, format: str | None = None) -> Surface:
    """The surface in the file at ``path`` with its colours."""
    return coloured_surface_of(comparison.opened(path, format), path)


def coloured_surface_of(mesh_file: MeshFile, path: str) -> Surface:
    """The surface in an open file, which is at ``path``, with its colours."""
    return replace(comparison.surface_of(mesh_file), colours=_read(mesh_file, path))


def _read(mesh_file: MeshFile, path: str) -> SurfaceColours:
    try:
        found = colours.surface_colours(mesh_file)
    except Exception as failure:  # colours are an extra, and files come from strangers
        log.info("%s: no colours", path, exc_info=True)
        return SurfaceColours(None, (f"its colours cannot be read: {str(failure)[:200]}",))
    if found is None:
        return SurfaceColours()
    if len(found) != len(mesh_file.vertices):
        return SurfaceColours(None, ("its colours do not fit its vertices",))
    if int(found.max(initial=0)) < _DARKEST:
        return SurfaceColours(None, ("all of its colours are black, and are not shown",))
    return SurfaceColours(found)
