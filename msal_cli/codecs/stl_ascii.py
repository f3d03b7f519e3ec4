"""Ascii STL: numbers replaced in the file's own text.

Keywords may be in any case and apart by any white space; a solid's name is the rest of its line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Floats, Ints, Longs
from msal_cli.codecs.detection import BYTE_ORDER_MARK
from msal_cli.codecs.slot_file import require_finite_result, require_shape
from msal_cli.codecs.slots import as_float32
from msal_cli.codecs.stl_facets import (
    FacetFile,
    binary_stl,
    check_countable,
    check_not_empty,
    not_finite,
    refuse_float64,
)
from msal_cli.codecs.text_slots import line_of, number_hint
from msal_cli.errors import (
    EXPORT_AGAIN,
    FormatError,
    InputError,
    InternalError,
    TooLargeError,
    TruncatedError,
)
from msal_cli.storage.regular import Buffer

MIN_FACET_BYTES = len("facet outer loop vertex 0 0 0 vertex 0 0 0 vertex 0 0 0 endloop endfacet ")
"""Bytes of text that a facet takes at least."""

_USUAL_FACET = 200


@dataclass(frozen=True, eq=False)
class Scan:
    """Facets of a text: see ``kernels.stl_facets`` for what the arrays are.

    ``n_bare`` counts facets without a normal.
    """

    facet_at: NDArray[np.int64]
    offsets: NDArray[np.int32]
    decimals: NDArray[np.int64]
    names: tuple[str, ...]
    n_solids: int
    end: int
    n_bare: int


def read_numbers(data: Buffer) -> tuple[Scan, Floats]:
    """All facets of a text and their numbers (m, 12), positions finite; raises as ``read``."""
    from msal_cli.kernels import stl_facets
    from msal_cli.kernels.text import as_bytes

    buf = without_end_mark(as_bytes(data))
    state = np.zeros(stl_facets.N_STATE, dtype=np.int64)
    if bytes(buf[:3]) == BYTE_ORDER_MARK:
        state[stl_facets.AT] = len(BYTE_ORDER_MARK)
    facets = scan_facets(buf, state, np.zeros(4, dtype=np.int64))
    status, at, word = facets.status
    if status != stl_facets.WHOLE:
        raise scan_error(buf, status, at, word, len(facets.facet_at))
    numbers = facets.numbers
    check_not_empty(len(numbers))
    check_countable(len(numbers))
    decide_numbers(data, facets.facet_at, facets.offsets, numbers)
    n_solids, n_bare = int(state[stl_facets.SOLIDS]), int(state[stl_facets.WITHOUT_NORMAL])
    scan = Scan(
        facets.facet_at, facets.offsets, facets.decimals, facets.names, n_solids, len(buf), n_bare
    )
    return scan, numbers


def decide_numbers(
    data: Buffer,
    facet_at: Longs,
    offsets: Ints,
    numbers: Floats,
) -> None:
    """Read numbers (m, 12) that are in doubt; raises for a position that is not finite."""
    doubtful = np.argwhere(~np.isfinite(numbers[:, 3:]))
    view = memoryview(data).cast("B")
    for facet, token in doubtful:
        start = int(facet_at[facet] + offsets[facet, token + 3])
        value = _read_number(view, start)
        if not np.isfinite(value):
            raise not_finite(int(facet), int(token) // 3, line_of(data, start))
        numbers[facet, token + 3] = value
    for facet, token in np.argwhere(np.isinf(numbers[:, :3])):
        start = int(facet_at[facet] + offsets[facet, token])
        numbers[facet, token] = _read_number(view, start)


def _read_number(view: memoryview, start: int) -> float:
    token = bytes(view[start : start + 4096]).split(None, 1)[0]
    try:
        return float(token)
    except ValueError:
        return float("nan")


def without_end_mark(buf: Bytes) -> Bytes:
    """A text without what some editors end it with: a NUL, or the end-of-file mark of old
    systems."""
    n_last = min(len(buf), 4096)
    return buf[: len(bytes(buf[-4096:]).rstrip(b"\0\x1a")) - n_last + len(buf)]


class Facets(NamedTuple):
    """What ``kernels.stl_facets.scan`` finds, and its last answer: status, byte, expected word."""

    facet_at: Longs
    offsets: Ints
    numbers: Floats
    decimals: Longs
    names: tuple[str, ...]
    status: tuple[int, int, int]


def scan_facets(buf: Bytes, state: Longs, decimals: Longs) -> Facets:
    """All facets of a text, from ``state`` on; ``decimals`` (4,) are carried on, too.

    The arrays grow with what is scanned, never with what is claimed.
    """
    from msal_cli.kernels import stl_facets

    room = min(len(buf) // _USUAL_FACET, len(buf) // MIN_FACET_BYTES) + 1
    facet_at = np.empty(room, dtype=np.int64)
    offsets = np.empty((room, 12), dtype=np.int32)
    numbers = np.empty((room, 12))
    solid_at = np.zeros(stl_facets.MAX_SOLIDS, dtype=np.int64)
    while True:
        status, stop, word = stl_facets.scan(
            buf, state, facet_at, offsets, numbers, solid_at, decimals
        )
        n = int(state[stl_facets.FACETS])
        if status != stl_facets.FULL:
            break
        room = min(len(buf) // MIN_FACET_BYTES + 1, n + n // 2 + 16)
        for array in (facet_at, offsets, numbers):
            array.resize((room, *array.shape[1:]), refcheck=False)
    for array in (facet_at, offsets, numbers):
        array.resize((n, *array.shape[1:]), refcheck=False)
    names = tuple(
        bytes(buf[at : at + 256]).splitlines()[0].decode("utf-8", "replace").strip()
        if at < len(buf)
        else ""
        for at in (int(one) for one in solid_at[: state[stl_facets.SOLIDS]])
    )
    answer = int(status), int(stop), int(word)
    return Facets(facet_at, offsets, numbers, decimals, names, answer)


def scan_error(buf: Bytes, status: int, at: int, word: int, facet: int) -> InputError:
    """The error for a text that ``stl_facets.scan`` does not accept."""
    from msal_cli.kernels import stl_facets

    token = (bytes(buf[at : at + 60]).split(None, 1) or [b""])[0]
    touches_end = at + len(token) == len(buf)
    where = f"facet {facet}, line {line_of(buf, at)}"
    wanted = stl_facets.WORDS[word]
    others = {stl_facets.FACET: ("endsolid",), stl_facets.NORMAL: ("outer",)}
    known = (wanted, *others.get(word, ()))
    cut = status == stl_facets.CUT or (
        touches_end
        and (
            status == stl_facets.BAD_NUMBER
            or (
                status == stl_facets.WRONG
                and any(w.encode().startswith(token.lower()) for w in known)
            )
        )
    )
    if cut:
        return TruncatedError(
            f"the text ends within a solid, after {facet} whole facets",
            where=where,
            hint="the file was cut short; copy or export it again",
        )
    text = token.decode("ascii", "backslashreplace")
    if status == stl_facets.OUTSIDE:
        return FormatError(
            f"expected 'solid', found {text!r}",
            where=where,
            hint="ascii STL is a list of solids; is this another format?",
        )
    if status == stl_facets.BAD_NUMBER:
        return FormatError(
            f"{text!r} is not a number",
            where=where,
            hint=number_hint(token),
        )
    if status == stl_facets.TOO_LONG:
        return TooLargeError("a single facet takes more than 2 GiB of text", where=where)
    hint = EXPORT_AGAIN
    if word == stl_facets.ENDLOOP and token.lower() == b"vertex":
        hint = "a facet of STL has three corners; triangulate the mesh first"
    return FormatError(f"expected '{wanted}', found {text!r}", where=where, hint=hint)


_AT_ONCE = 1 << 14
_NORMAL_DECIMALS = 6
_NOISE = 1e-9
"""Decimals of tiny numbers with an exponent count only down to this part of the extent."""


def read(data: Buffer, name: str) -> StlTextFile:
    """Read an ascii STL file.

    Raises
    ------
    TruncatedError
        if the text ends within a solid.
    FormatError
        for a wrong word, with its line.
    ContentError
        ``E_NO_FACES`` or ``E_NONFINITE``.
    """
    from msal_cli.kernels.welding import weld_corners

    scan, numbers = read_numbers(data)
    vertices, faces, _ = weld_corners(numbers[:, 3:])
    normals = np.ascontiguousarray(numbers[:, :3])
    return StlTextFile(data, scan, vertices, normals, faces)


def count_bad(normals: Floats) -> int:
    """Normals (m, 3) that are not three finite numbers."""
    # A sum is finite only if all are, and quicker; it may overflow, too.
    with np.errstate(over="ignore", invalid="ignore"):
        is_odd = not np.isfinite(normals.sum())
    return int((~np.isfinite(normals).all(axis=1)).sum()) if is_odd else 0


def list_warnings(n_bare: int, n_bad: int, trailing: int) -> tuple[str, ...]:
    """What a user should know: of facets without a normal, of those with one that is none, and of
    bytes behind the last solid."""
    warnings: list[str] = []
    if n_bare:
        warnings.append(
            f"{_count_text(n_bare, 'facet has', 'facets have')} no normal, and none is added"
        )
    if n_bad:
        warnings.append(
            f"{_count_text(n_bad, 'facet has', 'facets have')} a normal that is not three finite "
            "numbers: it is kept, not recomputed"
        )
    if trailing:
        warnings.append(f"{trailing} bytes behind the last solid are kept as they are")
    return tuple(warnings)


def _count_text(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"


def list_properties(has_normals: bool, n_solids: int, names: Sequence[str]) -> tuple[str, ...]:
    """What is carried along beside corners."""
    several = (f"{n_solids} solids",) if n_solids > 1 else ()
    named = tuple(f"solid {name!r}" for name in names if name)
    return (*(("facet normals",) * has_normals), *several, *named)


def choose_decimals(decimals: Longs, low: Floats, high: Floats) -> tuple[int, int]:
    """Digits behind the point for normals and for corners: never fewer than the file has.

    Tokens with an exponent can have any number (``1.5e-17``); theirs count as far as they
    mean something beside the size of the mesh.  ``decimals`` (4,) as of ``stl_facets.scan``,
    ``low`` and ``high`` (3,) are the corners of the box of all vertices.
    """
    from msal_cli.kernels.numbers import MAX_DECIMALS

    plain_normal, plain, exponent_normal, exponent = (int(d) for d in decimals)
    span = high - low
    extent = max(float(np.sqrt((span * span).sum())), 1e-300)
    needed = int(np.ceil(-np.log10(extent * 1e-7)))
    meant = int(np.ceil(-np.log10(extent * _NOISE)))
    normal = max(plain_normal, min(exponent_normal, 9), _NORMAL_DECIMALS)
    corner = max(plain, min(exponent, meant), needed, 0)
    return min(normal, MAX_DECIMALS), min(corner, MAX_DECIMALS)


class StlTextFile(FacetFile):
    """An ascii STL file; ``normals`` (m, 3) are those of its facets, as they are stored."""

    encoding = "ascii"
    precision = "text"

    def __init__(
        self, data: Buffer, scan: Scan, vertices: Floats, normals: Floats, faces: Ints
    ) -> None:
        properties = list_properties(scan.n_bare != len(faces), scan.n_solids, scan.names)
        trailing = len(memoryview(data).cast("B")) - scan.end
        warnings = list_warnings(scan.n_bare, count_bad(normals) - scan.n_bare, trailing)
        super().__init__(data, vertices, faces, properties, warnings)
        self.normals = normals
        self._scan = scan

    def _decimals(self) -> tuple[int, int]:
        """Digits behind the point for normals and for corners."""
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        return choose_decimals(self._scan.decimals, low, high)

    def _is_beyond_fixed(self, largest: float) -> bool:
        """Whether a new number has no fixed-point text, ``largest`` being the largest of all."""
        from msal_cli.kernels.numbers import FIXED_BELOW

        return largest >= FIXED_BELOW

    def _changes(self, vertices: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """The new numbers (m, 12) and which of them are to be written."""
        from msal_cli.kernels.stl_facets import renew_facet_normals

        require_shape(vertices, self.vertices)
        require_finite_result(vertices)
        m = len(self.faces)
        numbers, replace = np.empty((m, 12)), np.empty((m, 12), dtype=bool)
        numbers[:, :3], changed = renew_facet_normals(
            self.vertices, vertices, self.faces, self.normals
        )
        numbers[:, 3:] = vertices[self.faces].reshape(m, 9)
        replace[:, :3] = changed[:, None]
        replace[:, 3:] = (vertices != self.vertices)[self.faces].reshape(m, 9)
        return numbers, replace

    def replaced(self, vertices: Floats) -> Buffer:
        """The file with other vertices (n, 3) and the normals of moved facets recomputed."""
        if np.array_equal(vertices, self.vertices):
            return self.data
        from msal_cli.kernels import stl_facets, text

        numbers, replace = self._changes(vertices)
        buf = text.as_bytes(self.data)
        decimals = np.array(self._decimals(), dtype=np.int64)
        scan = self._scan
        parts = (slice(at, at + _AT_ONCE) for at in range(0, len(numbers), _AT_ONCE))
        largest = max(
            float(np.abs(numbers[part]).max(where=replace[part], initial=0.0)) for part in parts
        )
        if self._is_beyond_fixed(largest):
            starts = (scan.facet_at[:, None] + scan.offsets)[replace]
            return self._write_shortest(starts, numbers[replace])
        width = text.fixed_width(largest, int(decimals.max()))
        out = np.empty(len(buf) + int(np.count_nonzero(replace)) * width, dtype=np.uint8)
        length = stl_facets.write_tokens(
            buf, scan.facet_at, scan.offsets, replace, numbers, decimals, out
        )
        return out[:length].data

    def _write_shortest(self, starts: NDArray[np.int64], numbers: Floats) -> bytes:
        """The text with tokens replaced by the shortest text of numbers of any size."""
        view = memoryview(self.data).cast("B")
        pieces: list[bytes | memoryview] = []
        copied = 0
        for start, number in zip(starts.tolist(), numbers.tolist(), strict=True):
            pieces += [view[copied:start], repr(number).encode()]
            copied = start + len(bytes(view[start : start + 4096]).split(None, 1)[0])
        return b"".join([*pieces, view[copied:]])

    def check(self, output: Buffer, vertices: Floats) -> None:
        """Raise InternalError unless ``output`` is this file with only ``vertices`` replaced."""
        from msal_cli.kernels import stl_facets
        from msal_cli.kernels.text import as_bytes

        try:
            other, there = read_numbers(output)
        except InputError as failure:
            raise InternalError(
                f"the STL text that was made cannot be read: {failure}", where=failure.where
            ) from failure
        if len(there) != len(self.faces):
            raise InternalError("the number of facets changed")
        _, replace = self._changes(vertices)
        scan = self._scan
        if not stl_facets.is_same_outside(
            as_bytes(self.data),
            scan.facet_at,
            scan.offsets,
            as_bytes(output),
            other.facet_at,
            other.offsets,
            replace,
        ):
            raise InternalError("text other than that of moved corners changed")
        step = 10.0 ** -self._decimals()[1]
        for first in range(0, len(there), _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            corners = vertices[self.faces[part]].reshape(-1, 9)
            self._check_part(there[part], corners, replace[part, 0], step, first)

    def _check_part(
        self, there: Floats, corners: Floats, is_new: NDArray[np.bool_], step: float, first: int
    ) -> None:
        """Compare numbers (k, 12) that were read again, from facet ``first`` on, with corners
        (k, 9) within half a ``step``; normals where they ``is_new`` must have unit length."""
        wrong = np.abs(there[:, 3:] - corners) > 0.5 * step + 4e-16 * np.abs(corners)
        if wrong.any():
            facet, at = (int(one) for one in np.argwhere(wrong)[0])
            raise InternalError(
                "a corner was not written right", where=f"facet {first + facet}, corner {at // 3}"
            )
        with np.errstate(over="ignore"):
            length = np.linalg.norm(there[:, :3], axis=1)
        wrong_normals = is_new & ~(np.abs(length - 1.0) < 1e-5)
        if wrong_normals.any():
            raise InternalError(
                "a normal was not written right", where=f"facet {first + wrong_normals.argmax()}"
            )

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        """The file with ``vertices`` (n, 3) as ``encoding`` (same, ascii, binary).

        Raises
        ------
        UnsupportedError
            for a binary file of float64, which STL does not have.
        """
        if encoding in ("same", "ascii"):
            if precision == "float32":
                vertices = as_float32(vertices).astype(np.float64)
            return self.replaced(vertices)
        refuse_float64(precision)
        numbers, _ = self._changes(vertices)
        return binary_stl(numbers[:, 3:], numbers[:, :3], self._scan.names[0])
