"""STL: binary here, ascii in ``stl_ascii``; positions and normals replaced in the file's own bytes.

A binary file is 80 bytes of free text, a count, and for each facet 50 bytes: normal and three
corners as little-endian float32, and one 16-bit word that some programs use for colours.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from msal_cli.dataclass import dataclass
from msal_cli.errors import (
    ContentError,
    FormatError,
    InternalError,
    TruncatedError,
    UnsupportedError,
)
from msal_cli.files import stl_ascii
from msal_cli.files.base import Buffer
from msal_cli.files.stl_facets import check_not_empty, not_finite, soup_faces

Floats = NDArray[np.float64]

HEADER_BYTES = 80
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", 9), ("attribute", "<u2")])
"""One facet, 50 bytes without padding."""

_FIRST_FACET = HEADER_BYTES + 4
_LOOKED_AT = 1024
_AT_ONCE = 1 << 15
_PADDING = 8


def read(data: Buffer, name: str) -> StlFile | stl_ascii.StlTextFile:
    """Read an STL file, binary or ascii.

    A file whose first kilobyte is text is ascii.  In a binary file, whatever it begins with, that
    kilobyte holds the count and the first numbers, and with them control characters: the count
    alone has some unless it is beyond 500 million.

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
    if is_text(head):
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


def is_text(head: bytes) -> bool:
    """Whether the first kilobyte of ``head`` is text, of which ascii STL is made.

    A few bytes of padding at the end do not count; a header filled with zeros is not text.
    """
    head = head[:_LOOKED_AT]
    shown = head[:-_PADDING] + head[-_PADDING:].rstrip(b"\0\x1a")
    return bool(shown) and not any(c < 32 and c not in b"\t\n\v\f\r" for c in shown)


def _read_binary(data: Buffer, count: int) -> StlFile:
    trailing = len(memoryview(data).cast("B")) - _FIRST_FACET - FACET.itemsize * count
    check_not_empty(count, trailing)
    faces = soup_faces(count)
    facets = np.frombuffer(data, dtype=FACET, count=count, offset=_FIRST_FACET)
    vertices = _as_float64(facets["corners"]).reshape(-1, 3)
    finite = np.isfinite(vertices)
    if not finite.all():
        bad = int(np.argmin(finite.all(axis=1)))
        raise not_finite(bad // 3, bad % 3)
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
    if (_bits(facets["normal"]) & 0x7FFFFFFF).any():  # neither zero nor minus zero
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
    """A binary STL file; see ``files.base.MeshFile``.

    ``vertices`` are the corners in file order, three for each facet.
    """

    data: Buffer = field(repr=False)
    vertices: Floats
    faces: NDArray[np.int32]
    properties: tuple[str, ...]
    warnings: tuple[str, ...]
    format: str = "stl"
    encoding: str = "binary_little_endian"
    precision: str = "float32"
    references: tuple[str, ...] = ()
    n_polygons: int = field(init=False)

    def __post_init__(self) -> None:
        self.n_polygons = len(self.faces)

    @property
    def _facets(self) -> NDArray[np.void]:
        return self._facets_of(self.data)

    def _facets_of(self, data: Buffer) -> NDArray[np.void]:
        return np.frombuffer(data, dtype=FACET, count=self.n_polygons, offset=_FIRST_FACET)

    def polygons(self) -> NDArray[np.int32]:
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

    def replaced(self, vertices: Floats) -> Buffer:
        """The file with other corners (3m, 3) and the normals of moved facets recomputed.

        Raises
        ------
        ContentError
            with code ``E_RANGE`` if a position does not fit into float32.
        """
        old, new = self.vertices.reshape(-1, 9), vertices.reshape(-1, 9)
        if not (old != new).any():
            return self.data
        output = bytearray(self.data)
        before, after = self._facets, self._facets_of(output)
        for part in _parts(len(old)):
            moved = old[part] != new[part]
            corners = as_float32(new[part], part.start)
            after["corners"][part] = np.where(moved, corners, before["corners"][part])
            after["normal"][part] = self._renewed(new, part)
        return output

    def _renewed(self, new: Floats, part: slice) -> NDArray[np.float32]:
        """Facet normals of a part for corners (m, 9); unchanged ones keep their very bits."""
        from msal_cli.core.facet_normals import renewed_facet_normals

        stored = self._facets["normal"][part]
        normals, changed = renewed_facet_normals(
            self.vertices.reshape(-1, 9)[part], new[part], _as_float64(stored)
        )
        with np.errstate(all="ignore"):
            return np.where(changed[:, None], normals.astype(np.float32), stored)

    def check(self, output: Buffer, vertices: Floats) -> None:
        """Raise InternalError unless ``output`` is this file with only ``vertices`` replaced."""
        before, after = memoryview(self.data).cast("B"), memoryview(output).cast("B")
        end = _FIRST_FACET + FACET.itemsize * self.n_polygons
        if len(before) != len(after) or before[:_FIRST_FACET] != after[:_FIRST_FACET]:
            raise InternalError("the STL header or the length of the file changed")
        if before[end:] != after[end:]:
            raise InternalError("the bytes behind the last facet changed")
        old, new = self._facets, self._facets_of(output)
        for part in _parts(self.n_polygons):
            self._check_part(old[part], new[part], vertices.reshape(-1, 9)[part], part.start)

    def _check_part(
        self, old: NDArray[np.void], new: NDArray[np.void], corners: Floats, first: int
    ) -> None:
        if not np.array_equal(old["attribute"], new["attribute"]):
            raise InternalError("the attribute words of an STL file changed")
        moved = corners != old["corners"]
        written = new["corners"]
        wrong = np.where(
            moved, written != as_float32(corners, first), _bits(written) != _bits(old["corners"])
        )
        if wrong.any():
            facet = first + int(wrong.any(axis=1).argmax())
            raise InternalError("a corner was not written right", where=f"facet {facet}")
        changed = (_bits(old["normal"]) != _bits(new["normal"])).any(axis=1)
        normals = _as_float64(new["normal"][changed])
        unit = np.abs(np.einsum("ij,ij->i", normals, normals) - 1.0) < 1e-5
        if not (unit & moved[changed].any(axis=1)).all():
            facet = first + int(np.flatnonzero(changed)[np.argmin(unit)])
            raise InternalError("a normal was not written right", where=f"facet {facet}")

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        """The file with ``vertices`` (3m, 3) as ``encoding`` (same, ascii, binary).

        Raises
        ------
        UnsupportedError
            for a binary file of float64, which STL does not have.
        """
        if encoding in ("same", "binary", self.encoding):
            refuse_float64(precision)
            return self.replaced(vertices)
        corners = vertices.reshape(-1, 9)
        normals = _as_float64(self._renewed(corners, slice(0, None)))
        return stl_ascii.written(corners, normals, self.solids[0], single=precision != "float64")


def written(corners: Floats, normals: Floats, name: str) -> bytes:
    """A binary STL file of corners (m, 9) and normals (m, 3)."""
    facets = np.zeros(len(corners), dtype=FACET)
    facets["corners"] = as_float32(corners)
    with np.errstate(over="ignore", invalid="ignore"):
        single = normals.astype(np.float32)
    facets["normal"] = np.where(np.isfinite(single), single, np.float32(0.0))
    # A header that begins with "solid" would make readers take the file for text.
    header = b"binary STL " + name.encode("ascii", "replace")
    count = len(corners).to_bytes(4, "little")
    return header[:HEADER_BYTES].ljust(HEADER_BYTES) + count + facets.tobytes()


def _parts(n_facets: int) -> Iterator[slice]:
    """Ranges of facets whose temporary arrays stay in the processor's cache."""
    for start in range(0, n_facets, _AT_ONCE):
        yield slice(start, min(start + _AT_ONCE, n_facets))


def _as_float64(stored: NDArray[np.float32]) -> Floats:
    with np.errstate(invalid="ignore"):  # a signalling NaN
        return stored.astype(np.float64)


def _bits(stored: NDArray[np.float32]) -> NDArray[np.uint32]:
    return stored.view("<u4")


def as_float32(positions: Floats, first: int = 0) -> NDArray[np.float32]:
    """Positions (m, 9) or (n, 3) rounded to float32; ``first`` is the number of the first row.

    Raises
    ------
    ContentError
        with code ``E_RANGE`` if one is beyond float32's range.
    """
    with np.errstate(over="ignore", under="ignore"):
        rounded = positions.astype(np.float32)
    if not np.isfinite(rounded).all():
        bad = int(np.argmin(np.isfinite(rounded).reshape(len(rounded), -1).all(axis=1)))
        raise ContentError(
            "a position is too large for float32",
            code="E_RANGE",
            where=f"row {first + bad}",
            hint="scale the mesh, or write it to a format with float64",
        )
    return rounded


def refuse_float64(precision: str) -> None:
    """Raise UnsupportedError if binary STL is asked for float64."""
    if precision == "float64":
        raise UnsupportedError(
            "binary STL has no float64",
            hint="use --encoding ascii, or --to ply",
        )
