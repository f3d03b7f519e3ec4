"""Vertices held against their surroundings, fitted to normals, and what polynomials leave over."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.analysis.noise_estimate.spread import FREEDOMS, LEFT
from msal_cli.kernels import outliers
from msal_cli.kernels.geometry import face_normals
from msal_cli.kernels.patch_fits import fit_patches, fit_scales
from msal_cli.kernels.vertex_update import untangle, update_vertices
from msal_cli.mesh import prepare_mesh
from tests.shapes import grid

MIDDLE = 5 * 10 + 5


def uneven_grid(seed=0):
    """A flat grid of 10 by 10 vertices with uneven spacing."""
    vertices, faces = grid(10, 10)
    vertices[:, :2] += np.random.default_rng(seed).uniform(-0.15, 0.15, (len(vertices), 2))
    return prepare_mesh(vertices, faces).mesh


def agreements_of(mesh):
    found = np.ones(len(mesh.vertices))
    everything = np.ones(len(found), dtype=bool)
    outliers.measure_agreement(mesh.vertices, mesh.faces, mesh.topology, everything, found)
    return found


def judged(mesh, *chosen, is_known=False):
    chosen = np.array(chosen)
    return outliers.judge(
        chosen,
        mesh.vertices[chosen],
        mesh.vertices,
        mesh.faces,
        mesh.topology,
        agreements_of(mesh),
        mesh.mean_edge_length,
        is_known,
    )


def spiked(mesh, at, way):
    vertices = mesh.vertices.copy()
    vertices[at] += way
    return mesh.with_vertices(vertices)


def test_a_spike_goes_back_to_where_it_was():
    mesh = uneven_grid()
    scores, targets = judged(spiked(mesh, MIDDLE, (0.0, 0.0, 2.0)), MIDDLE)
    assert scores[0] > 2.0
    assert targets[0] == pytest.approx(mesh.vertices[MIDDLE], abs=1e-9)


def test_only_the_furthest_of_neighbours_is_picked():
    mesh = uneven_grid()
    scores = np.full(100, outliers.NOT_JUDGED)
    scores[[MIDDLE, MIDDLE + 1, MIDDLE + 11]] = 2.0, 3.0, 2.5
    assert outliers.pick(scores, 1.0, mesh.topology).tolist() == [MIDDLE + 1]
    scores[[MIDDLE, MIDDLE + 1]] = 3.0
    # Of two alike the one with the lower number.
    assert outliers.pick(scores, 2.6, mesh.topology).tolist() == [MIDDLE]
    assert not len(outliers.pick(scores, 3.0, mesh.topology))


def test_a_vertex_that_went_along_the_surface_goes_to_the_middle_of_its_neighbours():
    mesh = uneven_grid()
    # Sides that are flat to rounding are those of a design.
    rises = 0.02 * np.random.default_rng(1).standard_normal((len(mesh.vertices), 1))
    mesh = mesh.with_vertices(mesh.vertices + rises * np.array([0.0, 0.0, 1.0]))
    folded = spiked(mesh, MIDDLE, (1.7, 0.4, 0.0))
    scores, targets = judged(folded, MIDDLE)
    assert scores[0] > 2.0
    # Those whose faces it folds over count less, until it is back.
    back = spiked(folded, MIDDLE, targets[0] - folded.vertices[MIDDLE])
    _, targets = judged(back, MIDDLE, is_known=True)
    ring = mesh.topology.ring[
        mesh.topology.ring_start[MIDDLE] : mesh.topology.ring_start[MIDDLE + 1]
    ]
    assert targets[0] == pytest.approx(mesh.vertices[ring].mean(axis=0), abs=0.1)


def run(vertices, normals, faces, passes=1, fixed=(), on_pass=None):
    mesh = prepare_mesh(vertices, faces).mesh
    free = np.ones(len(vertices), dtype=bool)
    free[list(fixed)] = False
    return update_vertices(vertices, normals, mesh.faces, mesh.topology, free, passes, on_pass)


def test_a_level_sheet_keeps_every_bit():
    vertices, faces = grid(7, 6)
    vertices[:, 2] = 0.1  # not a binary fraction: a third of three of them need not be one of them
    up = np.tile([0.0, 0.0, 1.0], (len(faces), 1))
    assert (run(vertices, up, faces, passes=10) == vertices).all()


def untangled(mesh, positions, wanted, free=None):
    everywhere = np.ones(len(positions), dtype=bool)
    return untangle(
        positions, wanted, mesh.faces, mesh.topology, everywhere if free is None else free
    )


def angles_deg(mesh, positions, wanted):
    cosines = np.einsum("ij,ij->i", face_normals(positions, mesh.faces), wanted)
    return np.degrees(np.arccos(np.clip(cosines, -1, 1)))


def folded():
    """A flat sheet of which single vertices lie beyond their neighbours, and its true normals."""
    mesh = prepare_mesh(*grid(13, 13)).mesh
    wanted = face_normals(mesh.vertices, mesh.faces)
    inner = np.flatnonzero(~mesh.topology.boundary)
    strayed = inner[::17]
    positions = mesh.vertices.copy()
    positions[strayed] += 1.3 * mesh.mean_edge_length * np.array([1.0, 0.4, 0.0])
    return mesh, positions, wanted, strayed


def test_folds_are_opened():
    mesh, positions, wanted, strayed = folded()
    assert angles_deg(mesh, positions, wanted).max() > 170
    out = untangled(mesh, positions, wanted)
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


def fits_of(mesh, chosen=None):
    links = mesh.topology
    up = np.zeros_like(mesh.vertices)
    up[:, 2] = 1.0
    chosen = np.arange(len(mesh.vertices)) if chosen is None else np.array(chosen)
    return fit_patches(chosen, mesh.vertices, up, links.ring_start, links.ring)


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


def wide_fits_of(mesh, chosen=None):
    """Variances by the degrees of freedom, and these; then what else ``fit_scales`` gives."""
    up = np.zeros_like(mesh.vertices)
    up[:, 2] = 1.0
    chosen = np.arange(len(mesh.vertices)) if chosen is None else np.array(chosen)
    rests, rows, ranks, frames, offsets = fit_scales(
        chosen, mesh.vertices, up, mesh.topology.ring_start, mesh.topology.ring
    )
    freedoms = np.maximum(rows - ranks, 0)
    return rests / np.maximum(freedoms, 1), freedoms, rows, frames, offsets


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
    variances, _, _, _, _ = wide_fits_of(mesh, inside)
    assert variances.mean(axis=0) == pytest.approx(LEFT[rings], rel=0.07)
    # Of chi square with f degrees of freedom the variance is 2 / f, relative to the square mean.
    freedoms = 2.0 / (variances.std(axis=0) / variances.mean(axis=0)) ** 2
    assert freedoms == pytest.approx(FREEDOMS[rings], rel=0.2)
