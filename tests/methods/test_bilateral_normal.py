"""The bilateral filters of normals: hand-worked cases, plain twins, and known truth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msal_cli import methods
from msal_cli.kernels.connectivity import connectivity
from msal_cli.kernels.faces import face_centroids, face_rings
from msal_cli.kernels.geometry import face_normals_and_areas
from msal_cli.kernels.normal_filters import bilateral_averages, normal_system
from msal_cli.mesh import prepare_mesh
from tests.methods.plain_normals import global_filter, global_matrix, local_filter, neighbours
from tests.shapes import grid, noisy, torus

METHOD = methods.find("bilateral_normal")


def run(vertices, faces, on_sweep=None, **given):
    """The result about the origin of the input."""
    ready = prepare_mesh(vertices, faces)
    return METHOD.denoise(ready.mesh, METHOD.validate(given), on_sweep).vertices + ready.origin


def averaged(normals, areas, exponents, similarity):
    """One pass over faces all of which neighbour the first; the exponents of their distances."""
    others = len(normals) - 1
    centroids = np.zeros((others + 1, 3))
    centroids[1:, 0] = np.sqrt(2.0 * np.asarray(exponents))  # sigma_c = 1
    return bilateral_averages(
        np.array(normals, dtype=float),
        np.array(areas, dtype=float),
        centroids,
        np.array([0, others] + [others] * others, dtype=np.int32),
        np.arange(1, others + 1, dtype=np.int32),
        1.0,
        similarity,
        1,
        lambda: None,
    )[0]


def test_one_sum_worked_by_hand():
    # Two neighbours at right angles to one another, both at 45 degrees to the face: their
    # differences are alike.  Areas 1 and 3, exponents of the distances 0 and 1: 1 to 3 / e.
    half = np.sqrt(0.5)
    out = averaged([[0, half, half], [0, 0, 1], [0, 1, 0]], [9, 1, 3], [0, 1], 0.35)
    expected = np.array([0, 3 / np.e, 1])
    assert out == pytest.approx(expected / np.linalg.norm(expected), abs=1e-14)


def test_far_neighbours_do_not_underflow():
    # exp(-5000) is zero; the nearer of the two must count all the same, e times as much.
    out = averaged([[0, 0.6, 0.8], [0, 0.8, 0.6], [0.8, 0, 0.6]], [1, 1, 1], [5000, 5000.68], 9.0)
    assert np.isfinite(out).all()
    assert out[1] > out[0] > 0.1


def test_faces_without_area_do_not_count():
    out = averaged([[0, 0, 1], [0, 0, 0], [0, 0.6, 0.8]], [1, 0, 1e-9], [0, 50], 0.35)
    assert out == pytest.approx([0, 0.6, 0.8], abs=1e-15)
    kept = averaged([[0, 0, 1], [0, 0, 0]], [1, 0], [0], 0.35)
    assert (kept == [0, 0, 1]).all()
    none = averaged([[0, 0, 0], [0, 0, 1]], [0, 1], [0], 0.35)
    assert (none == 0).all()


def test_two_faces_swap_their_normals():
    # The own normal is left out: after two passes each face has its own again.
    vertices = np.array([[0, 0, 0], [0, 1, 0], [1, 0.5, 0], [-1, 0.5, 0.4]])
    faces = np.array([[0, 2, 1], [0, 1, 3]], dtype=np.int32)
    given = {"boundary": "free"}
    assert np.abs(run(vertices, faces, n=1, **given) - vertices).max() > 0.05
    assert np.abs(run(vertices, faces, n=2, **given) - vertices).max() < 1e-14


SHAPES = {
    "seed": st.integers(0, 999),
    "widths": st.tuples(st.sampled_from([0.5, 1.0, 3.0]), st.sampled_from([0.2, 0.35, 2.0])),
    "sharing": st.sampled_from(["vertex", "edge"]),
    "boundary": st.sampled_from(["fixed", "free"]),
    "closed": st.booleans(),
}


def rough(closed, seed):
    vertices, faces = torus(7, 5) if closed else grid(6, 5)
    return noisy(vertices, seed, 0.2), faces


@settings(max_examples=15, deadline=None)
@given(**SHAPES, passes=st.integers(1, 5))
def test_local_is_the_formula(seed, widths, sharing, boundary, closed, passes):
    vertices, faces = rough(closed, seed)
    chosen = {"closeness": widths[0], "similarity": widths[1], "neighbours": sharing}
    out = run(vertices, faces, **chosen, boundary=boundary, n=passes, vertex_iterations=4)
    expected = local_filter(vertices, faces, widths, passes, 4, sharing, boundary == "fixed")
    assert np.abs(out - expected).max() <= 1e-12 * np.ptp(vertices)


@settings(max_examples=15, deadline=None)
@given(**SHAPES, fidelity=st.sampled_from([1e-3, 0.01, 0.3, 1.0]))
def test_global_is_the_formula(seed, widths, sharing, boundary, closed, fidelity):
    vertices, faces = rough(closed, seed)
    chosen = {"closeness": widths[0], "similarity": widths[1], "neighbours": sharing}
    chosen |= {"variant": "global", "fidelity": fidelity, "vertex_iterations": 4}
    out = run(vertices, faces, **chosen, boundary=boundary)
    expected, least = global_filter(
        vertices, faces, widths, fidelity, 4, sharing, boundary == "fixed"
    )
    # Conjugate gradients stop at 1e-4; what they leave counts more where normals nearly cancel.
    assert np.abs(out - expected).max() <= 1e-4 / least * np.ptp(vertices)


def test_the_defaults_are_the_authors():
    vertices, faces = torus(7, 5)
    vertices = noisy(vertices, 1, 0.1)
    expected = local_filter(vertices, faces)
    assert np.abs(run(vertices, faces) - expected).max() <= 1e-12 * np.ptp(vertices)
    expected, least = global_filter(vertices, faces)
    assert np.abs(run(vertices, faces, variant="global") - expected).max() <= 1e-4 / least


def system(vertices, faces, sharing="vertex", area_unit=1.0):
    links = connectivity(len(vertices), faces)
    normals, areas = face_normals_and_areas(vertices, faces)
    rows = face_rings(faces, links, sharing)
    centroids = face_centroids(vertices, faces)
    areas *= area_unit
    return normals, areas, normal_system(normals, areas, centroids, *rows, 0.7, 0.35, 0.01)


def dense(matrix, m):
    """A, three columns at a time."""
    result = np.empty((m, m))
    for first in range(0, m, 3):
        x = np.zeros((m, 3))
        for axis in range(min(3, m - first)):
            x[first + axis, axis] = 1.0
        product = np.empty_like(x)
        matrix.times(x, product)
        result[:, first : first + 3] = product[:, : m - first]
    return result


@pytest.mark.parametrize("sharing", ["vertex", "edge"])
def test_the_matrix_is_the_formula(sharing):
    vertices, faces = grid(5, 4)
    # Two faces more that touch nothing, and at their other sides one another's corner only.
    vertices = np.concatenate([noisy(vertices, 3, 0.2), 9 + np.eye(3), 10 + np.eye(3)[:2]])
    faces = np.concatenate([faces, [[20, 21, 22], [22, 23, 24]]]).astype(np.int32)
    normals, areas, matrix = system(vertices, faces, sharing)
    expected = global_matrix(
        normals,
        areas,
        vertices[faces].mean(axis=1),
        neighbours(faces, sharing),
        (0.7, 0.35),
        0.01,
    )
    found = dense(matrix, len(faces))
    assert np.abs(found - expected).max() < 1e-13
    assert np.abs(matrix.diagonal - expected.diagonal()).max() < 1e-13


@pytest.mark.parametrize("height", [0.0, 1e-14])
def test_a_face_without_a_normal_stays_out_of_the_system(height):
    vertices, faces = grid(4, 4)
    vertices = np.concatenate([vertices, [[0.5, height, 0.0]]])
    faces = np.concatenate([faces, [[0, 16, 1]]]).astype(np.int32)
    _, _, matrix = system(vertices, faces)
    found = dense(matrix, len(faces))
    lone = found[-1]
    assert lone[-1] == pytest.approx(0.01)
    assert (lone[:-1] == 0).all()
    assert (found[:-1, -1] == 0).all()


def test_the_global_solve_can_be_interrupted_and_tells_its_end():
    vertices, faces = torus()
    vertices = noisy(vertices, 7, 0.1)
    told = []
    run(vertices, faces, lambda *at: told.append(at), variant="global", vertex_iterations=3)
    assert told[0] == told[5] == (0, 20)  # amid the solve
    assert told[-4:] == [(5, 20), (10, 20), (15, 20), (20, 20)]

    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(vertices, faces, stop, variant="global", vertex_iterations=0)
