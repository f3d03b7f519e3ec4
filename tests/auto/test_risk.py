"""Noise that is drawn, and errors of blends against those where the truth is known."""

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.analysis.added_noise import AddedNoise, add_noise
from msal_cli.auto.noise_model import AXIS, ISOTROPIC, NoiseModel
from msal_cli.auto.risk import SimulatedRisk, SteinRisk, estimate_errors
from msal_cli.auto.risk import _slopes as slopes_of
from msal_cli.auto.sample_patch import Part
from msal_cli.mesh import Mesh, prepare_mesh
from tests.shapes import grid, torus


@pytest.fixture(scope="module")
def mesh():
    return prepare_mesh(*torus(90, 45)).mesh


def drawn(mesh, seed=0, way="draw", **given):
    noise = NoiseModel(0.2, **given)
    generator = np.random.default_rng(seed)
    return getattr(noise, way)(mesh, mesh.vertex_normals("uniform"), generator)


@pytest.mark.parametrize("way", ["draw", "probe"])
def test_plain_noise_is_along_the_normals_and_white(mesh, way):
    moves = drawn(mesh, way=way)
    normals = mesh.vertex_normals("uniform")
    heights = np.einsum("ij,ij->i", moves, normals)
    assert moves == pytest.approx(heights[:, None] * normals, abs=1e-12)
    assert heights.std() == pytest.approx(0.2, rel=0.05)
    if way == "probe":
        assert np.abs(heights) == pytest.approx(np.full(len(heights), 0.2))


def test_isotropic_noise_has_the_level_in_every_coordinate(mesh):
    moves = drawn(mesh, direction=ISOTROPIC)
    assert moves.std(axis=0) == pytest.approx([0.2] * 3, rel=0.05)
    assert np.corrcoef(moves.T) == pytest.approx(np.eye(3), abs=0.05)


def test_noise_along_an_axis_has_no_other_part(mesh):
    axis = (0.6, 0.0, 0.8)
    moves = drawn(mesh, direction=AXIS, axis=axis)
    assert np.cross(moves, axis) == pytest.approx(np.zeros_like(moves), abs=1e-12)
    assert (moves @ axis).std() == pytest.approx(0.2, rel=0.05)


UP = np.array([0.0, 0.0, 1.0])


def sheet(rows=24, columns=20, noise=0.0, seed=0, judged=None):
    """A flat part with Gaussian noise along z, and the noise (n,)."""
    vertices, faces = grid(rows, columns)
    heights = noise * np.random.default_rng(seed).standard_normal(len(vertices))
    mesh = Mesh(vertices + heights[:, None] * UP, faces)
    inside = np.ones(len(vertices), dtype=bool) if judged is None else judged
    return Part(mesh, inside), heights


def upwards(mesh):
    return np.tile(UP, (len(mesh.vertices), 1))


@pytest.fixture
def level(monkeypatch):
    """Normals that noise does not turn: what Stein's lemma supposes."""
    monkeypatch.setattr(Mesh, "vertex_normals", lambda mesh, *ignored: upwards(mesh))


def along(matrix):
    """The filter that moves heights h by ``matrix`` h along z."""

    def run(mesh):
        return (matrix @ mesh.vertices[:, 2])[:, None] * UP

    return run


def scaled(factor):
    """The filter that moves heights h by ``factor`` h."""
    return lambda mesh: factor * mesh.vertices[:, 2:] * UP


def smoothing(mesh):
    """Heights that become the mean of their rings: a matrix (n, n)."""
    n = len(mesh.vertices)
    matrix = -np.eye(n)
    for i in range(n):
        ring = mesh.topology.ring[mesh.topology.ring_start[i] : mesh.topology.ring_start[i + 1]]
        matrix[i, ring] = 1.0 / len(ring)
    return matrix


def rehearsed(part, *runs, pilot=None, noise=0.1, way="drawn"):
    model = noise if isinstance(noise, NoiseModel) else NoiseModel(noise)
    pilot = part.mesh.vertices if pilot is None else pilot
    calls = []
    risk = SimulatedRisk(part, pilot, runs, model, way, lambda: calls.append(way)).risk()
    assert len(calls) == len(runs)
    return risk


def stein(part, noise, *runs):
    normals, calls = part.mesh.vertex_normals("uniform", 1), []
    judge = SteinRisk(part, normals, runs, NoiseModel(noise), lambda: calls.append(noise))
    assert len(calls) == 3 * len(runs)
    return judge.risk()


@pytest.mark.parametrize("factor", [-1.0, -0.5, 0.0, 0.25])
def test_heights_times_a_constant_exactly(level, factor):
    # d = a h has the divergence a; its risk is a^2 mean(h^2) / s^2 + 1 + 2 a.
    part, heights = sheet(noise=0.1)
    risk = stein(part, 0.1, scaled(factor))
    expected = factor**2 * float(np.mean(heights**2)) / 0.01 + 1.0 + 2.0 * factor
    assert risk.positions.singles()[0] == pytest.approx(expected, rel=1e-9)
    assert -risk.positions.gain[0] == pytest.approx(factor, abs=1e-9)
    assert -risk.slopes.gain[0] == pytest.approx(factor, abs=1e-9)
    # A height over a flat sheet sweeps a third of the area of the faces around.
    mesh = part.mesh
    around = np.bincount(mesh.faces.reshape(-1), minlength=len(heights)) / (3 * len(mesh.faces))
    around[mesh.topology.boundary] = 0.0
    # The area is that of the noisy sheet, which is a little larger.
    assert risk.drift[0] == pytest.approx(factor * float(around @ heights) / 0.1, rel=0.05)


PROBES = 24
"""Enough that their own scatter, alike in all draws, does not count."""

MODELS = {
    "shared": NoiseModel(0.1, rings=2),
    "isotropic": NoiseModel(0.1, direction=ISOTROPIC),
    "along an axis": NoiseModel(0.1, direction=AXIS, axis=(0.6, 0.0, 0.8)),
    "by region": NoiseModel(0.1, shares=np.where(np.arange(480) < 240, 1.4, 0.1)),
}


def averaging(mesh):
    """The umbrella filter, more along z than across it, and more at the last vertices."""
    matrix = np.linspace(0.2, 1.2, len(mesh.vertices))[:, None] * smoothing(mesh)
    return lambda other: (matrix @ other.vertices) * [0.2, 0.2, 1.0]


@pytest.mark.parametrize("noise", MODELS.values(), ids=MODELS)
def test_it_is_the_true_error_for_noise_of_any_colour_direction_and_level(noise):
    part, _ = sheet()
    flat = part.mesh
    normals = upwards(flat)
    once = averaging(flat)
    tilt = slopes_of(flat, normals, part.judged, noise.direction == ISOTROPIC)
    draws = np.random.default_rng(6)
    tilted = np.mean([np.sum(tilt(noise.draw(flat, normals, draws)) ** 2) for _ in range(40)])
    draws = np.random.default_rng(5)
    gaps, white_gaps, slope_gaps, errors = [], [], [], []
    for _ in range(20):
        added = noise.draw(flat, normals, draws)
        mesh = flat.with_vertices(flat.vertices + added)
        left = added + once(mesh)
        error = np.sum(left**2) / (480 * noise.variance(part.judged))
        judges = [
            SteinRisk(Part(mesh, part.judged), normals, [once], model, lambda: None, PROBES)
            for model in (noise, NoiseModel(0.1))
        ]
        risk = judges[0].risk()
        gaps.append(risk.positions.singles()[0] - error)
        white_gaps.append(judges[1].risk().positions.singles()[0] - error)
        slope_gaps.append(risk.slopes.singles()[0] - np.sum(tilt(left) ** 2) / tilted)
        errors.append(error)
    for gap in (gaps, slope_gaps):
        assert abs(np.mean(gap)) < 4.0 * np.std(gap) / np.sqrt(len(gap)) + 0.02
    again = rehearsed(part, once, noise=noise)
    # Noise that is taken for white along the normals is judged wrong.
    assert abs(np.mean(white_gaps)) > 2.0 * abs(np.mean(gaps)) + 0.02
    assert again.positions.singles()[0] == pytest.approx(np.mean(errors), rel=0.2)


def test_what_is_not_judged_does_not_count(level):
    inner = np.zeros(24 * 20, dtype=bool)
    inner[100:300] = True
    part, heights = sheet(noise=0.1, judged=inner)
    once = smoothing(part.mesh)

    def astray(mesh):
        moves = along(once)(mesh)
        moves[~inner] += 1e3 * mesh.vertices[~inner]
        return moves

    fair, odd = (stein(part, 0.1, run) for run in (along(once), astray))
    assert odd.positions.singles() == pytest.approx(fair.positions.singles(), rel=1e-12)
    assert odd.slopes.singles() == pytest.approx(fair.slopes.singles(), rel=1e-12)
    assert odd.drift == pytest.approx(fair.drift)
    mean = float(np.mean((once @ heights)[inner] ** 2)) / 0.01
    assert fair.positions.gram[0, 0] == pytest.approx(mean)

    again = [rehearsed(part, run) for run in (along(once), astray)]
    assert again[1].positions.gram == pytest.approx(again[0].positions.gram, rel=1e-12)
    assert again[1].positions.gain == pytest.approx(again[0].positions.gain, rel=1e-12)
    assert again[1].slopes.gain == pytest.approx(again[0].slopes.gain, rel=1e-12)


@pytest.mark.filterwarnings("error")
def test_with_nobody_to_judge_nothing_is_gained(level):
    part, _ = sheet(noise=0.1, judged=np.zeros(24 * 20, dtype=bool))
    for risk in (
        stein(part, 0.1, scaled(-1.0)),
        rehearsed(part, scaled(-1.0)),
        rehearsed(part, scaled(-1.0), pilot=2.0 * part.mesh.vertices, way="mirrored"),
    ):
        assert risk.positions.gram.tolist() == [[0.0]]
        for found in (risk.positions.gain, risk.slopes.gain, risk.drift):
            assert found.tolist() == [0.0]


def test_a_rehearsal_measures_what_is_left(level):
    # The pilot is flat, so what the filter makes of the noise is all that is left of it.
    flat, _ = sheet()
    once = smoothing(flat.mesh)
    seen = []

    def run(mesh):
        seen.append(mesh.vertices[:, 2].copy())
        return along(once)(mesh)

    risk = rehearsed(flat, run, scaled(-1.0))
    heights = seen[0]
    assert heights.std() == pytest.approx(0.1, rel=0.1)
    left = np.sum((heights + once @ heights) ** 2) / np.sum(heights**2)
    assert risk.positions.singles() == pytest.approx([left, 0.0], abs=1e-12)
    tilt = slopes_of(flat.mesh, upwards(flat.mesh), flat.judged)
    rest = tilt((heights + once @ heights)[:, None] * UP)
    whole = tilt(heights[:, None] * UP)
    assert risk.slopes.singles()[0] == pytest.approx(np.sum(rest**2) / np.sum(whole**2))
    assert risk.slopes.singles()[1] == pytest.approx(0.0, abs=1e-12)


def test_what_the_pilot_took_away_is_put_on_with_the_other_sign():
    part, heights = sheet(noise=0.1)
    pilot = part.mesh.vertices.copy()
    pilot[:, 2] = 0.25 * heights
    seen = []

    def run(mesh):
        seen.append(mesh.vertices.copy())
        return pilot - mesh.vertices

    rehearsal = SimulatedRisk(part, pilot, [run], NoiseModel(0.1), "mirrored", lambda: None)
    assert seen[0] == pytest.approx(2.0 * pilot - part.mesh.vertices, abs=1e-12)
    assert rehearsal.risk().positions.singles()[0] == pytest.approx(0.0, abs=1e-12)
    assert rehearsal.level == pytest.approx(0.75 * np.sqrt(np.mean(heights**2)))


@pytest.mark.parametrize("noise", [0.0, 1e-300])
def test_without_noise_every_move_is_an_error(noise):
    part, _ = sheet(noise=0.1)
    risk = stein(part, noise, scaled(-0.5), lambda mesh: np.zeros_like(mesh.vertices))
    again = rehearsed(part, scaled(-0.5), noise=noise)
    assert risk.positions.singles()[0] > 1e6
    assert risk.positions.singles()[1] == 1.0
    assert again.positions.singles()[0] > 1e6
    for found in (risk, again):
        assert np.isfinite(found.slopes.gram).all()
        assert np.isfinite(found.drift).all()


def test_isotropic_noise_counts_across_the_surface(mesh):
    noisy = mesh.with_vertices(add_noise(mesh, AddedNoise("gaussian", 0.3)))
    filter = methods.find("msal"), methods.find("msal").validate({})
    left = filter[0].denoise(noisy, filter[1]).vertices - mesh.vertices
    across = np.einsum("ij,ij->i", left, mesh.vertex_normals("uniform"))
    expected = across.std() / noisy.mean_edge_length
    assert estimate_errors(noisy, [filter]) == pytest.approx([expected], rel=0.1)
