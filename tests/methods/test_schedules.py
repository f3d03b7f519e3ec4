"""Schedules over every operator, and the robust and the Wiener one by their definitions."""

import functools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli import methods
from msal_cli.analysis.noise_estimate import estimate_noise
from msal_cli.errors import UsageError
from msal_cli.mesh import prepare_mesh
from tests.methods.runs import SHAPES, denoise, scan
from tests.paper import algorithm_1, heights_and_sigma, normal_field, one_rings
from tests.shapes import noisy, torus


def run(vertices, faces, name="msal", **given):
    method = methods.find(name)
    return method.denoise(prepare_mesh(vertices, faces).mesh, method.validate(given))


@given(
    seed=st.integers(0, 10**6),
    level=st.floats(0.0, 0.5),
    quantile=st.floats(0.01, 1.0),
    K=st.floats(0.05, 1.0),
)
def test_lambda_stays_within_0_and_1_and_the_definition(seed, level, quantile, K):
    vertices, faces = torus(9, 7)
    vertices = noisy(vertices, seed, level)
    vertices -= (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    result = run(vertices, faces, schedule="robust", quantile=quantile, K=K, n=3)
    expected = algorithm_1(vertices, faces, 3, K, 1, quantile)
    assert np.abs(result.vertices - expected).max() <= 1e-12 * np.ptp(vertices)
    fidelity = result.fields["fidelity"]
    assert fidelity.min() >= 0.0
    assert 1.0 - 1e-15 <= fidelity.max() <= 1.0


def noise_shares(bands: int) -> list[float]:
    """What unit white noise leaves in each band, on the lattice of valence 6, by convolution."""
    size = 4 * bands + 1
    values = np.zeros((size, size))
    values[size // 2, size // 2] = 1.0

    def mean(a):
        moves = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, -1), (-1, 1)]
        return sum(np.roll(a, move, (0, 1)) for move in moves) / 7

    shares = []
    for _ in range(bands - 1):
        low = mean(values)
        shares.append(((values - low) ** 2).sum())
        values = low
    return [*shares, (values**2).sum()]


def returned(t, rings, noise: float, caution: float, bands: int) -> np.ndarray:
    """What of the residual t (n,) is more than noise."""

    def mean(a):
        return np.array([np.mean([a[i], *a[ring]]) for i, ring in enumerate(rings)])

    def cut(rest):
        for _ in range(bands - 1):
            low = mean(rest)
            yield rest - low
            rest = low
        yield rest

    def around(a, passes):
        for _ in range(passes):
            a = mean(a)
        return a

    shares = noise_shares(bands)
    guess = np.zeros(len(t))
    for part, share in zip(cut(t), shares, strict=True):
        for i, power in enumerate(around(part**2, 6)):
            if power > 0:
                guess[i] += max(0, 1 - 1.4 * caution * share * noise**2 / power) * part[i]
    result = np.zeros(len(t))
    for part, signal, share in zip(cut(t), cut(guess), shares, strict=True):
        for i, power in enumerate(around(signal**2, 3)):
            if power > 0 and t[i] != 0:
                result[i] += power / (power + 0.4 * caution * share * noise**2) * part[i]
    return result


def wiener(v, faces, iterations: int, noise: float, caution: float, mollify: int) -> np.ndarray:
    """Plain sweeps of AL, and what they took beyond noise; ``noise`` in file units."""
    normals, rings = normal_field(v, faces, mollify), one_rings(len(v), faces)
    x = v.copy()
    for _ in range(iterations):
        x = x + heights_and_sigma(x, rings, normals)[0][:, None] * normals
    t = ((x - v) * normals).sum(axis=1)
    return x - returned(t, rings, noise, caution, 5)[:, None] * normals


@pytest.mark.parametrize("shape", ["torus", "open grid", "tiny"])
@pytest.mark.parametrize(("noise", "caution"), [(0.1, 1.0), (0.02, 1.2), (0.05, 0.3)])
def test_wiener_is_what_its_definition_says(shape, noise, caution):
    vertices, faces = SHAPES[shape]
    vertices = vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    unit = prepare_mesh(vertices, faces).mesh.mean_edge_length
    expected = wiener(vertices, faces, 3, noise * unit, caution, 1)
    given = {"schedule": "wiener", "noise": noise, "caution": caution, "n": 3}
    assert np.abs(run(vertices, faces, **given).vertices - expected).max() < 1e-12 * np.ptp(
        vertices
    )


def test_wiener_estimates_the_noise_unless_it_is_given():
    vertices, faces = torus(64, 32)
    vertices = noisy(vertices, 1)
    level = estimate_noise(prepare_mesh(vertices, faces).mesh).mean_edges
    by_itself = run(vertices, faces, schedule="wiener").vertices
    assert np.allclose(by_itself, run(vertices, faces, schedule="wiener", noise=level).vertices)
    assert not np.allclose(
        by_itself, run(vertices, faces, schedule="wiener", noise=3 * level).vertices
    )


@pytest.mark.parametrize("schedule", ["multiscale", "robust", "wiener"])
@pytest.mark.parametrize("name", ["msal", "umbrella"])
def test_trust_scales_the_pull(schedule, name):
    vertices, faces = SHAPES["torus"]
    mesh = prepare_mesh(vertices, faces).mesh
    method = methods.find(name)
    parameters = method.validate({"schedule": schedule})
    assert method.has_data_term(parameters)
    trust = np.random.default_rng(0).random(len(vertices))
    whole = method.denoise(mesh, parameters)
    scaled = method.denoise(mesh.with_constraints(None, trust), parameters)
    assert np.allclose(
        scaled.fields["fidelity"], trust * whole.fields["fidelity"], rtol=1e-14, atol=0
    )


SCHEDULED = [
    name
    for name in methods.names()
    if any("plain" in spec.choices for spec in methods.find(name).parameters)
]


@pytest.fixture(scope="module")
def mesh():
    return scan(0.05, 0)


@pytest.fixture(params=SCHEDULED)
def scheduled(request, mesh):
    return functools.partial(denoise, request.param, mesh)


def moved(mesh, vertices):
    return np.linalg.norm(vertices - mesh.vertices, axis=1)


def test_the_plain_schedule_is_the_default_and_has_neither_k_nor_lambda(scheduled):
    assert (scheduled(schedule="plain", fidelity=0.9) == scheduled()).all()
    with pytest.raises(UsageError, match=r"K = 0\.1 means nothing to the schedule plain"):
        scheduled(K=0.1)


def test_a_constant_pull_of_zero_is_the_plain_schedule(scheduled):
    assert (scheduled(schedule="constant", fidelity=0.0) == scheduled()).all()


def test_multiscale_comes_back_to_the_input(scheduled, mesh):
    # Section 3: as sweeps go on the process converges to the data, over any operator.
    few, many = (moved(mesh, scheduled(n=n, schedule="multiscale")).max() for n in (4, 200))
    assert many < 1e-3 * few


def test_a_robust_schedule_that_asks_for_the_largest_is_the_multiscale_one(scheduled):
    robust = scheduled(schedule="robust", quantile=1.0, K=0.3, n=3)
    assert (robust == scheduled(schedule="multiscale", K=0.3, n=3)).all()
    assert not (robust == scheduled(schedule="robust", quantile=0.5, K=0.3, n=3)).all()


def test_wiener_gives_back_all_if_there_is_no_noise_and_nothing_if_there_is_much(scheduled, mesh):
    plain = scheduled(n=4)
    normals = mesh.vertex_normals("uniform", 1)

    def along(vertices):
        return ((vertices - mesh.vertices) * normals).sum(axis=1)

    assert np.abs(along(scheduled(n=4, schedule="wiener", noise=1e-12))).max() < 1e-13
    assert (scheduled(n=4, schedule="wiener", noise=100) == plain).all()
    some = along(scheduled(n=4, schedule="wiener", noise=0.005))
    assert 0 < np.linalg.norm(some) < np.linalg.norm(along(plain))
