"""The header of a PLY file: parsing, and changing its number types.

The header is text up to the line ``end_header``, whatever follows.  Its lines end in LF, CR LF or
CR, as the first line does.
"""

import re
from collections.abc import Sequence

from msal_cli import errors
from msal_cli.codecs.detection import BYTE_ORDER_MARK
from msal_cli.light_dataclass import dataclass, field

POSITION = ("x", "y", "z")
NORMAL = ("nx", "ny", "nz")

MAX_BYTES = 65_536  # longest header that is read; its end is not searched for beyond this
MAX_LINES = 1_000  # most lines of a header; real ones have a few dozen

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
"""Number types in files, and their numpy codes; the 64-bit integers are an extension."""

_NOTES = {b"comment": "comments", b"Created": "comments", b"obj_info": "obj_info"}

ENCODINGS = ("ascii", "binary_little_endian", "binary_big_endian")


@dataclass(frozen=True)
class Property:
    """One ``property`` line: a scalar, or a list if ``count_type`` is not empty.

    ``type`` and ``count_type`` are spelt as in the file; ``line`` is the header line, from 0.
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
        """The least and the most bytes in a binary record; the least of a list is its count."""
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
    """One ``element`` line with its properties; ``count`` is the count in the header."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)

    def find(self, name: str) -> Property | None:
        return next((prop for prop in self.properties if prop.name == name), None)

    def index(self, name: str) -> int:
        return next(k for k, prop in enumerate(self.properties) if prop.name == name)

    def find_all(self, names: Sequence[str]) -> list[Property]:
        """The properties with these names, which must exist."""
        return [self.properties[self.index(name)] for name in names]


@dataclass()
class Header:
    size: int  # bytes up to and including the line end of ``end_header``
    newline: bytes  # the header's line end, ``b"\\n"``, ``b"\\r\\n"`` or ``b"\\r"``
    encoding: str = ""  # one of ``ENCODINGS``, from the line ``format_line`` (from 0)
    format_line: int = -1
    elements: list[Element] = field(default_factory=list)  # in file order
    # files in ``comment TextureFile`` lines, as written
    textures: list[str] = field(default_factory=list)
    # names of its lines without a meaning, each once
    notes: dict[str, None] = field(default_factory=dict)
    # values of ``obj_info`` lines of two words, by the first word
    infos: dict[str, str] = field(default_factory=dict)

    def find(self, name: str) -> Element | None:
        return next((element for element in self.elements if element.name == name), None)

    def byte_range(self) -> tuple[int, int | None]:
        """The least bytes of a file with this header, all lists being empty, and the most, nothing
        following its elements; None for a text, whose words can have any length."""
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
        """Numpy's sign for the byte order of the data; little-endian for ascii."""
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
    """The line end after the magic word; FormatError if the file is not PLY."""
    match = re.match(rb"ply[ \t]*(\r\n|\n|\r)", head)
    if match:
        return match.group(1)
    if b"ply\r".startswith(head):
        raise errors.cut_short("the file ends within its first line")
    raise errors.FormatError(
        "the file does not begin with a line 'ply'",
        where="line 1",
        hint="remove the byte-order mark in front of it"
        if head.startswith(BYTE_ORDER_MARK)
        else "is it another format under a .ply name?",
    )


def _split(head: bytes, newline: bytes, whole: bool) -> tuple[list[bytes], int]:
    """The header's lines without their ends, up to ``end_header``, and the header's size.

    ``whole`` means that ``head`` is the complete file, so that a missing end is a truncation.
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
        raise errors.cut_short("the file ends within its header: there is no 'end_header'", place)
    limit = f"{MAX_LINES:,} lines" if len(lines) >= MAX_LINES else f"{MAX_BYTES:,} bytes"
    raise errors.TooLargeError(
        f"the header has no 'end_header' within its first {limit}",
        where=place,
        hint="the file is damaged, or is not a PLY mesh",
    )


def _read_line(header: Header, number: int, text: bytes) -> None:
    """Add the declaration in line ``number`` (from 0) to a header; FormatError with the line."""

    def fail(message: str, hint: str = "") -> errors.FormatError:
        return errors.FormatError(message, where=f"line {number + 1}", hint=hint)

    words = text.split()
    if words and words[0] in _NOTES:
        header.notes[_NOTES[words[0]]] = None
    match words:
        case [b"obj_info", name, word]:
            header.infos[_decode(name)] = _decode(word)
        case [b"comment", name, _, *_] if name.lower() == b"texturefile":
            header.textures.append(_decode(text.split(None, 2)[2].strip()))
            header.notes["texture file names"] = None
        # Old versions of Blender write "Created by Blender3D 2.43".
        case [] | [b"comment" | b"obj_info", *_] | [b"Created", b"by", *_]:
            pass
        case [b"format", *_] if header.encoding:
            raise fail("the header states its format twice")
        case [b"format", encoding, version] if _decode(encoding) in ENCODINGS:
            if version != b"1.0":
                raise errors.UnsupportedError(
                    f"PLY version {_show(version)} is not known",
                    where=f"line {number + 1}",
                    hint="only version 1.0 exists",
                )
            header.encoding, header.format_line = _decode(encoding), number
        case [b"format", *_]:
            raise fail(
                f"the format line {_show(b' '.join(words))} is not understood",
                "expected 'format ascii 1.0', 'format binary_little_endian 1.0' or "
                "'format binary_big_endian 1.0'",
            )
        case [b"element", word, count]:
            # Twenty digits are enough for any count; more would only take time in int().
            if not count.isdigit() or len(count) > 20:
                raise fail(
                    f"the count {_show(count)} of element {_show(word)} is not a whole number from "
                    "0 up"
                )
            if header.find(_decode(word)):
                raise fail(f"the header declares element {_show(word)} twice")
            header.elements.append(Element(_decode(word), int(count)))
        case [b"element", *_]:
            raise fail("an element line needs a name and a count")
        case [b"property", *_] if not header.elements:
            raise fail("a property stands before the first element")
        case [b"property", b"list", _, _, word] | [b"property", _, word] if (
            len(words) == 5 or words[1] != b"list"
        ):
            types = words[1 + (len(words) == 5) : -1]
            for each in types:
                if _decode(each) not in TYPES:
                    raise fail(f"the number type {_show(each)} is not known")
            count_type, kind = ["", *map(_decode, types)][-2:]
            prop = Property(_decode(word), kind, count_type, number)
            if prop.count_code.startswith("f"):
                raise fail(f"the count of a list cannot be of type {count_type}")
            element = header.elements[-1]
            if element.find(prop.name):
                raise fail(f"element '{element.name}' declares property {_show(word)} twice")
            element.properties.append(prop)
        case [b"property", *_]:
            raise fail(
                f"the property line {_show(b' '.join(words))} is not understood",
                "expected 'property TYPE NAME' or 'property list TYPE TYPE NAME'",
            )
        case _:
            hint = "put the word 'comment' in front of it if it declares nothing"
            raise fail(f"the header line {_show(text)} is not understood", hint)


def parse_header(data: memoryview, is_whole: bool = True) -> Header:
    """The header of the PLY file ``data`` (bytes), or of a part of it if not ``is_whole``.

    Raises FormatError (not PLY, or an invalid line, with its number), UnsupportedError (another
    version), TruncatedError (the file ends within the header) and TooLargeError (no end within
    ``MAX_BYTES`` bytes or ``MAX_LINES`` lines).
    """
    head = bytes(data[:MAX_BYTES])
    newline = _first_line_end(head)
    lines, size = _split(head, newline, whole=is_whole and len(head) == len(data))
    header = Header(size, newline)
    for number, text in enumerate(lines[1:-1], start=1):
        _read_line(header, number, text)
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
    header: Header, text: bytes, encoding: str, precision: str, numbers: Sequence[Property]
) -> bytes:
    """The header's bytes with another encoding and other number types.

    Parameters
    ----------
    text : the header's bytes in the file.
    encoding : ``same``, ``ascii`` or ``binary`` (little endian).
    precision : ``same``, ``float32`` or ``float64``, for the scalars ``numbers``.

    Everything else is kept, spacing included, and types keep their style of names (``double`` for
    ``float``, ``float64`` for ``float32``).
    """
    second_words = {header.format_line: _ENCODING_OF.get(encoding, header.encoding)}
    for prop in numbers:
        code = _CODE_OF.get(precision, prop.code)
        if prop.code != code:
            second_words[prop.line] = _SPELLINGS[code][prop.type[-1].isdigit()]
    ending = b"\r" if header.newline == b"\r" else b"\n"
    lines = text.split(ending)
    for line, word in second_words.items():
        lines[line] = re.sub(rb"^(\s*\S+\s+)\S+", rb"\g<1>" + word.encode(), lines[line])
    return ending.join(lines)
