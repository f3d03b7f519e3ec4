"""STL, binary and ascii: positions and normals replaced inside the original bytes.

A binary file is 80 bytes of free text, a count, and for each facet 50 bytes: normal and three
corners as little-endian float32, and one 16-bit word that some programs use for colours.
Keywords may be in any case, separated by any white space; a solid's name is the rest of its line.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli import errors
from msal_cli.arrays import Bytes, Flags, Floats, Ints, Longs
from msal_cli.codecs import mesh_file, text_slots
from msal_cli.codecs.detection import BYTE_ORDER_MARK
from msal_cli.codecs.slots import Change, as_float32, require_range, to_type
from msal_cli.kernels.text import as_bytes
from msal_cli.storage.regular import Buffer

HEADER_BYTES = 80
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", 9), ("attribute", "<u2")])
"""One facet, 50 bytes without padding."""

MAX_FACETS = (2**31 - 1) // 3  # facets whose corners can be numbered with 32 bits

_BEGIN = b"binary STL "
_FIRST_FACET = HEADER_BYTES + 4
_LOOKED_AT = 1024
_AT_ONCE = 1 << 14  # facets whose bytes, old and new, stay in the processor's cache

_PADDING = 8
_NAMED_SOLID = re.compile(
    rb"\s*solid[ \t][^\r\n]*[\r\n]\s*facet\s+(?:normal|outer)\s", re.IGNORECASE
)
_WORD = re.compile(rb"\S+")
_FINER = 2  # decimals beyond those that the extent needs, for tiny numbers with an exponent


def read(data: Buffer) -> StlFile | StlTextFile:
    """Read an STL file, binary or ascii.

    A file whose first kilobyte is text is ascii (see ``is_text``).  In a binary file, whatever it
    begins with, that kilobyte holds the count and the first numbers, and with them control
    characters: the count alone has some unless it is beyond 500 million.

    Raises TruncatedError if the file is shorter than its count asks for, or an ascii solid does not
    end; FormatError if it is not STL, or an ascii file has a wrong word, with its line;
    ContentError ``E_NO_FACES`` or ``E_NONFINITE``.
    """
    from msal_cli.kernels.welding import weld_corners

    size = len(memoryview(data).cast("B"))
    head = bytes(memoryview(data).cast("B")[:_LOOKED_AT])
    if is_text(head, size):
        return StlTextFile(data)
    n_trailing = size - require_bytes(head, size)
    count = (size - n_trailing - _FIRST_FACET) // FACET.itemsize
    _check_count(count, n_trailing)
    facets = _facets(data, count)
    vertices, faces, bad = weld_corners(facets["corners"])
    if bad >= 0:
        raise _not_finite(bad, int(np.isfinite(facets["corners"][bad]).argmin()) // 3)
    return StlFile(data, vertices, faces, n_trailing)


def wanted_bytes(head: bytes) -> int:
    """The bytes that a binary file that begins with ``head`` should have by its count."""
    return _FIRST_FACET + FACET.itemsize * int.from_bytes(head[HEADER_BYTES:_FIRST_FACET], "little")


def require_bytes(head: bytes, size: int) -> int:
    """The bytes that a binary file should have; TruncatedError for a file of fewer."""
    wanted = wanted_bytes(head)
    if size >= max(wanted, _FIRST_FACET):
        return wanted
    message = f"the file has {size} bytes; a binary STL file has at least {_FIRST_FACET}"
    hint = errors.CUT_SHORT
    if size >= _FIRST_FACET:
        count, n_whole = ((n - _FIRST_FACET) // FACET.itemsize for n in (wanted, size))
        message = (
            f"the header counts {count:,} facets, which take {wanted:,} bytes, but the file has "
            f"{size:,}: {n_whole:,} whole facets"
        )
        hint = "the file was cut short, or is not STL; copy or export it again"
    raise errors.TruncatedError(message, where=f"byte {size}", hint=hint)


def is_text(head: bytes, size: int) -> bool:
    """Whether a file of ``size`` bytes is text, judged by the first kilobyte of ``head``.

    A few bytes of padding at the end are ignored, and so are control characters in the name of a
    solid if a facet in words follows; a header filled with zeros is not text.
    """
    head = head[:_LOOKED_AT]
    shown = head[:-_PADDING] + head[-_PADDING:].rstrip(b"\0\x1a")
    if bool(shown) and not any(c < 32 and c not in b"\t\n\v\f\r" for c in shown):
        return True
    return size != wanted_bytes(head) and _NAMED_SOLID.match(head) is not None


def _check_count(n_facets: int, n_trailing: int = 0) -> None:
    if not n_facets:
        more = f"; {n_trailing:,} bytes follow that it does not count" if n_trailing else ""
        raise errors.no_faces(f"the file has no facets{more}")
    if n_facets > MAX_FACETS:
        raise errors.TooLargeError(
            f"{n_facets:,} facets are more than the {MAX_FACETS:,} whose corners can be numbered",
            hint="cut the mesh into parts",
        )


def _not_finite(facet: int, corner: int, line: int | None = None) -> errors.ContentError:
    return errors.not_finite(
        "a position is not finite",
        f"facet {facet}, corner {corner}" + (f", line {line}" if line else ""),
    )


def _facets(data: Buffer, count: int) -> NDArray[np.void]:
    # A read-only view gives the same type of array for every buffer.
    fixed = memoryview(data).toreadonly()
    return np.frombuffer(fixed, dtype=FACET, count=count, offset=_FIRST_FACET)


class _FacetFile(mesh_file.MeshFile):
    """An STL file; see ``codecs.mesh_file.MeshFile``.

    ``vertices`` are the distinct positions of corners, in order of appearance; ``name`` is the name
    of the mesh in the file, ``normals`` (m, 3) are those of its facets as stored.
    """

    normals: Floats

    def __init__(self, data: Buffer, layout: mesh_file.Layout, name: str) -> None:
        super().__init__(data, "stl", layout)
        # A header has room for this many characters behind ``_BEGIN``.
        is_plain = name.isascii() and name.isprintable() and len(name) <= HEADER_BYTES - len(_BEGIN)
        self._name = name if is_plain else ""
        self.merged_vertices = self.faces.size - len(self.vertices)

    def forget_vertices(self) -> None:
        """Do nothing: reading them again takes long."""

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        """The file with ``vertices`` (n, 3) in an ``encoding`` (same, ascii, binary).

        Raises UnsupportedError for binary float64, which STL lacks.
        """
        was_text = self.encoding == "ascii"
        to_text = was_text if encoding == "same" else encoding == "ascii"
        if not to_text and precision == "float64":
            raise errors.UnsupportedError(
                "binary STL has no float64", hint="use --encoding ascii, or --to ply"
            )
        if to_text == was_text:
            if to_text and precision == "float32":
                vertices = as_float32(vertices).astype(np.float64)
            return self.replaced(vertices)
        mesh_file.require_finite_result(vertices)
        normals, _ = self._facet_normals(vertices)
        corners = vertices[self.faces].reshape(-1, 9)
        if to_text:
            return ascii_stl(corners, normals, self._name, single=precision != "float64")
        return binary_stl(corners, normals, self._name)

    def losses_by_encoding(self) -> list[str]:
        kept = ["facet normals", *["header text", f"solid {self._name!r}"] * bool(self._name)]
        lost = [prop for prop in self.properties if prop not in kept]
        return lost + super().losses_by_encoding()

    def _facet_normals(self, vertices: Floats) -> tuple[Floats, Flags]:
        from msal_cli.kernels.stl_facets import renew_facet_normals

        mesh_file.require_shape(vertices, self.vertices)
        return renew_facet_normals(self.vertices, vertices, self.faces, self.normals)


class StlFile(_FacetFile):
    """A binary STL file with ``n_trailing`` bytes after its last facet."""

    def __init__(self, data: Buffer, vertices: Floats, faces: Ints, n_trailing: int) -> None:
        header = bytes(memoryview(data).cast("B")[:HEADER_BYTES])
        facets = _facets(data, len(faces))
        # Whether any normal is not zero, nor minus zero; in most files the first part shows it.
        parts = (facets["normal"][at : at + _AT_ONCE] for at in range(0, len(facets), _AT_ONCE))
        is_there = {
            "facet normals": any((part.view("<u4") & 0x7FFFFFFF).any() for part in parts),
            "facet attribute words": facets["attribute"].any(),
            "colour in the header": b"COLOR=" in header,
            "material in the header": b"MATERIAL=" in header,
            "header text": header.strip(b"\0 "),
        }
        warnings: tuple[str, ...] = ()
        if n_trailing:
            more = errors.format_count(n_trailing // FACET.itemsize, "facet")
            room = f": room for {more} that the header does not count"
            rest = f"{errors.format_count(n_trailing, 'byte')} behind the last facet, kept"
            warnings = (rest + room * (n_trailing >= FACET.itemsize),)
        layout = mesh_file.Layout(
            "binary_little_endian",
            "float32",
            (),
            properties=tuple(name for name, has_it in is_there.items() if has_it),
            warnings=warnings,
            faces=faces,
            vertices=vertices,
        )
        super().__init__(data, layout, header.strip(b"\0 ").decode("latin-1"))
        self._end = _FIRST_FACET + FACET.itemsize * len(faces)

    @property
    def normals(self) -> Floats:  # type: ignore[override]
        with np.errstate(invalid="ignore"):  # a signalling NaN
            return _facets(self._data, self.n_polygons)["normal"].astype(np.float64)

    def as_stored(self, vertices: Floats) -> Floats:
        return to_type(vertices, "f4").astype(np.float64)

    def replaced(self, vertices: Floats) -> Buffer:
        mesh_file.require_shape(vertices, self.vertices)
        if np.array_equal(self.vertices, vertices):
            return self._data
        from msal_cli.kernels.parallel import over_ranges
        from msal_cli.kernels.stl_facets import replace_facets

        require_range(vertices, np.broadcast_to(True, vertices.shape), ("<f4",) * 3)
        before = np.frombuffer(self._data, dtype=np.uint8)
        output = np.empty_like(before)
        for rest in (slice(_FIRST_FACET), slice(self._end, None)):
            output[rest] = before[rest]
        facets = output[_FIRST_FACET : self._end].view(FACET)
        normals, corners = facets["normal"], facets["corners"]
        none = np.empty(0, dtype=bool)

        def write(start: int, stop: int, begin: int, *mesh: Any) -> None:
            for first in range(start, stop, _AT_ONCE):
                last = min(first + _AT_ONCE, stop)
                ends = (_FIRST_FACET + FACET.itemsize * (begin + at) for at in (first, last))
                part = slice(*ends)
                # Copied just before they are changed, so that the bytes are in the cache.
                output[part] = before[part]
                replace_facets(first, last, *mesh, normals[begin:], corners[begin:], none)

        for begin, old, new, faces in self._parts(vertices):
            over_ranges(write, len(faces), begin, old, new, faces)
        return output.data

    def _parts(self, vertices: Floats) -> Iterator[tuple[int, Floats, Floats, Ints]]:
        """All facets in parts: the first facet, the vertices before and after, and the corners.

        There is one part, unless arrays are in files and vertices in random order there: then they
        are read block by block.
        """
        from msal_cli.kernels import array_files, spatial_order

        if not (array_files.are_used() and spatial_order.is_random(self.faces)):
            yield 0, self.vertices, vertices, self.faces
            return
        facets = _facets(self._data, self.n_polygons)
        for first, last in spatial_order.blocks(self.n_polygons, 2 * 9 * vertices.itemsize):
            # Adding 0.0 makes -0.0 a plain zero.
            old = facets["corners"][first:last].astype(np.float64).reshape(-1, 3) + 0.0
            new = spatial_order.gather_rows(vertices, self.faces[first:last].reshape(-1))
            yield first, old, new, np.arange(len(old), dtype=np.int32).reshape(-1, 3)

    def check(self, output: Buffer, vertices: Floats) -> None:
        from msal_cli.kernels import stl_facets
        from msal_cli.kernels.parallel import over_ranges

        mesh_file.require_shape(vertices, self.vertices)
        mesh_file.require_finite_result(vertices)
        before, after = memoryview(self._data).cast("B"), memoryview(output).cast("B")
        if len(before) != len(after) or before[:_FIRST_FACET] != after[:_FIRST_FACET]:
            raise errors.InternalError("the STL header or the length of the file changed")
        if before[self._end :] != after[self._end :]:
            raise errors.InternalError("the bytes behind the last facet changed")
        old, new = _facets(self._data, self.n_polygons), _facets(output, self.n_polygons)
        words = [facets.view("<u2").reshape(-1, FACET.itemsize // 2) for facets in (old, new)]
        numbers = old["corners"], new["normal"], new["corners"]
        results: list[tuple[int, int]] = []

        def check_range(start: int, stop: int, begin: int, *mesh: Any) -> None:
            others = (array[begin:] for array in (*words, *numbers))
            facet, status = stl_facets.check_facets(start, stop, *mesh, *others)
            results.append((begin + facet, status))

        for begin, before_part, after_part, faces in self._parts(vertices):
            over_ranges(check_range, len(faces), begin, before_part, after_part, faces)
        messages = {
            stl_facets.WRONG_CORNER: "a corner was not written right",
            stl_facets.WRONG_NORMAL: "a normal was not written right",
            stl_facets.WRONG_ATTRIBUTE: "the attribute words of an STL file changed",
        }
        for facet, status in sorted(results):
            if status != stl_facets.RIGHT:
                raise errors.InternalError(messages[status], where=f"facet {facet}")


def _resolve_numbers(data: Buffer, run_at: Longs, numbers: Floats) -> None:
    """Read the numbers (m, 12) that the scan left open; ContentError for a position that is not
    finite."""
    view = memoryview(data).cast("B")
    is_doubtful = ~np.isfinite(numbers)
    is_doubtful[:, :3] = np.isinf(numbers[:, :3])
    for facet, token in np.argwhere(is_doubtful).tolist():
        at = int(run_at[facet, token // 3])
        word = next(itertools.islice(_WORD.finditer(view, at), token % 3, None))
        try:
            value = float(word[0])
        except ValueError:
            value = float("nan")
        if token >= 3 and not np.isfinite(value):
            raise _not_finite(facet, (token - 3) // 3, text_slots.line_of(data, word.start()))
        numbers[facet, token] = value


def _scan_error(buf: Bytes, status: int, at: int, word: int, facet: int) -> errors.InputError:
    from msal_cli.kernels import stl_facets

    token = (bytes(buf[at : at + 60]).split(None, 1) or [b""])[0]
    text = token.decode("ascii", "backslashreplace")
    where = f"facet {facet}, line {text_slots.line_of(buf, at)}"
    wanted = stl_facets.WORDS[word]
    others = {stl_facets.FACET: ("endsolid",), stl_facets.NORMAL: ("outer",)}
    is_begun = status == stl_facets.BAD_NUMBER or (
        status == stl_facets.WRONG
        and any(w.encode().startswith(token.lower()) for w in (wanted, *others.get(word, ())))
    )
    if status == stl_facets.CUT or (at + len(token) == len(buf) and is_begun):
        place = bytes(buf).lower().find(b"endfacet")
        if not facet and place >= 0:
            message = "the facets are on the line of 'solid', all of which is the solid's name"
            hint = "insert line breaks before 'facet' and 'endsolid'"
            where = f"line {text_slots.line_of(buf, place)}"
            return errors.FormatError(message, where=where, hint=hint)
        ends = "without 'endsolid'" if word == stl_facets.FACET else "within a facet"
        whole = errors.format_count(facet, "whole facet")
        return errors.cut_short(f"the text ends {ends}, after {whole}", where)
    message, hint = f"expected '{wanted}', found {text!r}", errors.EXPORT_AGAIN
    if status == stl_facets.OUTSIDE:
        message = f"expected 'solid', found {text!r}"
        hint = "ascii STL is a list of solids; is this another format?"
    elif status == stl_facets.BAD_NUMBER:
        message, hint = f"{text!r} is not a number", text_slots.number_hint(token)
    elif word == stl_facets.ENDLOOP and token.lower() == b"vertex":
        hint = "a facet of STL has three corners; triangulate the mesh first"
    return errors.FormatError(message, where=where, hint=hint)


class StlTextFile(_FacetFile):
    """An ascii STL file; its runs are those of ``kernels.stl_facets.scan``."""

    def __init__(self, data: Buffer) -> None:
        from msal_cli.kernels import stl_facets
        from msal_cli.kernels.welding import weld_corners

        buf = as_bytes(data)
        # Some editors end a text with NUL bytes, or with the end-of-file mark of old systems.
        tail = bytes(buf[-4096:])
        n_trailing = len(tail) - len(tail.rstrip(b"\0\x1a"))
        buf = buf[: len(buf) - n_trailing]
        state = np.zeros(stl_facets.N_STATE, dtype=np.int64)
        if bytes(buf[:3]) == BYTE_ORDER_MARK:
            state[stl_facets.AT] = len(BYTE_ORDER_MARK)
        # The arrays grow with what is scanned, never with what is claimed.
        room = len(buf) // 200 + 1  # usual bytes of a facet
        run_at, numbers = np.empty((room, 4), dtype=np.int64), np.empty((room, 12))
        solid_at = np.zeros(stl_facets.MAX_SOLIDS, dtype=np.int64)
        decimals = np.zeros(4, dtype=np.int64)
        status = stl_facets.FULL
        while status == stl_facets.FULL:
            status, at, word = stl_facets.scan(buf, state, run_at, numbers, solid_at, decimals)
            room = n_facets = int(state[stl_facets.FACETS])
            if status == stl_facets.FULL:
                room += n_facets // 2 + 16
            for array in (run_at, numbers):
                array.resize((room, *array.shape[1:]), refcheck=False)
        if status != stl_facets.WHOLE:
            raise _scan_error(buf, int(status), int(at), int(word), n_facets)
        _check_count(n_facets)
        _resolve_numbers(data, run_at, numbers)
        n_solids, n_bare = int(state[stl_facets.SOLIDS]), int(state[stl_facets.WITHOUT_NORMAL])
        lines = (bytes(buf[at : at + 256]).splitlines() for at in solid_at[:n_solids])
        names = [(line or [b""])[0].decode("utf-8", "replace").strip() for line in lines]
        normals = np.ascontiguousarray(numbers[:, :3])
        n_bad = int((~np.isfinite(normals).all(axis=1)).sum()) - n_bare
        have = "facet has", "facets have"
        texts = {
            f"{errors.format_count(n_bare, *have)} no normal, and none is added": n_bare,
            f"{errors.format_count(n_bad, *have)} a normal that is not three finite numbers: it is "
            "kept, not recomputed": n_bad,
            f"{errors.format_count(n_trailing, 'byte')} behind the last solid, kept": n_trailing,
        }
        vertices, faces, _ = weld_corners(numbers[:, 3:])
        layout = mesh_file.Layout(
            "ascii",
            "text",
            (text_slots.TextSlots(as_bytes(data), run_at.reshape(-1), values=normals),),
            properties=(
                *(("facet normals",) * (n_bare != n_facets)),
                *((f"{n_solids} solids",) * (n_solids > 1)),
                *(f"solid {name!r}" for name in names if name),
            ),
            warnings=tuple(text for text, count in texts.items() if count),
            faces=faces,
            vertices=vertices,
        )
        super().__init__(data, layout, names[0])
        self.normals, self._used_decimals = normals, decimals

    def _decimals(self) -> tuple[int, int]:
        """Decimals for normals and for corners, at least those of the file.

        Tokens with an exponent can have any number of decimals (``1.5e-17``); theirs count only as
        far as they matter at the size of the mesh.
        """
        from msal_cli.kernels.numbers import MAX_DECIMALS

        plain_normal, plain, exponent_normal, exponent = (int(d) for d in self._used_decimals)
        needed = text_slots.extent_decimals(self.vertices)
        needed = MAX_DECIMALS if needed is None else needed
        normal = max(plain_normal, min(exponent_normal, 9), text_slots.NORMAL_DECIMALS)
        corner = max(plain, min(exponent, needed + _FINER), needed, 0)
        return min(normal, MAX_DECIMALS), min(corner, MAX_DECIMALS)

    def _changes(self, vertices: Floats) -> list[Change]:
        """The new normal and corners of each facet, in the order of the file."""
        mesh_file.require_shape(vertices, self.vertices)
        is_moved = vertices != self.vertices
        if not is_moved.any():
            return []
        m = len(self.faces)
        values, is_changed = np.empty((m, 4, 3)), np.empty((m, 4, 3), dtype=bool)
        values[:, 0], rows = self._facet_normals(vertices)
        is_changed[:, 0] = rows[:, None]
        values[:, 1:] = vertices[self.faces]
        is_changed[:, 1:] = is_moved[self.faces]
        slots = self._layout.positions[0]
        return [Change(slots, values.reshape(-1, 3), is_changed.reshape(-1, 3))]

    def _plan_patches(self, changes: Sequence[Change]) -> list[text_slots.Patch]:
        [(slots, values, is_changed)] = changes
        normal, corner = self._decimals()
        decimals = np.array([normal, corner, corner, corner], dtype=np.uint8)
        return [text_slots.Patch(slots.at, values, is_changed, np.tile(decimals, len(self.faces)))]

    def _compare(self, result: Bytes, changes: Sequence[Change], vertices: Floats) -> None:
        for _, values, is_changed in changes:
            mesh_file.require_unit_length(values[::4], is_changed[::4, 0])
        super()._compare(result, changes, vertices)


def binary_stl(corners: Floats, normals: Floats, name: str) -> bytes:
    """A binary STL file of corners (m, 9) and normals (m, 3)."""
    facets = np.zeros(len(corners), dtype=FACET)
    facets["corners"] = as_float32(corners)
    with np.errstate(over="ignore", invalid="ignore"):
        single = normals.astype(np.float32)
    facets["normal"] = np.where(np.isfinite(single), single, np.float32(0.0))
    # If a header begins with "solid", readers take the file for text.
    header = _BEGIN + name.encode()
    count = len(corners).to_bytes(4, "little")
    return header.ljust(HEADER_BYTES) + count + facets.tobytes()


def ascii_stl(corners: Floats, normals: Floats, name: str, *, single: bool) -> Buffer:
    """An ascii STL file of corners (m, 9) and normals (m, 3), in the shortest exact digits: of
    float32 if ``single``.
    """
    from msal_cli.kernels.text import fill_rows, print_shortest

    numbers = np.concatenate([np.where(np.isfinite(normals), normals, 0.0), corners], axis=1)
    numbers[:, :3] = numbers[:, :3].astype(np.float32)
    digits, stops = print_shortest(numbers.reshape(-1), single)
    corner = (b"\n      vertex ", b" ", b" ")
    first = (b"\n    outer loop" + corner[0], b" ", b" ")
    pieces = (b"  facet normal ", b" ", b" ", *first, *corner, *corner)
    line = " ".join(name.split())
    head, tail = (f"{word} {line}".rstrip().encode() + b"\n" for word in ("solid", "endsolid"))
    facets = fill_rows((*pieces, b"\n    endloop\n  endfacet\n"), digits, stops)
    return b"".join([head, facets, tail])
