"""PLY files that are wrong: each gets its own typed error, and no damage crashes or hangs."""

from __future__ import annotations

import gc
import struct
import tracemalloc

import pytest

from msal_cli.codecs import ply
from msal_cli.errors import InternalError, MsalError
from tests.codecs import plain_ply
from tests.codecs.plain_ply import Element, Ply

XYZ = [("x", "float", ""), ("y", "float", ""), ("z", "float", "")]
CORNERS = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
LIST = [("vertex_indices", "int", "uchar")]


def text(head: str, body: str) -> bytes:
    """An ascii file; ``head`` are the header lines between format and end_header."""
    return f"ply\nformat ascii 1.0\n{head}end_header\n{body}".encode()


def binary(head: str, body: bytes, order: str = "little") -> bytes:
    return f"ply\nformat binary_{order}_endian 1.0\n{head}end_header\n".encode() + body


def tetra(encoding: str = "ascii", faces=((0, 1, 2),), **changes) -> bytes:
    elements = [
        Element("vertex", XYZ, [list(row) for row in changes.get("corners", CORNERS)]),
        Element("face", changes.get("list", LIST), [[list(face)] for face in faces]),
    ]
    return plain_ply.written(Ply(encoding, elements))


LE, BE = "binary_little_endian", "binary_big_endian"
V4 = "element vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
F1 = "element face 1\nproperty list uchar int vertex_indices\n"
V4_TEXT = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
V4_BYTES = struct.pack("<12f", *(x for row in CORNERS for x in row))
GOOD = tetra()

DAMAGED = {
    "empty": (b"", "E_TRUNCATED", ""),
    "another format": (b"solid cube\nfacet normal 0 0 1\n", "E_FORMAT", "byte 0"),
    "byte-order mark": (b"\xef\xbb\xbf" + GOOD, "E_FORMAT", "byte 0"),
    "only the magic line": (b"ply\n", "E_TRUNCATED", "line 2"),
    "no end_header": (GOOD[: GOOD.index(b"end_header")], "E_TRUNCATED", "line 9"),
    "no end_header, much data": (GOOD[: GOOD.index(b"end_header")] + bytes(1_000_000),
        "E_TOO_LARGE", ""),
    "endless comments": (GOOD.replace(b"element vertex", b"comment x\n" * 2000 + b"element vertex"),
        "E_TOO_LARGE", "line 1000"),
    "end_header at the limit": (GOOD.replace(b"element vertex",
        b"comment " + b"x" * (65_535 - GOOD.index(b"\nend_header") - 19) + b"\nelement vertex"),
        "E_TOO_LARGE", ""),
    "no format": (GOOD.replace(b"format ascii 1.0\n", b""), "E_FORMAT", "header"),
    "unknown encoding": (GOOD.replace(b"ascii", b"utf8"), "E_FORMAT", "line 2"),
    "unknown version": (GOOD.replace(b" 1.0", b" 2.0"), "E_UNSUPPORTED", "line 2"),
    "unknown keyword": (GOOD.replace(b"element face", b"elemnt face"), "E_FORMAT", "line 7"),
    "unknown line among elements, and data left over": (GOOD.replace(b"element face",
        b"polygons 2\nelement face") + b"3 0 1 3\n", "E_FORMAT", "line 7"),
    "binary rubbish in the header": (GOOD.replace(b"element face", b"\x00\xff\xfe face"),
        "E_FORMAT", "line 7"),
    "negative count": (GOOD.replace(b"vertex 4", b"vertex -4"), "E_FORMAT", "line 3"),
    "count of a thousand digits": (GOOD.replace(b"vertex 4", b"vertex " + b"9" * 1000), "E_FORMAT",
        "line 3"),
    "element twice": (text(V4 + V4 + F1, V4_TEXT), "E_FORMAT", "line 7"),
    "property twice": (GOOD.replace(b"property float y\n", b"property float x\n"), "E_FORMAT",
        "line 5"),
    "property before elements": (GOOD.replace(b"element vertex", b"property int a\nelement vertex"),
        "E_FORMAT", "line 3"),
    "unknown type": (GOOD.replace(b"float y", b"real y"), "E_FORMAT", "line 5"),
    "list with float count": (GOOD.replace(b"list uchar", b"list float"), "E_FORMAT", "line 8"),
    "no vertex element": (GOOD.replace(b"element vertex", b"element point"), "E_FORMAT", "header"),
    "no z": (GOOD.replace(b"float z", b"float w"), "E_FORMAT", "header"),
    "x is a list": (GOOD.replace(b"property float x", b"property list uchar float x"), "E_FORMAT",
        "header"),
    "corners are no list": (GOOD.replace(b"list uchar int vertex_indices", b"int vertex_indices"),
        "E_FORMAT", ""),
    "empty lists of 64-bit indices": (
        binary(
            V4 + "element face 2\nproperty list uchar uint64 vertex_indices\n", V4_BYTES + bytes(2)
        ),
        "E_NO_FACES",
        "element face",
    ),
    "binary: half a face": (binary(V4 + F1, V4_BYTES + b"\x03\0\0"), "E_TRUNCATED", "face 0"),
    "binary: list count beyond the end": (binary(V4 + F1, V4_BYTES + b"\xff" + bytes(12)),
        "E_TRUNCATED", "face 0"),
    "binary: negative list count": (binary(V4 + F1.replace("uchar", "char"),
        V4_BYTES + b"\xff" + bytes(12)), "E_FORMAT", "face 0"),
    "binary: list count of 1.8e19": (binary(V4 + F1.replace("uchar", "uint64"),
        V4_BYTES + b"\xff" * 8 + bytes(12)), "E_FORMAT", "face 0"),
    "binary: 1e19 vertices": (binary(V4.replace("4", "1" + "0" * 19) + F1, V4_BYTES), "E_TRUNCATED",
        "vertex 4"),
    "binary: 1e19 faces": (binary(V4 + F1.replace("face 1", "face 1" + "0" * 19),
        V4_BYTES + b"\x03" + bytes(12)), "E_TRUNCATED", "face 1"),
    "binary: index too large": (tetra(LE, [(0, 1, 2), (0, 1, 4)]), "E_INDEX", "face 1"),
    "binary: index negative": (tetra(LE, [(0, 1, -1)]), "E_INDEX", "face 0"),
    "binary: index of 2**63": (tetra(LE, [(0, 1, 2**63)], list=[("vertex_indices", "uint64",
        "uchar")]), "E_INDEX", "face 0"),
    "binary: index 1.5": (tetra(LE, [(0, 1, 1.5)], list=[("vertex_indices", "float", "uchar")]),
        "E_FORMAT", "face 0"),
    "binary: index 1e300": (tetra(LE, [(0, 1, 1e300)], list=[("vertex_indices", "double",
        "uchar")]), "E_INDEX", "face 0"),
    "binary: index in a mixed file": (tetra(BE, [(0, 1, 2), (0, 1, 2, 3), (0, 1, 9)]), "E_INDEX",
        "face 2"),
    "binary: wrong byte order": (tetra(LE, list=[("vertex_indices", "int",
        "int")]).replace(b"little", b"big"), "E_TRUNCATED", "face 0"),
    "binary: NaN": (tetra(LE, corners=[*CORNERS[:3], [0, float("nan"), 0]]), "E_NONFINITE",
        "vertex 3"),
    "binary: signalling NaN": (tetra(LE).replace(struct.pack("<f", 1.0), b"\x01\x00\x80\x7f"),
        "E_NONFINITE", "vertex 1"),
    "binary: strip index": (
        binary(
            V4 + "element tristrips 1\nproperty list int int vertex_indices\n",
            V4_BYTES + struct.pack("<6i", 5, 0, 1, -2, 2, 3),
        ),
        "E_INDEX",
        "tristrips 0",
    ),
    "point cloud": (binary(V4, V4_BYTES), "E_NO_FACES", ""),
    "faces but no vertices": (tetra(LE, corners=[]), "E_INDEX", "face 0"),
    "faces of two corners": (tetra(LE, [(0, 1), (2, 3)]), "E_NO_FACES", "element face"),
    "faces under another name": (tetra(LE).replace(b"vertex_indices", b"corner_numbers"),
        "E_NO_FACES", "element face"),
    "ascii: header only": (text(V4 + F1, ""), "E_TRUNCATED", "vertex 0, line 10"),
    "ascii: cut in the last line": (text(V4 + F1, V4_TEXT + "3 0 1"), "E_TRUNCATED", "face 0"),
    "ascii: a billion vertices": (text(V4.replace("4", "1000000000") + F1, V4_TEXT + "3 0 1 2\n"),
        "E_FORMAT", "vertex 4, line 14"),
    "ascii: 1e19 faces": (text(V4 + F1.replace("face 1", "face 1" + "0" * 19),
        V4_TEXT + "3 0 1 2\n"), "E_TRUNCATED", "face 1"),
    "ascii: too few values": (text(V4 + F1, V4_TEXT.replace("1 0 0", "1 0") + "3 0 1 2\n"),
        "E_FORMAT", "vertex 1, line 11"),
    "ascii: too many values": (text(V4 + F1, V4_TEXT.replace("1 0 0", "1 0 0 0") + "3 0 1 2\n"),
        "E_FORMAT", "vertex 1, line 11"),
    "ascii: two records on a line, and a word short": (text(V4 + F1, V4_TEXT.replace("\n1",
        " 1") + "3 0 1\n"), "E_FORMAT", "vertex 0, line 10"),
    "ascii: two elements on a line": (text(V4 + F1, V4_TEXT[:-1] + " 3 0 1 2\n"), "E_FORMAT",
        "vertex 3, line 13"),
    "ascii: list shorter than its count": (text(V4 + F1.replace("face 1", "face 2"),
        V4_TEXT + "4 0 1 2\n3 0 1 2\n"), "E_FORMAT", "face 0, line 14"),
    "ascii: fractional list count": (text(V4 + F1, V4_TEXT + "3.0 0 1 2\n"), "E_FORMAT",
        "face 0, line 14"),
    "ascii: word for a coordinate": (text(V4 + F1, V4_TEXT.replace("1 0 0",
        "1 zero 0") + "3 0 1 2\n"), "E_FORMAT", "line 11"),
    "ascii: word for a corner": (text(V4 + F1, V4_TEXT + "3 0 one 2\n"), "E_FORMAT", "line 14"),
    "ascii: index too large": (text(V4 + F1, V4_TEXT + "\n3 0 1 4\n"), "E_INDEX",
        "face 0, line 15"),
    "ascii: index negative": (text(V4 + F1, V4_TEXT + "3 0 1 -1\n"), "E_INDEX", "line 14"),
    "ascii: nan": (text(V4 + F1, V4_TEXT.replace("1 0 0", "1 nan 0") + "3 0 1 2\n"), "E_NONFINITE",
        "vertex 1, line 11"),
    "ascii said, binary data": (tetra(LE).replace(LE.encode(), b"ascii"), "E_FORMAT", "line 2"),
    "ascii: word for a normal": (
        text(
            V4 + "property float nx\nproperty float ny\nproperty float nz\n" + F1,
            V4_TEXT.replace("\n", " 0 0 one\n") + "3 0 1 2\n",
        ),
        "E_FORMAT",
        "line 13",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", [name for name in DAMAGED if "billion" in name or "e19" in name])
def test_a_promise_of_gigabytes_allocates_next_to_nothing(name):
    data = DAMAGED[name][0]
    with pytest.raises(MsalError):
        ply.read(data)  # compiles what it needs
    gc.collect()
    tracemalloc.start()
    with pytest.raises(MsalError):
        ply.read(data)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1_000_000


def test_an_element_without_properties_takes_no_room_however_large():
    data = binary("element nothing 18446744073709551615\n" + V4 + F1, tetra(LE)[-61:])
    assert len(ply.read(data).faces) == 1
    data = text("element nothing 18446744073709551615\n" + V4 + F1, V4_TEXT + "3 0 1 2\n")
    assert len(ply.read(data).faces) == 1


@pytest.mark.parametrize("extra", [[], [("near", "int", "uchar")]])
def test_whole_numbers_that_no_double_holds_are_replaced_and_kept(extra):
    wide = [("x", "float", ""), ("y", "uint64", ""), ("z", "int64", "")]
    rows = [
        [k % 2, 2**62 + 4097 * k, k // 2 - 2**53 - 1, *[[1] * k for _ in extra]] for k in range(4)
    ]
    vertex = Element("vertex", wide + extra, rows)
    data = plain_ply.written(Ply(LE, [vertex, Element("face", LIST, [[[0, 1, 2]], [[3, 2, 1]]])]))
    mesh = ply.read(data)
    vertices = mesh.vertices.copy()
    vertices[::2] += 65536.0
    output = mesh.replaced(vertices)
    mesh.check(output, vertices)
    damaged = bytearray(output)
    # The last bit of the y that stays, in the second record.
    damaged[data.index(b"end_header\n") + 11 + 20 + len(extra) + 4] ^= 1
    with pytest.raises(InternalError):
        mesh.check(damaged, vertices)


# Damage at random
