"""PLY files: positions and normals replaced inside the original bytes.

Read are ascii and both binary encodings, any elements and properties in any order, polygons
(``vertex_indices`` or ``vertex_index`` of ``face``) and triangle strips (``tristrips``).  Written
is a copy of the file in which only ``x y z`` of moved vertices, and the normals ``nx ny nz`` of
vertices and faces around them, differ.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Flags, Floats
from msal_cli.codecs import ply_sections as ply_layout
from msal_cli.codecs import text_slots_old as plain_text
from msal_cli.codecs.ply_ascii import Lines
from msal_cli.codecs.ply_description import (
    NORMAL,
    POSITION,
    check_strays,
    has_normals,
    precision_of,
    properties_of,
    vertex_element,
    wanted_names,
    warnings_of,
)
from msal_cli.codecs.ply_faces import Surface, surface
from msal_cli.codecs.ply_header import Header, parsed
from msal_cli.codecs.ply_sections import Fixed, Section, Varied, located
from msal_cli.codecs.ply_stream import Stream
from msal_cli.codecs.ply_text import (
    SHORTEST,
    WHOLE,
    Edit,
    edited,
    is_same_but_for,
    normal_decimals,
    position_decimals,
)
from msal_cli.errors import ContentError, InputError, InternalError
from msal_cli.storage.buffers import Buffer

_CHUNK = 1 << 20
"""Bytes compared at a time, so that a comparison needs no temporary as large as the file."""


_STREAM_WARNING = (
    "the records do not stand one to a line: they are read as a stream of words, and the lines kept"
)

_PARTS = 8
"""Parts of a section that are worth a thread of their own."""

_Part = tuple[Fixed | Varied, tuple[str, ...], Floats, Flags]


class Change(NamedTuple):
    """New ``values`` (count, 3) for the scalars ``names`` of a section, to be written where
    ``where`` (count, 3) is True."""

    section: Section
    names: tuple[str, ...]
    values: Floats
    where: Flags

    def parts(self) -> Iterator[_Part]:
        """The same in parts of binary records that fit a cache."""
        if isinstance(self.section, Fixed):
            for section, rows in self.section.parts():
                yield section, self.names, self.values[rows], self.where[rows]
        elif isinstance(self.section, Varied):
            yield self.section, self.names, self.values, self.where


def read(data: Buffer, name: str) -> PlyFile:
    """Open the PLY file ``data`` (its bytes); ``name`` is used in messages only.

    Raises FormatError (not PLY, or a line, type or value that breaks the format),
    TruncatedError (fewer bytes or lines than the counts promise), ContentError (``E_NONFINITE``,
    ``E_INDEX``, ``E_NO_FACES``), UnsupportedError and TooLargeError, each with the place.
    """
    return PlyFile(data, name)


class PlyFile:
    """An opened PLY file; see ``codecs.mesh_file.MeshFile`` for what its attributes mean.

    ``precision`` is the type of the coordinates: ``float32`` (also when mixed with double, since
    the coarsest one limits), ``float64``, ``text`` in ascii, or ``integer``.  Whole-number
    coordinates are rounded to the nearest whole number, halves to the even one.
    """

    format = "ply"
    merged_vertices = 0

    def __init__(self, data: Buffer, name: str) -> None:
        from msal_cli.kernels.text import as_bytes

        self.name = name
        self._data = data
        self._bytes: Bytes = as_bytes(memoryview(data).cast("B"))
        self._header: Header = parsed(memoryview(data).cast("B"))
        self.encoding: str = self._header.encoding
        vertex = vertex_element(self._header)
        sections, self._end = located(self._bytes, self._header, wanted_names)
        self._sections: dict[str, Section] = sections
        self._vertices: Floats | None = _finite(sections["vertex"])
        # Read here, so that a word that is no number is found before any work is done.
        self._normals = {
            name: section.numbers(NORMAL)
            for name, section in sections.items()
            if name in ("vertex", "face") and has_normals(section.element)
        }
        self._surface: Surface = surface(sections, len(self.vertices))
        self.faces: NDArray[np.int32] = self._surface.triangles
        self.n_polygons: int = self._surface.n_polygons
        self.precision: str = precision_of(self._header, vertex)
        self.properties: tuple[str, ...] = properties_of(self._header)
        self._last_normals: tuple[bytes, list[Change]] = (b"", [])
        self._decimals_known: dict[tuple[str, tuple[str, ...]], int] = {}
        self.references: tuple[str, ...] = self._header.textures
        rest = self._bytes[self._end :]
        n_behind = len(rest.tobytes().strip()) if self.encoding == "ascii" else len(rest)
        check_strays(self._header, n_behind)
        self.warnings: tuple[str, ...] = (
            *warnings_of(self._header, vertex),
            *self._surface.warnings,
            *((_STREAM_WARNING,) if self._is_stream else ()),
            *((f"{n_behind} bytes behind the last element are kept as they are",) * bool(n_behind)),
        )

    @property
    def _is_stream(self) -> bool:
        """Whether the ascii records do not stand one to a line."""
        return isinstance(self._sections["vertex"], Stream)

    @property
    def vertices(self) -> Floats:
        """The positions (n, 3)."""
        if self._vertices is None:
            self._vertices = self._sections["vertex"].numbers(POSITION)
        return self._vertices

    def forget_vertices(self) -> None:
        """Let go of the positions, except of those that are text."""
        if self.encoding != "ascii":
            self._vertices = None

    def vertex_property(self, name: str) -> Floats:
        """The scalar property ``name`` of the vertices, (n,); InputError (``E_PROPERTY``) if there
        is none."""
        element = self._sections["vertex"].element
        one = element.find(name)
        if one is None or one.is_list:
            known = [each.name for each in element.properties if not each.is_list]
            raise InputError(
                f"the vertices have no property {name!r}"
                + (" that is a number" if one is not None else ""),
                code="E_PROPERTY",
                hint=f"they have: {', '.join(known)}",
            )
        if name in POSITION + NORMAL:
            return self._sections["vertex"].numbers((name,))[:, 0]
        found, _ = located(
            self._bytes,
            self._header,
            lambda element: (name,) if element.name == "vertex" else (),
            last="vertex",
        )
        values: Floats = np.ascontiguousarray(found["vertex"].numbers((name,))[:, 0])
        return values

    # Replacing

    def replaced(self, vertices: Floats) -> Buffer:
        """The file with the positions ``vertices`` (n, 3), in file order and file units.

        A coordinate equal to the file's keeps its very bytes.  Raises ContentError (``E_RANGE``)
        where a new one does not fit the file's number type.
        """
        from msal_cli.kernels.parallel import over_ranges

        changes = self._changes(vertices)
        if not changes:
            return self._data
        _require_range(vertices, changes[0].where, self._codes(POSITION))
        if self.encoding == "ascii":
            plainly = self._statements(changes)
            output = plain_text.patched(self._bytes, plainly) if plainly else None
            return output or self._edited(changes, self._codes(POSITION))
        # An array of numpy's comes in large pages, where the system has such.
        copy = self._bytes.copy()

        def write(start: int, stop: int) -> None:
            for section, names, values, where in parts[start:stop]:
                section.write(copy[section.start : section.stop], names, values, where)

        for change in changes:
            parts = list(change.parts())
            over_ranges(write, len(parts), smallest=_PARTS)
        return copy.data

    def _statements(self, changes: Sequence[Change]) -> list[plain_text.Statements] | None:
        """The changes of an ascii file where all numbers, old and new, are plain."""
        found = []
        codes = self._codes(POSITION)
        for section, names, values, _ in changes:
            if not isinstance(section, Lines) or section.read is None:
                return None
            at = section.read.word_at.get(names)
            least = max(self._decimals(section, names, codes))
            if at is None or least == SHORTEST or WHOLE in self._decimals(section, names, codes):
                return None
            largest = max(float(values.max()), -float(values.min()))
            own = section.read.decimals[names]
            if names != POSITION:
                own = np.zeros_like(own)
            decimals = plain_text.row_decimals(own, least, largest)
            if decimals is None:
                return None
            old = section.numbers(names)
            new = np.require(values, np.float64, ("C", "W"))
            found.append(
                plain_text.Statements(at, 0, np.require(old, None, ("C", "W")), new, decimals)
            )
        return found

    def _edited(self, changes: Sequence[Change], codes: Sequence[str]) -> memoryview:
        """The ascii file with ``changes``; ``codes`` are the number types of x, y and z."""
        return edited(
            self._bytes,
            [
                Edit(section, names, values, where, self._decimals(section, names, codes))
                for section, names, values, where in changes
                if isinstance(section, Lines)
            ],
        )

    def _changed(self, vertices: Floats) -> Flags:
        """Which coordinates (n, 3) differ from the file's."""
        self._require_shape(vertices)
        changed: Flags = vertices != self.vertices
        return changed

    def _require_shape(self, vertices: Floats) -> None:
        if vertices.shape != self.vertices.shape or vertices.dtype != np.float64:
            raise InternalError(f"positions of shape {vertices.shape} and type {vertices.dtype}")

    def _codes(self, names: Sequence[str]) -> list[str]:
        return [one.code for one in self._sections["vertex"].element.find_all(names)]

    def _changes(self, vertices: Floats) -> list[Change]:
        """All that differs for new positions (n, 3), them first; nothing where none differs."""
        changed = self._changed(vertices)
        if not changed.any():
            return []
        return [
            Change(self._sections["vertex"], POSITION, vertices, changed),
            *self._new_normals(vertices),
        ]

    def _new_normals(self, vertices: Floats) -> list[Change]:
        """The stored normals of vertices and faces that are no longer right for ``vertices``.

        Remembered for the last positions, which writing and checking ask for in turn.
        """
        if not self._normals:
            return []
        key = hashlib.sha256(np.ascontiguousarray(vertices).data).digest()
        if self._last_normals[0] != key:
            self._last_normals = key, self._computed_normals(vertices)
        return self._last_normals[1]

    def _computed_normals(self, vertices: Floats) -> list[Change]:
        changes: list[Change] = []
        if "vertex" in self._normals:
            from msal_cli.kernels.geometry import regrouped_normals

            normals, changed = regrouped_normals(
                self.vertices, vertices, self.faces, self.faces, self._normals["vertex"]
            )
            changes.append(Change(self._sections["vertex"], NORMAL, normals, _three(changed)))
        if self._has_face_normals():
            moved: Flags = np.asarray(self._changed(vertices).any(axis=1))
            normals, changed = self._surface.face_normals(
                self.vertices, vertices, moved, self._normals["face"]
            )
            changes.append(Change(self._sections["face"], NORMAL, normals, _three(changed)))
        return changes

    def _has_face_normals(self) -> bool:
        return self._surface.n_faces > 0 and "face" in self._normals

    def _decimals(
        self, section: Lines, names: tuple[str, ...], codes: Sequence[str]
    ) -> tuple[int, ...]:
        """Digits behind the point for scalars of an ascii element; ``codes`` as in ``_edited``."""
        key = (section.element.name, names)
        if key not in self._decimals_known:
            self._decimals_known[key] = (
                position_decimals(section, names, self.vertices)
                if names == POSITION
                else normal_decimals(section, names)
            )
        decimals = self._decimals_known[key]
        if names != POSITION:
            return (decimals,) * len(names)
        return tuple(decimals if code[0] == "f" else WHOLE for code in codes)

    # Checking

    def check(self, output: Buffer, vertices: Floats) -> None:
        """Raise InternalError unless ``output`` is this file with only positions and normals
        replaced, by ``vertices`` (n, 3) up to the rounding of the file's number type."""
        result: Bytes = np.frombuffer(output, dtype=np.uint8)
        if not np.array_equal(result[: self._header.size], self._bytes[: self._header.size]):
            raise InternalError("the header of the output differs from the input's")
        changes = self._changes(vertices)
        if self.encoding != "ascii":
            self._check_binary(result, changes)
        elif not changes:
            _require_same(self._bytes, result)
        else:
            self._check_text(result, changes)

    def _check_binary(self, result: Bytes, changes: list[Change]) -> None:
        from msal_cli.kernels.parallel import over_ranges

        at = self._header.size
        _require_same(self._bytes[:at], result[:at])
        for section in self._sections.values():
            own = [change for change in changes if change.section is section]
            if isinstance(section, Lines) or not own:
                continue
            _require_same(self._bytes[at : section.start], result[at : section.start])
            if len(result) < section.stop:
                raise InternalError("the output is shorter than the input")
            parts = list(zip(*(change.parts() for change in own), strict=True))
            over_ranges(self._check_parts, len(parts), result, parts, smallest=_PARTS)
            at = section.stop
        _require_same(self._bytes[at:], result[at:])

    def _check_parts(
        self, start: int, stop: int, result: Bytes, parts: Sequence[Sequence[_Part]]
    ) -> None:
        for one in parts[start:stop]:
            self._check_part(result, one)

    def _check_part(self, result: Bytes, parts: Sequence[_Part]) -> None:
        """Check the changes of one section, or of the same records of it."""
        section = parts[0][0]
        restored = result[section.start : section.stop].copy()
        for _, names, values, where in parts:
            found = section.numbers(names, restored)
            codes = [one.code for one in section.element.find_all(names)]
            if len(set(codes)) == 1:
                is_other = found != ply_layout.stored(values, np.dtype(codes[0]))
            else:
                columns = zip(values.T, codes, strict=True)
                wanted = [ply_layout.stored(one, np.dtype(code)) for one, code in columns]
                is_other = found != np.stack(wanted, axis=1)
            is_other &= where
            if is_other.any():
                name = names[int(np.argmax(is_other.any(axis=0)))]
                raise InternalError(f"an {name} of the output is not the computed one")
            # Their bytes, not their values: 64-bit whole numbers need not fit a double.
            section.restore(restored, names, where)
        _require_same(self._bytes[section.start : section.stop], restored)

    def _check_text(self, result: Bytes, changes: list[Change]) -> None:
        from msal_cli.kernels import fast_patch as plain_patch

        plainly = self._statements(changes)
        if plainly:
            status, which, at = plain_text.compared(self._bytes, result, plainly)
            if status == plain_patch.DONE:
                return
            if status == plain_patch.WRONG_VALUE:
                raise InternalError(
                    f"an {', '.join(changes[which].names)} of the output is not the computed one",
                    where=changes[which].section.where(at),
                )
            if status == plain_patch.DIFFERENT:
                raise InternalError("the output differs from the input outside its positions")
        last = [n for n, one in self._sections.items() if any(c.section is one for c in changes)]
        kept: list[tuple[Lines, Lines, Sequence[str], Flags]] = []
        try:
            sections, _ = located(result, self._header, wanted_names, last[-1])
            for section, names, values, where in changes:
                new = sections[section.element.name]
                if not isinstance(section, Lines) or not isinstance(new, Lines):
                    continue
                stored = new.numbers(names)
                decimals = self._decimals(section, names, self._codes(POSITION))
                for k, digits in enumerate(decimals):
                    slack = 0.5 * 10.0 ** -max(digits, 0) + np.spacing(np.abs(values[:, k]))
                    # Written so that NaN fails.
                    with np.errstate(invalid="ignore"):
                        right = np.abs(stored[:, k] - values[:, k]) <= slack
                    if (where[:, k] & ~right).any():
                        raise InternalError(f"an {names[k]} of the output is not the computed one")
                kept.append((section, new, names, where))
        except InputError as error:
            raise InternalError(f"the output cannot be read again: {error}") from error
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
        from msal_cli.codecs.ply_recode import Recoding

        retypable: dict[str, tuple[str, ...]] = {"vertex": POSITION}
        if "vertex" in self._normals:
            retypable["vertex"] = POSITION + NORMAL
        if self._has_face_normals():
            retypable["face"] = NORMAL
        recoding = Recoding(
            self._bytes, self._header, encoding, precision, retypable, self._is_stream
        )
        if recoding.is_same:
            return self.replaced(vertices)
        self._require_shape(vertices)
        codes = [recoding.code(one) for one in self._sections["vertex"].element.find_all(POSITION)]
        _require_range(vertices, np.ones(vertices.shape, dtype=bool), codes)
        if self.encoding == recoding.encoding == "ascii":
            changes = self._changes(vertices)
            text = self._edited(changes, codes) if changes else self._bytes.data
            return recoding.header() + text[self._header.size :]
        values = {("vertex", name): vertices[:, k] for k, name in enumerate(POSITION)}
        for section, names, normals, where in self._new_normals(vertices):
            kept = np.where(where, normals, self._normals[section.element.name])
            values |= {(section.element.name, name): kept[:, k] for k, name in enumerate(names)}
        return recoding.encoded(values, self._end)


def _require_range(values: Floats, changed: Flags, codes: Sequence[str]) -> None:
    """Raise ContentError (``E_RANGE``) where a changed coordinate does not fit its type.

    values, changed : (n, 3); codes : numpy codes of x, y and z.
    """
    # Where all fit, told by two numbers; NaN does not.
    most = max(float(values.max(initial=0.0)), -float(values.min(initial=0.0)))
    if all(code[0] == "f" and most <= float(np.finfo(code).max) for code in codes):
        return
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
    if len(before) != len(after):
        raise InternalError("the output is not as long as the input")

    def compare(start: int, stop: int) -> None:
        for at in range(start * _CHUNK, stop * _CHUNK, _CHUNK):
            if not np.array_equal(before[at : at + _CHUNK], after[at : at + _CHUNK]):
                raise InternalError("the output differs from the input outside its positions")

    from msal_cli.kernels.parallel import over_ranges

    over_ranges(compare, -(-len(before) // _CHUNK), smallest=4)


def _finite(section: Section) -> Floats:
    """The positions (n, 3); ContentError (``E_NONFINITE``) where one is NaN or infinite."""
    vertices = section.numbers(POSITION)
    # A sum is finite only if all are, and quicker; it may overflow, too.
    with np.errstate(over="ignore", invalid="ignore"):
        total = vertices.sum()
    if np.isfinite(total):
        return vertices
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
