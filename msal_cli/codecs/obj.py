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
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Flags, Floats, Ints, Longs
from msal_cli.codecs.detection import BYTE_ORDER_MARK
from msal_cli.codecs.mesh_file import Layout
from msal_cli.codecs.slot_file import Change, SlotFile, require_finite_result
from msal_cli.codecs.slots import require_range
from msal_cli.codecs.text_slots import (
    SHORTEST,
    SHORTEST_SINGLE,
    Patch,
    Statements,
    extent_decimals,
    line_of,
    number_hint,
    replace_statements,
    usual_decimals,
)
from msal_cli.errors import (
    ContentError,
    FormatError,
    InputError,
    TooLargeError,
    TruncatedError,
    UnsupportedError,
)
from msal_cli.storage.regular import Buffer

MISFIT_DEG = 30.0
"""Angle between a face and its ``vn`` from which on it is warned that the vn does not fit."""

_NO_LIMIT = 99
"""Digits of a normal that a file may ask for."""


Keywords = Mapping[bytes, tuple[int, int]]
"""Keywords other than v, vt, vn and f: how often each occurs, and where first.  Of the walk's
``state``, see ``kernels.obj_scan``, only counts are looked at."""

_T = TypeVar("_T", bound=np.generic)


_BEGUN = re.compile(rb"[-+.\deE/\\]*")
_WORD = re.compile(rb"(?:[ \t\v\f]|\\(?:\r\n?|\n))*+([^\s\\]*+(?:\\(?![\r\n])[^\s\\]*+)*+)")
_NUMBER = rb"([-+]?(?:\d{1,25}(?:\.\d{0,25})?|\.\d{1,25})(?:[eE][-+]?\d{1,3})?)"
_PLANE_POSITION = re.compile(rb"v" + 2 * (rb"[ \t]++" + _NUMBER) + rb"[ \t]*+(?=[\r\n#])")
_ALL = 1 << 62

_PROPERTY_OF = {
    b"usemtl": "materials",
    b"usemap": "texture maps",
    b"g": "groups",
    b"mg": "merging groups",
    b"o": "objects",
    b"s": "smoothing groups",
    b"l": "lines (vertices that only they use stay in place)",
    b"p": "points (vertices that only they use stay in place)",
}
_FREE_FORM = frozenset(
    b"vp cstype deg bmat step curv curv2 surf parm trim hole scrv sp end con"
    b" bzp bsp cdc cdp res".split()
)
_DISPLAY = frozenset(
    b"bevel c_interp d_interp lod maplib shadow_obj trace_obj ctech stech mtllib call csh".split()
)

_CONTINUED = re.compile(rb"\\(\r\n|\r|\n)")
_LIBRARY = re.compile(r"\S.*?\.mtl(?=\s|$)|\S.*", re.IGNORECASE)
_SHOWN = 3

_LOOKED_AT = 4096
_ZEROS_LOOKED_AT = 1 << 16
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]")


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
            buf, at, used, 2, values=content.normals, unit_length=True, significant=_NO_LIMIT
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
        properties=_name_properties(content.state, content.keywords),
        references=_find_references(data, content.libraries),
        warnings=_describe_warnings(
            content.state, content.keywords, functools.partial(line_of, data)
        ),
        content=content,
    )


def _renew_normals(content: Content, old: Floats, new: Floats) -> list[tuple[Floats, Flags]]:
    from msal_cli.kernels.geometry import regroup_normals

    assert content.face_normals is not None
    return [regroup_normals(old, new, content.faces, content.face_normals, content.normals)]


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
        changes = [change for change in self._changes(vertices) if change.slots is not positions]
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
        return (_misfit_warning(n_normals, before, after, len(parsed.sizes), MISFIT_DEG),)


@dataclass(eq=False)
class _Positions(Statements):
    """The positions of an OBJ file."""

    @functools.cached_property
    def decimals(self) -> int:
        """Decimals of new numbers: as many as are usual, or as the extent asks for."""
        from msal_cli.kernels.numbers import FIXED_BELOW, MAX_DECIMALS

        needed = extent_decimals(self.values) or 0
        largest = max(float(self.values.max()), -float(self.values.min()))
        if needed > MAX_DECIMALS or largest >= FIXED_BELOW:
            return SHORTEST
        return max(min(usual_decimals(self.used), MAX_DECIMALS), needed)


@dataclass(frozen=True, eq=False)
class Content:
    """One OBJ file, parsed.

    Attributes
    ----------
    vertices : (n, 3) float64, file units; vertex_at : (n,) int64, where each statement begins;
        decimals : (n,) uint8, the most decimals of its numbers.
    normals, normal_at, normal_decimals : the same for the vn statements, (g, 3), (g,), (g,).
    faces : (m, 3) int32, polygons cut into triangles.
    face_normals : (m, 3) int32, the vn of each corner, -1 for none; None where no corner has one.
    corners, sizes : (k,) and (p,) int32, the p polygons as they are in the file; ``corners`` and
        ``faces`` share memory where all are triangles.
    state : (N_STATE,) int64, the counts that ``kernels.obj_scan`` names.
    keywords : every other keyword, how often it occurs, and where first.
    libraries : (l,) int64, where the mtllib statements begin.
    """

    vertices: Floats
    vertex_at: Longs
    decimals: Bytes
    normals: Floats
    normal_at: Longs
    normal_decimals: Bytes
    faces: Ints
    face_normals: Ints | None
    corners: Ints
    sizes: Ints
    state: Longs
    keywords: dict[bytes, tuple[int, int]]
    libraries: Longs


def _cut_triangles(corners: Ints, sizes: Ints) -> Ints:
    """(m, 3), the polygons cut into fans; a view where all are triangles."""
    if len(corners) == 3 * len(sizes) and bool((sizes == 3).all()):
        return corners.reshape(-1, 3)
    from msal_cli.kernels.ply_scan import fans

    triangles = np.empty((len(corners) - 2 * len(sizes), 3), dtype=np.int32)
    fans(corners, sizes, triangles)
    return triangles


def parse_content(data: Buffer) -> Content:
    """Parse the bytes of an OBJ file.

    Raises FormatError (binary data, a word that is no number or corner, a statement that is too
    short), TruncatedError (the file is empty, or its last line breaks off), ContentError
    (``E_NONFINITE``, ``E_INDEX``, ``E_NO_FACES``) and TooLargeError, each with the line.
    """
    from msal_cli.kernels.text import as_bytes

    refuse_binary(data)
    return _Reading(data, as_bytes(data)).content()


class _Reading:
    """The arrays that the walk fills, grown as it asks for it."""

    def __init__(self, data: Buffer, buf: Bytes) -> None:
        from msal_cli.kernels import obj_scan

        self._scan = obj_scan
        self._data = data
        self._buf = buf
        size = len(buf)
        n_vertices, n_normals, n_faces, n_zeros = obj_scan.count_statements(buf)
        if n_zeros:
            at = next(re.finditer(rb"\0", memoryview(data))).start()
            raise _binary_error(data, at)
        has_normals = n_normals > 1
        # No statement is shorter than "v 0 0 0" and its line end: the counts cannot exceed this,
        # whatever the bytes say.
        most = (size + 1) // 8 + 1
        n_vertices, n_normals = min(n_vertices, most), min(n_normals, most)
        self._n_faces = min(n_faces, most)
        if size > 2**33 or n_vertices >= 2**31:
            raise TooLargeError(
                f"{size:,} bytes are more than an OBJ file may have here",
                hint="convert the mesh to binary PLY",
            )
        self.vertices = np.empty((n_vertices, 3))
        self.vertex_at = np.empty(n_vertices, dtype=np.int64)
        self.decimals = np.empty(n_vertices, dtype=np.uint8)
        self.normals = np.empty((n_normals if has_normals else 0, 3))
        self.normal_at = np.empty(len(self.normals), dtype=np.int64)
        self.normal_decimals = np.empty(len(self.normals), dtype=np.uint8)
        self.corners = np.empty(3 * self._n_faces, dtype=np.int32)
        self.corner_normals = np.empty(len(self.corners) if has_normals else 0, dtype=np.int32)
        self.sizes = np.empty(self._n_faces, dtype=np.int32)
        self.undecided = np.empty((64, 2), dtype=np.int64)
        self.keywords = np.empty((obj_scan.MAX_KEYWORDS, 4), dtype=np.int64)
        self.libraries = np.empty(obj_scan.MAX_LIBRARIES, dtype=np.int64)
        self.state = self._begun()

    def _begun(self) -> Longs:
        """The state of a walk that is about to start."""
        scan = self._scan
        state = np.zeros(scan.N_STATE, dtype=np.int64)
        state[scan.LARGEST_VERTEX] = -1
        if self._buf[:3].tobytes() == BYTE_ORDER_MARK:
            state[scan.AT] = 3
        return state

    def content(self) -> Content:
        scan, state = self._scan, self.state
        while (result := self._walk(state, _ALL)) == scan.FULL:
            self._grow()
        if result != scan.WHOLE:
            raise self._refusal(result)
        n_vertices, n_normals = int(state[scan.VERTICES]), int(state[scan.NORMALS])
        n_faces, n_corners = int(state[scan.FACES]), int(state[scan.CORNERS])
        vertices, normals = self.vertices[:n_vertices], self.normals[:n_normals]
        self._decide(vertices, normals)
        # A normal that is none is as good as zero, which is kept and compares equal to itself.
        normals[~np.isfinite(normals).all(axis=1)] = 0.0
        corners, sizes = self.corners[:n_corners], self.sizes[:n_faces]
        if n_corners == 3 * n_faces and bool((sizes == 3).all()):
            # One number instead of one for each face.
            sizes = np.broadcast_to(np.int32(3), (n_faces,))
            del self.sizes
        keywords = {
            self._buf[at : at + size].tobytes(): (int(count), int(at))
            for _, count, at, size in self.keywords[: int(state[scan.KEYWORDS])]
        }
        self._require_whole_face()
        if not n_vertices or not n_faces:
            raise _no_faces_error(n_vertices, int(state[scan.SHORT]), keywords)
        self._require_finite(vertices)
        self._require_vertices(corners, sizes, n_vertices)
        face_normals = None
        corner_normals = self.corner_normals[:n_corners]
        if n_normals and len(corner_normals):
            if state[scan.LARGEST_NORMAL] > n_normals:
                corner_normals[corner_normals >= n_normals] = -1
            if (corner_normals >= 0).any():
                face_normals = _cut_triangles(corner_normals, sizes)
        return Content(
            vertices=vertices,
            vertex_at=self.vertex_at[:n_vertices],
            decimals=self.decimals[:n_vertices],
            normals=normals,
            normal_at=self.normal_at[:n_normals],
            normal_decimals=self.normal_decimals[:n_normals],
            faces=_cut_triangles(corners, sizes),
            face_normals=face_normals,
            corners=corners,
            sizes=sizes,
            state=state,
            keywords=keywords,
            libraries=self.libraries[: int(state[scan.LIBRARIES])],
        )

    def _walk(self, state: Longs, n_faces: int) -> int:
        """Go on until ``n_faces`` faces are read; what ``scan`` says."""
        outputs = (
            *(self.vertices, self.vertex_at, self.decimals),
            *(self.normals, self.normal_at, self.normal_decimals),
            *(self.corners, self.corner_normals, self.sizes),
            *(self.undecided, self.keywords, self.libraries),
        )
        return int(self._scan.scan(self._buf, state, n_faces, *outputs))

    def _grow(self) -> None:
        scan, state = self._scan, self.state
        n_faces, n_corners = int(state[scan.FACES]), int(state[scan.CORNERS])
        if state[scan.UNDECIDED_ROWS] == len(self.undecided):
            self.undecided = _grown(self.undecided, 2 * len(self.undecided))
        elif state[scan.VERTICES] == len(self.vertices):
            self.vertices = _grown(self.vertices, 2 * len(self.vertices) + 1)
            self.vertex_at = _grown(self.vertex_at, len(self.vertices))
            self.decimals = _grown(self.decimals, len(self.vertices))
        elif len(self.normals) and state[scan.NORMALS] == len(self.normals):
            self.normals = _grown(self.normals, 2 * len(self.normals) + 1)
            self.normal_at = _grown(self.normal_at, len(self.normals))
            self.normal_decimals = _grown(self.normal_decimals, len(self.normals))
        elif n_faces == len(self.sizes):
            self.sizes = _grown(self.sizes, 2 * len(self.sizes))
        else:
            # As many for each face to come as the faces so far have.
            alike = (n_corners // max(n_faces, 1) + 1) * self._n_faces
            room = max(min(alike, len(self._buf) // 2), len(self.corners) * 3 // 2 + 1)
            self.corners = _grown(self.corners, room)
            if len(self.corner_normals):
                self.corner_normals = _grown(self.corner_normals, room)

    def _decide(self, vertices: Floats, normals: Floats) -> None:
        """Read the statements with numbers that need Python's ``float``."""
        view = memoryview(self._data)
        for is_normal, row in self.undecided[: self.state[self._scan.UNDECIDED_ROWS]].tolist():
            at = int(self.normal_at[row] + 2 if is_normal else self.vertex_at[row] + 1)
            for axis in range(3):
                word = _WORD.match(view, at)
                assert word is not None  # the walk has seen three numbers here
                at = word.end()
                (normals if is_normal else vertices)[row, axis] = _number(word[1])

    def _place(self, at: int) -> str:
        return f"line {line_of(self._data, at)}"

    def _refusal(self, result: int) -> InputError:
        """The error for what the walk returned."""
        scan, state = self._scan, self.state
        at = int(state[scan.WORD])
        place = self._place(at)
        statement = bytes(self._buf[int(state[scan.AT]) : int(state[scan.AT]) + 2])
        stop = int(scan.skip_word(self._buf, at))
        word = self._buf[at:stop].tobytes()
        shown = word[:40].decode("ascii", "backslashreplace")
        next_face = f"face {int(state[scan.FACES]) + int(state[scan.SHORT]) + 1}"
        is_cut = self._is_last_line(at) and _BEGUN.fullmatch(word) is not None
        if result == scan.BAD_INDEX:
            return _bad_index_error(shown, f"{place}, {next_face}", int(state[scan.VERTICES]))
        if is_cut:
            return TruncatedError(
                "the last line breaks off", where=place, hint="copy or export the file again"
            )
        hint = "correct the line, or export the file again"
        if result in (scan.BAD_NUMBER, scan.FEW_NUMBERS):
            is_normal = statement == b"vn"
            number = int(state[scan.NORMALS if is_normal else scan.VERTICES]) + 1
            what = "normal" if is_normal else "vertex"
            if result == scan.BAD_NUMBER:
                message = f"{shown!r} is not a number"
            else:
                message = f"a {what} needs three numbers"
            is_flat = _PLANE_POSITION.match(memoryview(self._data), int(state[scan.AT]))
            if is_flat and number == 1:
                message += ", but it has two: the file is a drawing in the plane"
                hint = "msal denoises surfaces in space; add a third number to every v line"
            return FormatError(
                message,
                where=f"{place}, {what} {number}",
                hint=number_hint(word, hint),
            )
        message = (
            "a face has no corners"
            if result == scan.NO_CORNERS
            else f"{shown!r} is not a corner of a face: v, v/vt, v//vn or v/vt/vn in whole numbers"
        )
        return FormatError(message, where=f"{place}, {next_face}", hint=hint)

    def _is_last_line(self, at: int) -> bool:
        """Whether the file ends, without a line end, in the line of byte ``at``."""
        rest = bytes(self._buf[at : at + (1 << 16)])
        return at + len(rest) == len(self._buf) and not (b"\n" in rest or b"\r" in rest)

    def _require_whole_face(self) -> None:
        """Raise where the last line is a face that breaks off."""
        scan, state = self._scan, self.state
        last_short = int(state[scan.LAST_SHORT_AT])
        if state[scan.SHORT] and self._is_last_line(last_short):
            # A face that lost its last corners and its line end did not lose them on purpose.
            raise TruncatedError(
                "the last line breaks off: its face has fewer than three corners",
                where=self._place(last_short),
                hint="copy or export the file again",
            )

    def _require_finite(self, vertices: Floats) -> None:
        """Raise where a position (n, 3) is not finite."""
        finite = np.isfinite(vertices)
        if finite.all():
            return
        bad = int(np.argmin(finite.all(axis=1)))
        raise ContentError(
            f"the position {tuple(vertices[bad].tolist())} is not finite",
            where=f"{self._place(int(self.vertex_at[bad]))}, vertex {bad + 1}",
            hint="remove the vertex and its faces, or export the file again",
            code="E_NONFINITE",
        )

    def _require_vertices(self, corners: Ints, sizes: Ints, n_vertices: int) -> None:
        """Raise where a face names a vertex that the whole file does not have."""
        scan = self._scan
        if self.state[scan.LARGEST_VERTEX] < n_vertices:
            return
        corner = int(np.argmax(corners >= n_vertices))
        face = int(np.searchsorted(np.cumsum(sizes, dtype=np.int64), corner, side="right"))
        number = int(corners[corner]) + 1
        self.sizes = np.empty(len(sizes), dtype=np.int32)
        # A second walk that ends behind this face says where it is, and so no other walk need
        # keep the place of every face.
        again = self._begun()
        self._walk(again, face + 1)
        number_of_face = face + 1 + int(again[scan.SHORT])
        place = self._place(int(again[scan.LAST_FACE_AT]))
        shown = "2147483648 or more" if number >= 2**31 else str(number)
        raise _bad_index_error(shown, f"{place}, face {number_of_face}", n_vertices)


def _number(word: bytes) -> float:
    """A number of any length; NaN as old run-time libraries print it has no other form."""
    try:
        return float(word)
    except ValueError:
        return math.nan


def _grown(array: NDArray[_T], rows: int) -> NDArray[_T]:
    """A copy with room for ``rows`` rows."""
    larger = np.empty((rows, *array.shape[1:]), dtype=array.dtype)
    larger[: len(array)] = array
    return larger


def _name_properties(state: Longs, keywords: Keywords) -> tuple[str, ...]:
    """What is carried along beside positions and faces."""
    from msal_cli.kernels import obj_scan

    found = []
    if state[obj_scan.TEXTURE]:
        found.append("texture coordinates")
    if state[obj_scan.NORMALS]:
        found.append("normals")
    if state[obj_scan.COLOURED]:
        found.append("vertex colours")
    if state[obj_scan.WEIGHTED]:
        found.append("weights w")
    found += [words for keyword, words in _PROPERTY_OF.items() if keyword in keywords]
    if not _FREE_FORM.isdisjoint(keywords):
        found.append("free-form geometry (vertices that only it uses stay in place)")
    return tuple(found)


def _find_references(data: Buffer, libraries: Longs) -> tuple[str, ...]:
    """The material libraries that ``mtllib`` statements at these bytes name, in order, each once.

    A name may hold blanks: it ends with ``.mtl``, or with the line.
    """
    names: dict[str, None] = {}
    view = memoryview(data)
    for at in libraries:
        for name in _LIBRARY.findall(_argument(view, int(at), b"mtllib")):
            names[name.strip().strip('"')] = None
    return tuple(name for name in names if name)


def _argument(view: memoryview, at: int, keyword: bytes) -> str:
    """What stands behind the keyword at ``at``, continued lines joined."""
    size = 1 << 10
    while True:
        text = _CONTINUED.sub(b" ", bytes(view[at : at + size]))
        line = re.match(rb"[^\r\n]*", text)
        assert line is not None
        # A backslash in the last bytes looked at may continue the line.
        if at + size >= len(view) or line.end() < len(text) - 1:
            break
        size *= 2
    return line[0][len(keyword) :].decode("utf-8", "surrogateescape").strip()


def _describe_warnings(
    state: Longs, keywords: Keywords, line_at: Callable[[int], int]
) -> tuple[str, ...]:
    """What a user should know of a file that could be read all the same; ``line_at`` is the line of
    a byte."""
    from msal_cli.kernels import obj_scan

    found = []
    if state[obj_scan.WEIGHTED]:
        line = line_at(int(state[obj_scan.WEIGHTED_AT]))
        found.append(
            f"{_counted(state[obj_scan.WEIGHTED], 'vertex has', 'vertices have')} a weight w other"
            f" than 1 (first in line {line}); x y z are taken as they stand and w is kept"
        )
    if state[obj_scan.SHORT]:
        line = line_at(int(state[obj_scan.SHORT_AT]))
        found.append(
            f"{_counted(state[obj_scan.SHORT], 'face has', 'faces have')} fewer than three corners"
            f" (first in line {line}); kept in the file, left out of the computation"
        )
    for number, count, what in (
        (state[obj_scan.LARGEST_TEXTURE], state[obj_scan.TEXTURE], "texture coordinate"),
        (state[obj_scan.LARGEST_NORMAL], state[obj_scan.NORMALS], "normal"),
    ):
        if number > count:
            found.append(f"faces name {what} {number}, but there are {count}; kept as they are")
    if state[obj_scan.BEFORE_FIRST]:
        found.append(
            "faces name a texture coordinate or normal 0, or one before the first"
            f" ({_counted(state[obj_scan.BEFORE_FIRST], 'corner', 'corners')}); kept as they are"
        )
    unknown = {
        keyword: seen
        for keyword, seen in keywords.items()
        if keyword not in _PROPERTY_OF and keyword not in _FREE_FORM | _DISPLAY
    }
    if unknown:
        shown = ", ".join(
            f"{keyword[:20].decode('utf-8', 'backslashreplace')!r} in line {line_at(at)}"
            for keyword, (_, at) in list(unknown.items())[:_SHOWN]
        )
        total = sum(count for count, _ in unknown.values())
        found.append(
            f"{_counted(total, 'line is', 'lines are')} no statement that is known and kept as"
            f" {'it is' if total == 1 else 'they are'}: {shown}{', ...' * (len(unknown) > _SHOWN)}"
        )
    return tuple(found)


def _misfit_warning(
    n_normals: int, n_before: int, n_after: int, n_faces: int, limit_deg: float
) -> str:
    """What to say where ``n_after`` of all faces are further than a limit from a ``vn`` that they
    share, and fewer of them were before."""
    before, after = (f"{100.0 * one / n_faces:.1f} %" for one in (n_before, n_after))
    return (
        f"{_counted(n_normals, 'vn is', 'vn are')} shared by faces that turned apart: {n_after} of"
        f" {n_faces} faces ({after}) are now more than {limit_deg:.0f} degrees off their vn"
        f" ({before} before); let the program that reads the file compute normals, or write PLY"
        " (--to ply), which has one for each vertex"
    )


def _counted(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"


def refuse_binary(data: Buffer) -> None:
    """Raise unless the beginning of ``data`` can be the text of an OBJ file."""
    if not len(data):
        raise TruncatedError("the file is empty", hint="copy or export it again")
    head = bytes(memoryview(data)[:_LOOKED_AT])
    # Old systems end a text with this mark; it is kept as a line that is no statement.
    control = _CONTROL.search(head.rstrip(b"\x1a\r\n") if len(data) <= _LOOKED_AT else head)
    # Zeros are looked for farther on: the first pages of a file may be sound.
    found = control.start() if control else bytes(memoryview(data)[:_ZEROS_LOOKED_AT]).find(0)
    if found >= 0:
        raise _binary_error(data, found)


def _binary_error(data: Buffer, at: int) -> FormatError:
    return FormatError(
        f"byte {at} is a control character: this is binary data, not OBJ text",
        where=f"byte {at}, line {line_of(data, at)}",
        hint="pass --format if the suffix is wrong, or copy the file again",
    )


def _no_faces_error(n_vertices: int, n_short: int, keywords: Collection[bytes]) -> ContentError:
    if not {b"V", b"F"}.isdisjoint(keywords):
        hint = "the keywords V and F are in capitals; OBJ writes them small"
    elif n_short:
        hint = "its faces have one or two corners; a face needs three"
    elif n_vertices:
        hint = "it was cut short, or is a point cloud: export it again, or make a mesh of it"
    else:
        hint = "check that this is an OBJ file"
    return ContentError(
        f"the file has {'no faces' if n_vertices else 'no vertices'}",
        hint=hint,
        code="E_NO_FACES",
    )


def _bad_index_error(number: str, where: str, n_vertices: int) -> ContentError:
    return ContentError(
        f"a face names vertex {number}, but there are {n_vertices} vertices",
        where=where,
        hint="the file is cut off or was put together wrongly; export it again",
        code="E_INDEX",
    )
