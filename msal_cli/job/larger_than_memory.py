"""Which files are read in pieces because they do not fit into memory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from msal_cli import machine

if TYPE_CHECKING:
    from msal_cli.codecs.streamed_mesh import StreamedMesh


def open_too_large(
    paths: Sequence[str], format: str | None = None
) -> tuple[StreamedMesh, ...] | None:
    """The files, opened to be read in pieces, if they do not fit into memory together.

    None if they fit, and if one of them has a format that cannot be read in pieces: whoever loads
    it says that it is too large.

    Raises
    ------
    InputError
        for a file that is damaged, as far as its header and its size show.
    """
    from msal_cli.codecs.streamed import open_streamed
    from msal_cli.errors import UnsupportedError
    from msal_cli.storage.urls import is_url

    if any(map(is_url, paths)) or not are_too_large(paths, format):
        return None
    try:
        return tuple(open_streamed(path, format) for path in paths)
    except UnsupportedError:
        return None


def are_too_large(paths: Sequence[str], format: str | None = None) -> bool:
    """Whether files do not fit into memory together, by their sizes and headers."""
    from msal_cli.codecs.forecast import forecast
    from msal_cli.mesh import MOST_FACES

    forecasts = [forecast(path, format=format) for path in paths]
    if any((one.faces or 0) > MOST_FACES for one in forecasts):
        return True
    free = machine.available_bytes()
    return free is not None and sum(one.memory_bytes or 0 for one in forecasts) > free
