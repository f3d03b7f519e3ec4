"""One model part of a 3MF package: XML parsed so that positions can be replaced in its text.

Long lists of vertices and triangles in the plain form that nearly all programs write are matched by
a pattern, and left out of the text for the slow XML parser.
"""

import math
import re
from array import array

import numpy as np
from numpy.typing import NDArray

from msal_cli import errors
from msal_cli.arrays import Floats, Longs
from msal_cli.codecs.xml_tree import Element, parse_tree
from msal_cli.light_dataclass import dataclass, field

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
_NEAR = 64  # bytes before the end of a list that have its last tag, but for many blanks


def find_quoted(region: NDArray[np.uint8], offset: int) -> tuple[Longs, Longs]:
    """The places of the first three quoted values of each element, (n, 3) starts and stops;
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
"""Extensions that a file may require, because none of them changes the mesh."""

_STALE = {
    _MICROSOFT + "beamlattice/2017/02": "a beam lattice",
    _MICROSOFT + "slice/2015/07": "slices",
}
"""Extensions that describe the same surface again, so that it must not move alone."""

_PAINT = "triangle attributes"
"""Attributes of triangles besides their corners: colours, materials, paint of a slicer."""

MAX_USES = 100_000  # components and items of a part; large assemblies have some thousands

UNITS = {"micron": "um", "millimeter": "mm", "centimeter": "cm", "inch": "in"}
UNITS |= {"foot": "ft", "meter": "m"}
"""The units of 3MF, and their names in options."""

_DECIMAL = re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?", re.ASCII)
_NO_NUMBER = re.compile(r"[-+]?(?:nan|inf(?:inity)?)", re.IGNORECASE)


@dataclass(eq=False)
class ThreeMfMesh:
    """A mesh of a model part, in its own frame."""

    vertices: Floats  # (n, 3) float64, in the unit of the file
    starts: Longs  # (n, 3), first byte of each number in the part's text
    faces: NDArray[np.int64]  # (m, 3) int64, indices into ``vertices``


@dataclass(frozen=True)
class Use:
    """A component, or an item of the build: an object of a part, and its placement.

    ``path`` is empty for an object of the same part.  ``frame`` (4, 4) applies to column vectors.
    ``at`` is its place in the text.
    """

    object_id: int
    path: str
    frame: Floats = field(repr=False)
    at: int


def place_of(text: bytes, name: str, at: int) -> str:
    return f"{name}, line {1 + text.count(10, 0, at)}"


class Model:
    """A parsed model part; ``name`` is for messages.

    Raises FormatError, TruncatedError, UnsupportedError, and ContentError (``E_INDEX``,
    ``E_NONFINITE``).
    """

    def __init__(self, text: bytes, name: str) -> None:
        self.size = len(text)
        self.ids: set[int] = set()  # of its objects
        self.meshes: dict[int, ThreeMfMesh] = {}  # by their objects' ids, in the order of the file
        self.components: dict[int, list[Use]] = {}  # the components of objects
        self.items: list[Use] = []  # the items to build
        self.words: dict[str, None] = {}  # what else is kept unchanged, for reports
        self.stale: dict[str, None] = {}  # what would no longer fit the surface after a move
        self._text, self._name = text, name
        # For each plain list, by the first byte of its opening tag, where it begins and ends.  In
        # Python up to 3.11.4 a list may match that ends within a tag.
        self._lists = {
            tag.start(): match.span()
            for tag in _LIST.finditer(text)
            if (match := _PLAIN_LISTS[tag[1]].match(text, tag.end()))
            and text[match.end() - _NEAR : match.end()].rstrip().endswith(b">")
        }
        prefixes: dict[str, str] = {}
        left_out = list(self._lists.values())
        root = parse_tree(text, name=name, left_out=left_out, prefixes=prefixes)
        if root.name != "model" or root.space not in _CORES:
            raise self._damaged(f"the root element is {root.name[:40]!r}, not a model of 3MF", root)
        self.unit = root.attributes.get("unit", "millimeter")
        if self.unit not in UNITS:
            raise self._damaged(f"the unit {self.unit[:40]!r} is not one of 3MF", root)
        for prefix in root.attributes.get("requiredextensions", "").split():
            uri = prefixes.get(prefix, "")
            if uri not in _UNDERSTOOD:
                raise errors.UnsupportedError(
                    f"the file requires the extension {uri or prefix!r}, which is not understood",
                    where=self._where(root.start),
                    hint="export it as a plain mesh, without this extension",
                )
        n_uses = 0
        for element in root.inner():
            if element.space in _STALE:
                self.stale[_STALE[element.space]] = None
            elif element.space == _MICROSOFT + "material/2015/02":
                self.words["materials"] = None
            elif element.space not in _CORES:
                continue
            elif element.name == "object":
                self._read_object(element)
            elif element.name == "item":
                self.items.append(self._use(element))
            elif element.name in ("basematerials", "metadata"):
                word = "materials" if element.name == "basematerials" else "metadata"
                self.words[word] = None
            n_uses += element.name in ("component", "item")
            if n_uses > MAX_USES:
                raise errors.TooLargeError(
                    f"there are more than {MAX_USES:,} components and items",
                    where=self._where(element.start),
                    hint="export the mesh alone",
                )
        del self._text

    def _where(self, at: int) -> str:
        return place_of(self._text, self._name, at)

    def _damaged(self, message: str, element: Element) -> errors.FormatError:
        return errors.damaged(message, self._where(element.start))

    def _read_object(self, element: Element) -> None:
        number = self._whole(element, "id")
        if number in self.ids:
            raise self._damaged(f"two objects have the number {number}", element)
        self.ids.add(number)
        spaces = [key.rpartition(" ")[0] for key in element.attributes]
        self.stale |= {_STALE[space]: None for space in spaces if space in _STALE}
        if components := element.find("components"):
            self.components[number] = [self._use(use) for use in components.all("component")]
        meshes = list(element.all("mesh"))
        children = [child for mesh in meshes for child in mesh.children]
        lists = {each.name: each for each in children if each.name in ("vertices", "triangles")}
        if len(meshes) > 1 or sum(each.name in lists for each in children) > len(lists):
            raise self._damaged("the object has two meshes, or its mesh two equal lists", meshes[0])
        if len(lists) < 2:
            return
        vertices, starts = self._read_vertices(lists["vertices"], number)
        faces = self._read_triangles(lists["triangles"])
        wrong = faces.max(axis=1, initial=0) >= len(vertices)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise errors.bad_index(
                f"a triangle names vertex {int(faces[row].max())} of {len(vertices):,}",
                f"{self._where(meshes[0].stop)}, object {number}, triangle {row}",
            )
        self.meshes[number] = ThreeMfMesh(vertices, starts, faces)

    def _read_vertices(self, element: Element, number: int) -> tuple[Floats, Longs]:
        def not_finite(at: int, row: int) -> errors.ContentError:
            return errors.not_finite(
                "a position is not finite", f"{self._where(at)}, object {number}, vertex {row}"
            )

        if span := self._lists.get(element.start):
            starts, stops = find_quoted(np.frombuffer(self._text, np.uint8)[slice(*span)], span[0])
            vertices = self._numbers(starts, stops)
            is_finite = np.isfinite(vertices).all(axis=1)
            if not is_finite.all():
                raise not_finite(element.start, int(np.argmin(is_finite)))
            return vertices, starts
        values, places = array("d"), array("q")
        for row, vertex in enumerate(element.all("vertex")):
            spans = vertex.attribute_places(self._text)
            for axis in "xyz":
                start, stop = spans.get(axis, (vertex.start, vertex.start))
                raw = self._text[start:stop]
                # Matched as written, so that a new number can replace it.
                value = raw.strip().decode("utf-8", "replace")
                is_number = _DECIMAL.fullmatch(value)
                if _NO_NUMBER.fullmatch(value) or (is_number and math.isinf(float(value))):
                    raise not_finite(vertex.start, row)
                if not is_number:
                    message = f"{axis} of a vertex is {value[:40]!r}, not a number"
                    raise self._damaged(message, vertex)
                values.append(float(value))
                places.append(start + len(raw) - len(raw.lstrip()))
        return np.array(values).reshape(-1, 3), np.array(places, dtype=np.int64).reshape(-1, 3)

    def _read_triangles(self, element: Element) -> NDArray[np.int64]:
        if span := self._lists.get(element.start):
            region = np.frombuffer(self._text, np.uint8)[slice(*span)]
            starts, stops = find_quoted(region, span[0])
            if np.count_nonzero(region == _QUOTE) > 2 * starts.size:
                self.words[_PAINT] = None
            # As float64, an index with any number of digits does not wrap around.
            return np.minimum(self._numbers(starts, stops), 2.0**53).astype(np.int64)
        corners = array("q")
        for triangle in element.all("triangle"):
            corners.extend(self._whole(triangle, word) for word in ("v1", "v2", "v3"))
            if len(triangle.attributes) > 3:
                self.words[_PAINT] = None
        return np.array(corners, dtype=np.int64).reshape(-1, 3)

    def _numbers(self, starts: Longs, stops: Longs) -> Floats:
        from msal_cli.kernels import text

        buffer = text.as_bytes(self._text)
        values, bad = text.read_numbers(buffer, starts.reshape(-1), stops.reshape(-1))
        if bad >= 0:
            at = int(starts.reshape(-1)[bad])
            word = self._text[at : int(stops.reshape(-1)[bad])][:40].decode("ascii", "replace")
            raise errors.damaged(f"{word!r} is not a number", self._where(at))
        return values.reshape(-1, 3)

    def _whole(self, element: Element, word: str) -> int:
        value = element.attributes.get(word, "").strip()
        if not re.fullmatch(r"\+?[0-9]+", value):
            raise self._damaged(f"{word} is {value[:40]!r}, not a whole number", element)
        return min(int(value[:25]), 1 << 53)

    def _use(self, element: Element) -> Use:
        frame = np.eye(4)
        if "transform" in element.attributes:
            words = element.attributes["transform"].split()
            if len(words) != 12 or not all(map(_DECIMAL.fullmatch, words)):
                raise self._damaged("a transform has not twelve numbers", element)
            frame[:3] = np.array([float(word) for word in words]).reshape(4, 3).T
        path = element.attributes.get(f"{_PRODUCTION} path", "")
        return Use(self._whole(element, "objectid"), path, frame, element.start)
