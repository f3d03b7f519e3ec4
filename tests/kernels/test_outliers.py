"""Vertices held against their surroundings, fitted to normals, and what polynomials leave over."""

import numpy as np
import pytest

from msal_cli.analysis.noise_estimate.evidence import FREEDOMS, LEFT
from msal_cli.kernels import outliers
from msal_cli.kernels.geometry import face_normals
from msal_cli.kernels.patch_fits import fit_patches, fit_scales
from msal_cli.kernels.vertex_update import untangle, update_vertices
from msal_cli.mesh import prepare_mesh
from tests.shapes import grid


def test_only_the_furthest_of_neighbours_is_picked():
    links = prepare_mesh(*grid(10, 10)).mesh.topology
    scores = np.full(100, outliers.NOT_JUDGED)
    scores[[55, 56, 66]] = 2.0, 3.0, 2.5
    assert outliers.pick(scores, 1.0, links).tolist() == [56]
    scores[[55, 56]] = 3.0
    # Of two alike the one with the lower number.
    assert outliers.pick(scores, 2.6, links).tolist() == [55]
    assert not len(outliers.pick(scores, 3.0, links))


def test_a_level_sheet_keeps_every_bit():
    vertices, faces = grid(7, 6)
    vertices[:, 2] = 0.1  # not a binary fraction: a third of three of them need not be one of them
    up = np.tile([0.0, 0.0, 1.0], (len(faces), 1))
    mesh = prepare_mesh(vertices, faces).mesh
    everywhere = np.ones(len(vertices), dtype=bool)
    out = update_vertices(vertices, up, mesh.faces, mesh.topology, everywhere, 10)
    assert (out == vertices).all()


def angles_deg(mesh, positions, wanted):
    cosines = np.einsum("ij,ij->i", face_normals(positions, mesh.faces), wanted)
    return np.degrees(np.arccos(np.clip(cosines, -1, 1)))


def test_folds_are_opened():
    # A flat sheet of which single vertices lie beyond their neighbours.
    mesh = prepare_mesh(*grid(13, 13)).mesh
    wanted = face_normals(mesh.vertices, mesh.faces)
    strayed = np.flatnonzero(~mesh.topology.boundary)[::17]
    positions = mesh.vertices.copy()
    positions[strayed] += 1.3 * mesh.mean_edge_length * np.array([1.0, 0.4, 0.0])
    assert angles_deg(mesh, positions, wanted).max() > 170
    everywhere = np.ones(len(positions), dtype=bool)
    out = untangle(positions, wanted, mesh.faces, mesh.topology, everywhere)
    assert angles_deg(mesh, out, wanted).max() < 1e-6
    # Far from them nothing moves, and nothing leaves the plane.
    touched = np.isin(mesh.faces, strayed).any(axis=1)
    rim = np.unique(mesh.faces[touched])
    second = np.unique(mesh.faces[np.isin(mesh.faces, rim).any(axis=1)])
    others = np.setdiff1d(np.arange(len(positions)), second)
    assert len(others) > 20
    assert (out[others] == positions[others]).all()
    assert np.abs(out[:, 2] - mesh.vertices[:, 2]).max() == 0.0


PLANE, NEAR, FAR, CUBIC = range(4)


def graph_of(height, rows=14, columns=12, uneven=0.25, seed=0):
    """A mesh that is the graph of a function over an uneven grid."""
    vertices, faces = grid(rows, columns)
    vertices[:, :2] += np.random.default_rng(seed).uniform(-uneven, uneven, (len(vertices), 2))
    vertices[:, 2] = height(vertices[:, 0] / 10, vertices[:, 1] / 10)
    return prepare_mesh(vertices, faces).mesh


def fits_of(mesh, fit=fit_patches, chosen=None):
    """What a fit gives for all vertices of a graph, or some."""
    chosen = np.arange(len(mesh.vertices)) if chosen is None else chosen
    up = np.tile([0.0, 0.0, 1.0], (len(mesh.vertices), 1))
    return fit(chosen, mesh.vertices, up, mesh.topology.ring_start, mesh.topology.ring)


@pytest.mark.parametrize(
    ("height", "exact"),
    [
        (lambda x, y: 0.3 * x - y + 2, [PLANE, NEAR, FAR, CUBIC]),
        (lambda x, y: x * x - 2 * x * y + y, [NEAR, FAR, CUBIC]),
        (lambda x, y: x**3 - x * y * y + y, [CUBIC]),
    ],
)
def test_a_polynomial_leaves_nothing_over(height, exact):
    variances, freedoms, _, _ = fits_of(graph_of(height))
    for fit in range(4):
        largest = variances[:, fit].max()
        assert largest < 1e-14 if fit in exact else largest > 1e-8
    assert (freedoms[:, CUBIC] > 0).any()


@pytest.mark.parametrize("uneven", [0.0, 0.35])
def test_white_noise_leaves_its_variance(uneven):
    draw = np.random.default_rng(3)
    mesh = graph_of(lambda x, y: 0.1 * draw.standard_normal(len(x)), 120, 100, uneven)
    variances, freedoms, gaps, ratios = fits_of(mesh)
    for fit in range(4):
        has = freedoms[:, fit] > 0
        mean = np.average(variances[has, fit], weights=freedoms[has, fit])
        assert mean == pytest.approx(0.01, rel=0.04)
    # Of Student's distribution: with 12 degrees of freedom 1 in 100 is beyond 3.055.
    inner = freedoms[:, FAR] == 13
    assert (ratios[inner] > 3.055).mean() == pytest.approx(0.01, abs=0.003)
    assert gaps[inner].std() > 0.1


def averaged(mesh, heights, rings):
    """White numbers averaged over closed one-rings, with a root mean square of 1."""
    starts, ring = mesh.topology.ring_start, mesh.topology.ring
    owner = np.repeat(np.arange(len(heights)), np.diff(starts))
    for _ in range(rings):
        total = heights + np.bincount(owner, weights=heights[ring], minlength=len(heights))
        heights = total / (np.diff(starts) + 1.0)
    return heights / np.sqrt((heights**2).mean())


@pytest.mark.parametrize("rings", range(5))
def test_the_table_of_shared_noise(rings):
    """What ``colour`` expects of noise averaged over rings is what fits leave over of it."""
    vertices, faces = grid(120, 120)
    # A regular triangle grid; polynomials do not care, but distances are those of the table.
    mesh = prepare_mesh(vertices, faces).mesh
    draw = np.random.default_rng(rings)
    heights = averaged(mesh, draw.standard_normal(len(vertices)), rings)
    vertices[:, 2] = heights
    mesh = prepare_mesh(vertices, faces).mesh
    inside = np.flatnonzero((np.abs(mesh.vertices[:, :2]) < 52).all(axis=1))
    rests, rows, ranks, _, _ = fits_of(mesh, fit_scales, inside)
    variances = rests / np.maximum(rows - ranks, 1)
    assert variances.mean(axis=0) == pytest.approx(LEFT[rings], rel=0.07)
    # Of chi square with f degrees of freedom the variance is 2 / f, relative to the square mean.
    freedoms = 2.0 / (variances.std(axis=0) / variances.mean(axis=0)) ** 2
    assert freedoms == pytest.approx(FREEDOMS[rings], rel=0.2)
