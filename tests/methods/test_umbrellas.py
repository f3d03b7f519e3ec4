"""Umbrella operators: formulas, hand-worked cases, transfer functions and limits of stability."""

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.errors import UsageError
from msal_cli.kernels.umbrellas import sinc_coefficients
from tests.methods.plain_normals import edge_faces
from tests.methods.runs import SHAPES, assert_twin, denoise, run
from tests.shapes import grid, torus

TAUBIN = methods.find("taubin")
BOUNDARIES = pytest.mark.parametrize("boundary", ["curve", "free", "fixed"])


def rows(n: int, faces: np.ndarray, boundary: str) -> list[list[int]]:
    """The neighbours that each vertex is averaged with under a rule at open edges."""
    edges = {edge: len(own) for edge, own in edge_faces(faces).items()}
    rim = {i for edge, count in edges.items() if count == 1 for i in edge}
    result: list[list[int]] = [[] for _ in range(n)]
    for (a, b), count in edges.items():
        for i, k in ((a, b), (b, a)):
            if i not in rim or boundary == "free" or (boundary == "curve" and count == 1):
                result[i].append(k)
    return result


def umbrella(x: np.ndarray, ring: list[list[int]]) -> np.ndarray:
    """Eq. (3): the mean of the neighbours, less the vertex."""
    return np.array(
        [x[row].mean(axis=0) - x[i] if row else np.zeros(3) for i, row in enumerate(ring)]
    )


def scale_dependent_umbrella(x: np.ndarray, ring: list[list[int]], tau: float) -> np.ndarray:
    """Fujiwara's operator with the step of each vertex held at its limit."""
    moves = np.zeros_like(x)
    for i, row in enumerate(ring):
        e = x[row] - x[i]
        length = np.linalg.norm(e, axis=1)
        e, length = e[length > 0], length[length > 0]
        if len(e):
            operator = 2 / length.sum() * (e / length[:, None]).sum(axis=0)
            moves[i] = min(tau, length.sum() / (2 * (1 / length).sum())) * operator
    return moves


def hc(o: np.ndarray, ring: list[list[int]], iterations: int, alpha: float, beta: float):
    """The algorithm of Vollmer, Mencl and Mueller."""
    p = o.copy()
    for _ in range(iterations):
        q = p.copy()
        for i, row in enumerate(ring):
            if row:
                p[i] = q[row].mean(axis=0)
        b = p - (alpha * o + (1 - alpha) * q)
        p = np.array(
            [
                p[i] - (beta * b[i] + (1 - beta) * b[row].mean(axis=0)) if row else p[i]
                for i, row in enumerate(ring)
            ]
        )
    return p


def stretched(seed=3):
    """An open sheet whose edge lengths differ by a factor of about a hundred."""
    vertices, faces = grid(12, 12)
    vertices[:, :2] = 1.55 ** vertices[:, :2]
    rng = np.random.default_rng(seed)
    vertices[:, 2] = rng.normal(0, 0.1, len(vertices)) * vertices[:, :2].min(axis=1)
    return vertices, faces


def wave_on_torus(wave, around=240, across=12):
    """Heights that are an eigenvector of the umbrella operator, and its frequency k."""
    u = np.repeat(np.arange(around), across)
    vertices = np.stack([u, np.tile(np.arange(across), around), np.zeros(len(u))], axis=1) * 1.0
    vertices[:, 2] = np.cos(2 * np.pi * wave * u / around)
    # Of the six neighbours two keep u, two have u + 1 and two u - 1.
    return vertices, torus(around, across)[1], 1 - (2 + 4 * np.cos(2 * np.pi * wave / around)) / 6


@pytest.mark.parametrize("shape", ["torus", "open grid"])
@BOUNDARIES
@pytest.mark.parametrize("pull", [0.0, 0.3])
def test_the_umbrella_agrees_with_the_plain_twin(shape, boundary, pull):
    vertices, faces = SHAPES[shape]
    given = {"boundary": boundary, "schedule": "constant", "fidelity": pull}
    mesh, out = run("umbrella", vertices, faces, iterations=4, **given)
    v = mesh.vertices
    x, ring = v, rows(len(v), faces, boundary)
    for _ in range(4):
        x = x + 0.5 * umbrella(x, ring) + pull * (v - x)
    assert_twin(mesh, out, x)


@BOUNDARIES
@pytest.mark.parametrize(("alpha", "beta"), [(0.1, 0.6), (0.0, 0.5), (0.7, 0.9)])
def test_hc_agrees_with_the_plain_twin(boundary, alpha, beta):
    mesh, out = run("hc", *SHAPES["open grid"], boundary=boundary, alpha=alpha, beta=beta)
    ring = rows(len(mesh.vertices), mesh.faces, boundary)
    assert_twin(mesh, out, hc(mesh.vertices, ring, 10, alpha, beta))


def test_the_steps_of_taubin_are_the_common_ones():
    def step_of(**given):
        return TAUBIN.module.Parameters(**TAUBIN.validate(given)).outward_step

    assert TAUBIN.validate({})["shrink"] == 0.5
    assert step_of() == pytest.approx(-0.53, abs=5e-5)
    assert step_of(pass_band=0.1, shrink=0.6307) == pytest.approx(-0.6732, abs=5e-5)
    assert step_of(mu=-0.6) == -0.6
    assert step_of(pass_band=0.0) == -0.5


@BOUNDARIES
def test_taubin_agrees_with_the_plain_twin(boundary):
    vertices, faces = SHAPES["open grid"]
    given = {"iterations": 7, "mu": -0.7, "shrink": 0.6, "boundary": boundary}
    mesh, out = run("taubin", vertices, faces, **given)
    x = mesh.vertices
    ring = rows(len(x), faces, boundary)
    for _ in range(7):
        x = x + 0.6 * umbrella(x, ring)
        x = x - 0.7 * umbrella(x, ring)
    assert_twin(mesh, out, x)


@pytest.mark.parametrize(("shrink", "inflate"), [(0.1, -1.0), (0.3, -0.6), (0.49, -1.0)])
def test_steps_that_amplify_noise_are_refused(shrink, inflate):
    with pytest.raises(UsageError, match=f"mu = {inflate:g} amplify noise") as caught:
        TAUBIN.validate({"lambda": shrink, "mu": inflate})
    assert f"{-1.06 * shrink:.4g}" in caught.value.hint


def transfer(coefficients, k):
    """The windowed sinc's factor at a frequency."""
    return float(coefficients @ np.cos(np.arange(len(coefficients)) * np.arccos(1 - k / 2)))


@pytest.mark.parametrize("wave", [3, 20, 40, 100])
def test_a_wave_is_multiplied_by_the_transfer_function(wave):
    vertices, faces, k = wave_on_torus(wave)
    mesh, out = run("windowed_sinc", vertices, faces)
    expected = transfer(sinc_coefficients(0.1, 20), k)
    assert out[:, 2] == pytest.approx(expected * mesh.vertices[:, 2], abs=1e-12)
    out = denoise("taubin", mesh, iterations=3, mu=-0.53)
    expected = ((1 - 0.5 * k) * (1 + 0.53 * k)) ** 3
    assert out[:, 2] == pytest.approx(expected * mesh.vertices[:, 2], abs=1e-13)


@pytest.mark.parametrize(
    ("passes", "pass_band", "expected"),
    [
        # Measured with VTK 9.7 at waves 16, 24 and 40 of the torus above.
        (20, 0.1, [1.0, 0.9971, 0.8829]),
        (30, 0.05, [0.9981, 0.9488, 0.3404]),
        (50, 0.01, [0.7693, 0.1617, 0.0]),
    ],
)
def test_the_transfer_function_is_that_of_vtk(passes, pass_band, expected):
    coefficients = sinc_coefficients(pass_band, passes)
    at = [transfer(coefficients, wave_on_torus(wave)[2]) for wave in (16, 24, 40)]
    assert at == pytest.approx(expected, abs=1e-3)
    assert transfer(coefficients, 0.0) == pytest.approx(1.0, abs=1e-15)
    assert transfer(coefficients, pass_band) == pytest.approx(0.99904, abs=1e-9)


@pytest.mark.parametrize("shape", [SHAPES["torus"], stretched()], ids=["torus", "stretched"])
@BOUNDARIES
@pytest.mark.parametrize("time_step", [0.05, 0.25, 50.0])
def test_the_scale_dependent_umbrella_agrees_with_the_plain_twin(shape, boundary, time_step):
    given = {"iterations": 3, "boundary": boundary, "time_step": time_step}
    mesh, out = run("scale_dependent_umbrella", *shape, **given)
    x = mesh.vertices
    ring = rows(len(x), mesh.faces, boundary)
    for _ in range(3):
        x = x + scale_dependent_umbrella(x, ring, time_step * mesh.mean_edge_length**2)
    assert_twin(mesh, out, x)
