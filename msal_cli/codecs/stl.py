"""STL: binary here, ascii in ``stl_ascii``; positions and normals replaced in the file's own bytes.

A binary file is 80 bytes of free text, a count, and for each facet 50 bytes: normal and three
corners as little-endian float32, and one 16-bit word that some programs use for colours.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints
from msal_cli.codecs import stl_ascii
from msal_cli.codecs.slots import too_large_for_float32
from msal_cli.codecs.stl_checks import (
    FACET,
    HEADER_BYTES,
    check_countable,
    check_not_empty,
    not_finite,
)
from msal_cli.codecs.stl_writer import ascii_stl, refuse_float64
from msal_cli.errors import (
    FormatError,
    InternalError,
    TruncatedError,
)
from msal_cli.storage.buffers import Buffer

_FIRST_FACET = HEADER_BYTES + 4
_LOOKED_AT = 1024
_AT_ONCE = 1 << 14
"""Facets whose bytes, old and new, stay in the processor's cache."""

_PADDING = 8
_NAMED_SOLID = re.compile(
    rb"\s*solid[ \t][^\r\n]*[\r\n]\s*facet\s+(?:normal|outer)\s", re.IGNORECASE
)
_SURELY_FLOAT32 = 3.4e38


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
    # The free text of a binary file may begin with these bytes too.
    if size < max(wanted, _FIRST_FACET) and head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise FormatError(
            "the file is UTF-16 text", where="byte 0", hint="save it as ASCII or UTF-8"
        )
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
    from msal_cli.kernels.corner_welding import indexed

    trailing = len(memoryview(data).cast("B")) - _FIRST_FACET - FACET.itemsize * count
    check_not_empty(count, trailing)
    check_countable(count)
    fixed = memoryview(data).toreadonly()
    facets = np.frombuffer(fixed, dtype=FACET, count=count, offset=_FIRST_FACET)
    vertices, faces, bad = indexed(facets["corners"])
    if bad >= 0:
        raise not_finite(bad, int(np.isfinite(facets["corners"][bad]).argmin()) // 3)
    warnings: list[str] = []
    if trailing:
        more = trailing // FACET.itemsize
        warnings.append(
            f"{trailing} bytes behind the last facet are kept as they are"
            + (f"; they have room for {more} facets that the header does not count" if more else "")
        )
    return StlFile(data, vertices, faces, _properties(data, facets), tuple(warnings))


def _properties(data: Buffer, facets: NDArray[np.void]) -> tuple[str, ...]:
    """What a binary file has besides positions."""
    header = bytes(memoryview(data).cast("B")[:HEADER_BYTES])
    found = []
    # Neither zero nor minus zero; most files tell in the first part.
    parts = (facets["normal"][at : at + _AT_ONCE] for at in range(0, len(facets), _AT_ONCE))
    if any((_bits(part) & 0x7FFFFFFF).any() for part in parts):
        found.append("facet normals")
    if facets["attribute"].any():
        found.append("facet attribute words")
    if b"COLOR=" in header:
        found.append("colour in the header")
    if b"MATERIAL=" in header:
        found.append("material in the header")
    if header.strip(b"\0 "):
        found.append("header text")
    return tuple(found)


@dataclass(eq=False)
class StlFile:
    """A binary STL file; see ``codecs.mesh_file.MeshFile``.

    ``vertices`` are the different positions of corners, in order of appearance.
    """

    data: Buffer = field(repr=False)
    vertices: Floats
    faces: Ints
    properties: tuple[str, ...]
    warnings: tuple[str, ...]
    format: str = "stl"
    encoding: str = "binary_little_endian"
    precision: str = "float32"
    references: tuple[str, ...] = ()
    n_polygons: int = field(init=False)
    merged_vertices: int = field(init=False)

    def __post_init__(self) -> None:
        self.n_polygons = len(self.faces)
        self.merged_vertices = self.faces.size - len(self.vertices)

    @property
    def _end(self) -> int:
        """The first byte behind the last facet."""
        return _FIRST_FACET + FACET.itemsize * self.n_polygons

    @property
    def _facets(self) -> NDArray[np.void]:
        return self._facets_of(self.data)

    def _facets_of(self, data: Buffer) -> NDArray[np.void]:
        # One kind of array, whatever the buffer.
        fixed = memoryview(data).toreadonly()
        return np.frombuffer(fixed, dtype=FACET, count=self.n_polygons, offset=_FIRST_FACET)

    def polygons(self) -> Ints:
        """The facets as an (m, 3) array."""
        return self.faces

    @property
    def normals(self) -> Floats:
        """The stored facet normals (m, 3), as they are."""
        return _as_float64(self._facets["normal"])

    @property
    def solids(self) -> tuple[str, ...]:
        """The header's text, as the name of the one solid."""
        header = bytes(memoryview(self.data).cast("B")[:HEADER_BYTES])
        return (header.split(b"\0")[0].decode("ascii", "replace").strip(),)

    def forget_vertices(self) -> None:
        """Do nothing: to read them again takes long."""

    def replaced(self, vertices: Floats) -> Buffer:
        """The file with other vertices (n, 3) and the normals of moved facets recomputed.

        Raises
        ------
        ContentError
            with code ``E_RANGE`` if a position does not fit into float32.
        """
        if np.array_equal(self.vertices, vertices):
            return self.data
        from msal_cli.kernels.facet_normals import replaced
        from msal_cli.kernels.parallel import over_ranges

        self._require_float32(vertices)
        before = np.frombuffer(self.data, dtype=np.uint8)
        output = np.empty_like(before)
        for rest in (slice(_FIRST_FACET), slice(self._end, None)):
            output[rest] = before[rest]
        facets = output[_FIRST_FACET : self._end].view(FACET)
        normals, corners = facets["normal"], facets["corners"]
        untold = np.empty(0, dtype=bool)

        def write(start: int, stop: int) -> None:
            for first in range(start, stop, _AT_ONCE):
                last = min(first + _AT_ONCE, stop)
                part = slice(
                    _FIRST_FACET + FACET.itemsize * first, _FIRST_FACET + FACET.itemsize * last
                )
                # Just copied, the bytes are near when they are changed.
                output[part] = before[part]
                replaced(first, last, self.vertices, vertices, self.faces, normals, corners, untold)

        over_ranges(write, len(facets))
        return output.data

    def _require_float32(self, vertices: Floats) -> None:
        """Raise ContentError for a position that float32 does not hold."""
        if max(vertices.max(), -vertices.min()) < _SURELY_FLOAT32:
            return
        with np.errstate(over="ignore"):
            too_large = np.asarray(np.isinf(vertices.astype(np.float32)).any(axis=1))
        if too_large.any():
            facet = int(np.argmax(too_large[self.faces].any(axis=1)))
            raise too_large_for_float32(f"facet {facet}")

    def check(self, output: Buffer, vertices: Floats) -> None:
        """Raise InternalError unless ``output`` is this file with only ``vertices`` replaced."""
        from msal_cli.kernels import stl_check as facets
        from msal_cli.kernels.parallel import over_ranges

        before, after = memoryview(self.data).cast("B"), memoryview(output).cast("B")
        if len(before) != len(after) or before[:_FIRST_FACET] != after[:_FIRST_FACET]:
            raise InternalError("the STL header or the length of the file changed")
        if before[self._end :] != after[self._end :]:
            raise InternalError("the bytes behind the last facet changed")
        old, new = self._facets, self._facets_of(output)
        found: list[tuple[int, int]] = []

        def look(start: int, stop: int) -> None:
            found.append(
                facets.checked(
                    start,
                    stop,
                    self.vertices,
                    vertices,
                    self.faces,
                    _words(old),
                    _words(new),
                    old["corners"],
                    new["normal"],
                    new["corners"],
                )
            )

        over_ranges(look, self.n_polygons)
        for facet, wrong in sorted(found):
            if wrong != facets.RIGHT:
                raise InternalError(
                    {
                        facets.CORNER: "a corner was not written right",
                        facets.NORMAL: "a normal was not written right",
                        facets.ATTRIBUTE: "the attribute words of an STL file changed",
                    }[wrong],
                    where=f"facet {facet}",
                )

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
        from msal_cli.kernels.facet_normals import renewed_facet_normals

        stored = self.normals
        normals, _ = renewed_facet_normals(self.vertices, vertices, self.faces, stored)
        corners = vertices[self.faces].reshape(-1, 9)
        return ascii_stl(corners, normals, self.solids[0], single=precision != "float64")


def _words(facets: NDArray[np.void]) -> NDArray[np.uint16]:
    return facets.view("<u2").reshape(-1, FACET.itemsize // 2)


def _as_float64(stored: NDArray[np.float32]) -> Floats:
    with np.errstate(invalid="ignore"):  # a signalling NaN
        return stored.astype(np.float64)


def _bits(stored: NDArray[np.float32]) -> NDArray[np.uint32]:
    return stored.view("<u4")
