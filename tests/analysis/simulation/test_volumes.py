"""Simulated voxels, CT and slices."""

from __future__ import annotations

import builtins
import sys

import numpy as np
import pytest

from msal_cli.analysis.simulation import (
    DEFAULTS,
    OPTIONS,
    SCANNERS,
    ScannerSettings,
    find_truth,
    simulate_scan,
)
from msal_cli.analysis.simulation.marching import extract_surface
from msal_cli.analysis.simulation.volumes import remove_specks
from msal_cli.errors import ContentError, TooLargeError, UnsupportedError, UsageError
from msal_cli.kernels.geometry import area_and_volume
from msal_cli.mesh import prepare_mesh
from tests.shapes import ball, grid

pytest.importorskip("skimage")

SPHERE = prepare_mesh(*ball(48, 24)).mesh
"""A sphere of radius 1."""


def scan(scanner, cells=24, mesh=SPHERE, **settings):
    return simulate_scan(mesh, ScannerSettings(scanner, cells=cells, **settings))


@pytest.mark.parametrize("scanner", ["voxels", "ct", "slices"])
def test_a_solid_stays_closed_oriented_and_of_its_volume(scanner):
    made = scan(scanner)
    defects = prepare_mesh(made.vertices, made.faces).defects
    assert (defects.boundary_edges, defects.non_manifold_edges, defects.components) == (0, 0, 1)
    volume = area_and_volume(SPHERE.vertices, SPHERE.faces)[1]
    assert area_and_volume(made.vertices, made.faces)[1] == pytest.approx(volume, rel=0.05)


@pytest.mark.parametrize("scanner", ["voxels", "ct", "slices"])
def test_the_same_seed_makes_the_same_scan_only(scanner):
    first, again, other = (scan(scanner, seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(first.vertices, again.vertices)
    assert np.array_equal(first.faces, again.faces)
    assert not np.array_equal(first.vertices, other.vertices)


def test_binary_voxels_make_a_staircase():
    made = scan("voxels")
    # Every vertex lies in the middle of an edge of the grid, along one of its axes.
    steps = np.mod(made.vertices / made.cell - made.vertices[0] / made.cell, 0.5)
    assert np.minimum(steps, 0.5 - steps).max() < 1e-4
    radii = np.linalg.norm(made.vertices, axis=1)
    assert np.abs(radii - 1.0).max() < 0.9 * made.cell
    assert 0.1 < (radii - 1.0).std() / made.cell < 0.4


def test_grey_values_make_a_smooth_surface_and_noise_a_rough_one():
    def roughness(**settings):
        made = scan("ct", **settings)
        return float((np.linalg.norm(made.vertices, axis=1) - 1.0).std()) / made.cell

    quiet, white = roughness(level=0.0), roughness(level=0.1)
    assert quiet < 0.03
    assert 0.08 < white < 0.2
    assert roughness(level=0.05) == pytest.approx(0.5 * white, rel=0.25)


def test_correlated_noise_is_smoother_than_white():
    def share_with_neighbours(correlation):
        made = scan("ct", level=0.08, correlation=correlation)
        mesh = prepare_mesh(made.vertices, made.faces).mesh
        heights = np.linalg.norm(mesh.vertices, axis=1)
        heights -= heights.mean()
        ring, start = mesh.topology.ring, mesh.topology.ring_start
        rows = np.repeat(np.arange(len(heights)), np.diff(start))
        return (heights[rows] * heights[ring]).mean() / (heights**2).mean()

    assert share_with_neighbours(1.5) > 0.8 > 0.65 > share_with_neighbours(0.0)


def test_slices_lie_apart_along_the_direction():
    made = scan("slices", slices=4, direction=(0.0, 5.0, 0.0))
    heights = np.unique(np.round(made.vertices[:, 1] / made.cell, 4))
    gaps = np.diff(heights)
    # A vertex lies on a slice, or half-way between two.
    assert gaps == pytest.approx(2.0, abs=1e-3)
    assert len(np.unique(np.round(made.vertices[:, 0] / made.cell, 4))) > 2 * len(heights)


@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (1.0, -2.0, 0.5)])
def test_the_grid_is_turned_and_the_object_stays(direction):
    block = prepare_mesh(*ball(24, 12)).mesh.with_vertices(SPHERE_STRETCHED)
    made = scan("ct", mesh=block, direction=direction, level=0.0)
    assert np.ptp(made.vertices, axis=0) == pytest.approx(np.ptp(block.vertices, axis=0), rel=0.03)


SPHERE_STRETCHED = prepare_mesh(*ball(24, 12)).mesh.vertices * [1.0, 2.0, 3.0]


def test_the_resolution_is_a_count_or_a_length_in_edges():
    assert scan("voxels", cells=20).cell == pytest.approx(2.0 / 20, rel=1e-3)
    settings = ScannerSettings("voxels", cell_edges=0.8)
    assert simulate_scan(SPHERE, settings).cell == pytest.approx(0.8 * SPHERE.mean_edge_length)


def test_an_open_or_inverted_mesh_is_filled_all_the_same():
    vertices, faces = ball(48, 24)
    inverted = prepare_mesh(vertices, faces[:, ::-1]).mesh
    assert np.array_equal(scan("voxels", mesh=inverted).vertices, scan("voxels").vertices)
    lid = vertices[faces].mean(axis=1)[:, 2] > 0.9
    made = scan("voxels", mesh=prepare_mesh(vertices, faces[~lid]).mesh)
    assert made.closed_holes == 1
    assert prepare_mesh(made.vertices, made.faces).defects.boundary_edges == 0


def test_the_truth_lies_on_the_mesh():
    pytest.importorskip("fcpw")
    made = scan("voxels")
    truth = find_truth(SPHERE, made)
    radii = np.linalg.norm(truth, axis=1)
    assert 0.99 < radii.min() <= radii.max() <= 1.0 + 1e-9
    assert np.linalg.norm(truth - made.vertices, axis=1).max() < made.cell


def test_specks_in_the_air_and_cavities_are_left_out():
    volume = np.zeros((9, 9, 9), dtype=np.float32)
    volume[2:7, 2:7, 2:7] = 1.0
    clean = volume >= 0.5
    volume[0, 0, 0] = 0.9
    volume[4, 4, 4] = 0.2
    made = remove_specks(volume, clean)
    assert np.array_equal(made, clean.astype(np.float32))


def test_a_surface_ends_where_values_are_not_known():
    x = np.arange(12, dtype=np.float32)
    volume = np.broadcast_to(5.5 - x[:, None, None], (12, 12, 12)).astype(np.float32)
    known = np.ones(volume.shape, dtype=bool)
    known[:, :4, :] = False
    vertices, faces = extract_surface(volume, 0.0, np.array([1.0, 2.0, 1.0]), known)
    assert vertices[:, 0] == pytest.approx(5.5)
    assert (vertices[:, 1].min(), vertices[:, 1].max()) == (8.0, 22.0)
    # Greater values are inside: the surface looks towards greater x.
    a, b, c = (vertices[faces[:, at]] for at in range(3))
    assert (np.cross(b - a, c - a)[:, 0] > 0.0).all()
    with pytest.raises(ContentError, match="no surface"):
        extract_surface(volume, 0.0, np.ones(3), np.zeros_like(known))


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"scanner": "laser"}, "laser"),
        ({"cells": 2}, "cells"),
        ({"level": -1.0}, "level"),
        ({"level": float("nan")}, "level"),
        ({"slices": 0}, "slices"),
        ({"seed": -1}, "seed"),
        ({"direction": (0.0, 0.0, 0.0)}, "direction"),
    ],
)
def test_settings_that_mean_nothing_are_refused(settings, named):
    with pytest.raises(UsageError, match=named):
        ScannerSettings(**({"scanner": "voxels"} | settings))


def test_every_scanner_says_which_settings_it_uses():
    fields = ScannerSettings.__dataclass_fields__
    for scanner in SCANNERS:
        assert set(OPTIONS[scanner]) == set(DEFAULTS.get(scanner, {}))
        assert set(OPTIONS[scanner]) <= set(fields)


def test_a_volume_that_is_too_large_is_refused_before_it_is_made():
    with pytest.raises(TooLargeError, match="voxels"):
        scan("voxels", cells=4000)


def test_a_sheet_has_nothing_inside():
    with pytest.raises(ContentError, match="fills no voxel"):
        scan("voxels", mesh=prepare_mesh(*grid()).mesh)


def test_without_the_library_the_message_says_what_to_install(monkeypatch):
    for name in [one for one in sys.modules if one.partition(".")[0] == "skimage"]:
        monkeypatch.delitem(sys.modules, name)
    real = builtins.__import__

    def missing(name, *rest):
        if name.partition(".")[0] == "skimage":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(UnsupportedError, match="scikit-image") as caught:
        scan("voxels")
    assert caught.value.code == "E_NO_LIBRARY"
    assert "simulation" in caught.value.hint
