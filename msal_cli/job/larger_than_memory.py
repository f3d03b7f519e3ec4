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
    from msal_cli.codecs import forecast, streamed
    from msal_cli.codecs.headers import MOST_TRIANGLES
    from msal_cli.mesh import MOST_FACES

    forecasts = [forecast.forecast(path, format=format) for path in paths]
    free = machine.available_bytes()
    needed = sum(one.memory_bytes or 0 for one in forecasts)
    has_many = any((one.faces or 0) > MOST_FACES for one in forecasts)
    if not has_many and (free is None or needed <= free):
        return None
