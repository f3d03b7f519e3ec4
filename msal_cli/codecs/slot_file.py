"""Files of which a codec has found where positions and normals lie: these alone are replaced.

The formats' own modules (``ply``, ``off``, ``vtk`` ...) parse a file into a ``Layout``; replacing,
checking, ranges and normals are the same for all of them and are here.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints, Longs
from msal_cli.codecs.record_slots import Overwrite, RecordSlots, check_overwritten, overwrite
from msal_cli.codecs.slots import Slots, TextSlots, UnitSlots, require_range, splice
from msal_cli.codecs.text_slots import (
    Patch,
    Statements,
    is_replaced,
    replace_statements,
)
from msal_cli.codecs.tokens import require_indices
from msal_cli.errors import ContentError, InternalError, MsalError, UnsupportedError
from msal_cli.kernels.text import as_bytes
from msal_cli.storage.buffers import Buffer

_NONE = np.zeros(0, dtype=np.int64)

_NORMAL_SLACK = 1e-5
"""How far the length of a new normal may be from one."""

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


def _empty() -> Longs:
    return _NONE


@dataclass(eq=False)
class Layout:
    """What a parser makes of a file.

    Attributes
    ----------
    encoding, precision : as in ``mesh_file.MeshFile``.
    positions : arrays of positions (n_i, 3), whose rows one behind the other are the vertices;
        ``RecordSlots`` in binary files, in which nothing else depends on them, else ``UnitSlots``.
    corners : (c,) int64, the vertices of all surface polygons, one polygon behind the other.
    sizes : (p,) int64, how many corners each polygon has, at least 3.
    faces : (m, 3) int32, the triangles, where the parser has made them and checked them and the
        positions; then ``corners`` and ``sizes`` are for the codec alone, empty where all polygons
        are triangles.
    vertices : (n, 3), where the parser has read them; the file takes them over.
    normals : arrays of normals (g_i, 3).
    normal_of_corner : (c,) int64, the normal that each corner uses, -1 for none; None where each
        vertex has its own.
    renew_normals : makes of the old and the new vertices each array of normals (g_i, 3), and says
        which rows changed (g_i,); None for the usual way.
    frames : for each array of positions, the transform (4, 4) from it to the vertices; empty where
        they are the same.
    held : what cells the file has, for the message where none is a surface.
    dependents : what else changes with positions, none of it inside a unit of theirs.
    """

    encoding: str
    precision: str
    positions: tuple[Slots, ...]
    corners: Longs = field(default_factory=_empty)
    sizes: Longs = field(default_factory=_empty)
    normals: tuple[Slots, ...] = ()
    normal_of_corner: Longs | None = None
    frames: tuple[Floats, ...] = ()
    properties: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    references: tuple[str, ...] = ()
    held: str = ""
    dependents: tuple[Dependent, ...] = ()
    faces: Ints | None = None
    vertices: Floats | None = None
    renew_normals: Callable[[Floats, Floats], Sequence[tuple[Floats, Flags]]] | None = None


Parse = Callable[[Buffer], Layout]


class Change(NamedTuple):
    """New ``values`` (n, k) of an array, and which of its numbers ``is_changed`` (n, k)."""

    slots: Slots
    values: Floats
    is_changed: Flags


class SlotFile:
    """An opened file; see ``mesh_file.MeshFile`` for the attributes.

    Raises ContentError (``E_NO_FACES``, ``E_NONFINITE``, ``E_INDEX``) for a layout that is no
    mesh, and what ``parse`` raises.
    """

    merged_vertices = 0

    def __init__(self, data: Buffer, format: str, parse: Parse) -> None:
        self.format = format
        self._data = data
        self._parse = parse
        layout = self._layout = parse(data)
        self.encoding, self.precision = layout.encoding, layout.precision
        self._vertices, layout.vertices = layout.vertices, None
        self._last_normals: tuple[bytes, Sequence[tuple[Floats, Flags]]] = (b"", ())
        if layout.faces is None:
            self.faces, self._fans = _triangles(layout, self.vertices)
        else:
            self.faces = layout.faces
        self.n_polygons = len(layout.sizes) or len(self.faces)
        self.properties = layout.properties
        self.references = layout.references
        self.warnings = layout.warnings

    @property
    def vertices(self) -> Floats:
        """The positions (n, 3)."""
        if self._vertices is None:
            self._vertices = _vertices(self._layout)
        return self._vertices

    def forget_vertices(self) -> None:
        """Let go of the positions: a text's are kept with it, others are read again."""
        self._vertices = None

    def polygons(self) -> list[Any] | Ints:
        """The faces as the file has them: an (m, k) array or a list of (k,) arrays."""
        corners, sizes = self._layout.corners.astype(np.int32), self._layout.sizes
        if not len(sizes):
            return self.faces
        if (sizes == sizes[0]).all():
            return corners.reshape(-1, int(sizes[0]))
        return np.split(corners, np.cumsum(sizes[:-1]))

    def replaced(self, vertices: Floats) -> Buffer:
        """The file with the positions (n, 3) that moved, and their normals, replaced.

        New numbers of a text have as many decimals as their own line or the file usually has, or
        as 1e-7 of its extent asks for, whichever is more.  Raises ContentError (``E_RANGE``) for a
        position that does not fit the file's number type.
        """
        changes = self._changes(vertices)
        if not changes:
            return self._data
        for slots, values, is_changed in changes:
            if slots in self._layout.positions and slots.codes:
                require_range(values, is_changed, slots.codes)
        # Infinity and what is no number show in the sum of the extremes.
        if not math.isfinite(float(vertices.max()) + float(vertices.min())):
            raise InternalError("a new position is not finite")
        if self._is_binary:
            return overwrite(as_bytes(self._data), _overwrites(changes))
        patches = _patches(changes)
        output = replace_statements(as_bytes(self._data), patches) if patches else None
        return output or self._spliced(changes, vertices)

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
        changes = self._changes(vertices)
        data, result = as_bytes(self._data), as_bytes(output)
        if self._is_binary or not changes:
            check_overwritten(data, result, _overwrites(changes))
            return
        _require_unit_length(changes)
        patches = _patches(changes)
        if not patches or not is_replaced(data, result, patches):
            self._check_parsed(output, changes, vertices)

    @property
    def _is_binary(self) -> bool:
        """Whether all numbers are overwritten in place."""
        return all(isinstance(one, RecordSlots) for one in self._layout.positions)

    def _spliced(self, changes: Sequence[Change], vertices: Floats) -> memoryview:
        """The file with the bytes of all units that changed, and of all that depends on them."""
        edits = []
        for slots, values, is_changed in changes:
            assert isinstance(slots, UnitSlots)
            units = slots.units(is_changed)
            text, ends = slots.encode(values, units)
            edits.append((slots.starts[units], slots.stops[units], text, ends))
        shift = _shift(
            (stops, np.diff(ends, prepend=0) - (stops - starts)) for starts, stops, _, ends in edits
        )
        for one, word in self._dependent_texts(vertices, shift):
            edits.append((*_span(one), np.frombuffer(word, np.uint8), np.array([len(word)])))
        return splice(as_bytes(self._data), edits)

    def _check_parsed(self, output: Buffer, changes: Sequence[Change], vertices: Floats) -> None:
        """``check`` for units of any size: the output is parsed again."""
        result = as_bytes(output)
        try:
            there = self._parse(output)
        except MsalError as failure:
            raise InternalError(
                f"the {self.format} file that was made cannot be read: {failure}"
            ) from failure
        ours = (*self._layout.positions, *self._layout.normals)
        theirs = (*there.positions, *there.normals)
        if [one.values.shape for one in ours] != [one.values.shape for one in theirs]:
            raise InternalError(f"the {self.format} file that was made has other vertices")
        if len(there.dependents) != len(self._layout.dependents):
            raise InternalError(f"the {self.format} file that was made has other attributes")
        # Every unit that did not change must be there byte for byte, the others hold new numbers.
        before, after = [], []
        for slots, values, is_changed in changes:
            new = theirs[next(i for i, one in enumerate(ours) if one is slots)]
            assert isinstance(slots, UnitSlots) and isinstance(new, UnitSlots)
            units = slots.units(is_changed)
            expected, slack = slots.rounded(values)
            if len(new.starts) != len(slots.starts):
                raise InternalError(f"the {self.format} file that was made has other numbers")
            if not (
                _are_close(
                    new.values[is_changed],
                    expected[is_changed],
                    np.broadcast_to(slack, expected.shape)[is_changed],
                )
                and np.array_equal(
                    new.values[~is_changed], slots.values[~is_changed], equal_nan=True
                )
            ):
                raise InternalError(
                    f"a number of the {self.format} file that was made is not what it should be"
                )
            before.append((slots.starts[units], slots.stops[units]))
            after.append((new.starts[units], new.stops[units]))
        shift = _shift(
            (old[1], (new[1] - new[0]) - (old[1] - old[0]))
            for old, new in zip(before, after, strict=True)
        )
        for (one, text), now in zip(
            self._dependent_texts(vertices, shift), there.dependents, strict=True
        ):
            if result[now.start : now.stop].tobytes() != text:
                raise InternalError(
                    f"an attribute of the {self.format} file that was made is not what it should be"
                )
            before.append(_span(one))
            after.append(_span(now))
        from msal_cli.kernels.text import same_outside

        if not same_outside(as_bytes(self._data), *_in_order(before), result, *_in_order(after)):
            raise InternalError(
                f"the {self.format} file that was made differs in more than positions and normals"
            )

    def _require_shape(self, vertices: Floats) -> None:
        if vertices.shape != self.vertices.shape or vertices.dtype != np.float64:
            raise InternalError(
                f"positions of shape {vertices.shape} and type {vertices.dtype} for a file with "
                f"{len(self.vertices)} vertices"
            )

    def _changes(self, vertices: Floats) -> list[Change]:
        """The arrays that change; none where no vertex moves."""
        self._require_shape(vertices)
        is_moved = vertices != self.vertices
        if not is_moved.any():
            return []
        layout = self._layout
        is_one = len(layout.positions) == 1 and not layout.frames
        changes = []
        for slots, values in zip(layout.positions, self._to_file(vertices), strict=True):
            is_changed = is_moved if is_one else values != slots.values
            if slots.whole_rows:
                is_changed = np.broadcast_to(is_changed.any(axis=1)[:, None], values.shape)
            if isinstance(slots, TextSlots):
                rounded, _ = slots.rounded(values)
                if rounded is not values:
                    values, is_changed = rounded, rounded != slots.values
            changes.append(Change(slots, values, is_changed))
        changes += self._changed_normals(vertices)
        return [one for one in changes if one.is_changed.any()]

    def _changed_normals(self, vertices: Floats) -> list[Change]:
        """The normals of what moved.

        Remembered for the last positions, which writing and checking ask for in turn.
        """
        if not self._layout.normals:
            return []
        key = hashlib.sha256(np.ascontiguousarray(vertices).data).digest()
        if self._last_normals[0] != key:
            renew = self._layout.renew_normals or self._renew_normals
            self._last_normals = key, list(renew(self.vertices, vertices))
        changes = []
        for slots, (values, rows) in zip(self._layout.normals, self._last_normals[1], strict=True):
            is_changed = np.broadcast_to(rows[:, None], values.shape)
            if not slots.whole_rows:
                stored = slots.values
                is_changed = is_changed & (values != stored) & ~np.isnan(stored)
            changes.append(Change(slots, values, is_changed))
        return changes

    def _dependent_texts(self, vertices: Floats, shift: Shift) -> Iterator[tuple[Dependent, bytes]]:
        """What depends on positions, and the bytes that it should have."""
        if not self._layout.dependents:
            return
        positions = self._to_file(vertices)
        for one in self._layout.dependents:
            old = bytes(memoryview(self._data)[one.start : one.stop])
            yield one, one.text(old, positions, shift)

    def _to_file(self, vertices: Floats) -> list[Floats]:
        """New positions of each array, unmoved rows exactly as they are stored."""
        layout = self._layout
        if len(layout.positions) == 1 and not layout.frames:
            return [vertices]
        stored = [one.values for one in layout.positions]
        rows = np.split(vertices, np.cumsum([len(one) for one in stored])[:-1])
        if not layout.frames:
            return rows
        result = []
        for new, own, frame in zip(rows, stored, layout.frames, strict=True):
            is_moved = (new != _transformed(own, frame)).any(axis=1)
            back = _transformed(new, np.linalg.inv(frame).astype(np.float64))
            result.append(np.where(is_moved[:, None], back, own))
        return result

    def _renew_normals(self, old: Floats, new: Floats) -> list[tuple[Floats, Flags]]:
        """The normals of each array, those of faces that did not move as they are stored, and
        which rows changed."""
        from msal_cli.kernels.geometry import regrouped_normals

        layout = self._layout
        arrays = [one.values for one in layout.normals]
        normals = np.concatenate(arrays) if len(arrays) > 1 else arrays[0]
        entries = self.faces
        if layout.normal_of_corner is not None:
            entries = layout.normal_of_corner[self._fans].astype(np.int32)
        if layout.frames:
            stored, normals = normals, normals.copy()
            rows = np.zeros(len(normals), dtype=bool)
            first = 0
            for slots, own_new in zip(layout.positions, self._to_file(new), strict=True):
                is_own = (self.faces[:, 0] >= first) & (self.faces[:, 0] < first + len(own_new))
                own, is_changed = regrouped_normals(
                    slots.values,
                    own_new,
                    self.faces[is_own] - np.int32(first),
                    entries[is_own],
                    stored,
                )
                normals[is_changed] = own[is_changed]
                rows |= is_changed
                first += len(own_new)
        else:
            normals, rows = regrouped_normals(old, new, self.faces, entries, normals)
        cuts = np.cumsum([len(one) for one in arrays])[:-1]
        return list(zip(np.split(normals, cuts), np.split(rows, cuts), strict=True))


def _overwrites(changes: Sequence[Change]) -> list[Overwrite]:
    return [
        Overwrite(slots, values, where)
        for slots, values, where in changes
        if isinstance(slots, RecordSlots)
    ]


def _patches(changes: Sequence[Change]) -> list[Patch]:
    """The changes where all are statements whose lines keep their own decimals, else none."""
    patches = []
    for slots, values, _ in changes:
        decimals = slots.row_decimals(values) if isinstance(slots, Statements) else None
        if decimals is None or not isinstance(slots, Statements):
            return []
        patches.append(Patch(slots, np.require(values, np.float64, ("C", "W")), decimals))
    return patches


def _require_unit_length(changes: Sequence[Change]) -> None:
    """Raise InternalError where a new normal is not of unit length."""
    for slots, values, is_changed in changes:
        if isinstance(slots, TextSlots) and slots.unit_length:
            lengths = np.sqrt((values * values).sum(axis=1))
            is_wrong = ~(np.abs(lengths - 1.0) <= _NORMAL_SLACK) & is_changed.any(axis=1)
            if is_wrong.any():
                raise InternalError(
                    "a new normal is not of unit length", where=f"normal {np.argmax(is_wrong) + 1}"
                )


def _span(one: Dependent) -> tuple[Longs, Longs]:
    return np.array([one.start]), np.array([one.stop])


def _shift(growths: Iterable[tuple[Longs, Longs]]) -> Shift:
    """What growth of units makes of places; each item is the ends of units and by how many bytes
    they grow."""
    pairs = list(growths)
    stops = np.concatenate([_NONE, *(pair[0] for pair in pairs)])
    growth = np.concatenate([_NONE, *(pair[1] for pair in pairs)])
    return lambda at: int(growth[stops <= at].sum())


def _triangles(layout: Layout, vertices: Floats) -> tuple[Ints, Longs]:
    """Triangles (m, 3), and the places of their corners among those of the polygons.

    Raises ContentError for a layout that is no mesh.
    """
    if not len(layout.sizes):
        raise ContentError(
            f"the file has no surface faces; it holds {layout.held or 'nothing'}",
            code="E_NO_FACES",
            hint="msal denoises surfaces; extract the surface of a volume mesh first",
        )
    require_finite(vertices)
    require_indices(layout.corners, len(vertices))
    fans = np.stack(_fans(layout.sizes), axis=1)
    return layout.corners[fans].astype(np.int32), fans


def _vertices(layout: Layout) -> Floats:
    if not layout.frames:
        values = [one.values for one in layout.positions]
        return values[0] if len(values) == 1 else np.concatenate(values)
    return np.concatenate(
        [
            _transformed(one.values, frame)
            for one, frame in zip(layout.positions, layout.frames, strict=True)
        ]
    )


def _transformed(points: Floats, frame: Floats) -> Floats:
    """Points (n, 3) after a transform (4, 4); bit for bit the same for the identity."""
    if np.array_equal(frame, np.eye(4)):
        return points
    result: Floats = points @ frame[:3, :3].T + frame[:3, 3]
    return result


def require_finite(vertices: Floats, where: Callable[[int], str] = "vertex {}".format) -> None:
    """Raise ContentError (``E_NONFINITE``) where a position (n, 3) is NaN or infinite.

    ``where`` says in words where a vertex is stored.
    """
    # A sum is finite only if all are, and quicker; it may overflow, too.
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(vertices.sum()):
            return
    is_finite = np.isfinite(vertices).all(axis=1)
    if not is_finite.all():
        vertex = int(np.argmin(is_finite))
        raise ContentError(
            f"vertex {vertex} has a coordinate that is not a finite number",
            where=where(vertex),
            hint="remove such vertices, or export the scan again",
            code="E_NONFINITE",
        )


def _fans(sizes: Longs) -> tuple[Longs, Longs, Longs]:
    """Places among the corners of triangles that share each polygon's first corner."""
    n_triangles = sizes - 2
    first = np.repeat(np.cumsum(sizes) - sizes, n_triangles)
    inside = np.arange(len(first)) - np.repeat(np.cumsum(n_triangles) - n_triangles, n_triangles)
    return first, first + inside + 1, first + inside + 2


def _are_close(values: Floats, expected: Floats, slack: Floats) -> bool:
    last_place = 4.5e-16 * np.abs(expected) * (slack > 0)
    return bool((np.abs(values - expected) <= slack + last_place).all())


def _in_order(pieces: list[tuple[Longs, Longs]]) -> tuple[Longs, Longs]:
    starts = np.concatenate([_NONE, *(piece[0] for piece in pieces)])
    stops = np.concatenate([_NONE, *(piece[1] for piece in pieces)])
    if (starts[1:] > starts[:-1]).all():
        return starts, stops
    order = np.argsort(starts, kind="stable")
    return starts[order], stops[order]


# The names of before, until all codecs use the new ones.
PatchedFile = SlotFile
Content = Layout
