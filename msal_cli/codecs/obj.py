"""OBJ files: positions and normals replaced inside the original bytes.

Read are ``v`` (x y z, with w or a colour behind), ``vn`` and ``f`` in every form (v, v/vt, v//vn,
v/vt/vn, negative numbers, polygons, continued lines; ``fo`` of early versions is the same), with
blanks or tabs, LF, CR LF or CR.  Everything else is kept without being looked into: texture
coordinates, groups, materials, lines, points, curves, surfaces, comments.  Vertices that only
lines, points or curves use belong to no face and stay where they are.

Where readers differ, this one does what the better ones do:

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
import math
from dataclasses import dataclass, field

import numpy as np

from msal_cli.arrays import Flags, Floats
from msal_cli.codecs import obj_description
from msal_cli.codecs.decimals import SHORTEST, SHORTEST_SINGLE, extent_decimals, usual_decimals
from msal_cli.codecs.layout import Layout
from msal_cli.codecs.obj_content import Content
from msal_cli.codecs.obj_parser import parse_content
from msal_cli.codecs.slot_file import Change, SlotFile, require_finite_result
from msal_cli.codecs.slots import line_of, require_range
from msal_cli.codecs.text_slots import Patch, Statements, replace_statements
from msal_cli.errors import UnsupportedError
from msal_cli.storage.buffers import Buffer

MISFIT_DEG = 30.0
"""Angle between a face and its ``vn`` from which on it is warned that the vn does not fit."""

NO_LIMIT = 99
"""Digits of a normal that a file may ask for."""


def read(data: Buffer, name: str) -> ObjFile:
    """Open the OBJ file ``data`` (its bytes); ``name`` is there for all codecs alike.

    Raises FormatError (binary data, a word that is no number, a statement that is too short),
    TruncatedError (empty, or the last line breaks off), ContentError (``E_NONFINITE``,
    ``E_INDEX``, ``E_NO_FACES``) and TooLargeError, each with the line.
    """
    return ObjFile(data)


@dataclass(eq=False)
class _ObjLayout(Layout):
    content: Content = field(kw_only=True)


def _parse_layout(data: Buffer) -> _ObjLayout:
    from msal_cli.kernels.text import as_bytes

    content = parse_content(data)
    buf = as_bytes(data)
    normals: tuple[Statements, ...] = ()
    if content.face_normals is not None:
        at, used = content.normal_at, content.normal_decimals
        normal = Statements(
            buf, at, used, 2, values=content.normals, unit_length=True, significant=NO_LIMIT
        )
        normals = (normal,)
    return _ObjLayout(
        "ascii",
        "text",
        (_Positions(buf, content.vertex_at, content.decimals, 1, values=content.vertices),),
        content.corners,
        content.sizes,
        faces=content.faces,
        normals=normals,
        renew_normals=functools.partial(_renew_normals, content),
        properties=obj_description.properties(content.state, content.keywords),
        references=obj_description.references(data, content.libraries),
        warnings=obj_description.warnings(
            content.state, content.keywords, functools.partial(line_of, data)
        ),
        content=content,
    )


def _renew_normals(content: Content, old: Floats, new: Floats) -> list[tuple[Floats, Flags]]:
    from msal_cli.kernels.geometry import regrouped_normals

    assert content.face_normals is not None
    return [regrouped_normals(old, new, content.faces, content.face_normals, content.normals)]


class ObjFile(SlotFile):
    """An opened OBJ file; see ``mesh_file.MeshFile`` for the attributes."""

    def __init__(self, data: Buffer) -> None:
        super().__init__(data, "obj", _parse_layout)

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        """The file with every position (n, 3) written in a precision.

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
        style, code = (SHORTEST_SINGLE, "<f4") if precision == "float32" else (SHORTEST, "<f8")
        positions = self._layout.positions[0]
        changes = [one for one in self._changes(vertices) if one.slots is not positions]
        require_finite_result(vertices)
        is_all = np.broadcast_to(True, vertices.shape)
        require_range(vertices, is_all, (code,) * 3, first=1)
        patches = []
        for slots, values, is_changed in (Change(positions, vertices, is_all), *changes):
            assert isinstance(slots, Statements)
            styles = np.full(len(values), style, dtype=np.uint8)
            values = values.astype(code).astype(np.float64, order="C", copy=False)
            patches.append(Patch(slots, values, styles, is_changed))
        return replace_statements(patches[0].slots.data, patches)

    def normal_warnings(self, vertices: Floats) -> tuple[str, ...]:
        """A warning where ``vn`` that several places share cannot fit with the vertices (n, 3)."""
        assert isinstance(self._layout, _ObjLayout)
        parsed = self._layout.content
        if parsed.face_normals is None:
            return ()
        from msal_cli.kernels.shared_normals import find_misfits, find_users

        users = find_users(parsed.vertices, parsed.faces, parsed.face_normals, len(parsed.normals))
        if users is None:
            return ()
        [(normals, _)] = self._new_normals(vertices)
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
        return (
            obj_description.misfit_warning(n_normals, before, after, len(parsed.sizes), MISFIT_DEG),
        )


@dataclass(eq=False)
class _Positions(Statements):
    """The positions of an OBJ file."""

    @functools.cached_property
    def decimals(self) -> int:
        """Decimals of new numbers: as many as are usual, or as the extent asks for."""
        return position_decimals(usual_decimals(self.used), self.values)


def position_decimals(usual: int, values: Floats) -> int:
    """Decimals of new positions where ``usual`` ones are known; of ``values`` (n, 3) only the
    extremes count."""
    from msal_cli.kernels.numbers import FIXED_BELOW, MOST_DECIMALS

    needed = extent_decimals(values) or 0
    largest = max(float(values.max()), -float(values.min()))
    if needed > MOST_DECIMALS or largest >= FIXED_BELOW:
        return SHORTEST
    return max(min(usual, MOST_DECIMALS), needed)
