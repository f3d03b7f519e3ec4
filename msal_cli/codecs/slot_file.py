"""Files of which a codec has found where positions and normals lie: these alone are replaced.

The formats' own modules (``ply``, ``off``, ``vtk`` ...) parse a file into a ``Layout``; replacing,
checking, ranges and normals are the same for all of them and are here.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from msal_cli.arrays import Bytes, Flags, Floats, Ints
from msal_cli.codecs.mesh_file import Layout, cut_polygons, require_finite, transform
from msal_cli.codecs.slots import (
    Change,
    RecordSlots,
    check_overwritten,
    overwrite,
    require_range,
)
from msal_cli.codecs.text_slots import (
    Patch,
    TextSlots,
    plan_patches,
    replace_statements,
    require_replaced,
)
from msal_cli.codecs.tokens import require_indices
from msal_cli.errors import ContentError, InternalError, UnsupportedError
from msal_cli.kernels.text import as_bytes
from msal_cli.storage.regular import Buffer

_NORMAL_SLACK = 1e-5
"""How far the length of a new normal may be from one."""


class SlotFile:
    """An opened file; see ``mesh_file.MeshFile`` for the attributes.

    Raises ContentError (``E_NO_FACES``, ``E_NONFINITE``, ``E_INDEX``) for a layout that is no
    mesh.
    """

    merged_vertices = 0

    def __init__(self, data: Buffer, format: str, layout: Layout) -> None:
        self.format = format
        self._data = data
        self._layout = layout
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
        return self._write(changes, vertices)

    def _write(self, changes: Sequence[Change], vertices: Floats) -> Buffer:
        data = as_bytes(self._data)
        if self._is_binary:
            return overwrite(data, changes)
        return replace_statements(data, self._plan_patches(changes))

    def _plan_patches(self, changes: Sequence[Change]) -> list[Patch]:
        return plan_patches(changes)

    def _require_ranges(self, changes: Sequence[Change]) -> None:
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
        for slots, values, is_changed in changes:
            if isinstance(slots, TextSlots) and slots.unit_length:
                require_unit_length(values, np.asarray(is_changed.any(axis=1)))
        self._compare(as_bytes(output), changes, vertices)

    def _compare(self, result: Bytes, changes: Sequence[Change], vertices: Floats) -> None:
        """Raise InternalError unless ``result`` is what ``_write`` makes of these changes."""
        data = as_bytes(self._data)
        if self._is_binary or not changes:
            check_overwritten(data, result, changes)
        else:
            require_replaced(data, result, self._plan_patches(changes))

    @property
    def _is_binary(self) -> bool:
        """Whether all numbers are overwritten in place."""
        return all(isinstance(slots, RecordSlots) for slots in self._layout.positions)

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
                rounded = slots.rounded(values)
                if rounded is not values:
                    values, is_changed = rounded, is_changed & (rounded != slots.values)
            changes.append(Change(slots, values, is_changed))
        changes += self._changed_normals(vertices)
        return [change for change in changes if change.is_changed.any()]

    def _changed_normals(self, vertices: Floats) -> list[Change]:
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


def require_unit_length(normals: Floats, is_new: Flags) -> None:
    """Raise InternalError where a new normal (n, 3) is not of length one."""
    with np.errstate(over="ignore", invalid="ignore"):
        lengths = np.sqrt((normals * normals).sum(axis=1))
    is_wrong = ~(np.abs(lengths - 1.0) <= _NORMAL_SLACK) & is_new
    if is_wrong.any():
        where = f"normal {np.argmax(is_wrong) + 1}"
        raise InternalError("a new normal is not of unit length", where=where)
