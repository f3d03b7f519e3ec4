"""A mesh in the order of its tiles: nothing is lost, everything is where it belongs."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from msal_cli.errors import ContentError
from msal_cli.kernels.welding import weld
from msal_cli.tiles import cut
from msal_cli.tiles.plan import read_globals
from msal_cli.tiles.scratch import Scratch
from tests.tiles.fakes import FakeMesh, open_fake, run_stages


def make_grid(side: int, dtype: type = np.float32, seed: int = 0) -> FakeMesh:
    """A rough sheet of ``side`` by ``side`` vertices."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    vertices = np.stack([x, y, rng.normal(0, 0.1, x.shape)], axis=2).reshape(-1, 3).astype(dtype)
    corner = (x[:-1, :-1] * side + y[:-1, :-1]).reshape(-1)
    quads = np.stack([corner, corner + side, corner + side + 1, corner + 1], axis=1)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return FakeMesh(vertices, faces.astype(np.uint32))


def make_soup(mesh: FakeMesh) -> FakeMesh:
    """Every triangle with corners of its own."""
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    return FakeMesh(
        corners, np.arange(len(corners), dtype=np.uint32).reshape(-1, 3), are_corners=True
    )


def check(mesh: FakeMesh, scratch: Scratch, n_tiles: int) -> None:
    """All that later stages rely on."""
    n, m = len(mesh.vertices), len(mesh.faces)
    starts = read_globals(scratch)["tile_starts"]
    assert starts[0] == 0
    assert starts[-1] == n
    assert len(starts) == n_tiles + 1
    old = cut.read_old_numbers(scratch, 0, n)
    numbers = np.array(scratch.array("numbers.u4", np.uint32))
    # Every vertex is in one tile, in ascending order, with its own position.
    assert sorted(old.tolist()) == list(range(n))
    assert np.array_equal(old[numbers], np.arange(n))
    positions = cut.read_positions(scratch, 0, n)
    assert positions.dtype == mesh.vertices.dtype
    assert positions.tobytes() == mesh.vertices[old].tobytes()
    tile_of = np.empty(n, dtype=int)
    for tile in range(n_tiles):
        start, stop = cut.tile_range(scratch, tile)
        tile_of[start:stop] = tile
        assert (np.diff(old[start:stop].astype(int)) > 0).all()
    # Every face is in the tiles of its corners, once, in ascending order.
    ids = numbers[mesh.faces]
    for tile in range(n_tiles):
        triangles, corners = cut.tile_faces(scratch, tile)
        wanted = np.flatnonzero((tile_of[ids] == tile).any(axis=1))
        assert triangles.tolist() == wanted.tolist()
        assert corners.tolist() == ids[wanted].tolist()
    assert read_globals(scratch)["n_triangles"] == m
    # Coincident vertices are welded as in memory, and have one tile.
    first = weld(mesh.vertices.astype(np.float64), mesh.faces.astype(np.int32))
    assert cut.weld_numbers(scratch, numbers).tolist() == numbers[first].tolist()
    assert read_globals(scratch)["n_welded"] == np.count_nonzero(first != np.arange(n))
    assert (tile_of[numbers] == tile_of[numbers[first]]).all()
    known = read_globals(scratch)
    assert known["low"] == mesh.vertices.min(axis=0).tolist()
    assert known["high"] == mesh.vertices.max(axis=0).tolist()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("order", ["in order", "shuffled"])
@pytest.mark.parametrize("kind", ["indexed", "soup"])
def test_a_sheet_is_cut(dtype, order, kind, monkeypatch, tmp_path):
    mesh = make_grid(30, dtype)
    if kind == "soup":
        mesh = make_soup(mesh)
    if order == "shuffled":
        place = np.random.default_rng(1).permutation(len(mesh.vertices))
        vertices = np.empty_like(mesh.vertices)
        vertices[place] = mesh.vertices
        faces = np.random.default_rng(2).permutation(place[mesh.faces].astype(np.uint32))
        mesh = FakeMesh(vertices, faces, mesh.are_corners)
    plan, scratch = open_fake(monkeypatch, tmp_path, mesh)
    run_stages(scratch)
    assert plan.n_tiles == 16
    check(mesh, scratch, plan.n_tiles)
    sizes = np.diff(read_globals(scratch)["tile_starts"])
    of_tile = 6 * 60 if mesh.are_corners else 60
    assert sizes.max() <= 1.25 * of_tile
    assert sizes.min() >= of_tile // 2


COORDINATES = st.sampled_from([0.0, -0.0, 1.0, 2.0, 3.0, -1.0, 0.5, 1e30, -1e30, 5e-324])


@settings(deadline=None, max_examples=40)
@given(
    vertices=arrays.arrays(
        np.float64, st.integers(1, 60).map(lambda n: (n, 3)), elements=COORDINATES
    ),
    data=st.data(),
    tile_vertices=st.integers(1, 30),
    chunk_vertices=st.integers(1, 40),
    are_corners=st.booleans(),
)
def test_any_soup_is_cut(vertices, data, tile_vertices, chunk_vertices, are_corners):
    faces = data.draw(
        arrays.arrays(
            np.uint32,
            st.integers(1, 60).map(lambda m: (m, 3)),
            elements=st.integers(0, len(vertices) - 1),
        )
    )
    mesh = FakeMesh(vertices, faces)
    if are_corners:
        mesh = make_soup(mesh)
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        plan, scratch = open_fake(
            patch, Path(folder), mesh, tile_vertices=tile_vertices, chunk_vertices=chunk_vertices
        )
        run_stages(scratch)
        check(mesh, scratch, plan.n_tiles)


def test_corners_of_faces_alone_weld(monkeypatch, tmp_path):
    # Vertex 3 equals vertex 0, but no face has it; 4 equals 1, and a face repeats it.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [1, -0.0, 0]], np.float32)
    mesh = FakeMesh(vertices, np.array([[0, 1, 2], [4, 4, 2]], np.uint32))
    _, scratch = open_fake(monkeypatch, tmp_path, mesh)
    run_stages(scratch)
    assert cut.is_welded(scratch)
    assert cut.weld_numbers(scratch, np.arange(5, dtype=np.uint32)).tolist() == [0, 1, 2, 3, 1]
    assert scratch.result("weld", 0) == {"used": 4, "welded": 1}


def test_where_nothing_welds_nothing_is_looked_up(monkeypatch, tmp_path):
    _, scratch = open_fake(monkeypatch, tmp_path, make_grid(12))
    run_stages(scratch)
    assert not cut.is_welded(scratch)
    numbers = np.arange(10, dtype=np.uint32)
    assert cut.weld_numbers(scratch, numbers) is numbers


def test_a_task_can_be_repeated_after_it_was_killed(monkeypatch, tmp_path):
    mesh = make_grid(15)
    plan, scratch = open_fake(monkeypatch, tmp_path, mesh)
    run_stages(scratch)
    for one in (tmp_path / "done").rglob("[01].json"):
        one.unlink()
    for name in ("number", "faces", "weld"):
        (tmp_path / "done" / name / "reduced.json").unlink()
    run_stages(scratch, ("number", "faces", "weld"))
    check(mesh, scratch, plan.n_tiles)


def test_without_triangles_there_is_nothing_to_denoise(monkeypatch, tmp_path):
    mesh = make_grid(5)
    with pytest.raises(ContentError, match="no faces"):
        open_fake(monkeypatch, tmp_path, FakeMesh(mesh.vertices, mesh.faces[:0]))
    # Polygons of fewer than three corners make no triangles.
    monkeypatch.setattr(FakeMesh, "read_triangles", lambda self, chunk: self.faces[:0])
    _, scratch = open_fake(monkeypatch, tmp_path, mesh)
    with pytest.raises(ContentError, match="no faces"):
        run_stages(scratch)
