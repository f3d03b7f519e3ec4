"""What an OBJ file holds, read in one walk, or the error that says why it cannot be.

Errors count vertices and faces as the file does, from one.
"""

from __future__ import annotations

import math
import re
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Floats, Ints, Longs
from msal_cli.codecs.detection import BYTE_ORDER_MARK
from msal_cli.codecs.obj_content import Arrays, Before, Content, cut_triangles
from msal_cli.codecs.obj_errors import (
    bad_index_error,
    binary_error,
    no_faces_error,
    refuse_binary,
)
from msal_cli.codecs.slots import line_of, number_hint
from msal_cli.errors import ContentError, FormatError, InputError, TooLargeError, TruncatedError
from msal_cli.storage.buffers import Buffer

_T = TypeVar("_T", bound=np.generic)


_BEGUN = re.compile(rb"[-+.\deE/\\]*")
_WORD = re.compile(rb"(?:[ \t\v\f]|\\(?:\r\n?|\n))*+([^\s\\]*+(?:\\(?![\r\n])[^\s\\]*+)*+)")
_NUMBER = rb"([-+]?(?:\d{1,25}(?:\.\d{0,25})?|\.\d{1,25})(?:[eE][-+]?\d{1,3})?)"
_PLANE_POSITION = re.compile(rb"v" + 2 * (rb"[ \t]++" + _NUMBER) + rb"[ \t]*+(?=[\r\n#])")
_ALL = 1 << 62


def parse_content(data: Buffer) -> Content:
    """Parse the bytes of an OBJ file.

    Raises FormatError (binary data, a word that is no number or corner, a statement that is too
    short), TruncatedError (the file is empty, or its last line breaks off), ContentError
    (``E_NONFINITE``, ``E_INDEX``, ``E_NO_FACES``) and TooLargeError, each with the line.
    """
    from msal_cli.kernels.text import as_bytes

    refuse_binary(data)
    return Reading(data, as_bytes(data)).content()


class Reading:
    """The arrays that the walk fills, grown as it asks for it.

    ``data`` may be a part of a file with others ``before`` it; then its faces may have normals
    even if it has none.
    """

    def __init__(self, data: Buffer, buf: Bytes, before: Before | None = None) -> None:
        from msal_cli.kernels import obj_scan

        self._scan = obj_scan
        self._data = data
        self._buf = buf
        size = len(buf)
        self._before = before or Before()
        n_vertices, n_normals, n_faces, n_zeros = obj_scan.count_statements(buf)
        if n_zeros:
            at = next(re.finditer(rb"\0", memoryview(data))).start()
            raise binary_error(data, at, self._before.bytes, self._before.lines)
        has_normals = n_normals > 1 or before is not None
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
        self.keywords = np.empty((obj_scan.MOST_KEYWORDS, 4), dtype=np.int64)
        self.libraries = np.empty(obj_scan.MOST_LIBRARIES, dtype=np.int64)
        self.state = self._begun()

    def _begun(self) -> Longs:
        """The state of a walk that is about to start."""
        scan = self._scan
        state = np.zeros(scan.N_STATE, dtype=np.int64)
        state[scan.LARGEST_VERTEX] = -1
        state[scan.VERTICES_BEFORE] = self._before.vertices
        state[scan.NORMALS_BEFORE] = self._before.normals
        state[scan.TEXTURE_BEFORE] = self._before.texture
        if not self._before.bytes and self._buf[:3].tobytes() == BYTE_ORDER_MARK:
            state[scan.AT] = 3
        return state

    def walk(self) -> Arrays:
        """Read all statements; raises for one that is wrong."""
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
        return Arrays(
            vertices,
            self.vertex_at[:n_vertices],
            self.decimals[:n_vertices],
            normals,
            self.normal_at[:n_normals],
            self.normal_decimals[:n_normals],
            corners,
            self.corner_normals[:n_corners],
            sizes,
        )

    def content(self) -> Content:
        """Walk, repair and check."""
        scan = self._scan
        read = self.walk()
        state, corners, sizes = self.state, read.corners, read.sizes
        n_vertices, n_normals = len(read.vertices), len(read.normals)
        keywords = self.other_keywords()
        self.require_whole_face()
        if not n_vertices or not len(sizes):
            raise no_faces_error(n_vertices, int(state[scan.SHORT]), keywords)
        self.require_finite(read.vertices)
        self.require_vertices(corners, sizes, n_vertices)
        face_normals = None
        if n_normals and len(read.corner_normals):
            corner_normals = read.corner_normals
            if state[scan.LARGEST_NORMAL] > n_normals:
                corner_normals[corner_normals >= n_normals] = -1
            if (corner_normals >= 0).any():
                face_normals = cut_triangles(corner_normals, sizes)
        return Content(
            vertices=read.vertices,
            vertex_at=read.vertex_at,
            decimals=read.decimals,
            normals=read.normals,
            normal_at=read.normal_at,
            normal_decimals=read.normal_decimals,
            faces=cut_triangles(corners, sizes),
            face_normals=face_normals,
            corners=corners,
            sizes=sizes,
            state=state,
            keywords=keywords,
            libraries=self.libraries[: int(state[scan.LIBRARIES])],
        )

    def other_keywords(self) -> dict[bytes, tuple[int, int]]:
        """See ``Content.keywords``."""
        return {
            self._buf[at : at + size].tobytes(): (int(count), int(at))
            for _, count, at, size in self.keywords[: int(self.state[self._scan.KEYWORDS])]
        }

    def _walk(self, state: Longs, n_faces: int) -> int:
        """Go on until ``n_faces`` faces are read; what ``scanned`` says."""
        outputs = (
            *(self.vertices, self.vertex_at, self.decimals),
            *(self.normals, self.normal_at, self.normal_decimals),
            *(self.corners, self.corner_normals, self.sizes),
            *(self.undecided, self.keywords, self.libraries),
        )
        return int(self._scan.scanned(self._buf, state, n_faces, *outputs))

    def _grow(self) -> None:
        """Make room in the arrays that are full."""
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

    # What can be wrong

    def _place(self, at: int) -> str:
        return f"line {self._before.lines + line_of(self._data, at)}"

    def _refusal(self, result: int) -> InputError:
        """The error for what the walk returned."""
        scan, state = self._scan, self.state
        at = int(state[scan.WORD])
        place = self._place(at)
        statement = bytes(self._buf[int(state[scan.AT]) : int(state[scan.AT]) + 2])
        stop = int(scan.past_word(self._buf, at))
        word = self._buf[at:stop].tobytes()
        shown = word[:40].decode("ascii", "backslashreplace")
        is_cut = self._is_last_line(at) and _BEGUN.fullmatch(word) is not None
        if result == scan.BAD_INDEX:
            n_vertices = self._before.vertices + int(state[scan.VERTICES])
            return bad_index_error(shown, f"{place}, face {self._next_face}", n_vertices)
        if is_cut:
            return TruncatedError(
                "the last line breaks off", where=place, hint="copy or export the file again"
            )
        hint = "correct the line, or export the file again"
        if result in (scan.BAD_NUMBER, scan.FEW_NUMBERS):
            is_normal = statement == b"vn"
            number = int(state[scan.NORMALS if is_normal else scan.VERTICES]) + 1
            number += self._before.normals if is_normal else self._before.vertices
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
        return FormatError(message, where=f"{place}, face {self._next_face}", hint=hint)

    @property
    def _next_face(self) -> int:
        """The number of the next face."""
        scan, state = self._scan, self.state
        return self._before.faces + int(state[scan.FACES]) + int(state[scan.SHORT]) + 1

    def _is_last_line(self, at: int) -> bool:
        """Whether the file ends, without a line end, in the line of byte ``at``."""
        rest = bytes(self._buf[at : at + (1 << 16)])
        return at + len(rest) == len(self._buf) and not (b"\n" in rest or b"\r" in rest)

    def require_whole_face(self) -> None:
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

    def require_finite(self, vertices: Floats) -> None:
        """Raise where a position (n, 3) is not finite."""
        finite = np.isfinite(vertices)
        if finite.all():
            return
        bad = int(np.argmin(finite.all(axis=1)))
        raise ContentError(
            f"the position {tuple(vertices[bad].tolist())} is not finite",
            where=f"{self._place(int(self.vertex_at[bad]))}, "
            f"vertex {self._before.vertices + bad + 1}",
            hint="remove the vertex and its faces, or export the file again",
            code="E_NONFINITE",
        )

    def require_vertices(self, corners: Ints, sizes: Ints, n_vertices: int) -> None:
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
        number_of_face = self._before.faces + face + 1 + int(again[scan.SHORT])
        place = self._place(int(again[scan.LAST_FACE_AT]))
        shown = "2147483648 or more" if number >= 2**31 else str(number)
        raise bad_index_error(shown, f"{place}, face {number_of_face}", n_vertices)


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
