"""Files of which a codec has found where positions and normals lie: these alone are replaced.

The formats' own modules (``off``, ``vtk``, ``gmsh`` ...) parse a file into a ``Content``; all else
is the same for each of them and stands here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints, Longs
from msal_cli.codecs.slots import Numbers, spliced
from msal_cli.codecs.tokens import require_indices
from msal_cli.errors import EXPORT_AGAIN, ContentError, InternalError, MsalError, UnsupportedError
from msal_cli.storage.buffers import Buffer

_NONE = np.zeros(0, dtype=np.int64)


Shift = Callable[[int], int]
"""By how many bytes a place of the input moves, new positions and normals being written."""


@dataclass(frozen=True, eq=False)
class Dependent:
    """Bytes that depend on positions: counts of bytes up to a place, or bounds.

    ``text(old, positions, shift)`` are the bytes that stand for ``old``.
    """

    start: int
    stop: int
    text: Callable[[bytes, Sequence[Floats], Shift], bytes]


@dataclass(eq=False)
class Content:
    """What a parser makes of a file.

    Attributes
    ----------
    encoding, precision : as in ``base.MeshFile``.
    positions : arrays of positions (n_i, 3), whose rows one behind the other are the vertices.
    corners : (c,) int64, the vertices of all surface polygons, one polygon behind the other.
    sizes : (p,) int64, how many corners each polygon has, at least 3.
    normals : arrays of normals (g_i, 3).
    normal_of_corner : (c,) int64, the normal that each corner uses, -1 for none; None where each
        vertex has its own.
    frames : for each array of positions, the transform (4, 4) from it to the vertices; empty where
        they are the same.
    held : what cells the file has, for the message where none is a surface.
    dependents : what else changes with positions, none of it inside a unit of theirs.
    """

    encoding: str
    precision: str
    positions: tuple[Numbers, ...]
    corners: Longs
    sizes: Longs
    normals: tuple[Numbers, ...] = ()
    normal_of_corner: Longs | None = None
    frames: tuple[Floats, ...] = ()
    properties: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    references: tuple[str, ...] = ()
    held: str = ""
    dependents: tuple[Dependent, ...] = ()


Parse = Callable[[Buffer], Content]


class PatchedFile:
    """An opened file; see ``base.MeshFile`` for the attributes.

    Raises ContentError (``E_NO_FACES``, ``E_NONFINITE``, ``E_INDEX``) for a content that is no
    mesh, and what ``parse`` raises.
    """

    merged_vertices = 0

    def __init__(self, data: Buffer, format: str, parse: Parse) -> None:
        self.format = format
        self._data = data
        self._parse = parse
        content = self._content = parse(data)
        if not len(content.sizes):
            raise ContentError(
                f"the file has no surface faces; it holds {content.held or 'nothing'}",
                code="E_NO_FACES",
                hint="msal denoises surfaces; extract the surface of a volume mesh first",
            )
        self.encoding, self.precision = content.encoding, content.precision
        self.vertices = _vertices(content)
        _require_finite(self.vertices)
        require_indices(content.corners, len(self.vertices))
        first, second, third = _fans(content.sizes)
        self._fans = np.stack([first, second, third], axis=1)
        self.faces = content.corners[self._fans].astype(np.int32)
        self.n_polygons = len(content.sizes)
        self.properties = content.properties
        self.references = content.references
        self.warnings = content.warnings

    def polygons(self) -> list[Any] | Ints:
        """The faces as the file has them: an (m, k) array or a list of (k,) arrays."""
        corners, sizes = self._content.corners.astype(np.int32), self._content.sizes
        if (sizes == sizes[0]).all():
            return corners.reshape(-1, int(sizes[0]))
        return np.split(corners, np.cumsum(sizes[:-1]))

    def forget_vertices(self) -> None:
        """Do nothing: to read them again takes long."""

    def replaced(self, vertices: Floats) -> Buffer:
        """The file with the positions (n, 3) that moved, and their normals, replaced.

        New numbers of a text have as many decimals as the file usually has, or as 1e-7 of its
        extent asks for, whichever is more.
        """
        changes = self._changes(vertices)
        if not changes:
            return self._data
        edits = []
        for numbers, values, is_changed in changes:
            units = numbers.units(is_changed)
            text, ends = numbers.texts(values, units)
            edits.append((numbers.starts[units], numbers.stops[units], text, ends))
        from msal_cli.kernels.text import as_bytes

        shift = _shift(
            (stops, np.diff(ends, prepend=0) - (stops - starts)) for starts, stops, _, ends in edits
        )
        for one, word in self._dependent_texts(vertices, shift):
            edits.append((*_span(one), np.frombuffer(word, np.uint8), np.array([len(word)])))
        return spliced(as_bytes(self._data), edits)

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        """The file with ``vertices`` (n, 3); its encoding and its precision cannot be changed.

        Raises
        ------
        UnsupportedError
            for another encoding or precision than the file has.
        """
        own = "ascii" if self.encoding == "ascii" else "binary"
        if precision not in ("same", self.precision):
            raise UnsupportedError(
                f"the precision of {self.format} files cannot be changed",
                hint="use --to ply, which has float32 and float64",
            )
        if encoding not in ("same", own):
            raise UnsupportedError(
                f"this {self.format} file is {own}, and stays so",
                hint="leave --encoding away, or use --to ply, which has both",
            )
        return self.replaced(vertices)

    def check(self, output: Buffer, vertices: Floats) -> None:
        """Raise InternalError unless ``output`` is this file with only ``vertices`` replaced, and
        the normals of what moved."""
        from msal_cli.kernels.text import as_bytes, same_outside

        changes = self._changes(vertices)
        try:
            there = self._parse(output)
        except MsalError as failure:
            raise InternalError(
                f"the {self.format} file that was made cannot be read: {failure}"
            ) from failure
        ours = (*self._content.positions, *self._content.normals)
        theirs = (*there.positions, *there.normals)
        if [one.values.shape for one in ours] != [one.values.shape for one in theirs]:
            raise InternalError(f"the {self.format} file that was made has other vertices")
        if len(there.dependents) != len(self._content.dependents):
            raise InternalError(f"the {self.format} file that was made has other attributes")
        # Every unit that did not change must be there byte for byte, the others hold new numbers.
        before, after = [], []
        for numbers, values, is_changed in changes:
            units = numbers.units(is_changed)
            which = next(i for i, one in enumerate(ours) if one is numbers)
            output_numbers = theirs[which]
            expected, slack = numbers.stored(values)
            if len(output_numbers.starts) != len(numbers.starts):
                raise InternalError(f"the {self.format} file that was made has other numbers")
            if not (
                _are_close(output_numbers.values[is_changed], expected[is_changed], slack)
                and np.array_equal(
                    output_numbers.values[~is_changed], numbers.values[~is_changed], equal_nan=True
                )
            ):
                raise InternalError(
                    f"a number of the {self.format} file that was made is not what it should be"
                )
            before.append((numbers.starts[units], numbers.stops[units]))
            after.append((output_numbers.starts[units], output_numbers.stops[units]))
        shift = _shift(
            (old[1], (new[1] - new[0]) - (old[1] - old[0]))
            for old, new in zip(before, after, strict=True)
        )
        for (one, text), new in zip(
            self._dependent_texts(vertices, shift), there.dependents, strict=True
        ):
            if bytes(memoryview(output)[new.start : new.stop]) != text:
                raise InternalError(
                    f"an attribute of the {self.format} file that was made is not what it should be"
                )
            before.append(_span(one))
            after.append(_span(new))
        if not same_outside(
            as_bytes(self._data), *_in_order(before), as_bytes(output), *_in_order(after)
        ):
            raise InternalError(
                f"the {self.format} file that was made differs in more than positions and normals"
            )

    def _changes(self, vertices: Floats) -> list[tuple[Numbers, Floats, Flags]]:
        """The arrays that change, what they are to hold, and which numbers of it are new."""
        if vertices.shape != self.vertices.shape:
            raise InternalError(
                f"positions of shape {vertices.shape} for a file with {len(self.vertices)} vertices"
            )
        if not np.isfinite(vertices).all():
            raise InternalError("a new position is not finite")
        if not (vertices != self.vertices).any():
            return []
        content = self._content
        pairs = list(zip(content.positions, self._to_file(vertices), strict=True))
        if content.normals:
            pairs += zip(content.normals, self._new_normals(vertices), strict=True)
        changes = []
        for numbers, values in pairs:
            is_changed = (values != numbers.values) & ~np.isnan(numbers.values)
            if is_changed.any():
                changes.append((numbers, values, is_changed))
        return changes

    def _dependent_texts(self, vertices: Floats, shift: Shift) -> Iterator[tuple[Dependent, bytes]]:
        """What depends on positions, and the bytes that it should have."""
        if not self._content.dependents:
            return
        positions = self._to_file(vertices)
        for one in self._content.dependents:
            old = bytes(memoryview(self._data)[one.start : one.stop])
            yield one, one.text(old, positions, shift)

    def _to_file(self, vertices: Floats) -> list[Floats]:
        """New positions of each array, unmoved rows exactly as they are stored."""
        content = self._content
        rows = np.split(vertices, np.cumsum([len(one.values) for one in content.positions])[:-1])
        if not content.frames:
            return rows
        result = []
        for new, numbers, frame in zip(rows, content.positions, content.frames, strict=True):
            is_moved = (new != _transformed(numbers.values, frame)).any(axis=1)
            back = _transformed(new, np.linalg.inv(frame).astype(np.float64))
            result.append(np.where(is_moved[:, None], back, numbers.values))
        return result

    def _new_normals(self, vertices: Floats) -> list[Floats]:
        """The normals of each array, those of faces that did not move as they are stored."""
        from msal_cli.kernels.geometry import regrouped_normals

        content = self._content
        stored = np.concatenate([one.values for one in content.normals])
        entries = self.faces
        if content.normal_of_corner is not None:
            entries = content.normal_of_corner[self._fans].astype(np.int32)
        if content.frames:
            normals = stored.copy()
            for old, new, first in self._in_own_frames(vertices):
                is_own = (self.faces[:, 0] >= first) & (self.faces[:, 0] < first + len(old))
                own, is_changed = regrouped_normals(
                    old, new, self.faces[is_own] - np.int32(first), entries[is_own], stored
                )
                normals[is_changed] = own[is_changed]
        else:
            own, is_changed = regrouped_normals(
                self.vertices, vertices, self.faces, entries, stored
            )
            normals = np.where(is_changed[:, None], own, stored)
        return np.split(normals, np.cumsum([len(one.values) for one in content.normals])[:-1])

    def _in_own_frames(self, vertices: Floats) -> Iterator[tuple[Floats, Floats, int]]:
        """The stored and the new positions of each array, and its first vertex."""
        first = 0
        for numbers, new in zip(self._content.positions, self._to_file(vertices), strict=True):
            yield numbers.values, new, first
            first += len(new)


def _span(one: Dependent) -> tuple[Longs, Longs]:
    return np.array([one.start]), np.array([one.stop])


def _shift(growths: Iterable[tuple[Longs, Longs]]) -> Shift:
    """What growth of units makes of places; each item is the ends of units and by how many bytes
    they grow."""
    pairs = list(growths)
    stops = np.concatenate([_NONE, *(pair[0] for pair in pairs)])
    growth = np.concatenate([_NONE, *(pair[1] for pair in pairs)])
    return lambda at: int(growth[stops <= at].sum())


def _vertices(content: Content) -> Floats:
    if not content.frames:
        values = [one.values for one in content.positions]
        return values[0] if len(values) == 1 else np.concatenate(values)
    return np.concatenate(
        [
            _transformed(one.values, frame)
            for one, frame in zip(content.positions, content.frames, strict=True)
        ]
    )


def _transformed(points: Floats, frame: Floats) -> Floats:
    """Points (n, 3) after a transform (4, 4); bit for bit the same for the identity."""
    if np.array_equal(frame, np.eye(4)):
        return points
    result: Floats = points @ frame[:3, :3].T + frame[:3, 3]
    return result


def _require_finite(vertices: Floats) -> None:
    is_finite = np.isfinite(vertices).all(axis=1)
    if not is_finite.all():
        raise ContentError(
            "a position is not finite",
            code="E_NONFINITE",
            where=f"vertex {int(np.argmin(is_finite))}",
            hint=EXPORT_AGAIN,
        )


def _fans(sizes: Longs) -> tuple[Longs, Longs, Longs]:
    """Places among the corners of triangles that share each polygon's first corner."""
    n_triangles = sizes - 2
    first = np.repeat(np.cumsum(sizes) - sizes, n_triangles)
    inside = np.arange(len(first)) - np.repeat(np.cumsum(n_triangles) - n_triangles, n_triangles)
    return first, first + inside + 1, first + inside + 2


def _are_close(values: Floats, expected: Floats, slack: float) -> bool:
    return bool(
        (np.abs(values - expected) <= slack + 4.5e-16 * np.abs(expected) * (slack > 0)).all()
    )


def _in_order(pieces: list[tuple[Longs, Longs]]) -> tuple[Longs, Longs]:
    starts = np.concatenate([_NONE, *(piece[0] for piece in pieces)])
    stops = np.concatenate([_NONE, *(piece[1] for piece in pieces)])
    order = np.argsort(starts, kind="stable")
    return starts[order], stops[order]
