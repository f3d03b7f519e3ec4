"""Numbers and colours at vertices as PLY, read back by the codec and by another reader."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from msal_cli import codecs
from msal_cli.codecs.ply_write import with_fields
from msal_cli.errors import InternalError
from tests.cli.scans import closed_scan, ply_text
from tests.shapes import cube

QUADS = (
    b"ply\nformat ascii 1.0\nelement vertex 5\nproperty double x\nproperty double y\n"
    b"property double z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
    b"0 0 0\n1 0 0\n1 1 0\n0 1 0\n0.5 2 0\n4 0 1 2 3\n3 3 2 4\n"
)


def opened(data, name="a.ply"):
    return codecs.open_mesh(bytes(data), name)


def test_positions_faces_numbers_and_colours_are_there():
    source = opened(closed_scan())
    n = len(source.vertices)
    colours = np.arange(3 * n, dtype=np.uint8).reshape(n, 3)
    values = np.linspace(-1.0, 1.0, n)
    data = with_fields(source, source.vertices, {"deviation": values}, colours, ["of a test"])
    again = opened(data)
    assert np.array_equal(again.vertices, source.vertices)
    assert np.array_equal(again.faces, source.faces)
    assert "vertex.deviation float" in again.properties
    assert b"comment of a test\n" in data
    judge = trimesh.load(trimesh.util.wrap_as_stream(bytes(data)), "ply", process=False)
    assert np.array_equal(judge.visual.vertex_colors[:, :3], colours)
    stored = judge.metadata["_ply_raw"]["vertex"]["data"]["deviation"].reshape(-1)
    assert np.array_equal(stored, values.astype(np.float32))


def test_polygons_stay_polygons_and_double_stays_double():
    source = opened(QUADS)
    again = opened(with_fields(source, source.vertices + 1e-12, {"a": np.zeros(5)}))
    assert (again.n_polygons, again.precision) == (2, "float64")
    assert np.array_equal(again.vertices, source.vertices + 1e-12)
    assert [list(one) for one in again.polygons()] == [[0, 1, 2, 3], [3, 2, 4]]


def test_a_comment_cannot_end_the_header():
    source = opened(ply_text(*cube()))
    data = with_fields(source, source.vertices, {}, None, ["a\nend_header\r\x1b[31m\u202e.ply"])
    assert data.count(b"\nend_header\n") == 1
    assert np.array_equal(opened(data).vertices, source.vertices)


@pytest.mark.parametrize("name", ["x", "red", "two words", "a\nb", ""])
def test_a_field_that_cannot_be(name):
    source = opened(ply_text(*cube()))
    with pytest.raises(InternalError):
        with_fields(source, source.vertices, {name: np.zeros(8)})


def test_what_is_too_large_for_the_type_is_infinite():
    source = opened(ply_text(*cube()))
    data = with_fields(source, source.vertices, {"a": np.full(8, 1e300)})
    assert opened(data).properties == ("vertex.a float",)
