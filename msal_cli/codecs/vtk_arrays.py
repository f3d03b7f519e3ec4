"""Arrays of VTK's XML files: as text, as base64 or as raw bytes, compressed or not."""

from __future__ import annotations

import base64
import binascii
import lzma
import re
import zlib
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Flags, Floats, Longs
from msal_cli.codecs.slots import BinaryNumbers, Tokens, UnitSlots, to_type
from msal_cli.codecs.tokens import Words
from msal_cli.codecs.xml_offsets import Element
from msal_cli.errors import (
    EXPORT_AGAIN,
    FormatError,
    TooLargeError,
    TruncatedError,
    UnsupportedError,
)
from msal_cli.storage.buffers import Buffer
from msal_cli.storage.gzip_streams import ALWAYS_EXPANDED, LARGEST_RATIO
from msal_cli.storage.limits import memory_bytes

_CODES = {
    f"{sign}Int{bits}": f"{code}{bits // 8}"
    for sign, code in (("", "i"), ("U", "u"))
    for bits in (8, 16, 32, 64)
} | {"Float32": "f4", "Float64": "f8"}
_MOST_LZMA_BYTES = 256 << 20
_BLANKS = b" \t\r\n"


@dataclass(eq=False)
class Coding:
    """How a file stores arrays: ``order`` of bytes, size of the ``header`` numbers, the name of
    the ``compressor``, and where the appended data begin, or -1."""

    data: Buffer = field(repr=False)
    order: str
    header: str
    compressor: str
    appended_at: int = -1
    appended_stop: int = -1
    is_raw: bool = False
    expanded_bytes: int = 0

    def expand(self, size: int, packed: int, at: int) -> None:
        """Count an array of ``size`` bytes that is stored in ``packed``; TooLargeError beyond what
        one array, or all arrays together, may expand to."""
        self.expanded_bytes += size
        of_all = max(ALWAYS_EXPANDED, LARGEST_RATIO * len(self.data))
        if size > max(ALWAYS_EXPANDED, LARGEST_RATIO * packed) or self.expanded_bytes > min(
            of_all, memory_bytes() // 2
        ):
            raise TooLargeError(
                f"an array of {packed:,} bytes expands to {size:,}, and all to "
                f"{self.expanded_bytes:,}",
                where=f"byte {at}",
                hint="write the file without compression if it is what it should be",
            )

    def place(self, array: Element) -> tuple[int, int, bool]:
        """The first byte of an array, the last that it may have, and whether it is raw."""
        if array.attributes.get("format") != "appended":
            return array.inside, array.text_stop, False
        offset = array.attributes.get("offset", "").strip()
        if self.appended_at < 0 or not re.fullmatch(r"[0-9]{1,18}", offset):
            raise FormatError(
                "an array is said to be appended, but is not",
                where=f"byte {array.start}",
                hint=EXPORT_AGAIN,
            )
        return self.appended_at + int(offset), self.appended_stop, self.is_raw


def code_of(array: Element, coding: Coding) -> str:
    """numpy's type of an array's numbers."""
    kind = array.attributes.get("type", "")
    if kind not in _CODES:
        raise UnsupportedError(
            f"numbers of the type {kind[:40]!r} are not read", where=f"byte {array.start}"
        )
    return coding.order + _CODES[kind]


def integers(array: Element, coding: Coding) -> NDArray[np.int64]:
    """All whole numbers of an array (k,)."""
    code = code_of(array, coding)
    if array.attributes.get("format", "ascii") == "ascii":
        return Words(coding.data, array.inside, array.text_stop).integers(slice(None))
    content = _decoded(array, coding)[0]
    if len(content) % np.dtype(code).itemsize:
        raise FormatError("an array is cut", where=f"byte {array.start}", hint=EXPORT_AGAIN)
    return np.frombuffer(content, dtype=code).astype(np.int64)


def numbers(array: Element, coding: Coding, count: int, *, are_normals: bool = False) -> UnitSlots:
    """The rows (count, 3) of an array of floating-point numbers."""
    from msal_cli.kernels.text import as_bytes

    code = code_of(array, coding)
    if code[1] != "f":
        raise UnsupportedError(
            f"positions are stored as {array.attributes['type']}",
            where=f"byte {array.start}",
            hint="write them as Float32 or Float64",
        )
    data = as_bytes(coding.data)
    if array.attributes.get("format", "ascii") == "ascii":
        words = Words(data, array.inside, array.text_stop)
        _require_count(len(words), 3 * count, array)
        return Tokens(data, words.starts, words.stops, unit_length=are_normals)
    content, start, stop = _decoded(array, coding)
    size = 3 * np.dtype(code).itemsize
    _require_count(len(content), size * count, array)
    if coding.place(array)[2] and not coding.compressor:
        first = stop - size * count
        return BinaryNumbers(data, first + size * np.arange(count, dtype=np.int64), code)
    return EncodedNumbers(coding, array, code, start, stop, content)


def _require_count(there: int, wanted: int, array: Element) -> None:
    if there != wanted:
        kind = TruncatedError if there < wanted else FormatError
        raise kind(
            f"an array holds {there:,} numbers or bytes where {wanted:,} are counted",
            where=f"byte {array.start}",
            hint=EXPORT_AGAIN,
        )


@dataclass(eq=False)
class EncodedNumbers(UnitSlots):
    """An array that is one unit, since it is compressed or written in base64."""

    coding: Coding = field(repr=False)
    array: Element = field(repr=False)
    code: str
    start: int
    stop: int
    content: Buffer = field(repr=False)
    values: Floats = field(init=False, repr=False)
    starts: Longs = field(init=False, repr=False)
    stops: Longs = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.starts = np.array([self.start], dtype=np.int64)
        self.stops = np.array([self.stop], dtype=np.int64)
        rows = np.frombuffer(self.content, dtype=self.code).reshape(-1, 3)
        self.values = rows.astype(np.float64)

    def units(self, is_changed: Flags) -> Flags:
        return np.array([is_changed.any()])

    def encode(self, values: Floats, units: Flags) -> tuple[Bytes, Longs]:
        rows = np.frombuffer(self.content, dtype=self.code).reshape(-1, 3)
        # Rows that did not move keep their bits, the signs of zeros included.
        is_same = (values == self.values).all(axis=1)[:, None]
        new = np.where(is_same, rows, to_type(values, self.code))
        text = np.frombuffer(_encoded(new.astype(self.code).tobytes(), self), dtype=np.uint8)
        return text, np.array([len(text)], dtype=np.int64)

    def rounded(self, values: Floats) -> tuple[Floats, float]:
        return to_type(values, self.code).astype(np.float64), 0.0


def _decoded(array: Element, coding: Coding) -> tuple[Buffer, int, int]:
    """The bytes of an array, and between which bytes of the file it is stored, headers included."""
    start, stop, is_raw = coding.place(array)
    view = memoryview(coding.data).cast("B")[:stop]
    source: _Raw | _Base64 = _Raw(view, start) if is_raw else _Base64(view, start)
    width = np.dtype(coding.header).itemsize
    head = source.take(width if not coding.compressor else 3 * width)
    counts = np.frombuffer(head, dtype=coding.header).tolist()
    if not coding.compressor:
        content = source.take(counts[0])
        coding.expand(len(content), len(content), start)
        return content, source.first, source.end()
    n_blocks, block_bytes, last_bytes = counts
    if n_blocks * width > stop - start:
        raise TruncatedError("blocks are missing", where=f"byte {start}", hint=EXPORT_AGAIN)
    sizes = np.frombuffer(source.take(n_blocks * width), dtype=coding.header).tolist()
    source.begin_data()
    packed = sum(sizes)
    total = (n_blocks - 1) * block_bytes + (last_bytes or block_bytes) if n_blocks else 0
    coding.expand(total, packed, start)
    content = b"".join(
        _expanded(
            source.take(size),
            last_bytes if last_bytes and k == n_blocks - 1 else block_bytes,
            coding.compressor,
            start,
        )
        for k, size in enumerate(sizes)
    )
    return content, source.first, source.end()


def _expanded(block: bytes, size: int, compressor: str, at: int) -> bytes:
    """A block of ``size`` bytes."""
    try:
        if compressor == "vtkZLibDataCompressor":
            content = zlib.decompressobj().decompress(block, size + 1)
        else:
            limit = lzma.LZMADecompressor(memlimit=_MOST_LZMA_BYTES)
            content = limit.decompress(block, size + 1)
    except (zlib.error, lzma.LZMAError) as failure:
        raise FormatError(
            f"a compressed array is damaged: {failure}", where=f"byte {at}", hint=EXPORT_AGAIN
        ) from None
    if len(content) != size:
        raise FormatError(
            "a compressed block has another size than it says",
            where=f"byte {at}",
            hint=EXPORT_AGAIN,
        )
    return content


def _encoded(content: bytes, like: EncodedNumbers) -> bytes:
    """Bytes as an array is stored, compressed and written as the one that it replaces."""
    coding = like.coding
    is_raw = coding.place(like.array)[2]
    width = np.dtype(coding.header).itemsize
    view = memoryview(coding.data).cast("B")[: like.stop]
    source: _Raw | _Base64 = _Raw(view, like.start) if is_raw else _Base64(view, like.start)
    head = source.take(width if not coding.compressor else 3 * width)
    if not coding.compressor:
        if source.is_split():
            return base64.b64encode(head) + base64.b64encode(content)
        return base64.b64encode(head + content)
    block_bytes = max(1, int(np.frombuffer(head, dtype=coding.header)[1]))
    blocks = [content[at : at + block_bytes] for at in range(0, len(content), block_bytes)]
    pack = zlib.compress if coding.compressor == "vtkZLibDataCompressor" else lzma.compress
    packed = [pack(block) for block in blocks]
    last = len(content) % block_bytes
    counts = [len(blocks), block_bytes, last, *(len(one) for one in packed)]
    head = np.array(counts, dtype=coding.header).tobytes()
    body = b"".join(packed)
    return head + body if is_raw else base64.b64encode(head) + base64.b64encode(body)


class _Raw:
    """Bytes taken one behind the other; ``first`` is where they begin."""

    def __init__(self, view: memoryview, at: int) -> None:
        self.first = self._at = at
        self._view = view

    def take(self, size: int) -> bytes:
        """The next ``size`` bytes."""
        if size < 0 or self._at + size > len(self._view):
            raise _cut(len(self._view))
        self._at += size
        return bytes(self._view[self._at - size : self._at])

    def begin_data(self) -> None:
        """Nothing stands between header and data."""

    def is_split(self) -> bool:
        return False

    def end(self) -> int:
        """The byte behind what was taken."""
        return self._at


class _Base64:
    """Bytes taken from base64, whose header may be a piece of its own."""

    def __init__(self, view: memoryview, at: int) -> None:
        while at < len(view) and view[at] in _BLANKS:
            at += 1
        self.first = self._at = at
        self._view = view
        self._left = b""
        self._split = False

    def take(self, size: int) -> bytes:
        """The next ``size`` bytes."""
        missing = size - len(self._left)
        if missing > 0:
            letters = 4 * -(-missing // 3)
            if size < 0 or self._at + letters > len(self._view):
                raise _cut(len(self._view))
            text = bytes(self._view[self._at : self._at + letters])
            try:
                self._left += base64.b64decode(text, validate=True)
            except binascii.Error:
                raise FormatError(
                    "an array is not base64", where=f"byte {self._at}", hint=EXPORT_AGAIN
                ) from None
            self._at += letters
            self._split |= text.endswith(b"=")
        if len(self._left) < size:
            raise _cut(self._at)
        result, self._left = self._left[:size], self._left[size:]
        return result

    def begin_data(self) -> None:
        """Compressed data are a piece of their own."""
        self._left = b""

    def is_split(self) -> bool:
        """Whether the header was a piece of its own."""
        return self._split

    def end(self) -> int:
        """The byte behind what was taken."""
        return self._at


def _cut(at: int) -> TruncatedError:
    return TruncatedError(
        "an array ends before all its bytes are there", where=f"byte {at}", hint=EXPORT_AGAIN
    )
