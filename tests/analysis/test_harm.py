"""What counts as damage: lost volume, and flipped faces that no fold of the input explains."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.analysis import added_noise as noise
from msal_cli.analysis.harm import (
    AREA,
    FLIPPED,
    MOVES,
    NAMED_LEEWAY,
    VOLUME,
    excessive_change,
    folded_faces,
    harmful_change,
)
from msal_cli.analysis.measures import is_negative, measure_surface_change, relative_volume_change
from msal_cli.mesh import prepare_mesh
from tests.shapes import ball, cube, grid, torus


def harm_of(before, after, has_volume=True):
    return harmful_change(
        before, after, measure_surface_change(before, after), has_volume=has_volume
    )


@pytest.mark.parametrize(
    ("scale", "is_harm"), [(0.8, False), (0.79, True), (1.14, False), (1.15, True), (-1.0, True)]
)
@pytest.mark.parametrize("order", [1, -1])
def test_half_of_the_volume_is_harm_whichever_side_is_out(scale, is_harm, order):
    vertices, faces = torus()
    mesh = prepare_mesh(vertices, faces[:, ::order]).mesh
    found = harm_of(mesh, mesh.with_vertices(mesh.vertices * scale))
    assert (found is not None) == is_harm
    assert found is None or found.code == VOLUME
    if scale == 0.79:
        assert found.reason == "the volume changed by -50.7 %"


def excess_of(before, after, noise, has_volume=True, leeway=1.0):
    change = measure_surface_change(before, after)
    edge = before.mean_edge_length
    ways = np.linalg.norm(after.vertices - before.vertices, axis=1)
    p95 = float(np.quantile(ways, 0.95)) / edge
    return excessive_change(change, edge, noise, p95, has_volume=has_volume, leeway=leeway)


def test_what_noise_does_not_explain_is_harm():
    mesh = prepare_mesh(*ball()).mesh
    smaller = mesh.with_vertices(0.99 * mesh.vertices)
    assert excess_of(mesh, smaller, 0.01).code == VOLUME
    assert excess_of(mesh, smaller, 0.01).reason.startswith("the volume changed by -3.0 %")
    shifted = mesh.with_vertices(mesh.vertices + [0.2 * mesh.mean_edge_length, 0.0, 0.0])
    assert excess_of(mesh, shifted, 0.01).code == MOVES
    assert excess_of(mesh, smaller, 0.01, leeway=NAMED_LEEWAY) is None
    stretched = mesh.with_vertices(mesh.vertices * [1.05, 1.0, 1.0])
    assert excess_of(mesh, stretched, 0.01, has_volume=False).code == AREA
    assert excess_of(mesh, mesh, 0.0) is None


@pytest.mark.parametrize("level", [0.05, 0.1, 0.3, 0.5, 0.7])
@pytest.mark.parametrize("kind", ["gaussian-normal", "gaussian"])
@pytest.mark.parametrize("shape", [ball, lambda: torus(96, 48)])
def test_the_true_surface_is_no_harm(shape, kind, level):
    clean = prepare_mesh(*shape()).mesh
    noisy = clean.with_vertices(noise.add_plain_noise(clean, kind, level, seed=3))
    read = level * clean.mean_edge_length / noisy.mean_edge_length
    assert excess_of(noisy, clean, read) is None


def test_flips_on_a_smooth_mesh_are_harm():
    mesh = prepare_mesh(*grid(20, 20)).mesh
    vertices = mesh.vertices.copy()
    inner = np.flatnonzero(~mesh.topology.boundary)
    for vertex in inner[::25]:
        vertices[vertex, :2] += [5.0, 5.0]
    after = mesh.with_vertices(vertices)
    n_flipped = measure_surface_change(mesh, after).normals.flipped_faces
    assert n_flipped > 0.02 * len(mesh.faces)
    found = harm_of(mesh, after, has_volume=False)
    assert found is not None
    assert found.code == FLIPPED
    assert found.reason.startswith(f"{n_flipped} of {len(mesh.faces)} faces flipped (")


@pytest.mark.parametrize("level", [0.2, 0.4, 0.6])
def test_unfolding_what_noise_folded_is_no_harm(level):
    clean = prepare_mesh(*ball()).mesh
    noisy = clean.with_vertices(noise.add_plain_noise(clean, "gaussian", level, seed=3))
    assert measure_surface_change(noisy, clean).normals.flipped_faces > 0.02 * len(clean.faces)
    assert folded_faces(noisy) > 0
    assert harm_of(noisy, clean) is None


@pytest.mark.parametrize("shape", [cube, ball, torus, grid])
def test_clean_shapes_have_no_folds_and_open_ones_no_volume_to_lose(shape):
    mesh = prepare_mesh(*shape()).mesh
    assert folded_faces(mesh) == 0
    assert harm_of(mesh, mesh.with_vertices(mesh.vertices * 0.1), has_volume=False) is None


def test_a_sheet_with_two_sides_encloses_nothing():
    vertices, faces = cube()
    flat = prepare_mesh(vertices * [1.0, 1.0, 1e-13], faces).mesh
    change = measure_surface_change(flat, flat.with_vertices(flat.vertices * [1.0, 1.0, -5.0]))
    volumes = change.volume_before, change.volume_after
    assert relative_volume_change(*volumes, change.area_before) is None
    assert not is_negative(-abs(change.volume_before), change.area_before)
    assert is_negative(-1.0, 6.0)
    assert not is_negative(1.0, 6.0)
