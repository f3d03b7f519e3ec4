"""Noise that is added to meshes."""

import hashlib

import numpy as np
import pytest

from benchmarks.ground_truth import add_plain_noise
from msal_cli.analysis.added_noise import GRAZING_CAP, KINDS, AddedNoise, add_noise, grazing_growth
from msal_cli.errors import UsageError
from msal_cli.mesh import prepare_mesh
from tests.shapes import grid, torus

KINDS_MOVED = {"impulsive": 0.1, "half": 0.5}


def added(mesh, kind, level=0.2, seed=7, **settings):
    return add_noise(mesh, AddedNoise(kind, level, seed, **settings))


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_makes_one_noise_which_moves_so_many_vertices_and_none_at_level_0(kind):
    mesh = prepare_mesh(*torus(40, 21)).mesh
    first = added(mesh, kind, direction=(1.0, 0.1, 0.3))
    assert np.array_equal(first, added(mesh, kind, direction=(1.0, 0.1, 0.3)))
    assert not np.array_equal(first, added(mesh, kind, seed=8, direction=(1.0, 0.1, 0.3)))
    if kind not in ("quantised", "outliers"):
        assert np.array_equal(added(mesh, kind, 0.0), mesh.vertices)
    if kind not in ("quantised", "ramp"):
        moved = (first != mesh.vertices).any(axis=1)
        assert moved.mean() == pytest.approx(KINDS_MOVED.get(kind, 1.0), abs=0.001)


@pytest.mark.parametrize(
    ("kind", "along", "across"),
    [("gaussian-normal", 1.0, 0.0), ("gaussian", 1.0, np.sqrt(2.0)), ("mixed", 1.0, 1.0)],
)
def test_how_far_vertices_move_along_their_normals_and_across(kind, along, across):
    mesh = prepare_mesh(*torus(160, 80)).mesh
    steps = (add_plain_noise(mesh, kind, 0.2, 1) - mesh.vertices) / (0.2 * mesh.mean_edge_length)
    heights = (steps * mesh.vertex_normals()).sum(axis=1)
    rest = np.linalg.norm(steps - heights[:, None] * mesh.vertex_normals(), axis=1)
    assert heights.std() == pytest.approx(along, rel=0.03)
    assert heights.mean() == pytest.approx(0.0, abs=0.03)
    assert np.sqrt((rest**2).mean()) == pytest.approx(across, rel=0.03, abs=1e-12)


def steps_of(mesh, kind, level=0.2, seed=1, **settings):
    """Displacements (n, 3) in mean edge lengths."""
    return (added(mesh, kind, level, seed, **settings) - mesh.vertices) / mesh.mean_edge_length


@pytest.mark.parametrize(
    ("kind", "digest"),
    [
        ("gaussian-normal", "cec99a35c5eb3acd"),
        ("gaussian", "08c5ace30f57f8d3"),
        ("mixed", "74a1eb1cd0ab39fd"),
        ("impulsive", "517d11e5cf949876"),
    ],
)
def test_the_first_kinds_keep_their_bytes(kind, digest):
    made = add_plain_noise(prepare_mesh(*torus()).mesh, kind, 0.2, 7, 0.3)
    assert hashlib.sha256(made.tobytes()).hexdigest()[:16] == digest
    assert np.array_equal(made, added(prepare_mesh(*torus()).mesh, kind, fraction=0.3))


@pytest.mark.parametrize(("rings", "expected"), [(0, 0.0), (1, 4 / 7), (2, 136 / 175)])
def test_neighbours_share_noise_as_calculated_for_valence_six(rings, expected):
    # Closed one-rings of two neighbours have 4 of 7 vertices in common.  Taken twice, the weights
    # of an average are 7 once, 4 six times, 1 six and 2 six times: 175 is their sum of squares,
    # and 136 that of their products with those of a neighbour.
    mesh = prepare_mesh(*torus(200, 100)).mesh
    steps = steps_of(mesh, "correlated", rings=rings)
    heights = (steps * mesh.vertex_normals()).sum(axis=1)
    start = np.repeat(np.arange(len(heights)), np.diff(mesh.topology.ring_start))
    shared = (heights[start] * heights[mesh.topology.ring]).mean() / (heights**2).mean()
    assert shared == pytest.approx(expected, abs=0.015)
    assert heights.std() == pytest.approx(0.2, rel=0.02)
    # The usual number of rings.
    for kind, usual in (("correlated", 2), ("view", 0)):
        is_same = np.array_equal(added(mesh, kind), added(mesh, kind, rings=rings))
        assert is_same == (rings == usual)


def test_noise_along_the_view_has_that_direction_and_level():
    mesh = prepare_mesh(*torus(80, 40)).mesh
    steps = steps_of(mesh, "view", direction=(0.0, 3.0, -4.0))
    along = steps @ [0.0, 0.6, -0.8]
    assert along.std() == pytest.approx(0.2, rel=0.04)
    assert steps == pytest.approx(along[:, None] * [0.0, 0.6, -0.8], abs=1e-12)


def test_quantised_depths_are_multiples_of_the_step():
    mesh = prepare_mesh(*torus()).mesh
    axis = np.array([0.6, 0.0, 0.8])
    made = added(mesh, "quantised", direction=tuple(2.0 * axis), step=0.5)
    depths = made @ axis / (0.5 * mesh.mean_edge_length)
    assert depths == pytest.approx(np.round(depths), abs=1e-9)
    across = np.cross(made - mesh.vertices, axis)
    assert np.abs(across).max() < 1e-12
    before = mesh.vertices @ axis / (0.5 * mesh.mean_edge_length)
    assert np.abs(before - np.round(before)).max() > 0.3
    # Without noise, no depth moves by more than half a step.
    quiet = steps_of(mesh, "quantised", 0.0, direction=tuple(axis))
    assert 0.2 < np.abs(quiet @ axis).max() <= 0.25 + 1e-12


def test_grazing_noise_grows_with_the_angle_of_incidence():
    normals = np.array([[0, 0, 1], [0, 0, -1], [0, 0.8, 0.6], [1, 0, 0], [0, 0, 0]], dtype=float)
    growth = grazing_growth(normals, np.array([0.0, 0.0, 1.0]))
    assert growth == pytest.approx([1.0, 1.0, 1 / 0.6, GRAZING_CAP, GRAZING_CAP])
    mesh = prepare_mesh(*torus(160, 80)).mesh
    cosines = np.abs(mesh.vertex_normals()[:, 2])
    along = steps_of(mesh, "grazing")[:, 2]
    assert along[cosines > 0.95].std() == pytest.approx(0.2, rel=0.06)
    middle = (cosines > 0.45) & (cosines < 0.55)
    assert along[middle].std() == pytest.approx(0.4, rel=0.08)
    assert along[cosines < 0.2].std() == pytest.approx(1.0, rel=0.06)


def test_a_ramp_grows_from_nothing_to_the_level():
    mesh = prepare_mesh(*torus(160, 80)).mesh
    steps = steps_of(mesh, "ramp", direction=(0.0, -2.0, 0.0))
    heights = (steps * mesh.vertex_normals()).sum(axis=1)
    shares = (4.0 - mesh.vertices[:, 1]) / 8.0
    plain = (steps_of(mesh, "gaussian-normal") * mesh.vertex_normals()).sum(axis=1)
    assert heights == pytest.approx(shares * plain, abs=1e-12)


def test_outliers_lie_one_to_three_edges_off_in_any_direction():
    mesh = prepare_mesh(*torus(160, 80)).mesh
    steps = steps_of(mesh, "outliers", 0.0, fraction=0.05)
    lengths = np.linalg.norm(steps, axis=1)
    moved = lengths > 0.0
    assert moved.sum() == round(0.05 * len(moved))
    assert 1.0 <= lengths[moved].min() < 1.1 < 2.9 < lengths[moved].max() <= 3.0
    assert (steps[moved] / lengths[moved, None]).mean(axis=0) == pytest.approx(0.0, abs=0.1)
    rest = steps_of(mesh, "outliers", 0.2, fraction=0.05)[~moved]
    assert np.linalg.norm(rest, axis=1).std() > 0.1
    assert np.sqrt((rest**2).sum(axis=1).mean()) == pytest.approx(0.2, rel=0.03)


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"level": -0.1}, "level"),
        ({"level": np.nan}, "level"),
        ({"seed": -1}, "seed"),
        ({"fraction": 1.5}, "fraction"),
        ({"rings": -1}, "rings"),
        ({"rings": 1000}, "rings"),
        ({"direction": (0.0, 0.0, 0.0)}, "direction"),
        ({"direction": (np.inf, 0.0, 0.0)}, "direction"),
        ({"step": 0.0}, "step"),
        ({"border": 2.0}, "border"),
    ],
)
def test_settings_that_mean_nothing_are_refused(settings, named):
    with pytest.raises(UsageError, match=named):
        AddedNoise("quantised", **settings)
    with pytest.raises(UsageError, match="salt"):
        add_plain_noise(prepare_mesh(*grid()).mesh, "salt", 0.1, 0)
