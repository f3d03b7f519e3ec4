"""Binary STL in pieces: the same facets, the same bytes and the same errors as the whole file."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msal_cli.codecs.streamed import stl
from msal_cli.errors import ContentError, InputError, MsalError
from tests.codecs import plain_stl
from tests.codecs.streamed import pieces


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    """Two facets at a time, so that every border is met."""
    monkeypatch.setattr(stl, "_AT_ONCE", 2)
    monkeypatch.setattr(stl, "_REPLACED", 2)


NUMBERS = st.sampled_from([0.0, -0.0, 1.0, 2.0, -3.0, 0.1, 1e-30, 5e8])
FACETS = st.lists(st.lists(NUMBERS, min_size=9, max_size=9), min_size=1, max_size=7)
NORMALS = st.sampled_from([None, 0.0, np.nan, -1.0, 3.0])


@settings(max_examples=50, deadline=None)
@given(FACETS, NORMALS, st.booleans(), st.integers(1, 8), st.randoms(use_true_random=False))
def test_pieces_are_the_whole_file(corners, normal, has_rest, step, random):
    corners = np.float32(corners).astype(np.float64)
    normals = None if normal is None else np.full((len(corners), 3), normal)
    words = [random.choice([0, 0, 77]) for _ in corners]
    rest = b"\1" * 60 if has_rest else b""
    data = plain_stl.binary(corners, normals, words, b"COLOR=1234", rest)
    whole = pieces.whole(data, "stl")
    with tempfile.TemporaryDirectory() as folder:
        mesh = pieces.stored(Path(folder), data, "stl")
        for name in ("encoding", "precision", "properties", "references", "n_polygons", "warnings"):
            assert getattr(mesh, name) == getattr(whole, name), name
        vertices = pieces.read_vertices(mesh, step)
        expected = whole.vertices[whole.faces.reshape(-1)]
        assert vertices.astype(np.float64).tobytes() == expected.tobytes()
        triangles = pieces.read_triangles(mesh, step)
        assert np.array_equal(triangles, np.arange(3 * len(corners)).reshape(-1, 3))
        new = whole.vertices.copy()
        for i in range(len(new)):
            for k in range(3):
                if random.random() < 0.4:
                    new[i, k] = random.uniform(-1e9, 1e9)
        soup = new[whole.faces.reshape(-1)]
        assert pieces.replace(mesh, soup, step=50 * step) == bytes(whole.replaced(new))
        assert pieces.replace(mesh, expected, step=7) == data


def failure(read) -> tuple[str, str, str]:
    with pytest.raises(MsalError) as caught:
        read()
    return caught.value.code, caught.value.where, caught.value.message


def read_all(tmp_path, data: bytes) -> None:
    mesh = pieces.stored(tmp_path, data, "stl")
    pieces.read_vertices(mesh, 2)
    pieces.read_triangles(mesh, 2)


def test_every_prefix_is_refused_as_the_whole_file_is(tmp_path):
    data = plain_stl.binary(plain_stl.tetrahedron(), header=b"\0")
    for size in range(len(data)):
        part = data[:size]
        expected = failure(lambda part=part: pieces.whole(part, "stl"))
        assert failure(lambda part=part: read_all(tmp_path, part)) == expected


@pytest.mark.parametrize("at", [0, 4, 17, 35])
def test_a_position_that_is_not_finite_is_named(tmp_path, at):
    corners = plain_stl.tetrahedron()
    corners.reshape(-1)[at] = np.nan
    data = plain_stl.binary(corners, np.ones((4, 3)))
    expected = failure(lambda: pieces.whole(data, "stl"))
    assert failure(lambda: read_all(tmp_path, data)) == expected


def test_no_facets_and_too_many_are_refused(tmp_path):
    data = plain_stl.binary(np.empty((0, 9)))
    expected = failure(lambda: pieces.whole(data, "stl"))
    assert failure(lambda: read_all(tmp_path, data)) == expected
    path = tmp_path / "large.stl"
    count = 1_500_000_000
    path.write_bytes(bytes(80) + count.to_bytes(4, "little"))
    with path.open("r+b") as file:
        file.truncate(84 + 50 * count)
    with pytest.raises(MsalError) as caught:
        pieces.open_streamed(path)
    assert caught.value.code == "E_TOO_LARGE"


def test_a_position_beyond_float32_is_refused(tmp_path):
    data = plain_stl.binary(plain_stl.tetrahedron())
    mesh = pieces.stored(tmp_path, data, "stl")
    new = pieces.read_vertices(mesh, 12).astype(np.float64)
    new[7, 1] = 1e39
    with pytest.raises(ContentError) as caught:
        pieces.replace(mesh, new, step=50)
    assert (caught.value.code, caught.value.where) == ("E_RANGE", "vertex 7")


def test_properties_of_vertices_are_none(tmp_path):
    mesh = pieces.stored(tmp_path, plain_stl.binary(plain_stl.tetrahedron()), "stl")
    with pytest.raises(InputError) as caught:
        mesh.read_property("quality", 0, 1)
    assert caught.value.code == "E_PROPERTY"
