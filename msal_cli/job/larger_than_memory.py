"""Which files are read in pieces because they do not fit into memory, and how these are opened."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from msal_cli import machine
from msal_cli.errors import OutputError, UnsupportedError

if TYPE_CHECKING:
    from msal_cli.codecs.streamed_mesh import StreamedMesh
    from msal_cli.job.streamed_progress import ReadingListener


@contextmanager
def opened_in_pieces(
    paths: Sequence[str], format: str | None = None, listener: ReadingListener | None = None
) -> Iterator[tuple[StreamedMesh, ...] | None]:
    """The files, opened to be read in pieces, if they do not fit into memory together.

    None if they fit, and if one of them has a format that cannot be read in pieces: loading it
    then says that it is too large.  The numbers of a text are kept in a temporary folder until the
    end.

    Raises
    ------
    InputError
        for a file that is damaged, as far as its header and its size show.
    OutputError
        if the numbers of a text cannot be kept.
    """
    from msal_cli.storage.urls import is_url

    if any(map(is_url, paths)) or not are_too_large(paths, format):
        yield None
        return
    with ExitStack() as at_end:
        meshes: tuple[StreamedMesh, ...] | None = None
        # Of another format: loading it says that it is too large.
        with suppress(UnsupportedError):
            meshes = tuple(_open(path, format, listener, at_end) for path in paths)
        yield meshes


def are_too_large(paths: Sequence[str], format: str | None = None) -> bool:
    """Whether files do not fit into memory together, by their sizes and headers."""
    from msal_cli.codecs.forecast import forecast
    from msal_cli.mesh import MOST_FACES

    forecasts = [forecast(path, format=format) for path in paths]
    if any((one.faces or 0) > MOST_FACES for one in forecasts):
        return True
    free = machine.available_bytes()
    return free is not None and sum(one.memory_bytes or 0 for one in forecasts) > free


def _open(
    path: str, format: str | None, listener: ReadingListener | None, at_end: ExitStack
) -> StreamedMesh:
    from msal_cli.codecs.streamed import open_streamed

    try:
        return open_streamed(path, format)
    except UnsupportedError:
        pass  # a text, perhaps
    if listener is not None:
        listener.on_folder()
    folder = Path(tempfile.mkdtemp(prefix="msal-"))
    at_end.callback(shutil.rmtree, folder, ignore_errors=True)

    def on_bytes(done: int, total: int) -> None:
        # Numbers take about as many bytes as their text.
        if shutil.disk_usage(folder).free < total - done:
            raise _no_space(folder, f"about {total - done:,} bytes more are needed")
        if listener is not None:
            listener.on_text(path, done, total)

    try:
        return open_streamed(path, format, folder, on_bytes)
    except OSError as error:
        raise _no_space(folder, error.strerror or str(error)) from error


def _no_space(folder: Path, why: str) -> OutputError:
    return OutputError(
        f"a text larger than memory, whose numbers cannot be kept in {str(folder)!r}: {why}",
        hint="name a folder with more space in the environment variable TMPDIR, or convert the "
        "mesh to a binary PLY",
    )
