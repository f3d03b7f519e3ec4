"""STL: binary here, ascii in ``stl_ascii``; positions and normals replaced in the file's own bytes.

A binary file is 80 bytes of free text, a count, and for each facet 50 bytes: normal and three
corners as little-endian float32, and one 16-bit word that some programs use for colours.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints
from msal_cli.codecs import stl_ascii
from msal_cli.codecs.slot_file import require_finite_result, require_shape
from msal_cli.codecs.slots import require_range
from msal_cli.codecs.stl_facets import (
    FACET,
    HEADER_BYTES,
    FacetFile,
    ascii_stl,
    check_countable,
    check_not_empty,
    not_finite,
    refuse_float64,
)
from msal_cli.errors import (
    InternalError,
    TruncatedError,
)
from msal_cli.storage.regular import Buffer

_FIRST_FACET = HEADER_BYTES + 4
_LOOKED_AT = 1024
_AT_ONCE = 1 << 14
"""Facets whose bytes, old and new, stay in the processor's cache."""

_PADDING = 8
_NAMED_SOLID = re.compile(
    rb"\s*solid[ \t][^\r\n]*[\r\n]\s*facet\s+(?:normal|outer)\s", re.IGNORECASE
)


def read(data: Buffer, name: str) -> StlFile | stl_ascii.StlTextFile:
    """Read an STL file, binary or ascii.

    A file whose first kilobyte is text is ascii (see ``is_text``).  In a binary file, whatever it
    begins with, that kilobyte holds the count and the first numbers, and with them control
    characters: the count alone has some unless it is beyond 500 million.

    Raises
    ------
    TruncatedError
        if the file is shorter than its count asks for, or an ascii solid does not end.
    FormatError
        if it is not STL, or an ascii file has a wrong word.
    ContentError
        ``E_NO_FACES`` or ``E_NONFINITE``.
    """
    size = len(memoryview(data).cast("B"))
    head = bytes(memoryview(data).cast("B")[:_LOOKED_AT])
    if is_text(head, size):
        return stl_ascii.read(data, name)
    wanted = wanted_bytes(head, size)
    return _read_binary(data, (wanted - _FIRST_FACET) // FACET.itemsize)


def wanted_bytes(head: bytes, size: int) -> int:
    """The bytes that a binary file of ``size`` bytes that begins with ``head`` should have.

    Raises FormatError for text of another kind and TruncatedError for a file that has fewer.
    """
    count = int.from_bytes(head[HEADER_BYTES:_FIRST_FACET], "little")
    wanted = _FIRST_FACET + FACET.itemsize * count
    if size < _FIRST_FACET:
        raise TruncatedError(
            f"the file has {size} bytes; a binary STL file has at least {_FIRST_FACET}",
            where=f"byte {size}",
            hint="the file was cut short; copy or export it again",
        )
    if size < wanted:
        whole = (size - _FIRST_FACET) // FACET.itemsize
        raise TruncatedError(
            f"the header counts {count} facets, which take {wanted} bytes, but the file has "
            f"{size}: {whole} whole facets",
            where=f"byte {size}",
            hint="the file was cut short, or is not STL; copy or export it again",
        )
    return wanted


def is_text(head: bytes, size: int) -> bool:
    """Whether a file of ``size`` bytes is text, judged by the first kilobyte of ``head``.

    A few bytes of padding at the end do not count, nor do control characters in the name of a solid
    that begins with a facet in words; a header filled with zeros is not text.
    """
    head = head[:_LOOKED_AT]
    shown = head[:-_PADDING] + head[-_PADDING:].rstrip(b"\0\x1a")
    if bool(shown) and not any(c < 32 and c not in b"\t\n\v\f\r" for c in shown):
        return True
    count = int.from_bytes(head[HEADER_BYTES:_FIRST_FACET], "little")
    return size != _FIRST_FACET + FACET.itemsize * count and _NAMED_SOLID.match(head) is not None


def _read_binary(data: Buffer, count: int) -> StlFile:
    from msal_cli.kernels.welding import weld_corners

    trailing = len(memoryview(data).cast("B")) - _FIRST_FACET - FACET.itemsize * count
    check_not_empty(count, trailing)
    check_countable(count)
    facets = _facets(data, count)
    vertices, faces, bad = weld_corners(facets["corners"])
    if bad >= 0:
        raise not_finite(bad, int(np.isfinite(facets["corners"][bad]).argmin()) // 3)
    warnings = trailing_warning(trailing)
    return StlFile(data, vertices, faces, _properties(data, facets), warnings)


def trailing_warning(n_bytes: int) -> tuple[str, ...]:
    """What a user should know of bytes that follow the last facet."""
    if not n_bytes:
        return ()
    more = n_bytes // FACET.itemsize
    return (
        f"{n_bytes} bytes behind the last facet are kept as they are"
        + (f"; they have room for {more} facets that the header does not count" if more else ""),
    )


def _facets(data: Buffer, count: int) -> NDArray[np.void]:
    # One kind of array, whatever the buffer.
    fixed = memoryview(data).toreadonly()
    return np.frombuffer(fixed, dtype=FACET, count=count, offset=_FIRST_FACET)


def _properties(data: Buffer, facets: NDArray[np.void]) -> tuple[str, ...]:
    """What a binary file has besides positions."""
    header = bytes(memoryview(data).cast("B")[:HEADER_BYTES])
    # Neither zero nor minus zero; most files tell in the first part.
    parts = (facets["normal"][at : at + _AT_ONCE] for at in range(0, len(facets), _AT_ONCE))
    has_normals = any((part.view("<u4") & 0x7FFFFFFF).any() for part in parts)
    return colour_properties(header, has_normals, bool(facets["attribute"].any()))


def colour_properties(header: bytes, has_normals: bool, has_words: bool) -> tuple[str, ...]:
    """What a file with this header has besides positions, in words."""
    found = []
    if has_normals:
        found.append("facet normals")
    if has_words:
        found.append("facet attribute words")
    if b"COLOR=" in header:
        found.append("colour in the header")
    if b"MATERIAL=" in header:
        found.append("material in the header")
    if header.strip(b"\0 "):
        found.append("header text")
    return tuple(found)


class StlFile(FacetFile):
    """A binary STL file."""

    encoding = "binary_little_endian"
    precision = "float32"

    @property
    def _end(self) -> int:
        return _FIRST_FACET + FACET.itemsize * self.n_polygons

    @property
    def normals(self) -> Floats:
        """The stored facet normals (m, 3), as they are."""
        with np.errstate(invalid="ignore"):  # a signalling NaN
            return _facets(self.data, self.n_polygons)["normal"].astype(np.float64)

    def replaced(self, vertices: Floats) -> Buffer:
        """The file with other vertices (n, 3) and the normals of moved facets recomputed.

        Raises
        ------
        ContentError
            with code ``E_RANGE`` if a position does not fit into float32.
        """
        require_shape(vertices, self.vertices)
        if np.array_equal(self.vertices, vertices):
            return self.data
        from msal_cli.kernels.parallel import over_ranges
        from msal_cli.kernels.stl_facets import replace_facets

        require_range(vertices, np.broadcast_to(True, vertices.shape), ("<f4",) * 3)
        before = np.frombuffer(self.data, dtype=np.uint8)
        output = np.empty_like(before)
        for rest in (slice(_FIRST_FACET), slice(self._end, None)):
            output[rest] = before[rest]
        facets = output[_FIRST_FACET : self._end].view(FACET)
        normals, corners = facets["normal"], facets["corners"]
        none = np.empty(0, dtype=bool)

        def write(start: int, stop: int) -> None:
            for first in range(start, stop, _AT_ONCE):
                last = min(first + _AT_ONCE, stop)
                part = slice(
                    _FIRST_FACET + FACET.itemsize * first, _FIRST_FACET + FACET.itemsize * last
                )
                # Just copied, the bytes are near when they are changed.
                output[part] = before[part]
                replace_facets(
                    first, last, self.vertices, vertices, self.faces, normals, corners, none
                )

        over_ranges(write, len(facets))
        return output.data

    def check(self, output: Buffer, vertices: Floats) -> None:
        """Raise InternalError unless ``output`` is this file with only ``vertices`` replaced."""
        require_shape(vertices, self.vertices)
        require_finite_result(vertices)
        before, after = memoryview(self.data).cast("B"), memoryview(output).cast("B")
        if len(before) != len(after) or before[:_FIRST_FACET] != after[:_FIRST_FACET]:
            raise InternalError("the STL header or the length of the file changed")
        if before[self._end :] != after[self._end :]:
            raise InternalError("the bytes behind the last facet changed")
        old, new = _facets(self.data, self.n_polygons), _facets(output, self.n_polygons)
        check_replaced(old, new, self.vertices, vertices, self.faces)

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        """The file with ``vertices`` (n, 3) as ``encoding`` (same, ascii, binary).

        Raises
        ------
        UnsupportedError
            for a binary file of float64, which STL does not have.
        """
        if encoding in ("same", "binary", self.encoding):
            refuse_float64(precision)
            return self.replaced(vertices)
        from msal_cli.kernels.stl_facets import renew_facet_normals

        require_shape(vertices, self.vertices)
        normals, _ = renew_facet_normals(self.vertices, vertices, self.faces, self.normals)
        corners = vertices[self.faces].reshape(-1, 9)
        header = bytes(memoryview(self.data).cast("B")[:HEADER_BYTES])
        name = header.split(b"\0")[0].decode("ascii", "replace")
        return ascii_stl(corners, normals, name, single=precision != "float64")


def check_replaced(
    before: NDArray[np.void],
    after: NDArray[np.void],
    old: Floats,
    new: Floats,
    faces: Ints,
) -> None:
    """Raise InternalError unless facets (m,) differ just as ``new`` vertices ask for.

    old, new (n, 3) : vertices, whose numbers are in ``faces`` (m, 3).
    """
    from msal_cli.kernels import stl_facets as facets
    from msal_cli.kernels.parallel import over_ranges

    found: list[tuple[int, int]] = []

    def look(start: int, stop: int) -> None:
        found.append(
            facets.check_facets(
                start,
                stop,
                old,
                new,
                faces,
                _words(before),
                _words(after),
                before["corners"],
                after["normal"],
                after["corners"],
            )
        )

    over_ranges(look, len(before))
    for facet, wrong in sorted(found):
        if wrong != facets.RIGHT:
            raise InternalError(
                {
                    facets.WRONG_CORNER: "a corner was not written right",
                    facets.WRONG_NORMAL: "a normal was not written right",
                    facets.WRONG_ATTRIBUTE: "the attribute words of an STL file changed",
                }[wrong],
                where=f"facet {facet}",
            )


def _words(facets: NDArray[np.void]) -> NDArray[np.uint16]:
    return facets.view("<u2").reshape(-1, FACET.itemsize // 2)
