"""OBJ files: positions and normals replaced inside the original bytes.

Read are ``v`` (x y z, with w or a colour behind), ``vn`` and ``f`` in every form (v, v/vt, v//vn,
v/vt/vn, negative numbers, polygons, continued lines; ``fo`` of early versions is the same), with
blanks or tabs, LF, CR LF or CR.  Everything else is kept without being looked into: texture
coordinates, groups, materials, lines, points, curves, surfaces, comments.  Vertices that only
lines, points or curves use belong to no face and stay where they are.

Settled where readers differ, after what the better ones do:

- keywords are small letters, as in Assimp, Blender, MeshLab and tinyobjloader: ``V`` and ``F`` are
  kept as unknown lines, with a warning, and a file with no others has no faces;
- a face of one or two corners is kept in the file, left out of the mesh and warned of (Blender,
  tinyobjloader); a face that names no vertex at all is an error;
- a wrong vertex number is an error; a wrong vt or vn number cannot harm positions: a warning;
- a position's w is kept and otherwise ignored;
- a comment is not continued by a backslash at its end.
"""

from __future__ import annotations

import functools
import hashlib
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats
from msal_cli.codecs import obj_description as obj_words
from msal_cli.codecs import text_slots_old as plain_text
from msal_cli.codecs.obj_parser import Content, content
from msal_cli.errors import ContentError, InternalError, UnsupportedError
from msal_cli.storage.buffers import Buffer

NORMAL_DECIMALS = 6
"""Decimals that a recomputed unit normal has at the least."""

SHORTEST_DOUBLE, SHORTEST_SINGLE = 18, 19
"""In place of a number of decimals: the shortest text that is read back as the same number."""

_NORMAL_SLACK = 1e-5
"""How far the length of a recomputed normal may be from 1 once it is rounded for the file."""

_FAR_FINER = 1e-7
"""Of the bounding box's diagonal: positions are written at least this finely."""


MISFIT_DEG = 30.0
"""Angle between a face and its ``vn`` from which on it is warned that the vn does not fit."""


def read(data: Buffer, name: str) -> ObjFile:
    """Open the OBJ file ``data`` (its bytes); ``name`` is there for all codecs alike.

    Raises FormatError (binary data, a word that is no number, a statement that is too short),
    TruncatedError (empty, or the last line breaks off), ContentError (``E_NONFINITE``,
    ``E_INDEX``, ``E_NO_FACES``) and TooLargeError, each with the line.
    """
    return ObjFile(data)


class ObjFile:
    """An opened OBJ file; see ``base.MeshFile`` for the attributes."""

    format = "obj"
    encoding = "ascii"
    precision = "text"
    merged_vertices = 0

    def __init__(self, data: Buffer) -> None:
        self._data = data
        self._content: Content = content(data)
        self.vertices = self._content.vertices
        self.faces = self._content.faces
        self.n_polygons = len(self._content.sizes)
        self.properties = obj_words.properties(self._content)
        self.references = obj_words.references(data, self._content)
        self.warnings = obj_words.warnings(data, self._content)
        self._last_normals: tuple[bytes, Floats] = (b"", self._content.normals)

    def polygons(self) -> list[Any] | NDArray[np.int32]:
        """The faces as the file has them: (m, k) int32 if all have k corners, else m arrays."""
        corners, sizes = self._content.corners, self._content.sizes
        if (sizes == sizes[0]).all():
            return corners.reshape(-1, int(sizes[0]))
        return np.split(corners, np.cumsum(sizes[:-1], dtype=np.int64))

    def forget_vertices(self) -> None:
        """Do nothing: to read them again takes long."""

    def replaced(self, vertices: Floats) -> Buffer:
        """The file with the coordinates that differ from the stored ones replaced.

        ``vertices`` is (n, 3) in file order.  New positions have as many decimals as their own
        line has, as the file usually has, or as 1e-7 of its extent asks for, whichever is most;
        the normals of faces that moved are recomputed.
        With nothing moved the result is the input itself.  Raises InternalError for an array of
        another shape or with values that are not finite.
        """
        vertices = self._accepted(vertices)
        if np.array_equal(vertices, self.vertices):
            return self._data
        plainly = self._statements(vertices)
        if plainly is not None:
            from msal_cli.kernels.text import as_bytes

            output = plain_text.patched(as_bytes(self._data), plainly)
            if output is not None:
                return output
        return self._patched(vertices, self._decimals, self._normal_decimals, False)

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        """The file with every position written in a precision.

        ``encoding`` is ``same`` or ``ascii``; ``binary`` raises UnsupportedError.  ``precision``
        ``float32`` or ``float64`` writes each number as the shortest text that is read back as
        the same number of that type; ``same`` is ``replaced``.  Raises ContentError
        (``E_RANGE``) for a position beyond float32.
        """
        if encoding == "binary":
            raise UnsupportedError(
                "OBJ is text; it has no binary encoding",
                hint="leave --encoding away, or write PLY with --to ply --encoding binary",
            )
        if precision == "same":
            return self.replaced(vertices)
        vertices = self._accepted(vertices)
        style = SHORTEST_SINGLE if precision == "float32" else SHORTEST_DOUBLE
        if precision == "float32":
            beyond = np.abs(vertices).max(axis=1) > float(np.finfo(np.float32).max)
            if beyond.any():
                raise ContentError(
                    "a position is too large for float32",
                    where=f"vertex {int(np.argmax(beyond)) + 1}",
                    hint="use --precision float64",
                    code="E_RANGE",
                )
        return self._patched(vertices, style, style, True)

    def check(self, output: Buffer, vertices: Floats) -> None:
        """Raise InternalError unless ``output`` is this file with only numbers of ``v`` and ``vn``
        replaced: positions by ``vertices`` within half a unit of the last decimal, unmoved ones
        in their very bytes, normals kept or of unit length."""
        from msal_cli.kernels import fast_patch as plain_patch
        from msal_cli.kernels.text import as_bytes

        vertices = self._accepted(vertices)
        plainly = self._statements(vertices)
        if plainly is not None:
            self._require_unit_length(plainly[1:])
            result, which, at = plain_text.compared(as_bytes(self._data), as_bytes(output), plainly)
            if result != plain_patch.ODD:
                self._require(
                    result != plain_patch.WRONG_VALUE,
                    result != plain_patch.DIFFERENT,
                    f"near {'normal' if which else 'vertex'} {at + 1}",
                )
                return
        self._check_any(as_bytes(output), vertices)

    @staticmethod
    def _require(is_right: bool, is_same: bool, where: str) -> None:
        if not is_right:
            raise InternalError("the output holds another number than it should", where=where)
        if not is_same:
            raise InternalError(
                "the output differs from the input in more than positions and normals", where=where
            )

    @staticmethod
    def _require_unit_length(groups: list[plain_text.Statements]) -> None:
        """Raise InternalError where a new normal is not of unit length."""
        for one in groups:
            lengths = np.sqrt((one.new * one.new).sum(axis=1))
            wrong = ~(np.abs(lengths - 1.0) <= _NORMAL_SLACK) & (one.new != one.old).any(axis=1)
            if wrong.any():
                raise InternalError(
                    "a new normal is not of unit length", where=f"normal {np.argmax(wrong) + 1}"
                )

    def _check_any(self, after: NDArray[np.uint8], vertices: Floats) -> None:
        """``check`` for numbers of every form."""
        from msal_cli.kernels import obj_patch
        from msal_cli.kernels.text import as_bytes

        parsed = self._content
        decimals = self._decimals
        exact = decimals == SHORTEST_DOUBLE
        tolerance = 0.0 if exact else 0.5 * 10.0**-decimals * (1.0 + 1e-9)
        has_moved = not np.array_equal(vertices, self.vertices)
        unit = _NORMAL_SLACK if has_moved and parsed.face_normals is not None else -1.0
        walk = np.zeros(obj_patch.N_WALK, dtype=np.int64)
        while True:
            result = obj_patch.compared(
                as_bytes(self._data),
                after,
                walk,
                parsed.vertex_at,
                parsed.vertices,
                vertices,
                tolerance,
                parsed.normal_at,
                unit,
            )
            vertex, axis = int(walk[obj_patch.VERTEX]), int(walk[obj_patch.AXIS])
            if result != obj_patch.ASIDE:
                break
            word = after[int(walk[obj_patch.BEGIN]) : int(walk[obj_patch.END])].tobytes()
            wanted = float(vertices[vertex, axis])
            if abs(float(word) - wanted) > tolerance + 4.5e-16 * abs(wanted):
                result = obj_patch.WRONG_VALUE
                break
            walk[obj_patch.AXIS] += 1
        self._require(
            result != obj_patch.WRONG_VALUE,
            result != obj_patch.DIFFERENT,
            f"near vertex {vertex + 1}",
        )

    def _accepted(self, vertices: Floats) -> Floats:
        """``vertices`` as the kernels take them."""
        if vertices.shape != self.vertices.shape:
            raise InternalError(
                f"positions of shape {vertices.shape} for a file with {len(self.vertices)} vertices"
            )
        # Infinity and what is no number show in the sum of the extremes.
        if not math.isfinite(float(vertices.max()) + float(vertices.min())):
            bad = int(np.argmin(np.isfinite(vertices).all(axis=1)))
            raise InternalError("a new position is not finite", where=f"vertex {bad + 1}")
        return np.ascontiguousarray(vertices, np.float64)

    def _statements(self, vertices: Floats) -> list[plain_text.Statements] | None:
        """What changes, where all numbers are plain: the positions, and perhaps the normals."""
        parsed = self._content
        largest = max(float(vertices.max()), -float(vertices.min()))
        decimals = plain_text.row_decimals(parsed.decimals, self._decimals, largest)
        if decimals is None:
            return None
        found = [plain_text.Statements(parsed.vertex_at, 1, parsed.vertices, vertices, decimals)]
        if parsed.face_normals is not None:
            own = np.zeros(len(parsed.normals), dtype=np.uint8)
            decimals = plain_text.row_decimals(own, self._normal_decimals, 1.0)
            if decimals is None:
                return None
            normals = self._new_normals(vertices)
            found.append(
                plain_text.Statements(parsed.normal_at, 2, parsed.normals, normals, decimals)
            )
        return found

    def _new_normals(self, vertices: Floats) -> Floats:
        """The normals (g, 3) that the file should have with its vertices there.

        Remembered for the last positions, which writing and checking ask for in turn.
        """
        from msal_cli.kernels.geometry import regrouped_normals

        parsed = self._content
        if parsed.face_normals is None:
            return parsed.normals
        key = hashlib.sha256(vertices.data).digest()
        if self._last_normals[0] != key:
            normals, _ = regrouped_normals(
                parsed.vertices, vertices, parsed.faces, parsed.face_normals, parsed.normals
            )
            self._last_normals = key, normals
        return self._last_normals[1]

    def normal_warnings(self, vertices: Floats) -> tuple[str, ...]:
        """A warning where ``vn`` that several places share cannot fit with the vertices (n, 3)."""
        parsed = self._content
        if parsed.face_normals is None:
            return ()
        from msal_cli.kernels.shared_normals import find_misfits, find_users

        users = find_users(parsed.vertices, parsed.faces, parsed.face_normals, len(parsed.normals))
        if users is None:
            return ()
        normals = self._new_normals(self._accepted(vertices))
        misfits = find_misfits(
            users,
            parsed.vertices,
            vertices,
            parsed.faces,
            parsed.normals,
            normals,
            math.radians(MISFIT_DEG),
        )
        face = np.repeat(np.arange(len(parsed.sizes)), parsed.sizes - 2)
        before = len(np.unique(face[misfits.faces_before]))
        after = len(np.unique(face[misfits.faces_after]))
        if after <= before:
            return ()
        n_normals = int(misfits.entries.sum())
        return (obj_words.misfit_warning(n_normals, before, after, len(parsed.sizes), MISFIT_DEG),)

    @functools.cached_property
    def _decimals(self) -> int:
        """Least decimals of new positions: as many as are usual, or as the extent asks for."""
        from msal_cli.kernels.digits import FIXED_BELOW, MOST_DECIMALS

        used = min(plain_text.usual_decimals(self._content.decimals), MOST_DECIMALS)
        # Column by column: numpy reduces the first of two axes slowly.
        low = np.array([self.vertices[:, axis].min() for axis in range(3)])
        high = np.array([self.vertices[:, axis].max() for axis in range(3)])
        extent = math.hypot(*(high * 0.5 - low * 0.5).tolist()) * 2.0
        step = extent * _FAR_FINER
        needed = math.ceil(-math.log10(step)) if 0.0 < step < math.inf else 0
        largest = max(float(np.abs(low).max()), float(np.abs(high).max()))
        if needed > MOST_DECIMALS or largest >= FIXED_BELOW:
            return SHORTEST_DOUBLE
        return max(used, needed)

    @functools.cached_property
    def _normal_decimals(self) -> int:
        """Decimals of new normals."""
        from msal_cli.kernels.digits import MOST_DECIMALS

        used = plain_text.usual_decimals(self._content.normal_decimals)
        return min(max(used, NORMAL_DECIMALS), MOST_DECIMALS)

    def _patched(
        self, vertices: Floats, decimals: int, normal_decimals: int, is_forced: bool
    ) -> memoryview:
        """The file with new numbers: every position if ``is_forced``, else those that differ."""
        from msal_cli.kernels.obj_patch import patched
        from msal_cli.kernels.text import as_bytes

        parsed = self._content
        buf = as_bytes(self._data)
        normals = self._new_normals(vertices)
        is_moved = np.ones(vertices.shape, dtype=bool) if is_forced else vertices != self.vertices
        is_turned = normals != parsed.normals
        text, stops = _texts(vertices[is_moved], decimals)
        normal_text, normal_stops = _texts(normals[is_turned], normal_decimals)
        # The words that go away are counted as empty: a little too long, cut off at the end.
        out = np.empty(len(buf) + len(text) + len(normal_text), dtype=np.uint8)
        size = patched(
            buf,
            parsed.vertex_at,
            is_moved,
            as_bytes(text),
            stops,
            parsed.normal_at,
            is_turned,
            as_bytes(normal_text),
            normal_stops,
            out,
        )
        return out[:size].data


def _texts(values: Floats, decimals: int) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """New texts, one behind the other, and where each ends."""
    from msal_cli.kernels.text import printed, printed_shortest

    if decimals in (SHORTEST_DOUBLE, SHORTEST_SINGLE):
        return printed_shortest(values, decimals == SHORTEST_SINGLE)
    return printed(values, decimals)
