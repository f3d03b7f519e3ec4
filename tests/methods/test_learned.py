"""The learned filter: what its weights must do, and how they are read."""

import dataclasses
import functools
import hashlib
import json

import numpy as np
import pytest

from msal_cli.analysis.added_noise import AddedNoise, add_noise
from msal_cli.analysis.noise_estimate import NOISE, TEXTURE, Reading, estimate_noise
from msal_cli.errors import InternalError
from msal_cli.mesh import prepare_mesh
from msal_cli.methods import _cascade
from msal_cli.methods.learned import resolve_noise
from tests.methods.runs import denoise, error_deg
from tests.shapes import ball, box, grid, torus
from training.regression import write_networks

run = functools.partial(denoise, "learned")


def block(n=14):
    """A block with sharp edges."""
    return prepare_mesh(*box(n, n, n)).mesh


def smooth():
    return prepare_mesh(*torus(120, 60)).mesh


def test_the_weights_fit_into_400_kb():
    assert (_cascade.WEIGHTS / "learned.f32").stat().st_size < 400_000
    assert len(_cascade.load_networks()) == 3


def test_networks_come_back_as_they_were_written(tmp_path):
    networks = _cascade.load_networks()
    write_networks(tmp_path / "own.json", networks, {"trained_by": "a test"})
    again = _cascade.read_networks(tmp_path / "own.json")
    for network, copy in zip(networks, again, strict=True):
        for layer, same in zip(network.layers, copy.layers, strict=True):
            assert (layer[0] == same[0]).all()
            assert (layer[1] == same[1]).all()


@pytest.mark.parametrize(
    ("harm", "words"),
    [
        ("cut", "damaged"),
        ("changed", "damaged"),
        ("too short", r"are [\d,]+ numbers instead of"),
        *((f"layer {layer}", "in stage 2") for layer in range(4)),
        *((harm, None) for harm in ("no header", "no JSON", "missing")),
    ],
)
def test_damaged_weights_are_refused(tmp_path, harm, words):
    path, data = tmp_path / "own.json", tmp_path / "own.f32"
    write_networks(path, _cascade.load_networks(), {})
    header, floats = json.loads(path.read_text()), data.read_bytes()
    if harm in ("cut", "too short"):
        data.write_bytes(floats[:-4])
    if harm == "too short":
        header["sha256"] = hashlib.sha256(floats[:-4]).hexdigest()
    if harm == "changed":
        data.write_bytes(b"\1" + floats[1:])
    if harm.startswith("layer"):
        header["stages"][1][int(harm[-1])] += 1
    path.write_text("{" if harm == "no JSON" else json.dumps(header))
    if harm in ("missing", "no header"):
        (data if harm == "missing" else path).unlink()
    with pytest.raises(InternalError, match=words):
        _cascade.read_networks(path)


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

    assert off(_cascade.return_texture(scan, true.vertices, 0.2)) < 0.05
    assert off(_cascade.return_texture(scan, flat, 0.2)) < 0.5 * off(flat)
    # Noise that is stronger than it is said to be, or shared by neighbours, does not come back.
    for given in (0.05, 0.15, 0.5):
        assert _cascade.return_texture(scan, flat, given) is flat


def test_the_noise_is_estimated_by_its_kind(monkeypatch):
    true = smooth()
    noisy = true.with_vertices(add_noise(true, AddedNoise("gaussian-normal", 0.2)))
    level = estimate_noise(noisy)
    assert resolve_noise(noisy, 0.0) == (level.mean_edges, True, False)
    assert resolve_noise(noisy, 0.07) == (0.07, True, False)

    def say(kind, **changes):
        character = dataclasses.replace(level.character, kind=kind)
        said = dataclasses.replace(level, character=character, **changes)
        place = "msal_cli.analysis.noise_estimate.estimate_noise"
        monkeypatch.setattr(place, lambda mesh: said)

    say("staircase")
    assert resolve_noise(noisy, 0.0) == (None, False, False)
    assert np.isfinite(run(noisy)).all()
    say("uneven", mean_edges=0.1, lowest=0.01, highest=0.4)
    assert resolve_noise(noisy, 0.0) == (pytest.approx(0.2), False, True)
    assert resolve_noise(noisy, 0.07) == (0.07, False, True)


def test_a_clean_mesh_comes_back(monkeypatch):
    true = smooth()
    assert estimate_noise(true).is_negligible
    assert (run(true) == true.vertices).all()
    assert (run(true, noise=0.05) != true.vertices).any()
    # Who names the method where it is unsure wants noise to go.
    for level, expected in ((0.02, 0.02), (0.002, 0.0)):
        readings = Reading(NOISE, level, 0.6), Reading(TEXTURE, 0.0, 0.4)
        doubted = dataclasses.replace(estimate_noise(true), readings=readings)
        place = "msal_cli.analysis.noise_estimate.estimate_noise"
        monkeypatch.setattr(place, lambda mesh, doubted=doubted: doubted)
        assert resolve_noise(true, 0.0)[0] == expected
        assert (run(true) == true.vertices).all() == (expected == 0.0)


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
