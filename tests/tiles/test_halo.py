"""The part of the mesh that a tile is computed on has all that is near to the tile."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.errors import ContentError
from msal_cli.tiles import halo
from msal_cli.tiles.plan import read_globals, write_globals
from tests.shapes import grid, noisy, torus
from tests.tiles.fakes import FakeMesh, open_fake, run_stages
from tests.tiles.whole_run import choose


def cut(monkeypatch, folder, mesh: FakeMesh, rings: int, **sizes):
    folder.mkdir(exist_ok=True)
    _, scratch = open_fake(monkeypatch, folder, mesh, **sizes)
    run_stages(scratch)
    choose(scratch, "al", {})
    scratch.finish_stage("choose", {"again": False})
    write_globals(scratch, rings=rings)
    return scratch


def rings_around(faces: np.ndarray, own: np.ndarray, n: int) -> np.ndarray:
    """Edges from the nearest own vertex."""
    rings = np.where(own, 0, n)
    for _ in range(n):
        nearest = rings[faces].min(axis=1)
        before = rings.copy()
        for corner in range(3):
            np.minimum.at(rings, faces[:, corner], nearest + 1)
        if (rings == before).all():
            break
    return rings


@pytest.mark.parametrize("reach", [1, 2, 5])
@pytest.mark.parametrize("tile_vertices", [5, 40])
def test_a_part_is_a_tile_and_its_rings(monkeypatch, tmp_path, reach, tile_vertices):
    vertices, faces = torus(20, 10)
    rng = np.random.default_rng(0)
    order = rng.permutation(len(vertices))
    faces = np.argsort(order)[faces][rng.permutation(len(faces))]
    mesh = FakeMesh(noisy(vertices)[order].astype(np.float32), faces.astype(np.uint32))
    scratch = cut(monkeypatch, tmp_path, mesh, reach, tile_vertices=tile_vertices)
    run_stages(scratch, ("rim",))
    rings = halo.count_rings(scratch)
    assert rings == reach + 2
    starts = read_globals(scratch)["tile_starts"]
    old = np.array(scratch.array("old.u4", np.uint32))
    for tile in range(0, len(starts) - 1, 3):
        part = halo.assemble_part(scratch, tile)
        assert (old[part.ids] == part.file_vertices).all()
        assert (np.diff(part.file_vertices.astype(int)) > 0).all()
        assert (np.diff(part.triangles.astype(int)) > 0).all()
        assert (part.file_vertices[part.faces] == faces[part.triangles]).all()
        own = np.zeros(len(vertices), dtype=bool)
        own[old[starts[tile] : starts[tile + 1]]] = True
        assert (own[part.file_vertices] == part.own).all()
        assert part.own.sum() == own.sum()
        near = rings_around(faces, own, len(vertices))[faces].min(axis=1) < rings
        assert part.triangles.tolist() == np.flatnonzero(near).tolist()
        assert set(part.file_vertices) == set(faces[near].reshape(-1))


def test_a_tile_that_no_face_has(monkeypatch, tmp_path):
    vertices, faces = grid(12, 12)
    stray = np.random.default_rng(0).uniform(50.0, 60.0, (150, 3))
    positions = np.concatenate([vertices, stray]).astype(np.float32)
    mesh = FakeMesh(positions, faces.astype(np.uint32))
    scratch = cut(monkeypatch, tmp_path, mesh, 1, tile_vertices=40)
    run_stages(scratch, ("rim",))
    sizes = [halo.assemble_part(scratch, tile).own.sum() for tile in range(8)]
    assert sum(sizes) == len(vertices)
    assert min(sizes) == 0
    known = read_globals(scratch)
    assert known["used_vertices"] == len(vertices)
    assert known["origin"] == [5.5, 5.5, 0.0]


def test_a_mesh_of_degenerate_faces_is_refused(monkeypatch, tmp_path):
    faces = np.array([[0, 0, 1], [1, 2, 1], [5, 2, 2]], dtype=np.uint32)
    mesh = FakeMesh(np.random.default_rng(0).random((6, 3)), faces)
    scratch = cut(monkeypatch, tmp_path, mesh, 1)
    with pytest.raises(ContentError) as caught:
        run_stages(scratch, ("rim",))
    assert caught.value.code == "E_NO_FACES"


@pytest.mark.parametrize("scale", [1e70, 1e-70])
def test_an_extent_without_measure_is_refused(monkeypatch, tmp_path, scale):
    vertices, faces = torus(12, 8)
    mesh = FakeMesh(vertices * scale, faces.astype(np.uint32))
    scratch = cut(monkeypatch, tmp_path, mesh, 1)
    with pytest.raises(ContentError) as caught:
        run_stages(scratch, ("rim",))
    assert caught.value.code == "E_RANGE"
