"""What is chosen for noise that is not white along the normals, and that it pays."""

import dataclasses
import functools

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.analysis.added_noise import AddedNoise, add_noise
from msal_cli.analysis.noise_estimate import NoiseCharacter, estimate_noise, local_levels
from msal_cli.auto import Wishes, adaptive, search
from msal_cli.auto.risk import count_relaxing
from msal_cli.auto.samples import NoiseModel, build_model
from msal_cli.auto.search import _Search
from msal_cli.mesh import prepare_mesh
from msal_cli.methods.blend import parse_levels, parse_members
from tests.auto.test_search import angle, made_by
from tests.shapes import grid, torus

KINDS = {
    "shared": AddedNoise("correlated", 0.2, seed=1, rings=2),
    "isotropic": AddedNoise("gaussian", 0.2, seed=1),
    "half": AddedNoise("half", 0.25, seed=1, direction=(0.0, 1.0, 0.0)),
    "view": AddedNoise("view", 0.2, seed=1),
}
_WORDS = ("shared over two rings", "in all directions", "uneven over the surface", "along the view")
WORDS = dict(zip(KINDS, _WORDS, strict=True))


@functools.lru_cache
def pair(kind):
    """A torus with noise, and without."""
    true = prepare_mesh(*torus(100, 50)).mesh
    return true.with_vertices(add_noise(true, KINDS[kind])), true


@functools.lru_cache
def choose_auto(mesh):
    # It counts where the estimate is unsure only.
    return search.choose_method(mesh, Wishes(assume="noise"))


def angle_to_true(kind, made):
    return angle(pair(kind)[1], made)


def denoise_as_white(mesh):
    """The plain command's filter for that noise if it were white, whatever it is."""
    al = methods.find("al")
    noise = float(round(estimate_noise(mesh).mean_edges, 4))
    given = {"schedule": "wiener", "iterations": 6, "noise": noise}
    return mesh.with_vertices(al.denoise(mesh, al.validate(given)).vertices)


@pytest.mark.parametrize("kind", KINDS)
def test_auto_takes_most_of_it_away(kind):
    mesh, _ = pair(kind)
    choice = choose_auto(mesh)
    assert WORDS[kind] in choice.reason.split(";")[0] or estimate_noise(mesh).is_unsure
    assert bool(choice.parameters.get("line")) == (kind == "view")
    left = angle_to_true(kind, made_by(choice, mesh))
    assert left < 0.3 * angle_to_true(kind, mesh)
    assert left < 0.8 * angle_to_true(kind, denoise_as_white(mesh))


@pytest.mark.parametrize("kind", ["isotropic", "half"])
def test_the_plain_command_knows_direction_and_place(kind):
    mesh, _ = pair(kind)
    choice = adaptive.choose_adaptive(mesh, wishes=Wishes(assume="noise"))
    assert choice.method == "blend"
    assert WORDS[kind] in choice.reason or estimate_noise(mesh).is_unsure
    left = angle_to_true(kind, made_by(choice, mesh))
    assert left < 0.9 * angle_to_true(kind, denoise_as_white(mesh))


@pytest.mark.parametrize("choose", [adaptive.choose_adaptive, choose_auto])
def test_triangles_are_evened_out_where_noise_is_in_all_directions(choose):
    mesh, _ = pair("isotropic")
    choice = choose(mesh)
    assert choice.parameters["relax"] == 2
    assert choice.reason.endswith("after triangles were evened out")
    # And one linear filter more is tried than on white noise.
    assert choose is choose_auto or choice.tried == 3 + adaptive.MILD + 1


@pytest.mark.parametrize("choose", [adaptive.choose_adaptive, choose_auto])
def test_quiet_places_hardly_move(choose):
    mesh, true = pair("half")
    choice = choose(mesh)
    levels = parse_levels(choice.parameters["levels"])
    members = parse_members(choice.parameters["members"], len(levels))
    assert len(levels) > 1
    assert sum(member.weights[-1] for member in members) == pytest.approx(1.0)
    moved = np.linalg.norm(made_by(choice, mesh).vertices - mesh.vertices, axis=1)
    quiet, loud = true.vertices[:, 1] < -1.5, true.vertices[:, 1] > 1.5
    assert moved[quiet].mean() < 0.1 * moved[loud].mean()


def test_a_weakly_noisy_range_scan_is_left_to_the_learned_filter():
    """White noise that is seen is but a part: the rest is shared, and looks like shape."""
    # An open patch with long waves, as one view sees it.
    vertices, faces = grid(70, 70)
    vertices = np.asarray(vertices, dtype=float)
    vertices[:, 2] += 2.0 * np.sin(0.15 * vertices[:, 0]) * np.sin(0.15 * vertices[:, 1])
    true = prepare_mesh(vertices, faces).mesh
    shared = true.with_vertices(add_noise(true, AddedNoise("correlated", 0.08, seed=3, rings=3)))
    mesh = shared.with_vertices(add_noise(shared, AddedNoise("gaussian-normal", 0.05, seed=4)))
    search = _Search(mesh, Wishes(), range_level(mesh, "white", 0.98), lambda *_: None, False)
    choice = search.choose()
    made = made_by(choice, mesh)
    angles = [angle(true, surface) for surface in (mesh, made)]
    assert "learned (noise times" in choice.reason
    assert angles[1] < 0.5 * angles[0]


@pytest.mark.parametrize(
    "kind",
    [
        "correlated",
        *(
            pytest.param(kind, marks=pytest.mark.ci)
            for kind in ("white", "view", "quantised", "staircase", "unknown")
        ),
    ],
)
def test_noise_like_no_draw_is_left_to_the_learned_filter_and_linear_ones(kind, monkeypatch):
    found = []
    choose = _Search._choose_by_mirror
    monkeypatch.setattr(
        _Search, "_choose_by_mirror", lambda *given: found.append(choose(*given)) or found[-1]
    )
    true = pair("shared")[1]
    mesh = true.with_vertices(add_noise(true, AddedNoise("correlated", 0.06, seed=1, rings=1)))
    choices = [
        _Search(
            mesh, Wishes(), range_level(mesh, kind, confidence), lambda *_: None, False
        ).choose()
        for confidence in (0.5, 0.99)
    ]
    # Vertices go to lines of sight only where the view is sure.
    alike = {"noise": choices[0].noise, "reason": "", "parameters": {}}
    assert dataclasses.replace(choices[0], **alike) == dataclasses.replace(choices[1], **alike)
    first, second = (choice.parameters.items() for choice in choices)
    assert {name for name, _ in first ^ second} <= {"line"}
    assert bool(found) == (kind not in ("white", "unknown", "staircase"))


def test_triangles_that_are_uneven_by_themselves_are_evened_once_where_angles_gain():
    true = pair("isotropic")[1]
    model = NoiseModel(0.1 * true.mean_edge_length, direction="isotropic")
    for level, white, isotropic in ((0.0, 0, 2), (0.15, 0, 1)):
        uneven = add_noise(true, AddedNoise("gaussian", level, seed=2))
        across = true.vertex_normals()
        ways = uneven - true.vertices
        base = true.with_vertices(uneven - (ways * across).sum(axis=1)[:, None] * across)
        for kind, passes in (("gaussian-normal", white), ("gaussian", isotropic)):
            mesh = base.with_vertices(add_noise(base, AddedNoise(kind, 0.1, seed=1)))
            assert count_relaxing(mesh, model) == passes


def range_level(mesh, kind, confidence):
    """Noise of 0.06 mean edge lengths with a wide interval."""
    noise = estimate_noise(mesh)
    edge = mesh.mean_edge_length
    axis = (0.0, 0.0, 1.0) if kind in ("view", "quantised") else None
    direction = "axis" if axis else "normals"
    character = NoiseCharacter(kind, 0, direction, axis, 0.0, 0.0, confidence, "a test")
    level = {"file_units": 0.06 * edge, "mean_edges": 0.06, "low": 0.04, "high": 0.08}
    return dataclasses.replace(noise, character=character, **level)


def test_local_levels_follow_the_noise():
    mesh, true = pair("half")
    levels = local_levels(mesh)
    edge = true.mean_edge_length / mesh.mean_edge_length
    quiet, loud = true.vertices[:, 1] < -1.0, true.vertices[:, 1] > 1.0
    assert levels[loud].mean() == pytest.approx(0.25 * edge, rel=0.2)
    assert levels[quiet].mean() < 0.02
    assert local_levels(mesh) is levels
    larger = mesh.with_vertices(3.0 * mesh.vertices)
    assert local_levels(larger) == pytest.approx(levels, rel=1e-6, abs=1e-9)


def test_the_model_is_what_was_estimated():
    meshes = [pair(kind)[0] for kind in ("half", "shared", "isotropic")]
    half, shared, isotropic = (build_model(mesh, estimate_noise(mesh)) for mesh in meshes)
    assert half.shares is not None
    assert np.mean(half.shares**2) == pytest.approx(1.0)
    assert (shared.rings, shared.direction, shared.shares) == (2, "normals", None)
    assert (isotropic.rings, isotropic.direction) == (0, "isotropic")
    assert shared.level == pytest.approx(0.2 * pair("shared")[1].mean_edge_length, rel=0.15)
