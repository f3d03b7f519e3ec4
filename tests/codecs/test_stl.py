"""STL, binary and what both kinds have in common; the damaged bytes of both."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from msal_cli import methods
from msal_cli.codecs import stl
from msal_cli.job import comparison, inspection, pipeline
from msal_cli.job.settings import Settings, Task
from tests.codecs import plain_stl
from tests.codecs.plain_stl import tetrahedron

COORDINATES = st.floats(-1e6, 1e6, width=32)


def soups(max_facets: int = 6):
    shapes = st.integers(1, max_facets).map(lambda m: (m, 9))
    return arrays.arrays(np.float64, shapes, elements=COORDINATES)


def facets_of(data: bytes) -> list[tuple]:
    """Every facet as (normal, corners, attribute), unpacked one by one."""
    (count,) = struct.unpack_from("<I", data, 80)
    facets = []
    for k in range(count):
        numbers = struct.unpack_from("<12fH", data, 84 + 50 * k)
        facets.append((numbers[:3], numbers[3:12], numbers[12]))
    return facets


def corners_of(file) -> np.ndarray:
    """The corners (m, 9) in file order."""
    return file.vertices[file.faces].reshape(-1, 9)


def moved(file, amount=0.25):
    vertices = file.vertices.copy()
    vertices[:3] += amount * np.arange(1, 10).reshape(3, 3)
    return vertices


# Identities


@given(soups())
def test_corners_are_read_exactly_in_file_order(corners):
    file = stl.read(plain_stl.binary(corners))
    assert np.array_equal(corners_of(file), corners)
    assert len(np.unique(file.vertices, axis=0)) == len(file.vertices)
    first = np.unique(file.faces, return_index=True)[1]
    assert (np.diff(first) > 0).all()  # numbered in order of appearance
    assert file.n_polygons == len(corners)
    assert file.merged_vertices == 3 * len(corners) - len(file.vertices)
    assert file.faces.dtype == np.int32
    assert file.vertices.dtype == np.float64


@given(
    soups(),
    arrays.arrays(np.float64, (18, 3), elements=COORDINATES),
    st.lists(st.integers(0, 0xFFFF), min_size=6, max_size=6),
)
def test_only_positions_and_normals_change(corners, others, attributes):
    m = len(corners)
    data = plain_stl.binary(
        corners, attributes=attributes[:m], header=b"COLOR=\x01\x02\x03\xff", trailing=b"tail"
    )
    file = stl.read(data)
    vertices = others[: len(file.vertices)]
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    others = vertices[file.faces].reshape(-1, 9)
    assert output[:84] == data[:84]
    assert output[-4:] == b"tail"
    before, after = facets_of(data), facets_of(output)
    for k in range(m):
        assert after[k][1] == tuple(others[k])
        assert after[k][2] == attributes[k]
        if (corners[k] == others[k]).all():
            assert after[k] == before[k]


# Hand-worked cases


@pytest.mark.parametrize(
    ("stored", "expected"),
    [
        ((0, 0, 1), (1, 0, 0)),
        ((0, 0, 5e-30), (1, 0, 0)),  # any length
        ((0, 0, 3e38), (1, 0, 0)),
        ((0, 0, -1), (-1, 0, 0)),  # opposed the winding and still does
        ((0, 0, 0), (0, 0, 0)),
        ((-0.0, 0, 0), (-0.0, 0, 0)),
        ((1, 0, 0), (1, 0, 0)),  # across the old facet: the right-hand rule
    ],
)
def test_the_sense_of_a_stored_normal_is_kept(stored, expected):
    corners = np.array([[0, 0, 0, 1, 0, 0, 0, 1, 0]], dtype=float)
    data = plain_stl.binary(corners, normals=np.array([stored]))
    file = stl.read(data)
    turned = np.array([[0, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    output = bytes(file.replaced(turned))
    file.check(output, turned)
    assert output[84:96] == struct.pack("<3f", *expected)


@pytest.mark.parametrize("bits", [0x7FC00000, 0x7FA00001, 0xFFC00123, 0x7F800000])
def test_a_normal_that_is_no_number_is_kept_bit_for_bit(bits):
    data = bytearray(plain_stl.binary(tetrahedron()))
    struct.pack_into("<I", data, 84, bits)
    file = stl.read(bytes(data))
    vertices = moved(file)
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    assert output[84:96] == data[84:96]


def test_a_facet_that_loses_its_area_keeps_its_normal():
    data = plain_stl.binary(tetrahedron())
    file = stl.read(data)
    vertices = file.vertices.copy()
    vertices[:3] = [[0, 0, 0], [1, 1, 1], [2, 2, 2]]
    output = bytes(file.replaced(vertices))
    assert output[84:96] == data[84:96]
    file.check(output, vertices)


def test_minus_zero_that_does_not_move_keeps_its_sign():
    corners = tetrahedron()
    corners[0, 0] = -0.0
    data = plain_stl.binary(corners)
    file = stl.read(data)
    vertices = file.vertices.copy()
    vertices[0, 0] = 0.0
    assert bytes(file.replaced(vertices)) == data
    vertices[1, 2] += 1.0
    assert bytes(file.replaced(vertices))[96:100] == data[96:100]


def test_a_binary_file_that_begins_with_solid_is_binary():
    data = plain_stl.binary(tetrahedron(), header=b"solid made by an exporter")
    file = stl.read(data)
    assert file.encoding == "binary_little_endian"
    longer = stl.read(data + b"\0" * 7)
    assert longer.encoding == "binary_little_endian"
    assert longer.n_polygons == 4


# Re-encoding


def test_vertices_are_counted_after_welding_and_corners_beside_them(tmp_path):
    path = tmp_path / "a.stl"
    path.write_bytes(plain_stl.binary(tetrahedron()))
    record = inspection.inspect_file(str(path))
    assert (record.vertices, record.corners, record.welded_vertices) == (4, 12, 8)
    assert record.unreferenced_vertices == 0
    task = Task(str(path), str(tmp_path / "b.stl"), "a.stl")
    done = pipeline.denoise_file(
        task, Settings("al", methods.find("al").validate({"iterations": 1}))
    )
    assert done.status == "written"
    assert (done.vertices, done.corners, done.welded_vertices) == (4, 12, 8)
    assert done.unreferenced_vertices == 0
    compared = comparison.compare_files(str(path), str(tmp_path / "b.stl"))
    assert (compared.vertices_before, compared.corners_before) == (4, 12)
    assert (compared.vertices_after, compared.corners_after) == (4, 12)


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
    "cut within a facet": (BINARY[:100], "E_TRUNCATED", "byte 100"),
    "count one too many": (plain_stl.binary(tetrahedron(), count=5), "E_TRUNCATED",
        f"byte {len(BINARY)}"),
    "no facets": (plain_stl.binary(np.zeros((0, 9))), "E_NO_FACES", ""),
    "count of zero with facets": (plain_stl.binary(tetrahedron(), count=0), "E_NO_FACES", ""),
    "NaN corner": (with_float(96, float("nan")), "E_NONFINITE", "facet 0, corner 0"),
    "big endian": (BINARY[:80] + BINARY[83:79:-1] + BINARY[84:], "E_TRUNCATED", "byte 284"),
    "utf-16": (TEXT.decode().encode("utf-16"), "E_FORMAT", "byte 0"),
    "only a name": (b"solid a\n", "E_TRUNCATED", "facet 0, line 2"),
    "no endsolid": (TEXT[: TEXT.index(b"endsolid")], "E_TRUNCATED", "facet 4, line 30"),
    "cut in a keyword": (TEXT[: TEXT.index(b"outer") + 2], "E_TRUNCATED", "facet 0, line 3"),
    "cut in an exponent": (line(4, "vertex 0 0 1e")[:79], "E_TRUNCATED", ""),
    "no solid line": (TEXT[TEXT.index(b"facet") :], "E_FORMAT", "facet 0, line 1"),
    "glued words": (line(2, "facetnormal 0 0 1"), "E_FORMAT", "facet 0, line 2"),
    "two normal numbers": (line(2, "facet normal 0 0"), "E_FORMAT", "facet 0, line 3"),
    "four normal numbers": (line(2, "facet normal 0 0 1 1"), "E_FORMAT", "facet 0, line 2"),
    "four corners": (line(6, "vertex 0 0 1 vertex 1 1 1"), "E_FORMAT", "facet 0, line 6"),
    "a comma for a point": (line(5, "vertex 0,5 0 0"), "E_FORMAT", "facet 0, line 5"),
    "a word for a fourth coordinate": (line(4, "vertex 0 0 0 -x"), "E_FORMAT", "facet 0, line 4"),
    "a comment": (line(3, "# outer loop"), "E_FORMAT", "facet 0, line 3"),
    "no endfacet": (line(8, ""), "E_FORMAT", "facet 0, line 9"),
    "text behind the end": (TEXT + b"thank you\n", "E_FORMAT", "facet 4, line 31"),
    "NaN in text": (line(5, "vertex 0 NaN 0"), "E_NONFINITE", "facet 0, corner 1, line 5"),
}  # fmt: skip


@pytest.mark.parametrize("mark", [b"\xff\xfe", b"\xfe\xff"])
def test_a_binary_file_may_begin_like_utf_16(mark):
    assert len(stl.read(mark + BINARY[2:]).faces) == 4
