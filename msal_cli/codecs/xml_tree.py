"""XML files parsed so that their bytes can be replaced: elements and their places.

The XML is untrusted.  Expat reads it, without access to files and the network; document types, and
with them all entities, are refused.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from itertools import accumulate
from xml.parsers import expat

from msal_cli.codecs.text_slots import Span
from msal_cli.errors import TooLargeError, UnsupportedError, cut_short, damaged
from msal_cli.light_dataclass import dataclass, field
from msal_cli.storage.regular import Buffer

MAX_ELEMENTS = 1_000_000  # the tree of more elements would take more memory than meshes take

_MAX_DEPTH = 100
# Expat reports these errors only at the end of the data.
_CUT = (
    expat.errors.XML_ERROR_NO_ELEMENTS,
    expat.errors.XML_ERROR_UNCLOSED_TOKEN,
    expat.errors.XML_ERROR_UNCLOSED_CDATA_SECTION,
    expat.errors.XML_ERROR_PARTIAL_CHAR,
)
_TAG = re.compile(rb"<(?:[^\"'>]|\"[^\"]*\"|'[^']*')*>")
_ATTRIBUTE = re.compile(rb"\s([^\s=<>\"'/]+)\s*=\s*(?:\"([^\"]*)\"|'([^']*)')")


@dataclass(slots=True, eq=False)
class Element:
    space: str  # space, name: its namespace and its local name
    name: str
    # by name, which begins with the namespace and a blank if the attribute has one
    attributes: dict[str, str]
    start: int  # the first byte of its tag; its content is ``data[inside:stop]``
    inside: int
    stop: int
    children: list[Element] = field(default_factory=list)

    @property
    def text_stop(self) -> int:
        """The end of the text before the first child."""
        return self.children[0].start if self.children else self.stop

    def find(self, name: str) -> Element | None:
        return next(self.all(name), None)

    def all(self, name: str) -> Iterator[Element]:
        return (child for child in self.children if child.name == name)

    def inner(self) -> Iterator[Element]:
        """All descendants, in the order of the file."""
        left = self.children[::-1]
        while left:
            element = left.pop()
            yield element
            left.extend(element.children[::-1])

    def attribute_places(self, data: Buffer) -> dict[str, Span]:
        """The places of attribute values, by the attributes' names in the text."""
        places = {}
        for match in _ATTRIBUTE.finditer(memoryview(data)[: self.inside], self.start):
            places[match[1].decode("utf-8", "replace")] = match.span(
                2 if match[2] is not None else 3
            )
        return places


def parse_tree(
    data: Buffer,
    stop: int | None = None,
    *,
    name: str = "",
    left_out: Sequence[Span] = (),
    prefixes: dict[str, str] | None = None,
) -> Element:
    """The root of an XML file, or of its beginning up to the byte ``stop``.

    Parameters
    ----------
    name : the file's name, for the places of errors, if it is one of several.
    left_out : parts of the file, in order, with plain elements that are not parsed.
    prefixes : receives the namespaces by their prefixes.

    Raises FormatError if it is not well-formed XML; TruncatedError if the XML ends within an
    element or a tag; UnsupportedError for a document type, which may declare entities, or an
    encoding such as UTF-16; TooLargeError for more than ``MAX_ELEMENTS`` elements, or very deep
    ones.
    """
    root: Element | None = None
    opened: list[Element] = []
    count = 0
    parser = expat.ParserCreate(namespace_separator=" ")
    # The bytes that Expat had received before each part was left out, and all left out until then.
    skipped = list(accumulate((end - begin for begin, end in left_out), initial=0))
    fed = [begin - size for (begin, _), size in zip(left_out, skipped, strict=False)]

    def place(index: int) -> int:
        """The byte of the file for a byte that Expat received."""
        return index + skipped[bisect_right(fed, index)]

    of_name = f"{name}, " if name else ""

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal root, count
        count += 1
        if count > MAX_ELEMENTS or len(opened) > _MAX_DEPTH:
            raise TooLargeError(
                f"the file has more than {MAX_ELEMENTS:,} elements"
                if count > MAX_ELEMENTS
                else f"elements lie more than {_MAX_DEPTH} deep in one another",
                where=of_name.removesuffix(", "),
                hint="convert it to PLY",
            )
        at = place(parser.CurrentByteIndex)
        tag = _TAG.match(data, at)
        if tag is None:
            raise damaged("a tag does not end", f"{of_name}byte {at}")
        space, _, word = name.rpartition(" ")
        element = Element(space, word, attributes, at, tag.end(), tag.end())
        if opened:
            opened[-1].children.append(element)
        elif root is None:
            root = element
        opened.append(element)

    def end(name: str) -> None:
        element = opened.pop()
        # For ``<a/>`` the end is reported where the tag begins.
        element.stop = max(element.inside, place(parser.CurrentByteIndex))

    def refuse_doctype(*_: object) -> None:
        raise UnsupportedError(
            "the XML has a document type, whose entities may expand to anything",
            where=name,
            hint="remove the DOCTYPE, or export the mesh again",
        )

    def note_prefix(prefix: str | None, uri: str | None) -> None:
        if prefixes is not None:
            prefixes[prefix or ""] = uri or ""

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.StartDoctypeDeclHandler = refuse_doctype
    parser.StartNamespaceDeclHandler = note_prefix
    view = memoryview(data).cast("B")[:stop]
    if bytes(view[:2]) in (b"\xfe\xff", b"\xff\xfe", b"<\0", b"\0<"):
        raise UnsupportedError("the XML is UTF-16", where=name, hint="save it as UTF-8")
    try:
        done = 0
        for begin, after in left_out:
            parser.Parse(view[done:begin], False)
            done = after
        parser.Parse(view[done:], stop is None)
    except expat.ExpatError as failure:
        line = 1 + bytes(view[: place(parser.ErrorByteIndex)]).count(b"\n")
        where = f"{of_name}line {line}"
        reason = expat.errors.messages[failure.code]
        if reason in _CUT:
            raise cut_short("the XML ends early", where) from None
        raise damaged(f"it is not well-formed XML: {reason}", where) from None
    except (LookupError, ValueError) as failure:
        raise UnsupportedError(
            f"the XML is written in another way than UTF-8: {str(failure).rstrip('.')}",
            where=name,
            hint="save it as UTF-8",
        ) from None
    finally:
        # The handlers refer to the parser, and the cycle would delay freeing it.
        parser.StartElementHandler = parser.EndElementHandler = None
    if root is None:
        raise damaged("the file has no element", name)
    return root
