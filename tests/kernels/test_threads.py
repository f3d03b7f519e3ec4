"""Different work at the same time, and no number of threads that changes a bit."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from msal_cli.kernels import geometry, parallel, z_buffer
from msal_cli.kernels.conjugate_gradient import RowMatrix, conjugate_gradients
from msal_cli.kernels.connectivity import connectivity
from msal_cli.kernels.faces import face_rings
from msal_cli.kernels.geometry import normals_and_flat_faces, surface_figures
from msal_cli.kernels.parallel import MIN_COUNT, at_once, is_worth_it
from tests.shapes import grid, noisy, torus


@pytest.mark.parametrize("cores", ["1", "3"])
def test_results_come_in_the_order_of_the_tasks(cores, monkeypatch):
    monkeypatch.setenv("MSAL_THREADS", cores)
    assert at_once(MIN_COUNT, lambda: 1, lambda: "two", lambda: None) == [1, "two", None]
    assert at_once(1, lambda: 1) == [1]


def test_many_items_and_cores_are_shared(monkeypatch):
    monkeypatch.setenv("MSAL_THREADS", "2")
    meeting = threading.Barrier(2, timeout=20.0)
    # Neither passes before the other has come.
    at_once(MIN_COUNT, meeting.wait, meeting.wait)
    assert not is_worth_it(MIN_COUNT - 1)
    monkeypatch.setenv("MSAL_THREADS", "1")
    assert not is_worth_it(MIN_COUNT)


@pytest.mark.parametrize("cores", ["1", "2"])
def test_the_first_failure_is_raised(cores, monkeypatch):
    monkeypatch.setenv("MSAL_THREADS", cores)

    def fail(word):
        raise ValueError(word)

    with pytest.raises(ValueError, match="one"):
        at_once(MIN_COUNT, lambda: 0, lambda: fail("one"), lambda: fail("two"))


def link(vertices, faces):
    links = connectivity(len(vertices), faces)
    return links.ring_start, links.ring, links.boundary, links.boundary_edges


def list_face_rings(vertices, faces):
    return face_rings(faces, connectivity(len(vertices), faces), "vertex")


def compute_normals(vertices, faces):
    faces = faces.copy()
    faces[::1000, 1] = faces[::1000, 0]
    shuffled = np.random.default_rng(0).permutation(len(faces))
    return [
        part
        for order in (slice(None), shuffled)
        for part in normals_and_flat_faces(vertices, faces[order], "uniform")
    ]


def solve(vertices, faces):
    """I + 5 times the graph Laplacian."""
    n = len(vertices)
    links = connectivity(n, faces)
    diagonal = 1.0 + 5.0 * np.diff(links.ring_start)
    matrix = RowMatrix(diagonal, links.ring_start, links.ring, np.full(len(links.ring), -5.0))
    residuals = []
    goal = {"tolerance": 1e-6, "unit": 1.0, "most_iterations": 1000}
    goal["on_iteration"] = lambda done, residual: residuals.append(residual)
    solution = conjugate_gradients(matrix, vertices, np.zeros((n, 3)), **goal)
    assert len(residuals) > 5
    return solution, residuals


def draw(vertices, faces):
    points = np.random.default_rng(1).uniform(0, 300, (600, 3))
    return z_buffer.nearest_faces(points, faces[:900] % 600, 300, 300)


@pytest.mark.parametrize("shape", [torus(190, 93), grid(140, 131)], ids=["torus", "grid"])
@pytest.mark.parametrize(
    "work",
    [
        *(link, list_face_rings, compute_normals, solve, draw),
        lambda vertices, faces: [surface_figures(vertices, noisy(vertices, 2), faces)],
    ],
)
def test_threads_do_not_change_a_bit(work, shape, monkeypatch):
    # Not multiples of chunks, and enough rows for three ranges that end amid chunks.
    for module in (parallel, geometry):
        monkeypatch.setattr(module, "MIN_RANGE", 5_000)
    monkeypatch.setattr(parallel, "MIN_COUNT", 5_000)
    vertices, faces = noisy(shape[0], 1), shape[1]
    results = []
    for count in ("1", "2", "3"):
        monkeypatch.setenv("MSAL_THREADS", count)
        results.append([np.asarray(part).tobytes() for part in work(vertices, faces)])
    assert results[0] == results[1] == results[2]
