"""One model part of a 3MF package: XML taken apart so that positions can be replaced in its text.

The XML comes from strangers.  Expat reads it, which knows no files and no network; a document
type, and with it every entity, is refused.  The long lists of vertices and triangles, where they
have the plain form that nearly all programs write, are left out of what Expat gets, because they
would take most of the time: a pattern holds them to that form, and Expat sees the elements around.
"""

from __future__ import annotations

import math
import re
from array import array
from bisect import bisect_right
from dataclasses import dataclass, field
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Longs
from msal_cli.errors import (
    EXPORT_AGAIN,
    ContentError,
    FormatError,
    TooLargeError,
    UnsupportedError,
    damaged,
)

_NUMBER = rb'"([-+.0-9eE]++)"'
_INDEX = rb'"[0-9]++"'
_OTHERS = rb'(?:\s++(?!v[123]=)[\w:.-]++="[\x20\x21\x23-\x25\x27-\x3b\x3d-\x7e]*+")*+'
_PLAIN_LISTS = {
    b"vertices": re.compile(
        rb"(?:\s*+<vertex\s++x=" + _NUMBER + rb"\s++y=" + _NUMBER + rb"\s++z=" + _NUMBER
        + rb"\s*+/>)*+\s*+(?=</vertices)"
    ),
    b"triangles": re.compile(
        rb"(?:\s*+<triangle\s++v1=" + _INDEX + rb"\s++v2=" + _INDEX + rb"\s++v3=" + _INDEX
        + _OTHERS + rb"\s*+/>)*+\s*+(?=</triangles)"
    ),
}  # fmt: skip
_LIST = re.compile(rb"<(vertices|triangles)\s*>")
_QUOTE, _LESS = 34, 60


def find_quoted(region: NDArray[np.uint8], offset: int) -> tuple[Longs, Longs]:
    """What stands between the first three pairs of quotes of each element, (n, 3) starts and stops;
    ``offset`` is added to all."""
    quotes = np.flatnonzero(region == _QUOTE)
    tags = np.flatnonzero(region == _LESS)
    if len(quotes) == 6 * len(tags):
        pairs = quotes.reshape(-1, 6)
    else:
        pairs = quotes[np.searchsorted(quotes, tags)[:, None] + np.arange(6)]
    return pairs[:, 0::2] + (1 + offset), pairs[:, 1::2] + offset


_MICROSOFT = "http://schemas.microsoft.com/3dmanufacturing/"
_CORES = (_MICROSOFT + "core/2015/02", _MICROSOFT + "2013/01")
_PRODUCTION = _MICROSOFT + "production/2015/06"
_UNDERSTOOD = (
    *_CORES,
    _PRODUCTION,
    _MICROSOFT + "material/2015/02",
    _MICROSOFT + "trianglesets/2021/07",
)
"""Extensions that a file may require, since none of them changes what a mesh is."""

_STALE = {
    _MICROSOFT + "beamlattice/2017/02": "a beam lattice",
    _MICROSOFT + "slice/2015/07": "slices",
}
"""Extensions that describe the same surface a second time, so that it must not move alone."""

_PAINT = "triangle attributes"
"""Attributes of triangles beside their corners: colours, materials, what a slicer has painted."""

_MAX_DEPTH = 100
MAX_USES = 100_000
"""Components and items of a part; large assemblies have some thousands."""

UNITS = ("micron", "millimeter", "centimeter", "inch", "foot", "meter")

_ATTRIBUTE = re.compile(rb"\s+([^\s=<>\"'/]+)\s*=\s*(?:\"([^\"]*)\"|'([^']*)')")
_TAG_NAME = re.compile(rb"<[^\s<>/]+")
_DECIMAL = re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?", re.ASCII)
_NO_NUMBER = re.compile(r"[-+]?(?:nan|inf(?:inity)?)", re.IGNORECASE)


@dataclass(eq=False)
class ThreeMfMesh:
    """A mesh of a model part, in its own frame.

    Attributes
    ----------
    vertices : (n, 3) float64, in the unit of the file.
    starts, stops : (n, 3), first byte of each number in the part's text, and the byte behind it.
    faces : (m, 3) int64, indices into ``vertices``.
    """

    vertices: Floats
    starts: Longs
    stops: Longs
    faces: NDArray[np.int64]


@dataclass(frozen=True)
class Use:
    """A component, or an item of the build: an object of a part, and where it is put.

    ``path`` is empty for an object of the same part.  ``frame`` (4, 4) takes columns.  ``at`` is
    where it stands in the text.
    """

    object_id: int
    path: str
    frame: Floats = field(repr=False)
    at: int


def place_of(text: bytes, name: str, at: int) -> str:
    """A byte of a part in words."""
    return f"{name}, line {1 + text.count(10, 0, at)}"


def start_parser(text: bytes, name: str) -> expat.XMLParserType:
    """An Expat parser for XML in UTF-8 that refuses every document type."""
    if text[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\0" in text[:4]:
        raise UnsupportedError(
            "XML in UTF-16 is not read", where=name, hint="save the file with another program"
        )
    parser = expat.ParserCreate(namespace_separator=" ")

    def declare(version: str, encoding: str | None, standalone: int) -> None:
        if encoding and encoding.lower() not in ("utf-8", "utf8", "us-ascii", "ascii"):
            raise UnsupportedError(
                f"XML in {encoding[:40]} is not read",
                where=name,
                hint="save the file with another program",
            )

    def refuse(*_: object) -> None:
        raise damaged("the XML has a document type, which 3MF forbids", name)

    parser.XmlDeclHandler = declare
    parser.StartDoctypeDeclHandler = refuse
    return parser


class Model:
    """A model part taken apart; ``name`` is for messages.

    Attributes
    ----------
    size : bytes of its text.
    unit : the word for it.
    ids : the numbers of its objects.
    meshes : the meshes by their objects' numbers, in the order of the file.
    components : what an object is put together from.
    items : what is to be built.
    words : what else is carried along, for reports.
    stale : what would no longer fit the surface once it moved.

    Raises FormatError, TruncatedError, UnsupportedError, and ContentError (``E_INDEX``,
    ``E_NONFINITE``).
    """

    def __init__(self, text: bytes, name: str) -> None:
        self.size, self.unit = len(text), "millimeter"
        self.ids: set[int] = set()
        self.meshes: dict[int, ThreeMfMesh] = {}
        self.components: dict[int, list[Use]] = {}
        self.items: list[Use] = []
        self.words: dict[str, None] = {}
        self.stale: dict[str, None] = {}
        self._text = text
        self._name = name
        self._fed: list[int] = []
        """Bytes that Expat had got when a list was left out, and all bytes left out until then."""
        self._left_out: list[int] = [0]
        # Plain lists by the byte where the tag begins that opens each: where they begin and end.
        self._lists = {
            tag.start(): match.span()
            for tag in _LIST.finditer(text)
            if (match := _PLAIN_LISTS[tag[1]].match(text, tag.end()))
        }
        self._prefixes: dict[str, str] = {}
        self._path: list[str] = []
        self._object = -1
        self._n_uses = 0
        self._vertices: tuple[Floats, Longs, Longs] | None = None
        self._faces: NDArray[np.int64] | None = None
        # What is gathered element by element, where the lists are not plain.
        self._values, self._starts, self._stops = array("d"), array("q"), array("q")
        self._corners = array("q")
        self._parse()
        # The parser names this model, so that neither would be freed before long.
        del self._parser, self._text, self._vertices, self._faces

    def _parse(self) -> None:
        self._parser = parser = start_parser(self._text, self._name)
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.StartNamespaceDeclHandler = self._note_prefix
        view = memoryview(self._text)
        done = fed = 0
        try:
            for begin, stop in self._lists.values():
                parser.Parse(view[done:begin], False)
                fed += begin - done
                self._fed.append(fed)
                self._left_out.append(self._left_out[-1] + stop - begin)
                done = stop
            parser.Parse(view[done:], True)
        except expat.ExpatError as failure:
            at = self._place(parser.ErrorByteIndex)
            raise FormatError(
                f"the XML is damaged: {expat.ErrorString(failure.code)}",
                where=self._where(at),
                hint="the file was cut short or is damaged; export it again",
            ) from None

    def _place(self, index: int) -> int:
        """The byte of the text for a byte of what Expat got."""
        return index + self._left_out[bisect_right(self._fed, index)]

    def _here(self) -> int:
        return self._place(self._parser.CurrentByteIndex)

    def _where(self, at: int | None = None) -> str:
        return place_of(self._text, self._name, self._here() if at is None else at)

    def _note_prefix(self, prefix: str | None, uri: str | None) -> None:
        self._prefixes[prefix or ""] = uri or ""

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        space, _, word = name.rpartition(" ")
        is_core = space in _CORES
        above = self._path[-1] if self._path else ""
        self._path.append(word if is_core else name)
        if len(self._path) > _MAX_DEPTH:
            raise TooLargeError(
                f"elements lie in one another more than {_MAX_DEPTH} deep",
                where=self._where(),
                hint=EXPORT_AGAIN,
            )
        if not above:
            if word != "model" or not is_core:
                raise self._damaged(f"the root element is {word[:40]!r}, not a model of 3MF")
            self._open_model(attributes)
        elif space in _STALE:
            self.stale[_STALE[space]] = None
        elif not is_core:
            if space == _MICROSOFT + "material/2015/02":
                self.words["materials"] = None
        elif above == "vertices" and word == "vertex":
            self._add_vertex()
        elif above == "triangles" and word == "triangle":
            self._corners.extend(self._whole(attributes, word) for word in ("v1", "v2", "v3"))
            if len(attributes) > 3:
                self.words[_PAINT] = None
        elif word in ("vertices", "triangles") and above == "mesh":
            self._open_list(word)
        elif word == "mesh" and above == "object":
            if self._object in self.meshes:
                raise self._damaged("the object has two meshes")
            self._vertices = self._faces = None
        elif word == "object":
            self._open_object(attributes)
        elif word in ("component", "item"):
            use = self._use(attributes)
            self._n_uses += 1
            if self._n_uses > MAX_USES:
                raise TooLargeError(
                    f"there are more than {MAX_USES:,} components and items",
                    where=self._where(),
                    hint="export the mesh alone",
                )
            if word == "item":
                self.items.append(use)
            else:
                self.components.setdefault(self._object, []).append(use)
        elif word in ("basematerials", "metadata"):
            self.words["materials" if word == "basematerials" else word] = None

    def _end(self, name: str) -> None:
        word = self._path.pop()
        if word == "vertices" and self._vertices is None:
            values, starts, stops = map(np.array, (self._values, self._starts, self._stops))
            self._vertices = values.reshape(-1, 3), starts.reshape(-1, 3), stops.reshape(-1, 3)
            self._values, self._starts, self._stops = array("d"), array("q"), array("q")
        elif word == "triangles" and self._faces is None:
            self._faces = np.array(self._corners, dtype=np.int64).reshape(-1, 3)
            self._corners = array("q")
        elif word == "mesh" and self._path[-1] == "object":
            self._close_mesh()

    def _damaged(self, message: str) -> FormatError:
        return damaged(message, self._where())

    def _open_model(self, attributes: dict[str, str]) -> None:
        self.unit = attributes.get("unit", "millimeter")
        if self.unit not in UNITS:
            raise self._damaged(f"the unit {self.unit[:40]!r} is not one of 3MF")
        for prefix in attributes.get("requiredextensions", "").split():
            uri = self._prefixes.get(prefix, "")
            if uri not in _UNDERSTOOD:
                raise UnsupportedError(
                    f"the file requires the extension {uri or prefix!r}, which is not understood",
                    where=self._where(),
                    hint="export it as a plain mesh, without this extension",
                )

    def _open_object(self, attributes: dict[str, str]) -> None:
        self._object = self._whole(attributes, "id")
        if self._object in self.ids:
            raise self._damaged(f"two objects have the number {self._object}")
        self.ids.add(self._object)
        spaces = [key.rpartition(" ")[0] for key in attributes]
        self.stale |= {_STALE[space]: None for space in spaces if space in _STALE}

    def _open_list(self, word: str) -> None:
        if (self._vertices if word == "vertices" else self._faces) is not None:
            raise self._damaged(f"the mesh has two lists of {word}")
        start = self._here()
        if start not in self._lists:
            return
        begin, stop = self._lists[start]
        region = np.frombuffer(self._text, dtype=np.uint8)[begin:stop]
        starts, stops = find_quoted(region, begin)
        if word == "vertices":
            self._vertices = self._numbers(starts, stops), starts, stops
            finite = np.isfinite(self._vertices[0]).all(axis=1)
            if not finite.all():
                raise self._not_finite(int(np.argmin(finite)))
        else:
            if np.count_nonzero(region == ord('"')) > 2 * starts.size:
                self.words[_PAINT] = None
            # As float64, so that no index wraps round, however many digits it has.
            corners = self._numbers(starts, stops)
            self._faces = np.minimum(corners, 2.0**53).astype(np.int64)

    def _numbers(self, starts: Longs, stops: Longs) -> Floats:
        """The numbers (k, 3) at these bytes of the text."""
        from msal_cli.kernels import text

        buffer = text.as_bytes(self._text)
        values, bad = text.read_numbers(buffer, starts.reshape(-1), stops.reshape(-1))
        if bad >= 0:
            at = int(starts.reshape(-1)[bad])
            word = self._text[at : int(stops.reshape(-1)[bad])][:40].decode("ascii", "replace")
            raise damaged(f"{word!r} is not a number", self._where(at))
        return values.reshape(-1, 3)

    def _not_finite(self, row: int) -> ContentError:
        return ContentError(
            "a position is not finite",
            code="E_NONFINITE",
            where=f"{self._where()}, object {self._object}, vertex {row}",
            hint="remove the vertex, or export the mesh again",
        )

    def _add_vertex(self) -> None:
        at = self._here()
        spans = self._spans(at)
        for word in "xyz":
            start, stop = spans.get(word, (at, at))
            # As the text has it, so that a new number can take its place.
            value = self._text[start:stop].decode("utf-8", "replace")
            is_number = _DECIMAL.fullmatch(value)
            if _NO_NUMBER.fullmatch(value) or (is_number and math.isinf(float(value))):
                raise self._not_finite(len(self._starts) // 3)
            if not is_number:
                raise self._damaged(f"{word} of a vertex is {value[:40]!r}, not a number")
            self._values.append(float(value))
            self._starts.append(start)
            self._stops.append(stop)

    def _spans(self, at: int) -> dict[str, tuple[int, int]]:
        """Where the values of a tag's attributes lie in the text."""
        found = {}
        begin = _TAG_NAME.match(self._text, at)
        here = begin.end() if begin else at
        while match := _ATTRIBUTE.match(self._text, here):
            raw = match[2] if match[2] is not None else match[3]
            start = match.end() - 1 - len(raw.lstrip())
            found[match[1].decode("utf-8", "replace")] = start, start + len(raw.strip())
            here = match.end()
        return found

    def _whole(self, attributes: dict[str, str], word: str) -> int:
        value = attributes.get(word, "").strip()
        if not re.fullmatch(r"\+?[0-9]+", value):
            raise self._damaged(f"{word} is {value[:40]!r}, not a whole number")
        return min(int(value[:25]), 1 << 53)

    def _use(self, attributes: dict[str, str]) -> Use:
        frame = np.eye(4)
        if "transform" in attributes:
            words = attributes["transform"].split()
            if len(words) != 12 or not all(map(_DECIMAL.fullmatch, words)):
                raise self._damaged("a transform has not twelve numbers")
            frame[:3] = np.array([float(word) for word in words]).reshape(4, 3).T
        path = attributes.get(f"{_PRODUCTION} path", "")
        return Use(self._whole(attributes, "objectid"), path, frame, self._here())

    def _close_mesh(self) -> None:
        if self._vertices is None or self._faces is None:
            return
        vertices, starts, stops = self._vertices
        wrong = self._faces.max(axis=1, initial=0) >= len(vertices)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise ContentError(
                f"a triangle names vertex {int(self._faces[row].max())} of {len(vertices)}",
                code="E_INDEX",
                where=f"{self._where()}, object {self._object}, triangle {row}",
                hint=EXPORT_AGAIN,
            )
        self.meshes[self._object] = ThreeMfMesh(vertices, starts, stops, self._faces)
