"""A tile set as the source of a run by tiles: many files read as one mesh.

Vertices and triangles of the files stand behind one another.  A binary PLY is read in pieces;
another file is opened whole, one at a time.  Vertices that are at one place meet when the tiles are
welded; border vertices that are one at different places come from here at one place.
"""

from __future__ import annotations

import bisect
import io
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Longs
from msal_cli.codecs.mesh_file import MeshFile
from msal_cli.codecs.streamed_mesh import FaceChunk, NewNormals, NewPositions, StreamedMesh, Survey
from msal_cli.errors import InputError, InternalError, UnsupportedError
from msal_cli.storage.atomic import write_whole

FIXED = "msal:fixed"
"""A property of the vertices of a set: 1 for those that stay where they are, 0 for others."""

_TABLE = "set.npz"
_KINDS: dict[str, type[np.float32] | type[np.float64]] = {
    "float32": np.float32,
    "float64": np.float64,
}


@dataclass(frozen=True)
class SetFile:
    """A file of a set: its path, its vertices and triangles, and its bytes."""

    path: str
    n_vertices: int
    n_triangles: int
    size: int


@dataclass(frozen=True)
class SetSource:
    """A set before its tasks can read it.

    Attributes
    ----------
    files : in their order.
    format : over their names'.
    vertex_type : ``float32`` or ``float64``.
    table : of ``build_table``.
    """

    files: Sequence[SetFile]
    format: str | None
    vertex_type: str
    table: bytes

    def describe(self, folder: Path) -> dict[str, Any]:
        """What ``TilePlan.source`` holds, once ``write`` has written into this folder."""
        return {
            "kind": "set",
            "paths": [one.path for one in self.files],
            "files": [asdict(one) for one in self.files],
            "format": self.format,
            "vertex_type": self.vertex_type,
            "table": str(folder / _TABLE),
        }

    def write(self, folder: Path) -> None:
        """Write what tasks read beside the files."""
        write_whole(folder / _TABLE, [self.table])


def build_table(vertices: Longs, positions: Floats, fixed: Longs) -> bytes:
    """What is to be known of the vertices of a set, ascending: those that are read at other
    positions (k, 3), and those that stay where they are."""
    data = io.BytesIO()
    np.savez(data, vertices=vertices, positions=positions, fixed=fixed)
    return data.getvalue()


def open_set(description: dict[str, Any]) -> FileSet:
    """Open what ``SetSource.describe`` described."""
    return FileSet(description)


class FileSet:
    """See ``codecs.streamed_mesh.StreamedMesh``; it is only read."""

    format, encoding = "set", "binary"
    properties: tuple[str, ...] = ()
    references: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    are_corners = has_normals = False
    keeps_size = True

    def __init__(self, description: dict[str, Any]) -> None:
        self._description = description
        self._files = [SetFile(**one) for one in description["files"]]
        self.path = self._files[0].path
        self.precision: str = description["vertex_type"]
        self.vertex_type = _KINDS[self.precision]
        self._starts = _running_totals([one.n_vertices for one in self._files])
        self._first_triangles = _running_totals([one.n_triangles for one in self._files])
        self.n_vertices, self.n_polygons = self._starts[-1], self._first_triangles[-1]
        self.size = sum(one.size for one in self._files)
        self._opened: tuple[int, MeshFile | StreamedMesh] | None = None
        self._table: dict[str, Any] | None = None

    def read_vertices(self, start: int, stop: int) -> NDArray[Any]:
        """The positions (stop - start, 3), with those of the table in their place."""
        rows = np.empty((stop - start, 3), dtype=self.vertex_type)
        for place, first, last, at in self._parts(start, stop):
            opened = self._open(place)
            if _is_streamed(opened):
                rows[at : at + last - first] = opened.read_vertices(first, last)
            else:
                rows[at : at + last - first] = opened.vertices[first:last]
        table = self._read_table()
        low, high = np.searchsorted(table["vertices"], [start, stop])
        rows[table["vertices"][low:high] - start] = table["positions"][low:high]
        return rows

    def face_chunks(self, most: int) -> list[FaceChunk]:
        """All triangles in pieces of ``most`` or so, each of one file."""
        chunks = []
        for place, file in enumerate(self._files):
            before = self._first_triangles[place]
            opened = _open_streamed(file.path, self._description["format"])
            if opened is not None:
                chunks += [
                    FaceChunk(one.polygons, before + one.first_triangle, one.place)
                    for one in opened.face_chunks(most)
                ]
                continue
            for first in range(0, file.n_triangles, most):
                last = min(first + most, file.n_triangles)
                chunks.append(FaceChunk((first, last), before + first, (first, last)))
        return chunks

    def read_triangles(self, chunk: FaceChunk) -> NDArray[np.uint32]:
        """The triangles (m, 3) of a chunk."""
        place = bisect.bisect_right(self._first_triangles, chunk.first_triangle) - 1
        opened = self._open(place)
        if _is_streamed(opened):
            first = chunk.first_triangle - self._first_triangles[place]
            faces = opened.read_triangles(FaceChunk(chunk.polygons, first, chunk.place))
        else:
            faces = opened.faces[chunk.place[0] : chunk.place[1]].astype(np.uint32)
        if self._starts[place] + int(faces.max(initial=0)) > np.iinfo(np.uint32).max:
            raise InternalError("a vertex of a tile set has a number of more than 32 bits")
        triangles: NDArray[np.uint32] = faces + np.uint32(self._starts[place])
        return triangles

    def read_property(self, name: str, start: int, stop: int) -> Floats:
        """A property of vertices (stop - start,): ``FIXED``, or one that every file has."""
        values = np.zeros(stop - start)
        if name == FIXED:
            fixed = self._read_table()["fixed"]
            low, high = np.searchsorted(fixed, [start, stop])
            values[fixed[low:high] - start] = 1.0
            return values
        from msal_cli import codecs

        for place, first, last, at in self._parts(start, stop):
            opened = self._open(place)
            if _is_streamed(opened):
                values[at : at + last - first] = opened.read_property(name, first, last)
            else:
                values[at : at + last - first] = codecs.vertex_property(opened, name)[first:last]
        return values

    def read_normals(self, start: int, stop: int) -> Floats:
        """None: every file computes those of its own vertices when it is written."""
        raise InternalError("a tile set has no normals of its own")

    def output_pieces(self, most: int) -> list[tuple[int, int]]:
        """None: every file is written by itself."""
        return []

    def survey(self, positions: NewPositions, normals: NewNormals | None) -> Survey | None:
        """None: there are no texts of its own."""
        return None

    def replace(
        self,
        piece: tuple[int, int],
        positions: NewPositions,
        normals: NewNormals | None,
        survey: Survey | None = None,
    ) -> memoryview:
        """There is nothing to replace."""
        raise InternalError("a tile set has no bytes of its own")

    def _parts(self, start: int, stop: int) -> list[tuple[int, int, int, int]]:
        """The files that have some of these vertices: place, first and last of its own, and where
        they stand among those wanted."""
        parts = []
        place = max(0, bisect.bisect_right(self._starts, start) - 1)
        while place < len(self._files) and self._starts[place] < stop:
            own = self._starts[place]
            first, last = max(start, own), min(stop, self._starts[place + 1])
            if last > first:
                parts.append((place, first - own, last - own, first - start))
            place += 1
        return parts

    def _open(self, place: int) -> Any:
        """A file of the set; the last one is kept."""
        if self._opened is None or self._opened[0] != place:
            self._opened = None
            self._opened = place, self._read(self._files[place])
        return self._opened[1]

    def _read(self, file: SetFile) -> MeshFile | StreamedMesh:
        format = self._description["format"]
        streamed = _open_streamed(file.path, format)
        if streamed is not None:
            return streamed
        from msal_cli.codecs import header_check
        from msal_cli.job.opened_mesh import open_mesh

        opened, _ = open_mesh(header_check.read_input(file.path, format), file.path, format)
        if (len(opened.vertices), len(opened.faces)) != (file.n_vertices, file.n_triangles):
            raise InputError(
                f"{file.path!r} changed while its tile set was denoised",
                code="E_CHANGED",
                hint="run the same command again once it is complete",
            )
        return opened

    def _read_table(self) -> dict[str, Any]:
        if self._table is None:
            with np.load(self._description["table"]) as table:
                self._table = dict(table)
        return self._table


def _open_streamed(path: str, format: str | None) -> StreamedMesh | None:
    """A file that can be read in pieces and whose vertices are those of its codec; else None."""
    from msal_cli.codecs.streamed import open_streamed

    try:
        opened = open_streamed(path, format)
    except UnsupportedError:
        return None
    return None if opened.are_corners else opened


def _is_streamed(opened: Any) -> bool:
    return hasattr(opened, "read_vertices")


def _running_totals(counts: Sequence[int]) -> list[int]:
    totals = [0]
    for one in counts:
        totals.append(totals[-1] + one)
    return totals
