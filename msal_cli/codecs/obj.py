"""OBJ files: positions and normals replaced inside the original bytes.

Supported are ``v`` (x y z, followed by w or a colour), ``vn`` and ``f`` in every form (v, v/vt,
v//vn, v/vt/vn, negative numbers, polygons, continued lines; ``fo`` of early versions is the same),
with blanks or tabs, LF, CR LF or CR.  Everything else is kept without being parsed: texture
coordinates, groups, materials, lines, points, curves, surfaces, comments.  Vertices that only
lines, points or curves use belong to no face and stay where they are.

Where readers differ:

- keywords are lower case, as in Assimp, Blender, MeshLab and tinyobjloader: ``V`` and ``F`` are
  kept as unknown lines, with a warning, and a file with no others has no faces;
- a face of one or two corners is kept in the file, but not part of the mesh, whatever its indices,
  with a warning (Blender, tinyobjloader); a face without any corner is an error;
- a wrong vertex number is an error; a wrong vt or vn number, which does not affect positions, is a
  warning;
- a position's w is kept and otherwise ignored;
- a backslash at the end of a comment does not continue it.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msal_cli import errors
from msal_cli.arrays import Bytes, Floats, Ints, Longs
from msal_cli.codecs.detection import BYTE_ORDER_MARK
from msal_cli.codecs.mesh_file import Layout, MeshFile, cut_polygons, find_unplaced
from msal_cli.codecs.text_slots import (
    SHORTEST,
    Statements,
    extent_decimals,
    has_comments,
    line_of,
    number_hint,
    usual_decimals,
)
from msal_cli.errors import format_count
from msal_cli.kernels import obj_scan as scan
from msal_cli.kernels.parallel import over_ranges, threads
from msal_cli.kernels.text import as_bytes
from msal_cli.light_dataclass import dataclass
from msal_cli.storage.regular import Buffer

Keywords = Mapping[bytes, tuple[int, int]]
"""Keywords other than v, vt, vn and f: how often each occurs, and its first place.  For the walk's
``state``, see ``kernels.obj_scan``."""

_BEGUN = re.compile(rb"[-+.\deE/\\]*")
# Atomic groups, because Python up to 3.11.4 goes on behind the last try of a possessive one.
_WORD = re.compile(rb"(?>(?:[ \t\v\f]++|\\(?:\r\n?|\n))*)([^\s\\]*+(?>(?:\\(?![\r\n])[^\s\\]*+)*))")
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

_CONTINUED = re.compile(rb"\\(?:\r\n|\r|\n)")
_LINE = re.compile(rb"(?:[^\r\n\\]++|\\(?:\r\n|\r|\n)?+)*+")
_LIBRARY = re.compile(r"\S.*?\.mtl(?=\s|$)|\S.*", re.IGNORECASE)
_SHOWN = 3

_MIN_PIECE = 1 << 22  # bytes that are worth a thread

_LOOKED_AT = 4096
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]")


def read(data: Buffer) -> MeshFile:
    """Read an OBJ file.

    Raises FormatError (binary data, a word that is not a number, a statement that is too short),
    TruncatedError (empty, or the last line is cut off), ContentError (``E_NONFINITE``,
    ``E_INDEX``, ``E_NO_FACES``) and TooLargeError, each with the line.
    """
    return MeshFile(data, "obj", _Reader(data).read())


@dataclass(eq=False)
class _Positions(Statements):
    @functools.cached_property
    def decimals(self) -> int:
        """Decimals of new numbers: the usual ones of the file, or as many as its extent needs."""
        from msal_cli.kernels.numbers import FIXED_BELOW, MAX_DECIMALS

        needed = extent_decimals(self.values) or 0
        largest = max(float(self.values.max()), -float(self.values.min()))
        if needed > MAX_DECIMALS or largest >= FIXED_BELOW:
            return SHORTEST
        return max(min(usual_decimals(self.used), MAX_DECIMALS), needed)


class _Rows(NamedTuple):
    """Statements of three numbers: ``values`` (n, 3) float64, in file units; ``at`` (n,) int64,
    their first bytes; ``decimals`` (n,) uint8, the most decimals of their numbers."""

    values: Floats
    at: Longs
    decimals: Bytes

    def first(self, n_rows: int) -> _Rows:
        return _Rows(self.values[:n_rows], self.at[:n_rows], self.decimals[:n_rows])

    def slots(self, kind: type[Statements], buf: Bytes, skipped: int) -> Statements:
        slots = kind(buf, self.at, values=self.values, skipped=skipped)
        slots.used = self.decimals
        return slots


def _empty_rows(n_rows: int) -> _Rows:
    at, decimals = np.empty(n_rows, dtype=np.int64), np.empty(n_rows, dtype=np.uint8)
    return _Rows(np.empty((n_rows, 3)), at, decimals)


def _enlarge(n_rows: int, *arrays: NDArray[Any]) -> None:
    for array in arrays:
        array.resize((n_rows, *array.shape[1:]), refcheck=False)


def _cut_lines(buf: Bytes) -> list[int]:
    """The starts of pieces of a text, one per thread, and its end; all are starts of lines."""
    size = len(buf)
    n_pieces = max(min(threads(), size // _MIN_PIECE), 1)
    last_lines = buf[-_LOOKED_AT:].tobytes().splitlines()[1:-1]
    if any(line.startswith(b"f ") and len(line.split()) != 4 for line in last_lines):
        # Polygons other than triangles are read by a single walk.
        n_pieces = 1
    cuts = [0]
    for piece in range(1, n_pieces):
        at = size * piece // n_pieces
        for end in (np.flatnonzero(buf[at : at + _LOOKED_AT] == 10) + at).tolist():
            before = end - 1 - (buf[end - 1] == 13)
            if buf[before] != 92:
                cuts.append(end + 1)
                break
    return [*cuts, size]


class _Reader:
    """The arrays that the walk over ``data`` fills; they grow if it needs more room."""

    def __init__(self, data: Buffer) -> None:
        refuse_binary(data)
        self._data = data
        self._buf = as_bytes(data)
        size = len(self._buf)
        self._cuts = _cut_lines(self._buf)
        self._counts = self._count_pieces()
        # A statement at either end of the text may not be counted.
        n_vertices, n_normals, n_faces, n_zeros = (self._counts.sum(axis=0) + (2, 1, 2, 0)).tolist()
        if n_zeros:
            raise _binary_error(data, next(re.finditer(rb"\0", memoryview(data))).start())
        # No statement is shorter than "v 0 0 0" and a line end, which limits the counts, whatever
        # the bytes are.
        most = (size + 1) // 8 + 1
        n_vertices, n_faces = min(n_vertices, most), min(n_faces, most)
        if size > 2**33 or n_vertices >= 2**31:
            raise errors.TooLargeError(
                f"{size:,} bytes are more than an OBJ file may have here",
                hint="convert the mesh to binary PLY",
            )
        n_normals = min(n_normals, most) if n_normals > 1 else 0
        self._positions, self._normals = _empty_rows(n_vertices), _empty_rows(n_normals)
        self._n_faces = n_faces
        self._corners = np.empty(3 * n_faces, dtype=np.int32)
        self._corner_normals = np.empty(3 * n_faces if n_normals else 0, dtype=np.int32)
        self._sizes = np.empty(n_faces, dtype=np.int32)
        self._undecided = np.empty((64, 2), dtype=np.int64)
        self._keywords = np.empty((scan.MAX_KEYWORDS, 4), dtype=np.int64)
        self._libraries = np.empty(scan.MAX_LIBRARIES, dtype=np.int64)
        self._state = self._begin()

    def _begin(self) -> Longs:
        state = np.zeros(scan.N_STATE, dtype=np.int64)
        state[scan.LARGEST_VERTEX] = -1
        if self._buf[:3].tobytes() == BYTE_ORDER_MARK:
            state[scan.AT] = 3
        return state

    def _count_pieces(self) -> Longs:
        """Counts of positions, normals, faces and zeros in each piece, nearly exact."""
        counts = np.zeros((len(self._cuts) - 1, 4), dtype=np.int64)

        def count(start: int, stop: int) -> None:
            for piece in range(start, stop):
                first, last = self._cuts[piece : piece + 2]
                around = self._buf[max(first - 1, 0) : last + 1]
                counts[piece] = np.subtract(scan.count_statements(around), (2, 1, 2, 0))

        over_ranges(count, len(counts), smallest=1)
        # The first statement has no line end before it.
        counts[0, 0] += self._buf[:2].tobytes() == b"v "
        return counts

    def read(self) -> Layout:
        buf = self._buf
        if len(self._cuts) == 2 or not self._walk_pieces():
            while (result := self._walk(self._state, _ALL)) == scan.FULL:
                self._grow()
            if result != scan.WHOLE:
                raise self._scan_error(result)
        state = self._state
        n_vertices, n_faces = int(state[scan.VERTICES]), int(state[scan.FACES])
        n_normals, n_corners = int(state[scan.NORMALS]), int(state[scan.CORNERS])
        self._resolve_numbers()
        positions, normals = self._positions.first(n_vertices), self._normals.first(n_normals)
        # NaN normals are treated as zero, which is kept, and compares equal to itself.
        normals.values[~np.isfinite(normals.values).all(axis=1)] = 0.0
        corners, sizes = self._corners[:n_corners], self._sizes[:n_faces]
        if n_corners == 3 * n_faces and bool((sizes == 3).all()):
            # One number instead of one for each face.
            sizes = np.broadcast_to(np.int32(3), (n_faces,))
            del self._sizes
        keywords: dict[bytes, tuple[int, int]] = {}
        for _, count, at, size in self._keywords[: int(state[scan.KEYWORDS])].tolist():
            keyword = buf[at : at + size].tobytes()
            before, first = keywords.get(keyword, (0, at))
            keywords[keyword] = before + count, first
        unplaced = self._require_mesh(positions, corners, sizes, keywords)
        faces = cut_polygons(corners, sizes)
        layout = Layout(
            "ascii",
            "text",
            (positions.slots(_Positions, buf, 1),),
            corners,
            sizes,
            faces=faces,
            unplaced=unplaced,
            properties=_name_properties(state, keywords) + ("comments",) * has_comments(self._data),
            references=_find_references(self._data, self._libraries[: int(state[scan.LIBRARIES])]),
            warnings=_describe_warnings(state, keywords, functools.partial(line_of, self._data)),
        )
        corner_normals = self._corner_normals[:n_corners]
        corner_normals[corner_normals >= n_normals] = -1
        if n_normals and (corner_normals >= 0).any():
            from msal_cli.kernels.geometry import regroup_normals

            stored = normals.values
            entries = cut_polygons(corner_normals, sizes)
            slots = normals.slots(Statements, buf, 2)
            slots.unit_length, slots.significant = True, math.inf
            layout.normals = (slots,)
            layout.renew_normals = lambda old, new: [
                regroup_normals(old, new, faces, entries, stored)
            ]
        return layout

    def _walk_pieces(self) -> bool:
        """Read all pieces of the text in parallel, each into the rows that the counts give it.

        False if a piece has errors, faces that are not triangles, or other counts: then a single
        walk reads the whole text.
        """
        counts = self._counts[:, :3]
        ends, pieces = np.cumsum(counts, axis=0), range(len(counts))
        room = len(self._positions.at), len(self._normals.at), len(self._sizes)
        if (ends[-1] > room).any():
            # More are counted than are possible; the walk does not check starts beyond the end.
            return False
        states = np.zeros((len(counts), scan.N_STATE), dtype=np.int64)
        states[:, scan.AT] = self._cuts[:-1]
        states[0, scan.AT] = self._state[scan.AT]
        states[:, scan.LARGEST_VERTEX] = -1
        first = ends - counts
        states[:, [scan.VERTICES, scan.NORMALS, scan.FACES]] = first
        states[:, scan.CORNERS] = 3 * first[:, 2]
        results = np.zeros(len(counts), dtype=np.int64)
        own = self._undecided, self._keywords, self._libraries
        others = [[np.empty_like(array) for array in own] for _ in pieces]

        def walk(start: int, stop: int) -> None:
            for piece in range(start, stop):
                n_vertices, n_normals, n_faces = ends[piece].tolist()
                outputs = (
                    *[array[:n_vertices] for array in self._positions],
                    *[array[:n_normals] for array in self._normals],
                    self._corners[: 3 * n_faces],
                    self._corner_normals[: 3 * n_faces],
                    self._sizes[:n_faces],
                )
                text, state = self._buf[: self._cuts[piece + 1]], states[piece]
                results[piece] = scan.scan(text, state, _ALL, *outputs, *others[piece])

        over_ranges(walk, len(counts), smallest=1)
        found = states[:, [scan.VERTICES, scan.NORMALS, scan.FACES]]
        is_plain = (results == scan.WHOLE).all() and (found == ends).all()
        is_plain &= not states[:, [scan.SHORT, scan.BEFORE_FIRST]].any()
        is_plain &= (states[:, scan.CORNERS] == 3 * ends[:, 2]).all()
        is_plain &= states[:, scan.KEYWORDS].max() < scan.MAX_KEYWORDS
        if not is_plain:
            return False
        state = states[-1].copy()
        listed = [scan.UNDECIDED_ROWS, scan.KEYWORDS, scan.LIBRARIES]
        self._undecided, self._keywords, self._libraries = (
            np.concatenate([of[place][: states[piece, column]] for piece, of in enumerate(others)])
            for place, column in enumerate(listed)
        )
        added = [*listed, scan.TEXTURE, scan.WEIGHTED, scan.COLOURED]
        state[added] = states[:, added].sum(axis=0)
        largest = [scan.LARGEST_VERTEX, scan.LARGEST_TEXTURE, scan.LARGEST_NORMAL]
        state[[*largest, scan.LAST_FACE_AT]] = states[:, [*largest, scan.LAST_FACE_AT]].max(axis=0)
        state[scan.WEIGHTED_AT] = states[np.argmax(states[:, scan.WEIGHTED] > 0), scan.WEIGHTED_AT]
        self._state = state
        return True

    def _walk(self, state: Longs, n_faces: int) -> int:
        """Continue until ``n_faces`` faces are read; returns the status of ``scan``."""
        polygons = self._corners, self._corner_normals, self._sizes
        others = self._undecided, self._keywords, self._libraries
        outputs = (*self._positions, *self._normals, *polygons, *others)
        return int(scan.scan(self._buf, state, n_faces, *outputs))

    def _grow(self) -> None:
        state = self._state
        n_faces, n_corners = int(state[scan.FACES]), int(state[scan.CORNERS])
        n_vertices, n_normals = len(self._positions.at), len(self._normals.at)
        if state[scan.UNDECIDED_ROWS] == len(self._undecided):
            _enlarge(2 * len(self._undecided), self._undecided)
        elif state[scan.VERTICES] == n_vertices:
            _enlarge(2 * n_vertices + 1, *self._positions)
        elif n_normals and state[scan.NORMALS] == n_normals:
            _enlarge(2 * n_normals + 1, *self._normals)
        elif n_faces == len(self._sizes):
            _enlarge(2 * n_faces, self._sizes)
        else:
            # Assume as many corners per face as the faces so far have.
            alike = (n_corners // max(n_faces, 1) + 1) * self._n_faces
            room = max(min(alike, len(self._buf) // 2), len(self._corners) * 3 // 2 + 1)
            _enlarge(room, self._corners, *[self._corner_normals] * bool(len(self._corner_normals)))

    def _resolve_numbers(self) -> None:
        view = memoryview(self._data)
        for is_normal, row in self._undecided[: self._state[scan.UNDECIDED_ROWS]].tolist():
            rows = self._normals if is_normal else self._positions
            at = int(rows.at[row]) + (2 if is_normal else 1)
            for axis in range(3):
                word = _WORD.match(view, at)
                assert word is not None  # the walk has seen three numbers here
                at = word.end()
                try:
                    rows.values[row, axis] = float(word[1])
                except ValueError:
                    # The walk accepts NaN as old run-time libraries print it.
                    rows.values[row, axis] = math.nan

    def _place(self, at: int) -> str:
        return f"line {line_of(self._data, at)}"

    def _scan_error(self, result: int) -> errors.InputError:
        state = self._state
        at = int(state[scan.WORD])
        place = self._place(at)
        statement = bytes(self._buf[int(state[scan.AT]) : int(state[scan.AT]) + 2])
        word = self._buf[at : int(scan.skip_word(self._buf, at))].tobytes()
        shown = word[:40].decode("ascii", "backslashreplace")
        next_face = f"face {int(state[scan.FACES]) + int(state[scan.SHORT]) + 1}"
        if result == scan.BAD_INDEX:
            return _bad_index_error(shown, f"{place}, {next_face}", int(state[scan.VERTICES]))
        if self._is_last_line(at) and _BEGUN.fullmatch(word) is not None:
            return errors.cut_short("the last line breaks off", place)
        hint = "correct the line, or export the file again"
        if result in (scan.BAD_NUMBER, scan.FEW_NUMBERS):
            is_normal = statement == b"vn"
            number = int(state[scan.NORMALS if is_normal else scan.VERTICES]) + 1
            what = "normal" if is_normal else "vertex"
            message = f"a {what} needs three numbers"
            if result == scan.BAD_NUMBER:
                message = f"{shown!r} is not a number"
            is_flat = _PLANE_POSITION.match(memoryview(self._data), int(state[scan.AT]))
            if is_flat and number == 1:
                message += ", but it has two: the file is a drawing in the plane"
                hint = "msal denoises surfaces in space; add a third number to every v line"
            where = f"{place}, {what} {number}"
            return errors.FormatError(message, where=where, hint=number_hint(word, hint))
        message = f"{shown!r} is not a corner of a face: v, v/vt, v//vn or v/vt/vn in whole numbers"
        if result == scan.NO_CORNERS:
            message = "a face has no corners"
        return errors.FormatError(message, where=f"{place}, {next_face}", hint=hint)

    def _is_last_line(self, at: int) -> bool:
        """Whether byte ``at`` is in the last line, and that has no line end."""
        rest = bytes(self._buf[at : at + (1 << 16)])
        return at + len(rest) == len(self._buf) and not (b"\n" in rest or b"\r" in rest)

    def _require_mesh(
        self, positions: _Rows, corners: Ints, sizes: Ints, keywords: Keywords
    ) -> Longs:
        """The result of ``find_unplaced``; raises unless faces are complete and vertices exist."""
        state, n_vertices = self._state, len(positions.at)
        last_short = int(state[scan.LAST_SHORT_AT])
        if state[scan.SHORT] and self._is_last_line(last_short):
            # A face without its last corners and its line end was cut off.
            raise errors.cut_short(
                "the last line breaks off: its face has fewer than three corners",
                self._place(last_short),
            )
        if not n_vertices or not len(sizes):
            raise _no_faces_error(n_vertices, int(state[scan.SHORT]), keywords)
        unplaced = find_unplaced(
            positions.values,
            corners,
            lambda bad: f"{self._place(int(positions.at[bad]))}, vertex {bad + 1}",
        )
        # The largest index may be from a face that is not part of the mesh.
        if state[scan.LARGEST_VERTEX] >= n_vertices and (is_bad := corners >= n_vertices).any():
            corner = int(np.argmax(is_bad))
            face = int(np.searchsorted(np.cumsum(sizes, dtype=np.int64), corner, side="right"))
            number = int(corners[corner]) + 1
            self._sizes = np.empty(len(sizes), dtype=np.int32)
            # The places of faces are not stored: a second walk up to this face finds its place.
            again = self._begin()
            self._walk(again, face + 1)
            number_of_face = face + 1 + int(again[scan.SHORT])
            place = self._place(int(again[scan.LAST_FACE_AT]))
            shown = "2147483648 or more" if number >= 2**31 else str(number)
            raise _bad_index_error(shown, f"{place}, face {number_of_face}", n_vertices)
        return unplaced


def _name_properties(state: Longs, keywords: Keywords) -> tuple[str, ...]:
    is_there = {
        "texture coordinates": state[scan.TEXTURE],
        "normals": state[scan.NORMALS],
        "vertex colours": state[scan.COLOURED],
        "weights w": state[scan.WEIGHTED],
        **{words: keyword in keywords for keyword, words in _PROPERTY_OF.items()},
        "free-form geometry (vertices that only it uses stay in place)": (
            not _FREE_FORM.isdisjoint(keywords)
        ),
    }
    return tuple(name for name, has_it in is_there.items() if has_it)


def _find_references(data: Buffer, libraries: Longs) -> tuple[str, ...]:
    """The material libraries of ``mtllib`` statements at these bytes, in order, without repeats.

    A name may contain blanks: it ends with ``.mtl``, or with the line.
    """
    names: dict[str, None] = {}
    for at in libraries.tolist():
        line = _LINE.match(memoryview(data), at)
        assert line is not None  # it may be empty
        text = _CONTINUED.sub(b" ", line[0])[len("mtllib") :].decode("utf-8", "surrogateescape")
        for name in _LIBRARY.findall(text.strip()):
            names[name.strip().strip('"')] = None
    return tuple(name for name in names if name)


def _describe_warnings(
    state: Longs, keywords: Keywords, line_at: Callable[[int], int]
) -> tuple[str, ...]:
    """Warnings about a file that could be read; ``line_at`` gives the line of a byte."""
    warnings = []
    if state[scan.WEIGHTED]:
        line = line_at(int(state[scan.WEIGHTED_AT]))
        warnings.append(
            f"{format_count(state[scan.WEIGHTED], 'vertex has', 'vertices have')} a weight w other"
            f" than 1 (first in line {line}); x y z are taken as they stand and w is kept"
        )
    if state[scan.SHORT]:
        line = line_at(int(state[scan.SHORT_AT]))
        warnings.append(
            f"{format_count(state[scan.SHORT], 'face')} of fewer than three corners (first in line"
            f" {line}), kept and left out"
        )
    for number, count, what in (
        (state[scan.LARGEST_TEXTURE], state[scan.TEXTURE], "texture coordinate"),
        (state[scan.LARGEST_NORMAL], state[scan.NORMALS], "normal"),
    ):
        if number > count:
            warnings.append(f"faces name {what} {number}, but there are {count:,}; kept as is")
    if state[scan.BEFORE_FIRST]:
        warnings.append(
            "faces name a texture coordinate or normal 0, or one before the first"
            f" ({format_count(state[scan.BEFORE_FIRST], 'corner')}); kept as they are"
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
        warnings.append(
            f"{format_count(total, 'line')} without a known statement, kept: {shown}"
            f"{', ...' * (len(unknown) > _SHOWN)}"
        )
    return tuple(warnings)


def refuse_binary(data: Buffer) -> None:
    """Raise FormatError if the beginning of ``data`` cannot be the text of an OBJ file."""
    if not len(data):
        raise errors.cut_short("the file is empty")
    head = bytes(memoryview(data)[:_LOOKED_AT])
    # The end-of-file mark of old systems is kept, as a line that is no statement.
    control = _CONTROL.search(head.rstrip(b"\x1a\r\n") if len(data) <= _LOOKED_AT else head)
    # Zeros are searched for in more of the file, whose first pages may be intact.
    found = control.start() if control else bytes(memoryview(data)[: 1 << 16]).find(0)
    if found >= 0:
        raise _binary_error(data, found)


def _binary_error(data: Buffer, at: int) -> errors.FormatError:
    return errors.FormatError(
        f"byte {at} is a control character: this is binary data, not OBJ text",
        where=f"byte {at}, line {line_of(data, at)}",
        hint="pass --format if the suffix is wrong, or copy the file again",
    )


def _no_faces_error(
    n_vertices: int, n_short: int, keywords: Collection[bytes]
) -> errors.ContentError:
    if not {b"V", b"F"}.isdisjoint(keywords):
        hint = "the keywords V and F are in capitals; OBJ writes them small"
    elif n_short:
        hint = "its faces have one or two corners; a face needs three"
    elif not {b"l", b"p"}.isdisjoint(keywords):
        hint = "it has only lines or points; msal denoises surfaces"
    elif n_vertices:
        hint = "it was cut short, or is a point cloud: export it again, or make a mesh of it"
    else:
        hint = "check that this is an OBJ file"
    return errors.no_faces(f"the file has {'no faces' if n_vertices else 'no vertices'}", hint=hint)


def _bad_index_error(number: str, where: str, n_vertices: int) -> errors.ContentError:
    return errors.bad_index(
        f"a face names vertex {number} of {format_count(n_vertices, 'vertex')}", where
    )
