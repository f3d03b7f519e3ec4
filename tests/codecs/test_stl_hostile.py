"""STL files that are damaged: each gives its error, and none a traceback."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from msal_cli.codecs import stl
from tests.codecs import plain_stl
from tests.codecs.plain_stl import tetrahedron

BINARY = plain_stl.binary(tetrahedron(), attributes=[1, 2, 3, 4], header=b"COLOR=rgba")
TEXT = plain_stl.text(tetrahedron()).encode()


def with_float(at: int, value: float) -> bytes:
    data = bytearray(BINARY)
    struct.pack_into("<f", data, at, value)
    return bytes(data)


def line(number: int, new: str) -> bytes:
    lines = TEXT.decode().split("\n")
    lines[number - 1] = new
    return "\n".join(lines).encode()


DAMAGED = {
    "empty": (b"", "E_TRUNCATED", ""),
    "header only": (BINARY[:80], "E_TRUNCATED", "byte 80"),
    "cut within a facet": (BINARY[:100], "E_TRUNCATED", "byte 100"),
    "last byte missing": (BINARY[:-1], "E_TRUNCATED", f"byte {len(BINARY) - 1}"),
    "count of minus one": (plain_stl.binary(tetrahedron(), count=0xFFFFFFFF), "E_TRUNCATED",
        f"byte {len(BINARY)}"),
    "count one too many": (plain_stl.binary(tetrahedron(), count=5), "E_TRUNCATED",
        f"byte {len(BINARY)}"),
    "no facets": (plain_stl.binary(np.zeros((0, 9))), "E_NO_FACES", ""),
    "count of zero with facets": (plain_stl.binary(tetrahedron(), count=0), "E_NO_FACES", ""),
    "NaN corner": (with_float(96, float("nan")), "E_NONFINITE", "facet 0, corner 0"),
    "minus infinity, last": (with_float(84 + 150 + 44, float("-inf")), "E_NONFINITE",
        "facet 3, corner 2"),
    "begins with solid, cut": (b"solid" + BINARY[5:120], "E_TRUNCATED", "byte 120"),
    "big endian": (BINARY[:80] + BINARY[83:79:-1] + BINARY[84:], "E_TRUNCATED", "byte 284"),
    "utf-16": (TEXT.decode().encode("utf-16"), "E_FORMAT", "byte 0"),
    "a picture": (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + bytes(range(1, 200)), "E_TRUNCATED",
        "byte 215"),
    "empty solid": (b"solid a\nendsolid a\n", "E_NO_FACES", ""),
    "only a name": (b"solid a\n", "E_TRUNCATED", "facet 0, line 2"),
    "no endsolid": (TEXT[: TEXT.index(b"endsolid")], "E_TRUNCATED", "facet 4, line 30"),
    "cut in a keyword": (TEXT[: TEXT.index(b"outer") + 2], "E_TRUNCATED", "facet 0, line 3"),
    "cut before a number": (line(4, "vertex 0 0")[:80], "E_TRUNCATED", ""),
    "cut in an exponent": (line(4, "vertex 0 0 1e")[:79], "E_TRUNCATED", ""),
    "no solid line": (TEXT[TEXT.index(b"facet") :], "E_FORMAT", "facet 0, line 1"),
    "text that is no STL": (b"hello world, this is a letter\n" * 9, "E_FORMAT", "facet 0, line 1"),
    "misspelt facet": (line(9, "facets normal 0 0 1"), "E_FORMAT", "facet 1, line 9"),
    "glued words": (line(2, "facetnormal 0 0 1"), "E_FORMAT", "facet 0, line 2"),
    "two normal numbers": (line(2, "facet normal 0 0"), "E_FORMAT", "facet 0, line 3"),
    "four normal numbers": (line(2, "facet normal 0 0 1 1"), "E_FORMAT", "facet 0, line 2"),
    "two coordinates": (line(4, "vertex 0 0"), "E_FORMAT", "facet 0, line 5"),
    "four coordinates": (line(4, "vertex 0 0 0 0"), "E_FORMAT", "facet 0, line 4"),
    "four corners": (line(6, "vertex 0 0 1 vertex 1 1 1"), "E_FORMAT", "facet 0, line 6"),
    "a comma for a point": (line(5, "vertex 0,5 0 0"), "E_FORMAT", "facet 0, line 5"),
    "Fortran exponent": (line(5, "vertex 1.0D0 0 0"), "E_FORMAT", "facet 0, line 5"),
    "a comment": (line(3, "# outer loop"), "E_FORMAT", "facet 0, line 3"),
    "no endloop": (line(7, ""), "E_FORMAT", "facet 0, line 8"),
    "no endfacet": (line(8, ""), "E_FORMAT", "facet 0, line 9"),
    "solid within a solid": (line(9, "") + TEXT, "E_FORMAT", ""),
    "text behind the end": (TEXT + b"thank you\n", "E_FORMAT", "facet 4, line 31"),
    "NaN in text": (line(5, "vertex 0 NaN 0"), "E_NONFINITE", "facet 0, corner 1, line 5"),
    "too large in text": (line(5, "vertex 0 0 9e999"), "E_NONFINITE", "facet 0, corner 1, line 5"),
}  # fmt: skip


@pytest.mark.parametrize("mark", [b"\xff\xfe", b"\xfe\xff"])
def test_a_binary_file_may_begin_like_utf_16(mark):
    assert len(stl.read(mark + BINARY[2:], "").faces) == 4
