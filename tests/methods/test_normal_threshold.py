"""The threshold filter of normals: hand-worked cases, a plain twin, and known truth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msal_cli import methods
from msal_cli.errors import UsageError
from msal_cli.kernels.normal_filters import threshold_averages
from msal_cli.mesh import prepare_mesh
from tests.methods.plain_normals import threshold_filter
from tests.shapes import grid, noisy, torus

METHOD = methods.find("normal_threshold")


def run(vertices, faces, **given):
    """The result about the origin of the input."""
    ready = prepare_mesh(vertices, faces)
    return METHOD.denoise(ready.mesh, METHOD.validate(given)).vertices + ready.origin


def averaged(normals, pairs_of_faces, threshold, passes=1):
    rows = [[] for _ in normals]
    for f, g in pairs_of_faces:
        rows[f].append(g)
        rows[g].append(f)
    start = np.cumsum([0, *map(len, rows)]).astype(np.int32)
    ring = np.array([g for row in rows for g in row], dtype=np.int32)
    return threshold_averages(
        np.array(normals, dtype=float), start, ring, threshold, passes, lambda: None
    )


def test_two_normals_worked_by_hand():
    # At 60 degrees n . m = 1/2; with T = 1/4 the own normal weighs 9/16 and the other 1/16.
    m = np.array([np.sqrt(0.75), 0.0, 0.5])
    n = np.array([0.0, 0.0, 1.0])
    out = averaged([n, m], [(0, 1)], 0.25)
    expected = 9 * n + m
    assert out[0] == pytest.approx(expected / np.linalg.norm(expected), abs=1e-15)


def test_beyond_the_threshold_nothing_counts():
    n, m = np.array([0.0, 0.0, 1.0]), np.array([np.sqrt(0.75), 0.0, 0.5])
    assert (averaged([n, m], [(0, 1)], 0.500001, passes=9) == [n, m]).all()
    assert (averaged([n, m], [(0, 1)], 0.499999, passes=9) != [n, m]).any()


def test_faces_without_a_normal_stay_so_and_do_not_count():
    n = np.array([0.0, 0.6, 0.8])
    out = averaged([n, np.zeros(3)], [(0, 1)], 0.0, passes=3)
    assert out[0] == pytest.approx(n, abs=1e-15)
    assert (out[1] == 0.0).all()


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 999),
    T=st.sampled_from([0.0, 0.3, 0.5, 0.9]),
    passes=st.integers(1, 6),
    sharing=st.sampled_from(["vertex", "edge"]),
    boundary=st.sampled_from(["fixed", "free"]),
    closed=st.booleans(),
)
def test_it_is_the_formula(seed, T, passes, sharing, boundary, closed):
    vertices, faces = torus(7, 5) if closed else grid(6, 5)
    vertices = noisy(vertices, seed, 0.2)
    out = run(
        vertices,
        faces,
        T=T,
        n=passes,
        vertex_iterations=4,
        neighbours=sharing,
        boundary=boundary,
    )
    expected = threshold_filter(vertices, faces, T, passes, 4, sharing, boundary == "fixed")
    assert np.abs(out - expected).max() <= 1e-12 * np.ptp(vertices)


def test_the_defaults_are_the_authors():
    vertices, faces = torus(7, 5)
    vertices = noisy(vertices, 1, 0.1)
    expected = threshold_filter(vertices, faces)
    assert np.abs(run(vertices, faces) - expected).max() <= 1e-12 * np.ptp(vertices)


def test_a_sharp_edge_is_kept_where_flat_parts_are_smoothed():
    # A ridge of 90 degrees between two flat halves, with a little noise.
    vertices, faces = grid(21, 20)
    vertices[:, 2] = -np.abs(vertices[:, 0] - 9.0)
    rough = noisy(vertices, 2, 0.05)
    error = np.abs(run(rough, faces)[:, 2] - vertices[:, 2]).reshape(21, 20)[3:-3, 3:-3]
    start = np.abs(rough[:, 2] - vertices[:, 2]).reshape(21, 20)[3:-3, 3:-3]
    assert error.mean() < 0.7 * start.mean()
    assert error[:, 6].mean() < start.mean()  # the ridge itself


@pytest.mark.parametrize("T", ["1", "-0.1", "nan"])
def test_thresholds_that_leave_nothing_are_refused(T):
    with pytest.raises(UsageError, match="threshold"):
        METHOD.validate({"T": T})
