"""An opened mesh file: a mesh that can be written back with new positions.

The modules of formats (``ply``, ``off``, ``vtk`` ...) parse a file into a ``Layout``: positions,
faces, and their places in the file.  ``MeshFile`` keeps the original bytes, and replaces positions
(and normals, if the file has some) in a copy.  Replacing, checking, ranges and normals are the same
for all formats and are here.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Flags, Floats, Ints, Longs
from msal_cli.codecs import text_slots
from msal_cli.codecs.slots import (
    Change,
    RecordSlots,
    Slots,
    check_overwritten,
    overwrite,
    require_range,
)
from msal_cli.errors import InternalError, UnsupportedError, format_count, no_faces, not_finite
from msal_cli.kernels.text import as_bytes
from msal_cli.light_dataclass import dataclass, field
from msal_cli.storage.regular import Buffer


@dataclass(frozen=True, eq=False)
class Companion:
    """A file that an output needs in its folder: the relative path, with slashes, and the bytes."""

    name: str
    data: Buffer


@dataclass(frozen=True, eq=False)
class SurfaceColours:
    """Colours (n, 3) of the vertices, None if there are none to show, and notes about them."""

    vertices: NDArray[np.uint8] | None = None
    notes: tuple[str, ...] = ()


@dataclass(eq=False)
class Surface:
    """A mesh to denoise or compare: a mesh file, several as one, or a mesh in memory."""

    # (n, 3) float64, file units, in file order, exactly the values that the file stores
    vertices: Floats
    # (m, 3) int32, indices into ``vertices``, counter-clockwise seen from outside; polygons are cut
    # into triangles and strips are unrolled, for the computation only
    faces: Ints
    # vertices of the file that ``vertices`` lacks because an earlier one is at the same position,
    # such as corners of STL's facets; then no two of ``vertices`` are equal
    merged_vertices: int = 0
    # of the vertices, if they were read for pictures
    colours: SurfaceColours | None = None
    grid: Ints | None = None  # the samples (rows, columns) of a range grid that the faces join
    unit: str | None = None  # that of the positions, such as "mm", if the file states one

    @property
    def n_corners(self) -> int | None:
        """Corners in a file that has no vertices of its own (STL), else None."""
        n_merged = self.merged_vertices
        return len(self.vertices) + n_merged if n_merged else None

    def has_same_grid(self, other: Surface) -> bool:
        """Whether both are range grids of the same samples.

        Then their vertices correspond, even if their triangles, which depend on positions, differ.
        """
        own, others = self.grid, other.grid
        return own is not None and others is not None and np.array_equal(own, others)

    def has_same_faces(self, other: Surface) -> bool:
        """Whether the vertices of both correspond one to one."""
        return self.has_same_grid(other) or (
            len(self.vertices) == len(other.vertices) and np.array_equal(self.faces, other.faces)
        )

    def forget_vertices(self) -> None:
        """Free ``vertices`` if they can be read again quickly."""

    def as_stored(self, vertices: Floats) -> Floats:
        """New positions (n, 3) rounded to the number types of this surface; the same array if
        rounding changes nothing."""
        return vertices

    def vertex_property(self, name: str) -> Floats:
        """A property of the vertices (n,).  InputError (``E_PROPERTY``), with a hint that lists the
        properties, if it is missing; UnsupportedError for a format without properties."""
        raise NotImplementedError


PLACEMENT = "placement in the scene"
"""The property of a scene whose only mesh is denoised in its own frame, while the scene rotates,
scales or shifts it."""


def is_usable(frame: Floats) -> bool:
    """Whether positions can be transformed by a frame and back without loss."""
    try:
        with np.errstate(all="ignore"):
            is_steep = not np.linalg.cond(frame[:3, :3]) < 1e6
    except np.linalg.LinAlgError:
        return False
    # Larger entries could make float32 positions too large for computations.
    return not is_steep and bool(np.abs(frame).max() < 1e30)


def is_placed(frame: Floats) -> bool:
    """Whether a frame is not the identity."""
    return not np.array_equal(frame, np.eye(4))


def keep_winding(faces: Ints | Longs, frame: Floats) -> Ints | Longs:
    """Triangles (m, 3) whose normals point to the same side of the surface after the frame: if it
    mirrors, the order of corners is reversed."""
    return faces[:, [0, 2, 1]] if np.linalg.det(frame[:3, :3]) < 0.0 else faces


def transform(points: Floats, frame: Floats) -> Floats:
    """Points (n, 3) after a transform; bit for bit the same for the identity.

    Results that are too large become infinite.
    """
    if not is_placed(frame):
        return points
    with np.errstate(over="ignore", invalid="ignore"):
        result: Floats = points @ frame[:3, :3].T + frame[:3, 3]
    return result


_NONE = np.empty(0, dtype=np.int64)


@dataclass(eq=False)
class Layout:
    """A file as its parser describes it."""

    encoding: str  # encoding, precision: as in ``MeshFile``
    precision: str
    # arrays of positions (n_i, 3), which concatenated are the vertices; ``RecordSlots`` in binary
    # files
    positions: tuple[Slots, ...]
    # (c,) int64, the vertices of all surface polygons, one polygon after another
    corners: Longs | Ints = field(default_factory=lambda: _NONE)
    # (p,) int64, the number of corners of each polygon, at least 3
    sizes: Longs | Ints = field(default_factory=lambda: _NONE)
    # arrays of normals (g_i, 3); by default they have one for each vertex
    normals: tuple[Slots, ...] = ()
    # for each array of positions, its transform (4, 4) to the vertices; empty if all are identities
    frames: tuple[Floats, ...] = ()
    properties: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    references: tuple[str, ...] = ()
    held: str = ""  # what the file has besides points, for the message if it has no surface
    # (m, 3) int32, the triangles, if the parser has made them and checked them and the positions;
    # then ``corners`` and ``sizes`` are for the codec only, empty if all polygons are triangles
    faces: Ints | None = None
    # (n, 3), if the parser has read them; the file takes them over
    vertices: Floats | None = None
    # (k,) result of ``find_unplaced``, for one array of positions; outside the file these vertices
    # are at a corner of the first face
    unplaced: Longs = field(default_factory=lambda: _NONE)
    # computes from the old and the new vertices each array of normals (g_i, 3), and which rows
    # changed (g_i,); None for the default, which does not support ``frames``
    renew_normals: Callable[[Floats, Floats], Sequence[tuple[Floats, Flags]]] | None = None


def find_unplaced(
    vertices: NDArray[Any], corners: Ints | Longs, where: Callable[[int], str] = "vertex {}".format
) -> Longs:
    """The vertices (k,) whose positions, of (n, 3), are NaN or infinite: samples that an organized
    point cloud lacks.

    Raises ContentError (``E_NONFINITE``) if one is among the ``corners`` of the faces; ``where``
    gives the place of a vertex as text.
    """
    # Fast path: a finite sum proves that all are finite (otherwise it may have overflowed).
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(vertices.sum()):
            return _NONE
    unplaced = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(used := unplaced[np.isin(unplaced, corners)]):
        vertex = int(used[0])
        raise not_finite(
            f"vertex {vertex} has a coordinate that is not a finite number", where(vertex)
        )
    return unplaced


def cut_polygons(corners: Ints, sizes: Ints | Longs) -> Ints:
    """Triangles (m, 3) that share each polygon's first corner; a view if all are triangles.

    ``corners`` (c,) are those of the polygons, concatenated, ``sizes`` (p,) their numbers of
    corners; a polygon with fewer than three gives no triangle.
    """
    if len(corners) == 3 * len(sizes) and bool((sizes == 3).all()):
        return corners.reshape(-1, 3)
    from msal_cli.kernels import ply_scan

    triangles = np.empty((int(np.maximum(sizes - 2, 0).sum()), 3), dtype=np.int32)
    ply_scan.fans(corners, np.ascontiguousarray(sizes), triangles)
    return triangles


class MeshFile(Surface):
    """An opened mesh file; every codec returns one.

    Attributes
    ----------
    format : the suffix of its format, such as ``"ply"``.
    encoding : ``"ascii"``, ``"binary_little_endian"``, ``"binary_big_endian"`` or ``"binary"``.
    precision : ``"float32"``, ``"float64"``, ``"text"`` or ``"integer"``: how positions are stored.
    n_polygons : faces as the file counts them (a quad is one).
    properties : what else is kept unchanged, for reports: ``"vertex.quality float"``,
        ``"element camera"``, ``"texture coordinates"``, ``"materials"``, ``"groups"`` ...
    references : other files that this one refers to (materials, textures), as written in the file.
    warnings : problems of the file that did not prevent reading it; ``"THING, kept"`` names what
        no property does, and no other format stores.
    sources : other files that its mesh was read from.

    Raises ContentError (``E_NO_FACES``, ``E_NONFINITE``, ``E_INDEX``) for a layout that is not a
    mesh.
    """

    sources: tuple[str, ...] = ()

    def __init__(self, data: Buffer, format: str, layout: Layout) -> None:
        self.format = format
        # The bytes that the layout describes; a format may pack them into the file, ``data``.
        self.data = self._data = data
        self._layout = layout
        self.encoding, self.precision = layout.encoding, layout.precision
        self._vertices, layout.vertices = layout.vertices, None
        self._last_normals: tuple[bytes, Sequence[tuple[Floats, Flags]]] = (b"", ())
        faces = layout.faces
        if faces is None:
            if not len(layout.sizes):
                points = format_count(len(self.vertices), "point")
                held = ", ".join(filter(None, (points, layout.held)))
                raise no_faces(
                    f"the file has no surface faces; it holds {held}",
                    hint="msal denoises surfaces: make one of these points or cells first",
                )
            corners = layout.corners.astype(np.int64, copy=False)
            is_single = len(layout.positions) == 1 and not layout.frames
            layout.unplaced = find_unplaced(
                self.vertices, corners if is_single else np.arange(len(self.vertices))
            )
            text_slots.require_indices(corners, len(self.vertices))
            faces = cut_polygons(corners.astype(np.int32), layout.sizes)
        self.faces = faces
        self.n_polygons = len(layout.sizes) or len(self.faces)
        self.properties = layout.properties
        self.references = layout.references
        self.warnings = layout.warnings
        if len(layout.unplaced):
            points = format_count(len(layout.unplaced), "vertex")
            self.warnings += (f"{points} without a finite position, used by no face: kept",)
            self.forget_vertices()

    @property
    def vertices(self) -> Floats:  # type: ignore[override]
        """The positions (n, 3)."""
        if self._vertices is None:
            arrays = [slots.values for slots in self._layout.positions]
            if frames := self._layout.frames:
                arrays = [transform(*pair) for pair in zip(arrays, frames, strict=True)]
            self._vertices = arrays[0] if len(arrays) == 1 else np.concatenate(arrays)
            if len(unplaced := self._layout.unplaced):
                # A place on the mesh, so that its extent stays.
                self._vertices[unplaced] = self._vertices[self.faces[0, 0]]
        return self._vertices

    def with_unplaced(self, vertices: Floats) -> Floats:
        """``vertices`` (n, 3), with the stored numbers of those without a finite position, or NaN
        where a text, whose values are kept, has that corner now."""
        if len(which := self._layout.unplaced):
            stored = self._layout.positions[0].values[which]
            vertices = vertices.copy()
            is_finite = np.isfinite(stored).all(axis=1, keepdims=True)
            vertices[which] = np.where(is_finite, np.nan, stored)
        return vertices

    def things_kept(self) -> list[str]:
        """What the warnings name that no property does, and no other format stores."""
        return [text.split(", kept")[0] for text in self.warnings if ", kept" in text]

    def losses_by_encoding(self) -> list[str]:
        """What a change between ascii and binary loses."""
        return [thing for thing in self.things_kept() if " behind the last " in thing]

    def forget_vertices(self) -> None:
        # A layout of text keeps its values; others are read again.
        self._vertices = None

    def vertex_property(self, name: str) -> Floats:
        raise UnsupportedError(
            f"vertex properties such as {name!r} are read from PLY, not from {self.format.upper()}",
            hint="give a PLY, or leave out for this file what names a property",
        )

    def as_stored(self, vertices: Floats) -> Floats:
        rows, frames = self._to_file(vertices), self._layout.frames
        pairs = zip(self._layout.positions, rows, strict=True)
        arrays = [slots.rounded(own) for slots, own in pairs]
        if all(new is old for new, old in zip(arrays, rows, strict=True)):
            return vertices
        if frames:
            arrays = [transform(*pair) for pair in zip(arrays, frames, strict=True)]
        return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)

    def beside(
        self, output: Buffer, vertices: Floats, path: str | None
    ) -> tuple[Buffer, tuple[Companion, ...]]:
        """``output``, made for ``vertices`` (n, 3), in its final form for ``path`` (None for a
        stream), and the files that it needs in its folder."""
        return output, ()

    def polygons(self) -> tuple[Longs | Ints, Longs]:
        """The faces of the file: the corners (c,) of all, and how many each has (p,)."""
        corners, sizes = self._layout.corners, self._layout.sizes
        if not len(sizes):
            return self.faces.reshape(-1), np.full(len(self.faces), 3, dtype=np.int64)
        return corners, sizes.astype(np.int64, copy=False)

    def replaced(self, vertices: Floats) -> Buffer:
        """The file with the positions (n, 3) that moved, and their normals, replaced.

        A vertex equal to the stored one keeps its bytes; if none moved, the result is the input,
        byte for byte.  New numbers in text have as many decimals as their own line or the file
        usually has, or as 1e-7 of its extent needs, whichever is more.  Raises ContentError
        (``E_RANGE``) for a position that does not fit the file's number type.
        """
        data = self.replaced_data(vertices)
        return self.data if data is self._data else self._pack(data)

    def replaced_data(self, vertices: Floats) -> Buffer:
        """The bytes that the layout describes, with other positions (n, 3)."""
        changes = self._changes(vertices)
        if not changes:
            return self._data
        self._require_ranges(changes)
        require_finite_result(vertices)
        return self._write(changes, vertices)

    def _pack(self, data: Buffer) -> Buffer:
        """The file with other ``data``."""
        return data

    def _write(self, changes: Sequence[Change], vertices: Floats) -> Buffer:
        data = as_bytes(self._data)
        if self._is_binary:
            return overwrite(data, changes)
        return text_slots.replace_statements(data, self._plan_patches(changes))

    def _plan_patches(self, changes: Sequence[Change]) -> list[text_slots.Patch]:
        return text_slots.plan_patches(changes)

    def _require_ranges(self, changes: Sequence[Change]) -> None:
        for slots, values, is_changed in changes:
            if slots in self._layout.positions and slots.codes:
                require_range(values, is_changed, slots.codes)

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        """The file with ``vertices`` (n, 3); its encoding and its precision cannot be changed.

        Raises UnsupportedError for another encoding or precision than the file has.
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
        """Raise InternalError unless ``output`` is this file with only positions (and normals)
        replaced by ``vertices``, up to the rounding of the file's number type."""
        changes = self._changes(vertices)
        require_finite_result(vertices)
        for slots, values, is_changed in changes:
            if isinstance(slots, text_slots.TextSlots) and slots.unit_length:
                require_unit_length(values, np.asarray(is_changed.any(axis=1)))
        self._compare(as_bytes(output), changes, vertices)

    def _compare(self, result: Bytes, changes: Sequence[Change], vertices: Floats) -> None:
        """Raise InternalError unless ``result`` is what ``_write`` makes for these changes."""
        data = as_bytes(self._data)
        if self._is_binary or not changes:
            check_overwritten(data, result, changes)
        else:
            text_slots.require_replaced(data, result, self._plan_patches(changes))

    @property
    def _is_binary(self) -> bool:
        """Whether all numbers are overwritten in place."""
        return all(isinstance(slots, RecordSlots) for slots in self._layout.positions)

    def _changes(self, vertices: Floats) -> list[Change]:
        """The arrays that change; empty if no vertex moves."""
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
            if isinstance(slots, text_slots.TextSlots):
                rounded = slots.rounded(values)
                if rounded is not values:
                    values, is_changed = rounded, is_changed & (rounded != slots.values)
            changes.append(Change(slots, values, is_changed))
        changes += self._changed_normals(vertices)
        return [change for change in changes if change.is_changed.any()]

    def _changed_normals(self, vertices: Floats) -> list[Change]:
        if not self._layout.normals:
            return []
        # The last ones are cached, because writing and checking need the same.
        key = hashlib.sha256(np.ascontiguousarray(vertices).data).digest()
        if self._last_normals[0] != key:
            renew = self._layout.renew_normals or self._renew_normals
            self._last_normals = key, list(renew(self.vertices, vertices))
        changes = []
        for slots, (values, rows) in zip(self._layout.normals, self._last_normals[1], strict=True):
            is_changed = np.broadcast_to(rows[:, None], values.shape)
            if not slots.whole_rows:
                is_changed = is_changed & (values != slots.values) & ~np.isnan(slots.values)
            elif isinstance(slots, text_slots.TextSlots):
                # An unchanged number keeps its spelling, such as -0.
                is_changed = is_changed & (values != slots.values)
            changes.append(Change(slots, values, is_changed))
        return changes

    def _to_file(self, vertices: Floats) -> list[Floats]:
        """New positions for each array; rows that did not move are exactly as stored."""
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
        """The normals of each array, as stored for faces that did not move, and which rows
        changed."""
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
    # The sum of the extremes is not finite if any position is infinite or NaN.
    if not math.isfinite(float(vertices.max()) + float(vertices.min())):
        raise InternalError("a new position is not finite")


def require_unit_length(normals: Floats, is_new: Flags) -> None:
    """Raise InternalError if a new normal (n, 3) is not of unit length."""
    with np.errstate(over="ignore", invalid="ignore"):
        lengths = np.sqrt((normals * normals).sum(axis=1))
    is_wrong = ~(np.abs(lengths - 1.0) <= 1e-5) & is_new
    if is_wrong.any():
        where = f"normal {np.argmax(is_wrong) + 1}"
        raise InternalError("a new normal is not of unit length", where=where)
