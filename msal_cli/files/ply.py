"""PLY files: positions and normals replaced inside the original bytes.

Read are ascii and both binary encodings, any elements and properties in any order, polygons
(``vertex_indices`` or ``vertex_index`` of ``face``) and triangle strips (``tristrips``).  Written
is a copy of the file in which only ``x y z`` of moved vertices, and the normals ``nx ny nz`` of
vertices and faces around them, differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msal_cli.errors import ContentError, FormatError, InternalError
from msal_cli.files import ply_layout
from msal_cli.files.base import Buffer
from msal_cli.files.ply_faces import CORNERS, Surface, corner_list, surface
from msal_cli.files.ply_header import Element, Header, parsed
from msal_cli.files.ply_layout import Bytes, Flags, Floats, Lines, Section, located
from msal_cli.files.ply_text import (
    Edit,
    edited,
    is_same_but_for,
    normal_decimals,
    position_decimals,
)

POSITION = ("x", "y", "z")
NORMAL = ("nx", "ny", "nz")

_CHUNK = 1 << 22
"""Bytes compared at a time, so that a comparison needs no temporary as large as the file."""


_UNIT = 1e-4
"""How far the length of a recomputed normal may be from 1 once it is rounded for the file."""


class Change(NamedTuple):
    """New ``values`` (count, 3) for the scalars ``names`` of a section, to be written where
    ``where`` (count, 3) is True."""

    section: Section
    names: tuple[str, ...]
    values: Floats
    where: Flags


def read(data: Buffer, name: str) -> PlyFile:
    """Open the PLY file ``data`` (its bytes); ``name`` is used in messages only.

    Raises FormatError (not PLY, or a line, type or value that breaks the format),
    TruncatedError (fewer bytes or lines than the counts promise), ContentError (``E_NONFINITE``,
    ``E_INDEX``, ``E_NO_FACES``), UnsupportedError and TooLargeError, each with the place.
    """
    return PlyFile(data, name)


class PlyFile:
    """An opened PLY file; see ``files.base.MeshFile`` for what its attributes mean.

    ``precision`` is the type of the coordinates: ``float32`` (also when mixed with double, since
    the coarsest one limits), ``float64``, ``text`` in ascii, or ``integer``.  Whole-number
    coordinates are rounded to the nearest whole number, halves to the even one.
    """

    format = "ply"

    def __init__(self, data: Buffer, name: str) -> None:
        from msal_cli.core.text import as_bytes

        self.name = name
        self._data = data
        self._bytes: Bytes = as_bytes(memoryview(data).cast("B"))
        self._header: Header = parsed(memoryview(data).cast("B"))
        self.encoding: str = self._header.encoding
        vertex = _vertex_element(self._header)
        sections, self._end = located(self._bytes, self._header, _wanted)
        self._sections: dict[str, Section] = sections
        self.vertices: Floats = _finite(sections["vertex"])
        self._surface: Surface = surface(sections, len(self.vertices))
        self.faces: NDArray[np.int32] = self._surface.triangles
        self.n_polygons: int = self._surface.n_polygons
        self.precision: str = _precision(self._header, vertex)
        self.properties: tuple[str, ...] = _properties(self._header)
        self._decimals_known: dict[tuple[str, tuple[str, ...]], tuple[int, ...]] = {}
        self.references: tuple[str, ...] = self._header.textures
        self.warnings: tuple[str, ...] = (
            *_header_warnings(self._header, vertex),
            *self._surface.warnings,
            *self._trailing_warning(),
        )

    def _trailing_warning(self) -> tuple[str, ...]:
        rest = self._bytes[self._end :]
        if self.encoding == "ascii" and not rest.tobytes().strip():
            return ()
        if not len(rest):
            return ()
        return (f"{len(rest)} bytes behind the last element are kept as they are",)

    # Replacing

    def replaced(self, vertices: Floats) -> Buffer:
        """The file with the positions ``vertices`` (n, 3), in file order and file units.

        A coordinate equal to the file's keeps its very bytes.  Raises ContentError (``E_RANGE``)
        where a new one does not fit the file's number type.
        """
        changed = self._changed(vertices)
        if not changed.any():
            return self._data
        _require_range(vertices, changed, self._codes(POSITION))
        changes = [Change(self._sections["vertex"], POSITION, vertices, changed)]
        changes += self._new_normals(vertices)
        if self.encoding == "ascii":
            return edited(
                self._bytes,
                [
                    Edit(section, names, values, where, self._decimals(section, names))
                    for section, names, values, where in changes
                    if isinstance(section, Lines)
                ],
            )
        output = bytearray(self._data)
        target = np.frombuffer(output, dtype=np.uint8)
        for section, names, values, where in changes:
            if not isinstance(section, Lines):
                section.write(target[section.start : section.stop], names, values, where)
        return output

    def _changed(self, vertices: Floats) -> Flags:
        """Which coordinates (n, 3) differ from the file's."""
        if vertices.shape != self.vertices.shape or vertices.dtype != np.float64:
            raise InternalError(f"positions of shape {vertices.shape} and type {vertices.dtype}")
        changed: Flags = vertices != self.vertices
        return changed

    def _codes(self, names: Sequence[str]) -> list[str]:
        element = self._sections["vertex"].element
        return [element.properties[element.index(name)].code for name in names]

    def _new_normals(self, vertices: Floats) -> list[Change]:
        """The stored normals of vertices and faces that are no longer right for ``vertices``."""
        changes: list[Change] = []
        moved: Flags = np.asarray(self._changed(vertices).any(axis=1))
        if not moved.any():
            return changes
        if _has_normals(self._header.find("vertex")):
            from msal_cli.core.geometry import regrouped_normals

            section = self._sections["vertex"]
            normals, changed = regrouped_normals(
                self.vertices, vertices, self.faces, self.faces, section.numbers(NORMAL)
            )
            changes.append(Change(section, NORMAL, normals, _three(changed)))
        if self._has_face_normals():
            section = self._sections["face"]
            normals, changed = self._surface.face_normals(
                self.vertices, vertices, moved, section.numbers(NORMAL)
            )
            changes.append(Change(section, NORMAL, normals, _three(changed)))
        return changes

    def _has_face_normals(self) -> bool:
        return self._surface.n_faces > 0 and _has_normals(self._header.find("face"))

    def _decimals(self, section: Lines, names: tuple[str, ...]) -> tuple[int, ...]:
        key = (section.element.name, names)
        if key not in self._decimals_known:
            self._decimals_known[key] = (
                position_decimals(section, names, self.vertices)
                if names == POSITION
                else normal_decimals(section, names)
            )
        return self._decimals_known[key]

    # Checking

    def check(self, output: Buffer, vertices: Floats) -> None:
        """Raise InternalError unless ``output`` is this file with only positions and normals
        replaced, by ``vertices`` (n, 3) up to the rounding of the file's number type."""
        changed = self._changed(vertices)
        result: Bytes = np.frombuffer(output, dtype=np.uint8)
        if not np.array_equal(result[: self._header.size], self._bytes[: self._header.size]):
            raise InternalError("the header of the output differs from the input's")
        touched = self._touched(np.asarray(changed.any(axis=1)))
        if self.encoding == "ascii":
            self._check_text(result, vertices, changed, touched)
        else:
            self._check_binary(result, vertices, changed, touched)

    def _touched(self, moved: Flags) -> dict[str, Flags]:
        """Which records of the elements with normals may get new ones: those near a move."""
        touched: dict[str, Flags] = {}
        if not moved.any():
            return touched
        if _has_normals(self._header.find("vertex")):
            from msal_cli.core.connectivity import welded

            near = np.zeros(len(self.vertices), dtype=bool)
            near[self.faces[moved[self.faces].any(axis=1)]] = True
            # The twins of a vertex at a seam share its normal.
            place = welded(self.vertices, self.faces)
            near_place = np.zeros(len(near), dtype=bool)
            near_place[place[near]] = True
            touched["vertex"] = near_place[place]
        if self._has_face_normals():
            touched["face"] = self._surface.touched(moved)
        return touched

    def _check_binary(
        self, result: Bytes, vertices: Floats, changed: Flags, touched: dict[str, Flags]
    ) -> None:
        if len(result) != len(self._bytes):
            raise InternalError("the output is not as long as the input")
        at = self._header.size
        for name, section in self._sections.items():
            if isinstance(section, Lines) or (name != "vertex" and name not in touched):
                continue
            _require_same(self._bytes[at : section.start], result[at : section.start])
            restored = result[section.start : section.stop].copy()
            if name == "vertex":
                stored = section.numbers(POSITION, restored)
                for k, code in enumerate(self._codes(POSITION)):
                    expected = ply_layout.stored(vertices[:, k], np.dtype(code))
                    if not np.array_equal(stored[:, k], expected):
                        raise InternalError("a coordinate of the output is not the computed one")
                section.write(restored, POSITION, self.vertices, changed)
            if name in touched:
                old, new = section.numbers(NORMAL), section.numbers(NORMAL, restored)
                _require_normals(old, new, touched[name])
                section.write(restored, NORMAL, old, _three(touched[name]))
            _require_same(self._bytes[section.start : section.stop], restored)
            at = section.stop
        _require_same(self._bytes[at:], result[at:])

    def _check_text(
        self, result: Bytes, vertices: Floats, changed: Flags, touched: dict[str, Flags]
    ) -> None:
        last = [name for name in self._sections if name == "vertex" or name in touched][-1]
        kept: list[tuple[Lines, Lines, Sequence[str], Flags]] = []
        for name, new in located(result, self._header, _wanted, last)[0].items():
            old = self._sections[name]
            if not isinstance(old, Lines) or not isinstance(new, Lines):
                continue
            if name == "vertex":
                stored = new.numbers(POSITION)
                for k, decimals in enumerate(self._decimals(old, POSITION)):
                    slack = 0.5 * 10.0**-decimals + np.spacing(np.abs(vertices[:, k]))
                    off = np.abs(stored[:, k] - vertices[:, k])
                    if (off > np.where(changed[:, k], slack, 0.0)).any():
                        raise InternalError("a coordinate of the output is not the computed one")
                kept.append((old, new, POSITION, changed))
            if name in touched:
                _require_normals(old.numbers(NORMAL), new.numbers(NORMAL), touched[name])
                kept.append((old, new, NORMAL, _three(touched[name])))
        if not is_same_but_for(self._bytes, result, kept):
            raise InternalError("the output differs from the input outside its positions")

    # Conversion

    def polygons(self) -> list[Any] | NDArray[np.int32]:
        """The faces as the file has them: (m, k) int32 where all have k corners, or a list.

        Faces of fewer than three corners are left out; strips give their triangles.
        """
        return self._surface.polygons()

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        """The file with new positions (n, 3) in another encoding or with other number types.

        ``encoding`` is ``same``, ``ascii`` or ``binary`` (little endian); ``precision`` is
        ``same``, ``float32`` or ``float64`` and concerns positions and normals.  Every element,
        property, comment and their order are kept; bytes behind the last element are kept where
        the encoding stays.  Raises ContentError (``E_RANGE``) where a value does not fit its
        type, FormatError where an ascii value is not of its declared type.
        """
        from msal_cli.files.ply_encode import Recoding

        retypable: dict[str, tuple[str, ...]] = {"vertex": POSITION}
        if _has_normals(self._header.find("vertex")):
            retypable["vertex"] = POSITION + NORMAL
        if self._has_face_normals():
            retypable["face"] = NORMAL
        recoding = Recoding(self._bytes, self._header, encoding, precision, retypable)
        changed = self._changed(vertices)
        if recoding.is_same:
            return self.replaced(vertices)
        element = self._sections["vertex"].element
        codes = [recoding.code(element.properties[element.index(name)]) for name in POSITION]
        _require_range(vertices, np.ones_like(changed), codes)
        if self.encoding == recoding.encoding == "ascii":
            text = np.frombuffer(self.replaced(vertices), dtype=np.uint8)[self._header.size :]
            return recoding.header() + text.tobytes()
        values = {("vertex", name): vertices[:, k] for k, name in enumerate(POSITION)}
        for section, names, normals, where in self._new_normals(vertices):
            kept = np.where(where, normals, section.numbers(names))
            values |= {(section.element.name, name): kept[:, k] for k, name in enumerate(names)}
        return recoding.encoded(values, self._end)


def _require_range(values: Floats, changed: Flags, codes: Sequence[str]) -> None:
    """Raise ContentError (``E_RANGE``) where a changed coordinate does not fit its type.

    values, changed : (n, 3); codes : numpy codes of x, y and z.
    """
    for k, code in enumerate(codes):
        limits = np.finfo(code) if code[0] == "f" else np.iinfo(code)
        low, high = float(limits.min), float(limits.max)
        if high > limits.max:
            high = float(np.nextafter(high, 0.0))
        column = values[:, k] if code[0] == "f" else np.rint(values[:, k])
        # Written so that NaN counts as outside.
        bad = changed[:, k] & ~((column >= low) & (column <= high))
        if bad.any():
            vertex = int(np.argmax(bad))
            raise ContentError(
                f"the new {POSITION[k]} of vertex {vertex} does not fit the file's number type",
                where=f"vertex {vertex}",
                hint="write the positions as doubles: --precision float64",
                code="E_RANGE",
            )


def _three(flags: Flags) -> Flags:
    """Flags (n,) as (n, 3), without a copy."""
    return np.broadcast_to(flags[:, None], (len(flags), 3))


def _require_same(before: Bytes, after: Bytes) -> None:
    for at in range(0, len(before), _CHUNK):
        if not np.array_equal(before[at : at + _CHUNK], after[at : at + _CHUNK]):
            raise InternalError("the output differs from the input outside its positions")


def _require_normals(old: Floats, new: Floats, touched: Flags) -> None:
    """Raise InternalError unless new normals (k, 3) differ from the old ones only where
    ``touched`` (k,), and are unit vectors there."""
    differs = ~((old == new) | (np.isnan(old) & np.isnan(new))).all(axis=1)
    if (differs & ~touched).any():
        raise InternalError("a normal was changed away from every moved vertex")
    fresh = new[differs]
    # Written so that NaN fails.
    if not (np.abs((fresh * fresh).sum(axis=1) - 1.0) < _UNIT).all():
        raise InternalError("a recomputed normal has not the length 1")


def _wanted(element: Element) -> Sequence[str]:
    """Properties whose places are kept: positions, normals, corners."""
    if element.name == "vertex":
        return POSITION + NORMAL
    if element.name == "face":
        return CORNERS + NORMAL
    return CORNERS if element.name == "tristrips" else ()


def _has_normals(element: Element | None) -> bool:
    """Whether the element has nx, ny, nz as floating-point scalars."""
    if element is None:
        return False
    found = [element.find(name) for name in NORMAL]
    return all(one is not None and not one.is_list and one.code[0] == "f" for one in found)


def _vertex_element(header: Header) -> Element:
    """The element ``vertex`` with x, y and z as scalars; FormatError without."""
    vertex = header.find("vertex")
    if vertex is None:
        raise FormatError(
            "the header declares no element 'vertex'",
            where="header",
            hint="this PLY file does not hold a mesh",
        )
    for name in POSITION:
        one = vertex.find(name)
        if one is None or one.is_list:
            problem = "is a list" if one is not None else "is missing"
            raise FormatError(
                f"the coordinate '{name}' of element 'vertex' {problem}", where="header"
            )
    return vertex


def _finite(section: Section) -> Floats:
    """The positions (n, 3); ContentError (``E_NONFINITE``) where one is NaN or infinite."""
    vertices = section.numbers(POSITION)
    finite = np.isfinite(vertices)
    if not finite.all():
        vertex = int(np.argmin(finite.all(axis=1)))
        raise ContentError(
            f"vertex {vertex} has a coordinate that is not a finite number",
            where=section.where(vertex),
            hint="remove such vertices, or export the scan again",
            code="E_NONFINITE",
        )
    return vertices


def _precision(header: Header, vertex: Element) -> str:
    if header.encoding == "ascii":
        return "text"
    codes = {vertex.properties[vertex.index(name)].code for name in POSITION}
    if "f4" in codes:
        return "float32"
    return "float64" if "f8" in codes else "integer"


def _properties(header: Header) -> tuple[str, ...]:
    """What the file carries besides positions and corners, in file order."""
    carried: list[str] = []
    for element in header.elements:
        if element.name not in ("vertex", "face", "tristrips"):
            carried.append(f"element {element.name} ({element.count})")
            continue
        known = POSITION if element.name == "vertex" else (corner_list(element),)
        carried += [f"{element.name}.{one}" for one in element.properties if one.name not in known]
    return tuple(carried)


def _header_warnings(header: Header, vertex: Element) -> tuple[str, ...]:
    warnings = []
    whole = [n for n in POSITION if vertex.properties[vertex.index(n)].code[0] != "f"]
    if whole:
        warnings.append(
            f"coordinates {', '.join(whole)} are whole numbers: new ones are rounded to the "
            "nearest, halves to the even one"
        )
    for element in header.elements:
        named = [one for one in element.properties if one.name in NORMAL]
        if element.name in ("vertex", "face") and named and not _has_normals(element):
            warnings.append(
                f"the {', '.join(one.name for one in named)} of element '{element.name}' are not "
                "three floating-point numbers: they are kept, not recomputed"
            )
    return tuple(warnings)
