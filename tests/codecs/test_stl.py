"""Binary STL, and what binary and ascii have in common."""

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
    file = stl.read(plain_stl.binary(corners), "a.stl")
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
    file = stl.read(data, "a.stl")
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


def test_a_moved_facet_gets_the_normal_of_its_new_corners():
    corners = np.array([[0, 0, 0, 1, 0, 0, 0, 1, 0]], dtype=float)
    file = stl.read(plain_stl.binary(corners), "a.stl")
    turned = np.array([[0, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    assert facets_of(bytes(file.replaced(turned)))[0][0] == (1.0, 0.0, 0.0)


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
    file = stl.read(data, "a.stl")
    turned = np.array([[0, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    output = bytes(file.replaced(turned))
    file.check(output, turned)
    assert output[84:96] == struct.pack("<3f", *expected)


@pytest.mark.parametrize("bits", [0x7FC00000, 0x7FA00001, 0xFFC00123, 0x7F800000])
def test_a_normal_that_is_no_number_is_kept_bit_for_bit(bits):
    data = bytearray(plain_stl.binary(tetrahedron()))
    struct.pack_into("<I", data, 84, bits)
    file = stl.read(bytes(data), "a.stl")
    vertices = moved(file)
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    assert output[84:96] == data[84:96]


def test_a_facet_that_loses_its_area_keeps_its_normal():
    data = plain_stl.binary(tetrahedron())
    file = stl.read(data, "a.stl")
    vertices = file.vertices.copy()
    vertices[:3] = [[0, 0, 0], [1, 1, 1], [2, 2, 2]]
    output = bytes(file.replaced(vertices))
    assert output[84:96] == data[84:96]
    file.check(output, vertices)


def test_a_facet_that_had_no_area_follows_the_right_hand_rule():
    corners = np.array([[0, 0, 0, 1, 1, 1, 2, 2, 2]], dtype=float)
    file = stl.read(plain_stl.binary(corners, normals=np.array([[0, 0, 1]])), "a.stl")
    vertices = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0]], dtype=float)
    assert facets_of(bytes(file.replaced(vertices)))[0][0] == (0, 0, -1)


def test_minus_zero_that_does_not_move_keeps_its_sign():
    corners = tetrahedron()
    corners[0, 0] = -0.0
    data = plain_stl.binary(corners)
    file = stl.read(data, "a.stl")
    vertices = file.vertices.copy()
    vertices[0, 0] = 0.0
    assert bytes(file.replaced(vertices)) == data
    vertices[1, 2] += 1.0
    assert bytes(file.replaced(vertices))[96:100] == data[96:100]


def test_a_binary_file_that_begins_with_solid_is_binary():
    data = plain_stl.binary(tetrahedron(), header=b"solid made by an exporter")
    file = stl.read(data, "a.stl")
    assert file.encoding == "binary_little_endian"
    longer = stl.read(data + b"\0" * 7, "a.stl")
    assert longer.encoding == "binary_little_endian"
    assert longer.n_polygons == 4


def test_trailing_bytes_are_kept_and_told_of():
    data = plain_stl.binary(tetrahedron(), trailing=bytes(120))
    file = stl.read(data, "a.stl")
    assert "120 bytes" in file.warnings[0]
    assert "2 facets" in file.warnings[0]
    vertices = moved(file)
    output = file.replaced(vertices)
    assert bytes(output)[-120:] == bytes(120)
    file.check(output, vertices)


# Re-encoding


@given(soups())
def test_binary_to_ascii_and_back(corners):
    data = plain_stl.binary(corners + 0.0)
    file = stl.read(data, "a.stl")
    text = file.encoded(file.vertices, "ascii", "same")
    again = stl.read(text, "b.stl")
    assert again.encoding == "ascii"
    assert np.array_equal(corners_of(again).astype(np.float32), corners_of(file))
    back = again.encoded(again.vertices, "binary", "same")
    assert bytes(back)[84:] == data[84:]
    assert bytes(back)[:10] == b"binary STL"


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
