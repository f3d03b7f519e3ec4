"""Stage ``join``: the output in pieces, and its way to its place.

Each task gathers the new positions of the vertices in its piece of the file, which lie in the order
of tiles, and writes the piece into a file in the scratch folder; pieces of a text, whose lengths
change, have files of their own.  When all are there they are checked, flushed and moved to the name
of the output, which thus appears whole or not at all.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import zlib
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from msal_cli.arrays import Floats
from msal_cli.codecs.streamed_mesh import NewNormals, NewPositions, StreamedMesh, Survey
from msal_cli.errors import InputError, InternalError, OutputError
from msal_cli.storage import digests
from msal_cli.storage.atomic import Sources, publish, write_whole
from msal_cli.storage.gzip_streams import compress_pieces, is_gzip_name
from msal_cli.storage.regular import open_regular
from msal_cli.tiles import source as sources
from msal_cli.tiles.plan import TilePlan, load_plan
from msal_cli.tiles.scratch import Scratch

MOVED, NORMALS = "moved.f8", "normals.f8"
"""New positions (n, 3) and normals (n, 3) by new number, file units, float64: as of
``codecs.streamed_mesh.NewPositions`` and ``NewNormals``.  Without the first nothing moved."""

OUTPUT = "output.bin"
"""The output of a binary file as far as it is written."""

PIECES = "output"
"""A folder of the pieces of a text."""

_SURVEY = "survey.json"
_AT_ONCE = 4 << 20

_NUMBERS = "numbers.u4"
_FINISHED = "finished.json"


@dataclass(frozen=True)
class Finished:
    """An output that is in its place.

    Attributes
    ----------
    path : of the output.
    input_sha256, output_sha256 : hex digits.
    size : bytes of the output.
    is_changed : whether it differs from the input.
    """

    path: str
    input_sha256: str
    output_sha256: str
    size: int
    is_changed: bool


def run_join(scratch: Scratch, piece: int) -> dict[str, Any]:
    """Write a piece of the output; the result has its CRC-32, by which it is known later."""
    plan = load_plan(scratch)
    mesh = sources.open_source(plan.source)
    start, stop = plan.pieces[piece]
    positions = gather_rows(scratch, MOVED) if scratch.has(MOVED) else read_stored(mesh)
    normals = gather_rows(scratch, NORMALS) if scratch.has(NORMALS) else None
    survey = None if mesh.keeps_size else _survey(scratch, mesh, positions, normals)
    data = mesh.replace((start, stop), positions, normals, survey)
    if not mesh.keeps_size:
        (scratch.path / PIECES).mkdir(exist_ok=True)
        (scratch.path / PIECES / f"{piece}.bin").write_bytes(data)
    elif len(data) != stop - start:
        raise InternalError(
            f"piece {piece} of the output has {len(data)} bytes, not {stop - start}"
        )
    else:
        _write_at(scratch, start, data)
    return {"crc32": zlib.crc32(data), "size": len(data)}


def finish_output(scratch: Scratch, *, path: str | None = None, files: Sources = ()) -> Finished:
    """Move the output, all of whose pieces are written, to its place: that of the plan or ``path``.

    A call that was killed is repeated.  ``files``, from which it was made, limit its permission
    bits, see ``atomic.write_whole``.

    Raises
    ------
    InputError
        if the input has changed since the plan was made.
    OutputError
        if the system refuses, or the scratch folder does not hold what was written to it.
    """
    plan = load_plan(scratch)
    target = path if path is not None else plan.output
    if target is None:
        raise InternalError("the plan has no output")
    known = scratch.read_json(_FINISHED)
    if known is not None and not scratch.has(OUTPUT) and not scratch.has(PIECES):
        return Finished(**known)
    _require_same_input(plan)
    content = sources.open_source(plan.source).path
    is_packed = os.path.abspath(content) != os.path.abspath(plan.source["path"])
    if not scratch.has(OUTPUT) or is_packed or is_gzip_name(target):
        return _write_copy(scratch, plan, content if is_packed else None, target, files)
    finished = _check_pieces(scratch, plan, target)
    # Written before the file is moved, so that a repeated call knows what became of it.
    scratch.write_json(_FINISHED, asdict(finished))
    publish(scratch.path / OUTPUT, target, finished.size, sources=files)
    return finished


def _write_copy(
    scratch: Scratch, plan: TilePlan, content: str | None, target: str, files: Sources
) -> Finished:
    """``finish_output`` for pieces in files of their own, and where gzip is involved.

    ``content`` is what the input expands to, None where it is not compressed.
    """
    path = plan.source["path"]
    output = _HashedPieces(_read_pieces(scratch, plan))
    if is_gzip_name(target):
        pieces: Iterable[bytes] = output
        if content is not None and _hash_of(output) == digests.sha256_of_file(content):
            # Where nothing moved, the very bytes of the input.
            pieces = _read_file(path)
        else:
            pieces = compress_pieces(_read_pieces(scratch, plan))
        output = _HashedPieces(pieces)
    with ThreadPoolExecutor(1) as other:
        source = other.submit(digests.sha256_of_file, path)
        write_whole(target, output, sources=files)
        known = _result_of(source)
    made = output.digest.hexdigest()
    finished = Finished(target, known, made, output.size, made != known)
    scratch.write_json(_FINISHED, asdict(finished))
    (scratch.path / OUTPUT).unlink(missing_ok=True)
    shutil.rmtree(scratch.path / PIECES, ignore_errors=True)
    return finished


class _HashedPieces:
    """Pieces of a file whose ``size`` and SHA-256, ``digest``, are known once all are read."""

    def __init__(self, pieces: Iterable[bytes]) -> None:
        self._pieces = pieces
        self.digest, self.size = hashlib.sha256(), 0

    def __iter__(self) -> Iterator[bytes]:
        for piece in self._pieces:
            self.digest.update(piece)
            self.size += len(piece)
            yield piece


def _hash_of(pieces: _HashedPieces) -> str:
    for _ in pieces:
        pass
    return pieces.digest.hexdigest()


def _read_pieces(scratch: Scratch, plan: TilePlan) -> Iterator[bytes]:
    """The pieces of the output, each compared with what was written."""
    is_whole = scratch.has(OUTPUT)
    for piece, result in scratch.results("join").items():
        if is_whole:
            data = scratch.read_range(OUTPUT, np.uint8, *plan.pieces[piece]).tobytes()
        else:
            data = (scratch.path / PIECES / f"{piece}.bin").read_bytes()
        if len(data) != result["size"] or zlib.crc32(data) != result["crc32"]:
            raise _lost(scratch, f"piece {piece} of the output is not as it was")
        yield data


def _read_file(path: str) -> Iterator[bytes]:
    with open_regular(path, buffering=0) as file:
        while piece := file.read(_AT_ONCE):
            yield piece


def _survey(
    scratch: Scratch, mesh: StreamedMesh, positions: NewPositions, normals: NewNormals | None
) -> Survey | None:
    """What all new numbers decide; the first tasks find it out, others read it."""
    known = scratch.read_json(_SURVEY)
    if known is not None:
        return Survey(*known)
    survey = mesh.survey(positions, normals)
    scratch.write_json(_SURVEY, survey)
    return survey


def read_stored(mesh: Any) -> NewPositions:
    """New positions that are the stored ones."""
    return lambda start, stop: mesh.read_vertices(start, stop).astype(np.float64)


def gather_rows(scratch: Scratch, name: str) -> NewPositions:
    """The rows of an array in the order of tiles, for ranges of vertices of the file."""

    def gather(start: int, stop: int) -> Floats:
        numbers = scratch.read_range(_NUMBERS, np.uint32, start, stop)
        order = np.argsort(numbers, kind="stable")
        ascending = numbers[order].astype(np.int64)
        # Vertices of one tile have its numbers in the order of the file, so that a range of
        # vertices has a range of numbers in every tile, without gaps.
        cuts = np.flatnonzero(np.diff(ascending) != 1) + 1
        rows = np.empty((stop - start, 3))
        for first, last in zip([0, *cuts], [*cuts, stop - start], strict=True):
            if last > first:
                low = int(ascending[first])
                part = scratch.read_range(name, np.float64, low, low + last - first, 3)
                rows[order[first:last]] = part
        return rows

    return gather


def _write_at(scratch: Scratch, start: int, data: memoryview) -> None:
    """Write a piece of the output; the file is made where it is not there yet."""
    flags = os.O_WRONLY | os.O_CREAT | getattr(os, "O_BINARY", 0)
    flags |= getattr(os, "O_NOFOLLOW", 0)
    with open(os.open(scratch.path / OUTPUT, flags, 0o666), "wb", buffering=0) as file:
        file.seek(start)
        view = data.cast("B")
        while len(view):
            view = view[file.write(view) :]


def _require_same_input(plan: TilePlan) -> None:
    if sources.identify(plan.source) != plan.identity:
        raise InputError(
            "the input changed while it was denoised",
            hint="let no other program write it, and run again",
        )


def _check_pieces(scratch: Scratch, plan: TilePlan, target: str) -> Finished:
    """Read input and output, side by side, and compare every piece with what was written."""
    results = scratch.results("join")
    pieces = [(start, stop) for start, stop in plan.pieces if stop > start]
    sums = [
        results[index]["crc32"] for index, (start, stop) in enumerate(plan.pieces) if stop > start
    ]
    reader = _PieceReader([stop for _, stop in pieces])
    with ThreadPoolExecutor(1) as other:
        digest = other.submit(digests.sha256_of_file, plan.source["path"])
        output = digests.sha256_of_file(scratch.path / OUTPUT, reader.look)
        source = _result_of(digest)
    for piece, crc32, expected in zip(pieces, reader.sums, sums, strict=True):
        if crc32 != expected:
            raise _lost(scratch, f"the bytes {piece[0]} to {piece[1]} are not as they were")
    return Finished(target, source, output, reader.size, output != source)


def _result_of(digest: Future[str]) -> str:
    try:
        return digest.result()
    except OSError as failure:
        raise InputError(
            f"the input cannot be read: {failure.strerror}",
            code="E_READ",
            hint="check that it is still there, and run again",
        ) from failure


def _lost(scratch: Scratch, what: str) -> OutputError:
    return OutputError(
        f"the scratch folder lost data of the output: {what} written",
        path=str(scratch.path),
        hint="remove the scratch folder, check its disk, and run again",
    )


class _PieceReader:
    """The CRC-32 of every piece of a file that is read from its beginning.

    ``stops`` are the ends of the pieces, ascending.
    """

    def __init__(self, stops: list[int]) -> None:
        self._stops = stops
        self.sums = [0] * len(stops)
        self.size = 0
        self._piece = 0

    def look(self, data: bytes) -> None:
        """The next bytes."""
        view = memoryview(data)
        while len(view):
            if self._piece == len(self._stops):
                self.size += len(view)
                return
            room = self._stops[self._piece] - self.size
            self.sums[self._piece] = zlib.crc32(view[:room], self.sums[self._piece])
            self.size += min(room, len(view))
            if self.size == self._stops[self._piece]:
                self._piece += 1
            view = view[room:]
