"""How far the reading of meshes in pieces has come."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from msal_cli.codecs.streamed_mesh import StreamedMesh


class ReadingListener(Protocol):
    """Hears of meshes that are read in pieces because they do not fit into memory."""

    def on_folder(self) -> None:
        """A temporary folder is going to be made: a signal should raise, so that it is removed."""
        ...

    def on_text(self, name: str, done: int, total: int) -> None:
        """So many bytes of a text were read, whose numbers are kept in a file first."""
        ...

    def on_begin(self, names: Sequence[str], meshes: Sequence[StreamedMesh]) -> None:
        """These are going to be read; what their headers say is known."""
        ...

    def on_progress(self, done: int, total: int) -> None:
        """So many of all vertices and faces were read."""
        ...


class Steps:
    """Counts the vertices and faces that were read of ``meshes``, with their ``names``.

    ``vertex_passes`` and ``face_passes`` say how often each mesh will be read.
    """

    def __init__(
        self,
        listener: ReadingListener | None,
        names: Sequence[str],
        meshes: Sequence[StreamedMesh],
        vertex_passes: int = 1,
        face_passes: int = 1,
    ) -> None:
        self._listener = listener
        self._done = 0
        self._total = sum(
            vertex_passes * mesh.n_vertices + face_passes * mesh.n_polygons for mesh in meshes
        )
        if listener is not None:
            listener.on_begin(names, meshes)

    def add(self, count: int) -> None:
        """So many more were read."""
        self._done += count
        if self._listener is not None:
            self._listener.on_progress(min(self._done, self._total), self._total)
