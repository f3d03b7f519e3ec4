"""The elements of an XML file, and the bytes between which the content of each stands."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat

from msal_cli.errors import TooLargeError, UnsupportedError, damaged
from msal_cli.storage.regular import Buffer

MAX_ELEMENTS = 1_000_000
"""A file of more elements would take more memory as a tree than meshes take."""

_MAX_DEPTH = 100
_TAG = re.compile(rb"<(?:[^\"'>]|\"[^\"]*\"|'[^']*')*>")


@dataclass(slots=True, eq=False)
class Element:
    """An element; ``name`` is without its namespace, ``start`` the first byte of its tag, and its
    content is ``data[inside:stop]``."""

    name: str
    attributes: dict[str, str]
    start: int
    inside: int
    stop: int
    children: list[Element] = field(default_factory=list)

    @property
    def text_stop(self) -> int:
        """The end of the text in front of the first element inside."""
        return self.children[0].start if self.children else self.stop

    def find(self, name: str) -> Element | None:
        """The first child of that name."""
        return next(self.all(name), None)

    def all(self, name: str) -> Iterator[Element]:
        return (child for child in self.children if child.name == name)

    def inner(self) -> Iterator[Element]:
        """All elements inside, in the order of the file."""
        left = self.children[::-1]
        while left:
            element = left.pop()
            yield element
            left.extend(element.children[::-1])

    def attribute_place(self, data: Buffer, name: str) -> tuple[int, int] | None:
        """Between which bytes the value of an attribute stands, or None."""
        tag = bytes(memoryview(data)[self.start : self.inside])
        found = re.search(rb"\s%s\s*=\s*(?:\"([^\"]*)\"|'([^']*)')" % re.escape(name.encode()), tag)
        if not found:
            return None
        group = 1 if found[1] is not None else 2
        return self.start + found.start(group), self.start + found.end(group)


def parse_tree(data: Buffer, what: str, stop: int | None = None) -> Element:
    """The root of an XML file, or of its beginning up to the byte ``stop``.

    Entities are refused, so that nothing expands; no other file is opened, whatever is named.

    Raises
    ------
    FormatError
        if it is not well-formed XML.
    UnsupportedError
        for entities that the file declares, or letters of more than one byte as in UTF-16.
    TooLargeError
        for more than ``MAX_ELEMENTS`` elements.
    """
    builder = _Builder(data)
    parser = expat.ParserCreate()
    builder.parser = parser
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.EntityDeclHandler = builder.refuse_entity
    view = memoryview(data).cast("B")
    if bytes(view[:2]) in (b"\xfe\xff", b"\xff\xfe"):
        raise UnsupportedError("the XML is UTF-16", hint="save it as UTF-8")
    try:
        parser.Parse(bytes(view[:stop]), stop is None)
    except expat.ExpatError as failure:
        message = f"it is not well-formed XML: {expat.errors.messages[failure.code]}"
        raise damaged(message, f"line {failure.lineno}") from None
    except (LookupError, ValueError) as failure:
        raise UnsupportedError(
            f"the XML is written in another way than UTF-8: {failure}", hint="save it as UTF-8"
        ) from None
    finally:
        # Each names the other, so that neither would be freed before long.
        del builder.parser
    if builder.root is None:
        raise damaged(f"there is no {what} in the file")
    return builder.root


class _Builder:
    """Builds the tree while expat reads."""

    parser: expat.XMLParserType

    def __init__(self, data: Buffer) -> None:
        self.root: Element | None = None
        self._data = data
        self._open: list[Element] = []
        self._count = 0

    def start(self, name: str, attributes: dict[str, str]) -> None:
        self._count += 1
        if self._count > MAX_ELEMENTS or len(self._open) > _MAX_DEPTH:
            raise TooLargeError(
                f"the file has more than {MAX_ELEMENTS:,} elements"
                if self._count > MAX_ELEMENTS
                else f"elements lie more than {_MAX_DEPTH} deep in one another",
                hint="convert it to PLY",
            )
        at = self.parser.CurrentByteIndex
        tag = _TAG.match(self._data, at)
        if tag is None:
            raise damaged("a tag does not end", f"byte {at}")
        element = Element(name.rpartition(":")[2], attributes, at, tag.end(), tag.end())
        if self._open:
            self._open[-1].children.append(element)
        elif self.root is None:
            self.root = element
        self._open.append(element)

    def end(self, name: str) -> None:
        element = self._open.pop()
        # Of ``<a/>`` the end is reported where the tag begins.
        element.stop = max(element.inside, self.parser.CurrentByteIndex)
        if bytes(memoryview(self._data)[element.inside - 2 : element.inside]) == b"/>":
            element.stop = element.inside

    def refuse_entity(self, *_: object) -> None:
        raise UnsupportedError(
            "the XML declares entities, which may expand to anything",
            hint="remove the DOCTYPE, or export the mesh again",
        )
