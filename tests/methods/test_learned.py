"""The learned filter: what its weights must do, and how they are read."""

from __future__ import annotations

import dataclasses
import itertools
import json

import numpy as np
import pytest

from msal_cli.analysis.added_noise import AddedNoise, add_noise
from msal_cli.analysis.measures import normal_statistics
from msal_cli.analysis.noise_estimate import estimate_noise
from msal_cli.errors import InternalError
from msal_cli.mesh import prepare_mesh
from msal_cli.methods import find
from msal_cli.methods._cascade import (
    WEIGHTS,
    load_networks,
    read_networks,
    return_texture,
    write_networks,
)
from msal_cli.methods.learned import resolve_noise
from tests.shapes import ball, grid, torus


def run(mesh, **given):
    method = find("learned")
    return method.denoise(mesh, method.validate(given)).vertices


def error_deg(true, positions):
    return normal_statistics(true, true.with_vertices(positions)).mean_angular_error_deg


def block(n=14):
    """A block with sharp edges: every side a grid of n x n squares, cut in triangles."""
    points, faces = [], []
    for axis in range(3):
        for side in (0, 1):
            i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
            place = np.empty((n + 1, n + 1, 3))
            place[..., axis] = side * n
            place[..., (axis + 1) % 3], place[..., (axis + 2) % 3] = i, j
            at = len(points) * (n + 1) ** 2 + np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
            a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
            both = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
            faces.append(both if side else both[:, ::-1])
            points.append(place.reshape(-1, 3))
    return prepare_mesh(np.concatenate(points), np.concatenate(faces).astype(np.int32)).mesh


def smooth():
    return prepare_mesh(*torus(120, 60)).mesh


def test_the_weights_fit_into_400_kb_and_match_their_header():
    assert (WEIGHTS / "learned.f32").stat().st_size < 400_000
    header = json.loads((WEIGHTS / "learned.json").read_text())
    sizes = [pair for one in header["stages"] for pair in itertools.pairwise(one)]
    floats = sum(b * (a + 1) for a, b in sizes)
    assert (WEIGHTS / "learned.f32").stat().st_size == 4 * floats
    assert len(load_networks()) == 3


def test_networks_come_back_as_they_were_written(tmp_path):
    networks = load_networks()
    write_networks(tmp_path / "own.json", networks, {"trained_by": "a test"})
    again = read_networks(tmp_path / "own.json")
    for one, other in zip(networks, again, strict=True):
        for layer, same in zip(one.layers, other.layers, strict=True):
            assert (layer[0] == same[0]).all()
            assert (layer[1] == same[1]).all()


@pytest.mark.parametrize("harm", ["cut", "changed", "no header", "no JSON", "missing"])
def test_damaged_weights_are_refused(tmp_path, harm):
    write_networks(tmp_path / "own.json", load_networks(), {})
    data = tmp_path / "own.f32"
    if harm == "cut":
        data.write_bytes(data.read_bytes()[:-4])
    elif harm == "changed":
        data.write_bytes(b"\1" + data.read_bytes()[1:])
    elif harm == "no JSON":
        (tmp_path / "own.json").write_text("{")
    else:
        (data if harm == "missing" else tmp_path / "own.json").unlink()
    with pytest.raises(InternalError):
        read_networks(tmp_path / "own.json")


@pytest.mark.parametrize(
    ("noise", "most"),
    [
        (AddedNoise("gaussian-normal", 0.3), 0.12),
        (AddedNoise("gaussian-normal", 0.1), 0.15),
        (AddedNoise("impulsive", 0.5, fraction=0.3), 0.15),
        (AddedNoise("view", 0.2, direction=(1, 2, 3)), 0.2),
        (AddedNoise("half", 0.25), 0.2),
    ],
)
def test_noise_on_a_block_goes_and_its_edges_stay(noise, most):
    true = block()
    noisy = add_noise(true, noise)
    assert error_deg(true, run(true.with_vertices(noisy))) < most * error_deg(true, noisy)


@pytest.mark.parametrize("kind", ["gaussian-normal", "correlated", "quantised", "ramp"])
def test_noise_on_a_smooth_surface_goes(kind):
    true = smooth()
    noisy = add_noise(true, AddedNoise(kind, 0.2, direction=(1, 2, 3)))
    left = error_deg(true, run(true.with_vertices(noisy)))
    assert left < (0.5 if kind == "correlated" else 0.3) * error_deg(true, noisy)


@pytest.mark.parametrize("shape", [block, smooth, lambda: prepare_mesh(*ball(64, 32)).mesh])
def test_what_is_clean_hardly_moves(shape):
    true = shape()
    moved = np.linalg.norm(run(true) - true.vertices, axis=1)
    assert moved.mean() < 0.02 * true.mean_edge_length


def test_the_noise_that_is_given_decides_what_is_texture():
    vertices, faces = grid(50, 50)
    waves = np.sin(2.0 * np.pi * vertices[:, :2] / 6.0).prod(axis=1)
    textured = prepare_mesh(vertices + 0.35 * waves[:, None] * [0.0, 0.0, 1.0], faces).mesh
    away = {
        noise: np.linalg.norm(run(textured, noise=noise) - textured.vertices, axis=1).mean()
        for noise in (0.005, 0.3)
    }
    assert away[0.005] < 0.03
    assert away[0.3] > 3.0 * away[0.005]


def test_shape_beyond_white_noise_comes_back_and_noise_does_not():
    true = prepare_mesh(*torus(120, 60)).mesh
    normals, level = true.vertex_normals(), 0.2 * true.mean_edge_length
    noise = np.random.default_rng(0).normal(size=len(normals))[:, None] * level * normals
    scan = true.with_vertices(true.vertices + noise)
    lost = 2.0 * level * np.sin(9.0 * np.arctan2(true.vertices[:, 1], true.vertices[:, 0]))
    flat = true.vertices - lost[:, None] * normals

    def off(positions):
        return np.linalg.norm(positions - true.vertices, axis=1).mean() / level

    assert off(return_texture(scan, true.vertices, 0.2)) < 0.05
    assert off(return_texture(scan, flat, 0.2)) < 0.5 * off(flat)
    # Noise that is stronger than it is said to be, or shared by neighbours, does not come back.
    for given in (0.05, 0.5):
        assert return_texture(scan, flat, given) is flat


def test_the_noise_is_estimated_but_on_staircases(monkeypatch):
    true = smooth()
    noisy = true.with_vertices(add_noise(true, AddedNoise("gaussian-normal", 0.2)))
    level = estimate_noise(noisy)
    assert resolve_noise(noisy, 0.0) == (level.mean_edges, True)
    assert resolve_noise(noisy, 0.07) == (0.07, True)
    stairs = dataclasses.replace(level.character, kind="staircase")
    monkeypatch.setattr(
        "msal_cli.analysis.noise_estimate.estimate_noise",
        lambda mesh: dataclasses.replace(level, character=stairs),
    )
    assert resolve_noise(noisy, 0.0) == (None, False)
    assert np.isfinite(run(noisy)).all()


def test_stages_beyond_the_third_go_on():
    true = block(6)
    noisy = true.with_vertices(add_noise(true, AddedNoise("gaussian-normal", 0.3)))
    three, four = run(noisy, iterations=3), run(noisy, iterations=4)
    assert (three != four).any()
    assert error_deg(true, four) < 1.5 * error_deg(true, three) + 1.0


def test_texture_is_returned_for_white_noise_or_when_it_is_asked_for():
    true = smooth()
    numbers = np.random.default_rng(1).standard_normal((len(true.vertices), 1))
    level = 0.2 * true.mean_edge_length
    scan = true.with_vertices(true.vertices + level * numbers * true.vertex_normals())
    usual, returned, lost = (
        run(scan, noise=0.2, **given)
        for given in ({}, {"texture": "returned"}, {"texture": "lost"})
    )
    assert (usual == returned).all() and (usual != lost).any()
