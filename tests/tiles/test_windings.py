"""Faces are wound one way over all tiles as they are in memory."""

from __future__ import annotations

import numpy as np
import pytest

from tests.shapes import ball, noisy, torus
from tests.tiles.fakes import FakeMesh
from tests.tiles.whole_run import check_same


def turn(mesh: FakeMesh, chosen: np.ndarray) -> FakeMesh:
    faces = np.where(chosen[:, None], mesh.faces[:, ::-1], mesh.faces)
    return FakeMesh(mesh.vertices, np.ascontiguousarray(faces))


def several_parts() -> FakeMesh:
    parts, faces, n = [], [], 0
    for k, (vertices, own) in enumerate([ball(20, 10), torus(16, 8), ball(12, 6), torus(6, 5)]):
        parts.append(noisy(vertices + (9.0 * k, 0.0, 0.0), seed=k, level=0.05))
        faces.append(own + n)
        n += len(vertices)
    return FakeMesh(
        np.concatenate(parts).astype(np.float32), np.concatenate(faces).astype(np.uint32)
    )


def moebius_band(count: int = 40) -> FakeMesh:
    angle = 2 * np.pi * np.arange(count) / count
    rims = []
    for side in (-0.3, 0.0, 0.3):
        radius = 1 + side * np.cos(angle / 2)
        rims.append(
            np.stack(
                [radius * np.cos(angle), radius * np.sin(angle), side * np.sin(angle / 2)], axis=1
            )
        )
    low, middle, high = count * np.arange(3)
    faces = []
    for k in range(count):
        is_last = k + 1 == count
        ends = [high, middle, low] if is_last else [low + k + 1, middle + k + 1, high + k + 1]
        for one, other in ((0, 1), (1, 2)):
            a, b = (low, middle, high)[one] + k, (low, middle, high)[other] + k
            faces += [(a, b, ends[other]), (a, ends[other], ends[one])]
    vertices = noisy(np.concatenate(rims), level=0.01)
    return FakeMesh(vertices.astype(np.float32), np.array(faces, dtype=np.uint32))


@pytest.mark.parametrize("tile_vertices", [30, 150])
@pytest.mark.parametrize("share", [0.02, 0.5, 0.9])
def test_any_faces_turned(monkeypatch, tmp_path, share, tile_vertices):
    mesh = several_parts()
    chosen = np.random.default_rng(2).random(mesh.n_polygons) < share
    check_same(monkeypatch, tmp_path, turn(mesh, chosen), tile_vertices=tile_vertices)


def test_half_of_a_part_is_turned(monkeypatch, tmp_path):
    mesh = several_parts()
    chosen = mesh.vertices[mesh.faces[:, 0], 2] > 0.0
    check_same(monkeypatch, tmp_path, turn(mesh, chosen), "msal", tile_vertices=30)


def test_a_band_without_sides_stays_as_it_is(monkeypatch, tmp_path):
    scratch = check_same(monkeypatch, tmp_path, moebius_band(), tile_vertices=20)
    assert scratch.results("turn")
    check_same(monkeypatch, tmp_path / "one", moebius_band(), tile_vertices=1000)
