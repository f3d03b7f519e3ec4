"""Files of which a codec has found where positions and normals lie: these alone are replaced.

The formats' own modules (``ply``, ``off``, ``vtk`` ...) parse a file into a ``Layout``; replacing,
checking, ranges and normals are the same for all of them and are here.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints, Longs
from msal_cli.codecs.mesh_file import (
    Dependent,
    Parse,
    Shift,
    cut_polygons,
    require_finite,
    transform,
)
from msal_cli.codecs.slots import (
    Change,
    RecordSlots,
    UnitSlots,
    check_overwritten,
    overwrite,
    require_range,
    splice,
)
from msal_cli.codecs.text_slots import (
    Patch,
    Statements,
    TextSlots,
    is_interleaved,
    replace_statements,
    require_replaced,
)
from msal_cli.codecs.tokens import require_indices
from msal_cli.errors import ContentError, InternalError, MsalError, UnsupportedError
from msal_cli.kernels.text import as_bytes
from msal_cli.storage.regular import Buffer

_NONE = np.zeros(0, dtype=np.int64)

_NORMAL_SLACK = 1e-5
"""How far the length of a new normal may be from one."""


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
            self.faces = self._cut_faces()
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
            arrays = [slots.values for slots in self._layout.positions]
            if frames := self._layout.frames:
                arrays = [transform(*pair) for pair in zip(arrays, frames, strict=True)]
            self._vertices = arrays[0] if len(arrays) == 1 else np.concatenate(arrays)
        return self._vertices

    def _cut_faces(self) -> Ints:
        """The triangles (m, 3) of the polygons; ContentError for a file that is no mesh."""
        layout = self._layout
        if not len(layout.sizes):
            raise ContentError(
                f"the file has no surface faces; it holds {layout.held or 'nothing'}",
                code="E_NO_FACES",
                hint="msal denoises surfaces; extract the surface of a volume mesh first",
            )
        require_finite(self.vertices)
        corners = layout.corners.astype(np.int64, copy=False)
        require_indices(corners, len(self.vertices))
        return cut_polygons(corners.astype(np.int32), layout.sizes)

    def forget_vertices(self) -> None:
        """Let go of the positions: a text's are kept with it, others are read again."""
        self._vertices = None

    def polygons(self) -> list[Any] | Ints:
        """The faces as the file has them: an (m, k) array or a list of (k,) arrays."""
        corners = self._layout.corners.astype(np.int32, copy=False)
        sizes = self._layout.sizes
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
        self._require_ranges(changes)
        require_finite_result(vertices)
        if self._is_binary:
            return overwrite(as_bytes(self._data), changes)
        patches = _patches(changes)
        if patches:
            return replace_statements(as_bytes(self._data), patches)
        return self._spliced(changes, vertices)

    def _require_ranges(self, changes: Sequence[Change]) -> None:
        """Raise ContentError (``E_RANGE``) for a position that its number type cannot store."""
        for slots, values, is_changed in changes:
            if slots in self._layout.positions and slots.codes:
                require_range(values, is_changed, slots.codes)

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
        changes = self._changes(vertices)
        require_finite_result(vertices)
        data, result = as_bytes(self._data), as_bytes(output)
        if self._is_binary or not changes:
            check_overwritten(data, result, changes)
            return
        for slots, values, is_changed in changes:
            if isinstance(slots, TextSlots) and slots.unit_length:
                lengths = np.sqrt((values * values).sum(axis=1))
                is_wrong = ~(np.abs(lengths - 1.0) <= _NORMAL_SLACK) & is_changed.any(axis=1)
                if is_wrong.any():
                    where = f"normal {np.argmax(is_wrong) + 1}"
                    raise InternalError("a new normal is not of unit length", where=where)
        patches = _patches(changes)
        if patches:
            require_replaced(data, result, patches)
        else:
            self._check_parsed(output, changes, vertices)

    @property
    def _is_binary(self) -> bool:
        """Whether all numbers are overwritten in place."""
        return all(isinstance(slots, RecordSlots) for slots in self._layout.positions)

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
        for dependent, word in self._dependent_texts(vertices, shift):
            edits.append((*_span(dependent), np.frombuffer(word, np.uint8), np.array([len(word)])))
        return splice(as_bytes(self._data), edits)

    def _check_parsed(self, output: Buffer, changes: Sequence[Change], vertices: Floats) -> None:
        """``check`` for units of any size: the output is parsed again."""
        result = as_bytes(output)
        what = f"the {self.format} file that was made"
        try:
            there = self._parse(output)
        except MsalError as failure:
            raise InternalError(f"{what} cannot be read: {failure}") from failure
        ours = (*self._layout.positions, *self._layout.normals)
        theirs = (*there.positions, *there.normals)
        if [slots.values.shape for slots in ours] != [slots.values.shape for slots in theirs]:
            raise InternalError(f"{what} has other vertices")
        if len(there.dependents) != len(self._layout.dependents):
            raise InternalError(f"{what} has other attributes")
        # Every unit that did not change must be there byte for byte, the others hold new numbers.
        before, after = [], []
        for slots, values, is_changed in changes:
            new = theirs[next(i for i, own in enumerate(ours) if own is slots)]
            assert isinstance(slots, UnitSlots) and isinstance(new, UnitSlots)
            units = slots.units(is_changed)
            expected, slack = slots.rounded(values)
            if len(new.starts) != len(slots.starts):
                raise InternalError(f"{what} has other numbers")
            with np.errstate(invalid="ignore"):
                # The last place of a number that is not written exactly may differ.
                slack = slack + 4.5e-16 * np.abs(expected) * (np.asarray(slack) > 0)
                is_close = np.abs(new.values - expected) <= slack
            is_kept = (new.values == slots.values) | np.isnan(new.values) & np.isnan(slots.values)
            if not np.where(is_changed, is_close, is_kept).all():
                raise InternalError(f"a number of {what} is not what it should be")
            before.append((slots.starts[units], slots.stops[units]))
            after.append((new.starts[units], new.stops[units]))
        shift = _shift(
            (old[1], (new[1] - new[0]) - (old[1] - old[0]))
            for old, new in zip(before, after, strict=True)
        )
        for (dependent, text), now in zip(
            self._dependent_texts(vertices, shift), there.dependents, strict=True
        ):
            if result[now.start : now.stop].tobytes() != text:
                raise InternalError(f"an attribute of {what} is not what it should be")
            before.append(_span(dependent))
            after.append(_span(now))
        from msal_cli.kernels.text import is_same_outside

        if not is_same_outside(as_bytes(self._data), *_in_order(before), result, *_in_order(after)):
            raise InternalError(f"{what} differs in more than positions and normals")

    def _changes(self, vertices: Floats) -> list[Change]:
        """The arrays that change; none where no vertex moves."""
        require_shape(vertices, self.vertices)
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
                    values, is_changed = rounded, is_changed & (rounded != slots.values)
            changes.append(Change(slots, values, is_changed))
        changes += self._changed_normals(vertices)
        return [change for change in changes if change.is_changed.any()]

    def _changed_normals(self, vertices: Floats) -> list[Change]:
        """The normals of what moved."""
        if not self._layout.normals:
            return []
        changes = []
        renewed = self._new_normals(vertices)
        for slots, (values, rows) in zip(self._layout.normals, renewed, strict=True):
            is_changed = np.broadcast_to(rows[:, None], values.shape)
            if not slots.whole_rows:
                is_changed = is_changed & (values != slots.values) & ~np.isnan(slots.values)
            elif isinstance(slots, TextSlots):
                # A number that stays the same keeps its spelling, as -0 does.
                is_changed = is_changed & (values != slots.values)
            changes.append(Change(slots, values, is_changed))
        return changes

    def _new_normals(self, vertices: Floats) -> Sequence[tuple[Floats, Flags]]:
        """What ``Layout.renew_normals`` makes of new vertices (n, 3).

        Remembered for the last positions, which writing and checking ask for in turn.
        """
        key = hashlib.sha256(np.ascontiguousarray(vertices).data).digest()
        if self._last_normals[0] != key:
            renew = self._layout.renew_normals or self._renew_normals
            self._last_normals = key, list(renew(self.vertices, vertices))
        return self._last_normals[1]

    def _dependent_texts(self, vertices: Floats, shift: Shift) -> Iterator[tuple[Dependent, bytes]]:
        """What depends on positions, and the bytes that it should have."""
        if not self._layout.dependents:
            return
        positions = self._to_file(vertices)
        for dependent in self._layout.dependents:
            old = bytes(memoryview(self._data)[dependent.start : dependent.stop])
            yield dependent, dependent.text(old, positions, shift)

    def _to_file(self, vertices: Floats) -> list[Floats]:
        """New positions of each array, unmoved rows exactly as they are stored."""
        layout = self._layout
        if len(layout.positions) == 1 and not layout.frames:
            return [vertices]
        stored = [slots.values for slots in layout.positions]
        rows = np.split(vertices, np.cumsum([len(slots) for slots in stored])[:-1])
        if not layout.frames:
            return rows
        result = []
        for new, own, frame in zip(rows, stored, layout.frames, strict=True):
            is_moved = (new != transform(own, frame)).any(axis=1)
            back = transform(new, np.linalg.inv(frame).astype(np.float64))
            result.append(np.where(is_moved[:, None], back, own))
        return result

    def _renew_normals(self, old: Floats, new: Floats) -> list[tuple[Floats, Flags]]:
        """The normals of each array, those of faces that did not move as they are stored, and
        which rows changed."""
        from msal_cli.kernels.geometry import regroup_normals

        arrays = [slots.values for slots in self._layout.normals]
        normals = np.concatenate(arrays) if len(arrays) > 1 else arrays[0]
        normals, rows = regroup_normals(old, new, self.faces, self.faces, normals)
        cuts = np.cumsum([len(array) for array in arrays])[:-1]
        return list(zip(np.split(normals, cuts), np.split(rows, cuts), strict=True))


def require_shape(vertices: Floats, old: Floats) -> None:
    if vertices.shape != old.shape or vertices.dtype != np.float64:
        raise InternalError(
            f"positions of shape {vertices.shape} and type {vertices.dtype} for a file with "
            f"{len(old)} vertices"
        )


def require_finite_result(vertices: Floats) -> None:
    # Infinity and what is no number show in the sum of the extremes.
    if not math.isfinite(float(vertices.max()) + float(vertices.min())):
        raise InternalError("a new position is not finite")


def _patches(changes: Sequence[Change]) -> list[Patch]:
    """The changes where all are statements, else none.

    New numbers have the decimals of their own lines where that is possible for all arrays, else the
    same ones in each array.
    """
    patches, has_own = [], True
    for slots, values, _ in changes:
        if not isinstance(slots, Statements) or slots.has_whole_numbers:
            return []
        new = np.require(values, np.float64, ("C", "W"))
        decimals = slots.row_decimals(values)
        has_own = has_own and decimals is not None
        patches.append(Patch(slots, new, slots.used if decimals is None else decimals))
    if has_own and not is_interleaved(patches):
        return patches
    if any(patch.slots.whole_rows for patch in patches):
        return []
    return [
        patch._replace(decimals=np.full(len(patch.values), patch.slots.decimals, dtype=np.uint8))
        for patch in patches
    ]


def _span(dependent: Dependent) -> tuple[Longs, Longs]:
    return np.array([dependent.start]), np.array([dependent.stop])


def _shift(growths: Iterable[tuple[Longs, Longs]]) -> Shift:
    """What growth of units makes of places; each item is the ends of units and by how many bytes
    they grow."""
    pairs = list(growths)
    stops = np.concatenate([_NONE, *(pair[0] for pair in pairs)])
    growth = np.concatenate([_NONE, *(pair[1] for pair in pairs)])
    return lambda at: int(growth[stops <= at].sum())


def _in_order(pieces: list[tuple[Longs, Longs]]) -> tuple[Longs, Longs]:
    starts = np.concatenate([_NONE, *(piece[0] for piece in pieces)])
    stops = np.concatenate([_NONE, *(piece[1] for piece in pieces)])
    if (starts[1:] > starts[:-1]).all():
        return starts, stops
    order = np.argsort(starts, kind="stable")
    return starts[order], stops[order]
