"""The choice for whole meshes: what is tried, what it promises, and that it pays."""

import dataclasses
import itertools

import numpy as np
import pytest

from benchmarks import ground_truth
from msal_cli import methods
from msal_cli.analysis.measures import measure_surface_change
from msal_cli.analysis.noise_estimate import NOISE, TEXTURE, Reading, estimate_noise
from msal_cli.auto import NONE, Wishes, adaptive, blends, search
from msal_cli.auto.candidates import CANDIDATES
from msal_cli.auto.risk import Quadratic, Risk
from msal_cli.kernels import parallel
from msal_cli.mesh import Mesh, prepare_mesh
from tests.files import SAMPLES
from tests.shapes import box, grid, noisy, torus


@pytest.mark.parametrize("candidate", CANDIDATES, ids=lambda candidate: candidate.label)
def test_settings_are_allowed(candidate):
    method = methods.find(candidate.method)
    settings = candidate.settings(0.125)
    values = method.validate(settings)
    assert ("noise" in settings) == candidate.takes_noise
    if candidate.takes_noise:
        assert values["noise"] == 0.125
    assert candidate.cost > 0.0
    assert {spec.name for spec in method.parameters} >= set(settings)


def scan(around=40, across=20, level=0.05, seed=0):
    vertices, faces = torus(around, across)
    return prepare_mesh(noisy(vertices, seed, level), faces).mesh


@pytest.fixture(scope="module")
def mesh():
    return scan()


@pytest.fixture(scope="module")
def spiky():
    """A scan with noise at one vertex in ten, and none at the others."""
    true = prepare_mesh(*torus(40, 20)).mesh
    return true.with_vertices(ground_truth.add_plain_noise(true, "impulsive", 0.5, 3, fraction=0.1))


def chosen(mesh, **wishes):
    return search.choose_method(mesh, Wishes(**wishes))


def made_by(choice, mesh):
    if choice.method == NONE:
        return mesh
    return mesh.with_vertices(methods.find(choice.method).denoise(mesh, choice.parameters).vertices)


def moved_edges(before, after):
    """Mean displacement in mean edge lengths."""
    lengths = np.linalg.norm(after.vertices - before.vertices, axis=1)
    return float(lengths.mean()) / before.mean_edge_length


def angle(true, other):
    return measure_surface_change(true, other).mean_angular_error_deg


def test_it_is_the_same_with_any_number_of_threads(mesh, monkeypatch):
    # Small meshes are not shared between threads, unless they are made to be.
    monkeypatch.setattr(parallel, "MIN_RANGE", 100)
    monkeypatch.setattr(parallel, "MIN_COUNT", 100)
    made = []
    for threads in ("1", "2"):
        monkeypatch.setenv("MSAL_THREADS", threads)
        again = Mesh(mesh.vertices.copy(), mesh.faces.copy())
        made.append(dataclasses.replace(chosen(again), noise=None))
    assert made[0] == made[1]


def test_it_is_free_of_scale_and_place():
    vertices, faces = torus(40, 20)
    # Digits to spare, so that moving loses none.
    vertices = np.round(noisy(vertices, 0, 0.05) * 2.0**20) / 2.0**20
    here = chosen(prepare_mesh(vertices, faces).mesh)
    for place, scale in (([512.0, -1024.0, 4096.0], 1.0), ([0.0] * 3, 25.4)):
        other = chosen(prepare_mesh((vertices + place) * scale, faces).mesh)
        assert (other.method, other.parameters) == (here.method, here.parameters)
        assert other.reason == here.reason
        assert other.risk == pytest.approx(here.risk, rel=1e-6)


@pytest.mark.parametrize(("large", "count"), [(1, 1), (10**9, 2)])
def test_on_large_meshes_the_learned_filter_runs_once(box_scan, monkeypatch, large, count):
    def of_the_first_two(risks, *others):
        weights = np.zeros(len(risks[0].positions.gain))
        weights[:2] = 0.5
        return weights

    with_kind(box_scan, monkeypatch, kind="correlated", rings=1)
    monkeypatch.setattr(search.blends, "best_weights", of_the_first_two)
    monkeypatch.setattr(search, "LARGE", large)
    assert chosen(box_scan).reason.count("learned") == count


def test_with_trust_the_method_has_a_data_term(mesh):
    trust = np.linspace(0.0, 1.0, len(mesh.vertices))
    for wish in ({}, {"strength": 2.0}):
        choice = chosen(mesh.with_constraints(None, trust), **wish)
        assert methods.find(choice.method).has_data_term(choice.parameters)


@pytest.mark.filterwarnings("error")
def test_where_all_vertices_are_held_nothing_is_done(mesh, spiky):
    for scan in (mesh, spiky):
        held = np.ones(len(scan.vertices), dtype=bool)
        choice = chosen(scan.with_constraints(held, None))
        assert choice.method == NONE
        assert np.isfinite(choice.risk)


def odd_meshes():
    draw = np.random.default_rng(0)
    vertices, faces = torus(40, 20)
    rough = noisy(vertices, 0, 0.05)
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    line = np.column_stack([draw.random(50), np.zeros(50), np.zeros(50)])
    yield "tetrahedron", noisy(corners, 0, 0.3), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    yield "triangle", np.eye(3), [[0, 1, 2]]
    yield "two triangles", noisy(corners, 1, 0.5), [[0, 1, 2], [2, 1, 3]]
    yield "ten vertices", draw.normal(size=(10, 3)), draw.integers(0, 10, (16, 3))
    yield "no area", line, draw.integers(0, 50, (90, 3))
    part = np.concatenate([faces, 800 + draw.integers(0, 50, (900, 3))])
    yield "half of it without area", np.concatenate([rough, line]), part
    crowded = np.column_stack([faces[:80, 0], faces[:80, 1], np.roll(faces[:80, 2], 5)])
    yield "non-manifold", rough, np.concatenate([faces, crowded])
    for factor in (10.0, 1e6):
        spiked = rough.copy()
        spiked[::97] *= factor
        yield f"spikes of {factor:g}", spiked, faces
    flat, sheet = grid(30, 30)
    flat[draw.random(900) < 0.02, 2] = 2.0
    yield "spikes on a plane", flat, sheet
    apart = draw.normal(size=(300, 1, 3)) * 50.0 + draw.normal(size=(300, 3, 3))
    yield "confetti", apart.reshape(-1, 3), np.arange(900).reshape(-1, 3)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("vertices", "faces"),
    [pytest.param(vertices, faces, id=name) for name, vertices, faces in odd_meshes()],
)
def test_odd_meshes_are_chosen_for(vertices, faces):
    mesh = prepare_mesh(np.asarray(vertices, dtype=float), np.array(faces, dtype=np.int32)).mesh
    choice = chosen(mesh)
    assert np.isfinite(made_by(choice, mesh).vertices).all()
    assert choice.risk is None or np.isfinite(choice.risk)
    assert all(np.isfinite(risk) for _, risk in choice.runners_up)
    assert len(choice.runners_up) <= 3


@pytest.mark.parametrize(
    ("wishes", "level"),
    [
        ({"strength": 2.0, "keep": "shape"}, 0.05 * 1.2**2 * 1.25),
        ({"strength": 1.0}, 0.05 * 1.2),
        ({"keep": "shape"}, 0.05 * 1.25),
    ],
)
def test_a_wish_for_smoothing_is_done_on_a_clean_mesh_too(wishes, level):
    mesh = prepare_mesh(*torus(60, 30)).mesh
    choice = chosen(mesh, **wishes)
    assert (choice.method, choice.parameters["schedule"]) == ("al", "wiener")
    assert choice.parameters["noise"] == pytest.approx(level, abs=1e-4)
    assert "clean; smoothed for noise of 0.0" in choice.reason
    assert 0.0 < moved_edges(mesh, made_by(choice, mesh)) < 0.05


@pytest.mark.parametrize(
    ("wishes", "end"),
    [
        ({}, "left as it is"),
        ({"keep": "edges"}, "left as it is; --strength 1 smooths it all the same"),
        ({"keep": "texture"}, "clean; left as it is"),
        ({"strength": -1.0}, "clean; left as it is"),
    ],
)
def test_a_wish_that_does_not_mean_smoothing_gets_a_reason(wishes, end):
    choice = chosen(prepare_mesh(*torus(60, 30)).mesh, **wishes)
    assert (choice.method, choice.parameters) == (NONE, {})
    assert choice.reason.endswith(end)


def test_noise_or_texture_gets_a_share_of_the_choice_for_noise(mesh, monkeypatch):
    readings = (Reading(NOISE, 0.05, 0.6), Reading(TEXTURE, 0.0, 0.4))
    estimate = dataclasses.replace(estimate_noise(mesh), readings=readings)
    monkeypatch.setattr(search, "estimate_noise", lambda mesh: estimate)
    mild, noise, texture = (chosen(mesh, assume=assume) for assume in (None, NOISE, TEXTURE))
    assert texture.method == NONE and "assumed" not in mild.reason
    assert mild.reason.startswith("noise of 0.05 e or texture")
    assert blends.describe_rest(estimate, estimate) == "noise of 0.05 e or texture"
    full = moved_edges(mesh, made_by(noise, mesh))
    # Half of the noise at most is left if there is any, and half of it is gone if there is none.
    assert 0.3 * full < moved_edges(mesh, made_by(mild, mesh)) < 0.8 * full


def wish_corpus():
    """Small meshes: noise along the normals, in all directions, impulsive, uneven; texture; none.

    What is chosen for two kinds of noise is nearly what is chosen for another, after seconds.
    """
    true = prepare_mesh(*torus(40, 20)).mesh
    kinds = (("gaussian-normal", 0.2), ("gaussian", 0.15), ("impulsive", 0.4))
    for kind, level in kinds:
        rough = true.with_vertices(ground_truth.add_plain_noise(true, kind, level, 1))
        yield pytest.param(rough, id=kind, marks=[pytest.mark.ci] if kind == "gaussian" else [])
    half = ground_truth.add_plain_noise(true, "gaussian-normal", 0.3, 1)
    half[true.vertices[:, 0] < 0.0] = true.vertices[true.vertices[:, 0] < 0.0]
    yield pytest.param(true.with_vertices(half), id="uneven", marks=pytest.mark.ci)
    bumps = true.vertices.copy()
    bumps[:, 2] += 0.02 * np.sin(9.0 * bumps[:, 0]) * np.sin(9.0 * bumps[:, 1])
    yield pytest.param(true.with_vertices(bumps), id="texture")
    yield pytest.param(true, id="clean")


def relief(mesh):
    """Root mean square of the umbrella vectors, mean edge lengths: what is finer than a ring."""
    ring = mesh.topology
    totals = np.add.reduceat(mesh.vertices[ring.ring], ring.ring_start[:-1])
    counts = np.diff(ring.ring_start)[:, None]
    return float(np.sqrt(((totals / counts - mesh.vertices) ** 2).sum(axis=1).mean()))


def choose_plainly(mesh, **wishes):
    return adaptive.choose_adaptive(mesh, wishes=Wishes(**wishes))


def check_wishes(mesh, choose, **more):
    """Wishes for less move less, and those for more farther, always."""

    def made(**wishes):
        return made_by(choose(mesh, **more, **wishes), mesh)

    fewer, less, plain, more_, most = (made(strength=x) for x in (-2.0, -1.0, 0.0, 1.0, 2.0))
    moved = [moved_edges(mesh, after) for after in (fewer, less, plain, more_, most)]
    if moved[2] > 0.0:
        assert all(a < b for a, b in itertools.pairwise(moved))
    else:
        assert moved[:3] == [0.0] * 3 and moved[3] < moved[4]
    texture = made(keep="texture")
    assert moved_edges(mesh, texture) <= moved[2]
    return moved, plain, texture


@pytest.mark.parametrize("choose", [choose_plainly, chosen])
@pytest.mark.parametrize("mesh", list(wish_corpus()))
def test_wishes_move_less_and_more_than_the_choice(mesh, choose):
    moved, plain, texture = check_wishes(mesh, choose)
    assert moved[0] < 0.65 * moved[2] or moved[0] == moved[2] == 0.0 < moved[3]
    assert relief(texture) >= relief(plain) * (1.0 - 1e-12)


def test_progress_goes_up_and_ends_at_the_total(mesh, spiky):
    for scan in (mesh, spiky):
        steps = []
        search.choose_method(scan, Wishes(), lambda *step, steps=steps: steps.append(step))
        (total,) = {total for _, total in steps}
        done = [step for step, _ in steps]
        assert done == sorted(done)
        assert done[-1] == total
        assert done.count(total) == 1
    steps = []
    search.choose_method(prepare_mesh(*grid()).mesh, Wishes(), lambda *step: steps.append(step))
    assert steps == [(1, 1)]


@pytest.mark.parametrize(
    ("name", "level"),
    [
        ("bear_clean.obj", 0.2),
        pytest.param("vase_clean.obj", 0.1, marks=pytest.mark.slow),
        pytest.param("toadstool_clean.ply", 0.3, marks=pytest.mark.slow),
    ],
)
def test_it_is_better_than_the_default_and_than_the_scan(name, level):
    true = ground_truth.opened(SAMPLES / name)
    rough = true.with_vertices(ground_truth.add_plain_noise(true, "gaussian-normal", level, 7))
    default = methods.find("msal")
    plain = rough.with_vertices(default.denoise(rough, default.validate({})).vertices)
    choice = chosen(rough)
    made = made_by(choice, rough)
    assert angle(true, made) < 0.9 * min(angle(true, plain), angle(true, rough))
    assert moved_edges(true, made) < 0.9 * min(moved_edges(true, plain), moved_edges(true, rough))
    # And it knows how near it came.
    error = np.sqrt(((made.vertices - true.vertices) ** 2).sum(axis=1).mean())
    assert choice.risk == pytest.approx(error / rough.mean_edge_length, rel=0.25)


@pytest.mark.parametrize("name", ["bear_clean.obj", "bracket_clean.ply", "knot_clean.stl"])
def test_clean_samples_hardly_move(name):
    true = ground_truth.opened(SAMPLES / name)
    assert moved_edges(true, made_by(chosen(true), true)) < 0.015


@pytest.fixture(scope="module")
def box_scan():
    true = prepare_mesh(*box(16, 12, 10)).mesh
    return true.with_vertices(ground_truth.add_plain_noise(true, "gaussian-normal", 0.2, 1))


def test_of_a_machined_part_nothing_is_given_back_unless_noise_is_white(box_scan, monkeypatch):
    assert chosen(box_scan).parameters["texture"] == "auto"
    with_kind(box_scan, monkeypatch, kind="unknown")
    choice = chosen(box_scan)
    assert (choice.method, choice.parameters["texture"]) == ("learned", "lost")


@pytest.mark.parametrize(("large", "stages"), [(10_000, 5), (100, 4)])
def test_a_machined_part_gets_more_stages(box_scan, monkeypatch, large, stages):
    monkeypatch.setattr(search, "LARGE", large)
    assert chosen(box_scan).parameters["iterations"] == stages
    with_kind(box_scan, monkeypatch, kind="correlated", rings=1)
    assert chosen(box_scan).tried == 2, "no linear filters, which blur edges"


@pytest.mark.parametrize(("share", "end"), [(0.7, "; learned"), (0.3, "; 30% learned")])
def test_the_larger_part_of_the_way_becomes_all_of_it_on_a_machined_part(
    box_scan, monkeypatch, share, end
):
    def of_the_first(risks, *others):
        weights = np.zeros(len(risks[0].positions.gain))
        weights[0] = share
        return weights

    monkeypatch.setattr(search.blends, "best_weights", of_the_first)
    assert end in chosen(box_scan).reason


def with_kind(mesh, monkeypatch, **changes):
    """Make the estimate of a mesh one of another character."""
    estimate = estimate_noise(mesh)
    character = dataclasses.replace(estimate.character, **changes)
    changed = dataclasses.replace(estimate, character=character)
    monkeypatch.setattr(search, "estimate_noise", lambda mesh: changed)


def test_terraces_get_the_learned_filter_without_a_level(box_scan, monkeypatch):
    with_kind(box_scan, monkeypatch, kind="staircase", step=1.0)
    choice = chosen(box_scan)
    assert choice.method == "learned" and choice.reason.endswith("; learned")
    assert (choice.parameters["noise"], choice.parameters["texture"]) == (0.0, "lost")


@pytest.mark.parametrize(
    ("kind", "rings", "end"),
    [("correlated", 1, "learned"), ("view", 1, "learned"), ("view", 0, "left as it is")],
)
def test_learned_has_what_no_filter_has_where_neighbours_share_the_noise(
    box_scan, monkeypatch, kind, rings, end
):
    with_kind(box_scan, monkeypatch, kind=kind, rings=rings)
    monkeypatch.setattr(
        search.blends, "best_weights", lambda risks, *others: np.zeros(len(risks[0].positions.gain))
    )
    assert f"; {end}" in chosen(box_scan).reason


def test_a_wish_is_done_where_every_filter_would_add_error(mesh, monkeypatch):
    monkeypatch.setattr(
        search.blends, "best_weights", lambda risks, *others: np.zeros(len(risks[0].positions.gain))
    )
    left = chosen(mesh)
    assert left.method == NONE and "add more error" in left.reason
    choice = chosen(mesh, strength=1.0)
    assert choice.method == "al" and choice.tried == left.tried
    assert choice.parameters["noise"] > 1.15 * estimate_noise(mesh).mean_edges


@pytest.mark.parametrize("order", [1, -1])
def test_a_hedge_is_the_smaller_share_of_positions_and_slopes(order):
    mild, strong = Quadratic(np.eye(1), np.ones(1)), Quadratic(4.0 * np.eye(1), 2.0 * np.ones(1))
    risk = Risk(*(mild, strong)[::order])
    assert search.blends.hedge([risk], np.ones(1)) == 0.25
