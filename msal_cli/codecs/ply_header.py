"""The header of a PLY file: what it declares, and how it reads after a change of number types.

The header is plain text up to the line ``end_header``, whatever follows.  Its lines end in LF,
CR LF or CR; the first line shows which.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from msal_cli import errors
from msal_cli.codecs.detection import BYTE_ORDER_MARK

POSITION = ("x", "y", "z")
NORMAL = ("nx", "ny", "nz")

CUT_HINT = "the file was cut short or its header counts are wrong; copy or export it again"

MAX_BYTES = 65_536
"""Longest header that is read; a file without an end to its header is not searched further."""

MAX_LINES = 1_000
"""Most lines of a header; real ones have a few dozen."""

_SPELLINGS = {
    "i1": ("char", "int8"),
    "u1": ("uchar", "uint8"),
    "i2": ("short", "int16"),
    "u2": ("ushort", "uint16"),
    "i4": ("int", "int32"),
    "u4": ("uint", "uint32"),
    "i8": ("int64",),
    "u8": ("uint64",),
    "f4": ("float", "float32"),
    "f8": ("double", "float64"),
}
TYPES = {name: code for code, names in _SPELLINGS.items() for name in names}
"""Number types as files spell them, and their numpy codes; the 64-bit integers are an extension."""

_STRUCTURAL = ("format", "element", "property", "end_header")
"""Keywords without which a header cannot be understood."""

_ALIKE = 0.65
"""Similarity, from 0 to 1, from which on a word counts as a misspelt keyword."""

ENCODINGS = ("ascii", "binary_little_endian", "binary_big_endian")


@dataclass(frozen=True)
class Property:
    """One ``property`` line: a scalar, or a list when ``count_type`` is not empty.

    ``type`` and ``count_type`` are spelt as in the file; ``line`` counts header lines from 0.
    """

    name: str
    type: str
    count_type: str
    line: int

    @property
    def code(self) -> str:
        """Numpy code of the values, such as ``"f4"``."""
        return TYPES[self.type]

    @property
    def count_code(self) -> str:
        """Numpy code of a list's count; empty for a scalar."""
        return TYPES[self.count_type] if self.count_type else ""

    @property
    def is_list(self) -> bool:
        return bool(self.count_type)

    def byte_range(self) -> tuple[int, int]:
        """Bytes in a binary record at the least, which is a list's count, and at the most."""
        size = int(self.code[1])
        if not self.is_list:
            return size, size
        count_size = int(self.count_code[1])
        bits = 8 * count_size - (self.count_code[0] == "i")
        return count_size, count_size + ((1 << bits) - 1) * size

    def __str__(self) -> str:
        kind = f"list {self.count_type} {self.type}" if self.is_list else self.type
        return f"{self.name} {kind}"


@dataclass()
class Element:
    """One ``element`` line with its properties; ``count`` is what the file claims."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)

    def find(self, name: str) -> Property | None:
        return next((prop for prop in self.properties if prop.name == name), None)

    def index(self, name: str) -> int:
        return next(k for k, prop in enumerate(self.properties) if prop.name == name)

    def find_all(self, names: Sequence[str]) -> list[Property]:
        """The properties of these names, which all must be there."""
        return [self.properties[self.index(name)] for name in names]


@dataclass(frozen=True)
class Stray:
    """A header line without a known keyword, which is kept like a comment.

    ``line`` counts from 1, ``text`` is for messages.  ``is_doubtful`` is set for one behind the
    first ``element``: it could have declared something.
    """

    line: int
    text: str
    is_doubtful: bool


@dataclass()
class Header:
    """A parsed header.

    Attributes
    ----------
    size : bytes up to and including the line end of ``end_header``.
    newline : the header's line end, ``b"\\n"``, ``b"\\r\\n"`` or ``b"\\r"``.
    encoding : one of ``ENCODINGS``, which line ``format_line`` (from 0) states.
    elements : in file order.
    textures : files named by ``comment TextureFile``, as written.
    strays : lines that say nothing that is known.
    infos : words behind ``obj_info``, by the first of them.
    """

    size: int
    newline: bytes
    encoding: str = ""
    format_line: int = -1
    elements: list[Element] = field(default_factory=list)
    textures: list[str] = field(default_factory=list)
    strays: list[Stray] = field(default_factory=list)
    infos: dict[str, str] = field(default_factory=dict)

    def find(self, name: str) -> Element | None:
        return next((element for element in self.elements if element.name == name), None)

    def byte_range(self) -> tuple[int, int | None]:
        """Bytes that a file with this header has at the least, its lists being empty, and at the
        most, nothing being behind its elements; None for a text, whose words have any length."""
        records = [
            (element.count, prop) for element in self.elements for prop in element.properties
        ]
        if self.encoding == "ascii":
            # One digit and one separator for each value; the last value needs no separator.
            return self.size + 2 * sum(count for count, _ in records) - 1, None
        ranges = [(count, *prop.byte_range()) for count, prop in records]
        least, most = (sum(row[0] * row[k] for row in ranges) for k in (1, 2))
        return self.size + least, self.size + most

    @property
    def byte_order(self) -> str:
        """Numpy's sign for the byte order of the data; little for ascii, which has none."""
        return ">" if self.encoding == "binary_big_endian" else "<"


def _decode(text: bytes) -> str:
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError:
        return text.decode("latin-1")


def _show(text: bytes) -> str:
    word = _decode(text[:60])
    return repr(word if len(text) <= 60 else word + "...")


def _first_line_end(head: bytes) -> bytes:
    """The line end after the magic word; FormatError where the file is not PLY at all."""
    match = re.match(rb"ply[ \t]*(\r\n|\n|\r)", head)
    if match:
        return match.group(1)
    if head.startswith(BYTE_ORDER_MARK):
        raise errors.FormatError(
            "the file begins with a byte-order mark instead of the word 'ply'",
            where="byte 0",
            hint="remove the first three bytes",
        )
    if not head:
        raise errors.TruncatedError("the file is empty", hint="copy or export it again")
    if b"ply\n".startswith(head) or b"ply\r".startswith(head):
        raise errors.TruncatedError("the file ends within its first line", hint="export it again")
    raise errors.FormatError(
        "the file does not begin with a line 'ply'",
        where="line 1",
        hint="is it another format under a .ply name?",
    )


def _split(head: bytes, newline: bytes, whole: bool) -> tuple[list[bytes], int]:
    """The header's lines without their ends, ``end_header`` last, and the header's size.

    ``whole`` says that ``head`` is the complete file, so that a missing end is a truncation.
    """
    ending = b"\r" if newline == b"\r" else b"\n"
    lines: list[bytes] = []
    at = stop = 0
    while stop >= 0 and len(lines) < MAX_LINES:
        stop = head.find(ending, at)
        lines.append(head[at:] if stop < 0 else head[at:stop])
        at = stop + 1
        if lines[-1].strip() == b"end_header" and (stop >= 0 or whole):
            # The last line needs no line end when no data follow.
            return lines, len(head) if stop < 0 else at
    place = f"line {len(lines)}"
    if whole and len(lines) < MAX_LINES:
        raise errors.TruncatedError(
            "the file ends within its header: there is no 'end_header'",
            where=place,
            hint=errors.CUT_SHORT,
        )
    limit = f"{MAX_LINES} lines" if len(lines) >= MAX_LINES else f"{MAX_BYTES} bytes"
    raise errors.TooLargeError(
        f"the header has no 'end_header' within its first {limit}",
        where=place,
        hint="the file is damaged, or is not a PLY mesh",
    )


class _Parser:
    """Fills a header line by line; every method raises FormatError with the line."""

    def __init__(self, header: Header) -> None:
        self.header = header
        self.line = 0

    def fail(self, message: str, hint: str = "") -> errors.FormatError:
        return errors.FormatError(message, where=f"line {self.line + 1}", hint=hint)

    def read_format(self, words: list[bytes]) -> None:
        if self.header.encoding:
            raise self.fail("the header states its format twice")
        if len(words) != 3 or _decode(words[1]) not in ENCODINGS:
            raise self.fail(
                f"the format line {_show(b' '.join(words))} is not understood",
                "expected 'format ascii 1.0', 'format binary_little_endian 1.0' or "
                "'format binary_big_endian 1.0'",
            )
        if words[2] != b"1.0":
            raise errors.UnsupportedError(
                f"PLY version {_show(words[2])} is not known",
                where=f"line {self.line + 1}",
                hint="only version 1.0 exists",
            )
        self.header.encoding = _decode(words[1])
        self.header.format_line = self.line

    def read_element(self, words: list[bytes]) -> None:
        if len(words) != 3:
            raise self.fail("an element line needs a name and a count")
        name = _decode(words[1])
        # Twenty digits hold every count a file could have; more would only burn time in int().
        if not words[2].isdigit() or len(words[2]) > 20:
            raise self.fail(
                f"the count {_show(words[2])} of element {_show(words[1])} is not a whole "
                "number from 0 up"
            )
        if any(element.name == name for element in self.header.elements):
            raise self.fail(f"the header declares element {_show(words[1])} twice")
        self.header.elements.append(Element(name, int(words[2])))

    def read_property(self, words: list[bytes]) -> None:
        if not self.header.elements:
            raise self.fail("a property stands before the first element")
        is_list = len(words) > 1 and words[1] == b"list"
        if len(words) != (5 if is_list else 3):
            raise self.fail(
                f"the property line {_show(b' '.join(words))} is not understood",
                "expected 'property TYPE NAME' or 'property list TYPE TYPE NAME'",
            )
        for word in words[2 if is_list else 1 : -1]:
            if _decode(word) not in TYPES:
                raise self.fail(f"the number type {_show(word)} is not known")
        count_type = _decode(words[2]) if is_list else ""
        if is_list and TYPES[count_type][0] == "f":
            raise self.fail(f"the count of a list cannot be of type {count_type}")
        element = self.header.elements[-1]
        prop = Property(_decode(words[-1]), _decode(words[-2]), count_type, self.line)
        if element.find(prop.name):
            raise self.fail(f"element '{element.name}' declares property {_show(words[-1])} twice")
        element.properties.append(prop)

    def read(self, text: bytes) -> None:
        words = text.split()
        if not words:
            return
        if words[0] == b"obj_info":
            if len(words) == 3:
                self.header.infos[_decode(words[1])] = _decode(words[2])
        elif words[0] == b"comment":
            if len(words) > 2 and words[1].lower() == b"texturefile":
                self.header.textures.append(_decode(text.split(None, 2)[2].strip()))
        elif words[0] == b"format":
            self.read_format(words)
        elif words[0] == b"element":
            self.read_element(words)
        elif words[0] == b"property":
            self.read_property(words)
        elif _is_stray(text, words[0]):
            # As old versions of Blender write: "Created by Blender3D 2.43", without "comment".
            self.header.strays.append(Stray(self.line + 1, _show(text), bool(self.header.elements)))
        else:
            raise self.fail(f"the header line {_show(text)} is not understood")


def _is_stray(text: bytes, keyword: bytes) -> bool:
    """Whether a line is text whose first word cannot be meant as a structural keyword."""
    from difflib import get_close_matches

    if any((c < 32 and c != 9) or c == 127 for c in text.rstrip(b"\r")):
        return False
    word = _decode(keyword[:60]).lower()
    is_glued = any(word.startswith(keyword) for keyword in _STRUCTURAL)
    return not is_glued and not get_close_matches(word, _STRUCTURAL, cutoff=_ALIKE)


def parse_header(data: memoryview, is_whole: bool = True) -> Header:
    """The header of the PLY file ``data`` (bytes), or of its beginning if not ``is_whole``.

    Lines of other words are kept among ``Header.strays``.  Raises FormatError (not PLY, or a line
    that is damaged, with its number), UnsupportedError (another version), TruncatedError (the file
    ends within the header) and TooLargeError (no end within ``MAX_BYTES`` bytes or ``MAX_LINES``
    lines).
    """
    head = bytes(data[:MAX_BYTES])
    newline = _first_line_end(head)
    lines, size = _split(head, newline, whole=is_whole and len(head) == len(data))
    header = Header(size, newline)
    parser = _Parser(header)
    for parser.line, text in enumerate(lines):
        if 0 < parser.line < len(lines) - 1:
            parser.read(text)
    if not header.encoding:
        raise errors.FormatError(
            "the header has no format line",
            where="header",
            hint="expected 'format ascii 1.0' or one of the binary formats after 'ply'",
        )
    return header


_ENCODING_OF = {"ascii": "ascii", "binary": "binary_little_endian"}
_CODE_OF = {"float32": "f4", "float64": "f8"}


def retype_header(
    header: Header,
    text: bytes,
    encoding: str,
    precision: str,
    retypable: Mapping[str, Sequence[str]],
) -> bytes:
    """The header's bytes with another encoding and other types of numbers.

    Parameters
    ----------
    text : the header as it stands in the file.
    encoding : ``same``, ``ascii`` or ``binary`` (little endian).
    precision : ``same``, ``float32`` or ``float64``, of the scalars ``retypable`` of each element.

    Everything else, spacing included, is kept, and a type keeps its family of spelling
    (``double`` for ``float``, ``float64`` for ``float32``).
    """
    second_words = {header.format_line: _ENCODING_OF.get(encoding, header.encoding)}
    for element in header.elements:
        for prop in element.properties:
            code = _CODE_OF.get(precision, prop.code)
            if prop.name in retypable.get(element.name, ()) and prop.code != code:
                second_words[prop.line] = _SPELLINGS[code][prop.type[-1].isdigit()]
    ending = b"\r" if header.newline == b"\r" else b"\n"
    lines = text.split(ending)
    for line, word in second_words.items():
        lines[line] = re.sub(rb"^(\s*\S+\s+)\S+", rb"\g<1>" + word.encode(), lines[line])
    return ending.join(lines)
