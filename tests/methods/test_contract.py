"""Every method, found by name, keeps the same promises."""

import dataclasses
import functools

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.kernels import parallel
from msal_cli.mesh import prepare_mesh
from tests.methods import runs
from tests.shapes import fan, grid, noisy, torus

ALL = methods.names()
scan = functools.partial(runs.scan, 0.15, 0)


VARIANTS = [
    *((name, {}) for name in ALL),
    ("al", {"deviation": "median"}),
    ("al", {"weights": "tukey", "scaling": "edge"}),
    ("al", {"weights": "huber", "deviation": "median", "scaling": "mass"}),
    ("anisotropic_diffusion", {"variant": "amc", "iterations": 10}),
    ("bilateral", {"variant": "fleishman", "closeness": 1.0}),
    ("bilateral_normal", {"variant": "global"}),
    ("mean_curvature_flow", {"variant": "explicit"}),
    ("msal", {"schedule": "robust"}),
    ("msal", {"schedule": "wiener"}),
]
"""Methods with parameters that lead to other code."""


@dataclasses.dataclass
class Variant:
    """A method with some of its parameters."""

    method: methods.Method
    given: dict

    @property
    def defaults(self):
        return self.method.validate(self.given)

    def __call__(self, mesh, on_sweep=None, **more):
        values = self.method.validate(self.given | more)
        return self.method.denoise(mesh, values, on_sweep)


@pytest.fixture(params=ALL)
def method(request):
    return methods.find(request.param)


@pytest.fixture(params=VARIANTS, ids=lambda row: " ".join(map(str, (row[0], *row[1].values()))))
def run(request):
    name, given = request.param
    return Variant(methods.find(name), given)


def test_it_removes_noise(method):
    # Fine enough that the torus itself is smooth on the scale of the mesh; noise of 0.1 edges.
    vertices, faces = torus(120, 60)
    clean = prepare_mesh(vertices, faces).mesh
    mesh = prepare_mesh(noisy(vertices, 0, 0.17 * clean.mean_edge_length), faces).mesh
    out = runs.denoise(method.name, mesh)
    assert runs.error_deg(clean, out) < 0.7 * runs.error_deg(clean, mesh.vertices)


def test_results_are_finite_and_per_vertex_and_the_input_is_not_written_to(run):
    mesh = runs.scan(0.6, 0)
    before = mesh.vertices.copy(), mesh.faces.copy()
    mesh.vertices.flags.writeable = False
    mesh.faces.flags.writeable = False
    result = run(mesh)
    assert result.vertices is not mesh.vertices
    assert (mesh.vertices == before[0]).all() and (mesh.faces == before[1]).all()
    assert result.vertices.shape == mesh.vertices.shape
    assert result.vertices.dtype == np.float64
    assert np.isfinite(result.vertices).all()
    for values in result.fields.values():
        assert values.shape == (len(mesh.vertices),) and np.isfinite(values).all()


def test_a_flat_sheet_stays_flat(run):
    vertices, faces = grid(8, 8)
    mesh = prepare_mesh(vertices, faces).mesh
    out = run(mesh).vertices
    assert np.abs(out[:, 2]).max() < 1e-12


def test_threads_do_not_change_a_bit(run, monkeypatch):
    # Small ranges let a small mesh be shared between threads.
    monkeypatch.setattr(parallel, "MIN_RANGE", 100)
    mesh = scan(around=28, across=18)
    results = []
    given = {name: 2 for name in ("iterations",) if name in run.defaults}
    for count in ("1", "3"):
        monkeypatch.setenv("MSAL_THREADS", count)
        results.append(run(dataclasses.replace(mesh), **given).vertices)
    assert (results[0] == results[1]).all()


def test_vertex_order_does_not_matter(run):
    mesh = scan()
    order = np.random.default_rng(1).permutation(len(mesh.vertices))
    place = np.argsort(order)
    shuffled = prepare_mesh(mesh.vertices[order], place[mesh.faces].astype(np.int32))
    out = run(mesh).vertices
    other = run(shuffled.mesh).vertices + shuffled.origin
    assert np.allclose(out[order], other, atol=1e-9)


def test_scale_does_not_matter(run):
    mesh = scan()
    out = run(mesh).vertices
    small = dataclasses.replace(mesh, vertices=mesh.vertices * 2.0**-20)
    assert np.allclose(run(small).vertices * 2.0**20, out, rtol=0, atol=1e-9)


def test_progress_is_reported_after_every_sweep_and_may_end_the_run(run):
    reported = []
    few = {"iterations": 3} if "iterations" in run.defaults else {}
    run(scan(), lambda *at: reported.append(at), **few)
    assert reported[-1] == (3, 3) or not few
    assert reported == sorted(reported)

    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(scan(), stop)


def test_zero_iterations_return_the_input(run):
    if "iterations" not in run.defaults:
        pytest.skip("not iterative")
    mesh = scan()
    out = run(mesh, iterations=0).vertices
    assert (out == mesh.vertices).all()


def test_fixed_vertices_stay(run):
    mesh = scan()
    fixed = np.arange(len(mesh.vertices)) % 7 == 0
    out = run(mesh.with_constraints(fixed, None)).vertices
    assert (out[fixed] == mesh.vertices[fixed]).all()
    assert (out[~fixed] != mesh.vertices[~fixed]).any(axis=1).mean() > 0.9
    if run.defaults.get("iterations", 1) > 1:  # the sweeps see the others where they are
        free = run(mesh).vertices
        assert np.abs(out - free)[~fixed].max() > 1e-3 * mesh.mean_edge_length


def test_the_rule_at_open_edges(run):
    if "boundary" not in run.defaults:
        pytest.skip("no such rule")
    vertices, faces = grid(24, 24)
    mesh = prepare_mesh(noisy(vertices, 8, 0.2), faces).mesh
    rim = mesh.topology.boundary
    fixed, free = (run(mesh, boundary=rule).vertices for rule in ("fixed", "free"))
    assert (fixed[rim] == mesh.vertices[rim]).all()
    assert (fixed[~rim] != mesh.vertices[~rim]).any(axis=1).mean() > 0.8
    assert (free[rim] != mesh.vertices[rim]).any(axis=1).mean() > 0.8


@pytest.mark.parametrize("dirt", ["spike", "needle", "fold", "bow-tie", "isolated"])
def test_dirt_is_survived_and_a_vertex_without_faces_stays(run, dirt):
    vertices, faces = torus()
    vertices = np.concatenate([noisy(vertices, 3, 0.1), [[2.0, 2.0, 2.0]]])
    if dirt == "spike":
        vertices[17] += 1e6
    elif dirt == "needle":
        vertices[5] = vertices[6] + 1e-14
    elif dirt == "fold":
        faces = np.concatenate([faces, faces[:40, ::-1]])
    elif dirt == "bow-tie":
        faces = np.concatenate([faces, [[0, 100, 200], [0, 1, 200], [0, 1, 100]]])
    else:
        faces = faces[::3]
    ready = prepare_mesh(vertices, faces.astype(np.int32))
    # So few vertices are taken for a design without noise.
    given = {"noise": 0.1} if "noise" in run.defaults else {}
    out = run(ready.mesh, **given).vertices
    assert np.isfinite(out).all()
    # The last vertex has no face.
    assert (out[-1] == ready.mesh.vertices[-1]).all()
    assert dirt == "isolated" or (out[:-1] != ready.mesh.vertices[:-1]).any()


def test_a_hub_of_many_faces_is_survived(run):
    # A sum over all pairs of faces would take minutes.
    heights = np.random.default_rng(0).normal(0, 0.003, 10_000)
    mesh = prepare_mesh(*fan(heights)).mesh
    given = {name: 1 for name in ("iterations", "normal_iterations") if name in run.defaults}
    assert np.isfinite(run(mesh, **given).vertices).all()


def test_parameters_describe_themselves(method):
    assert method.summary
    assert len(method.summary) < 100
    assert method.source
    for spec in method.parameters:
        assert spec.help
        assert spec.choices or spec.more, f"{spec.name}: which way is more?"
        assert spec.validate(spec.default) == spec.default
        assert spec.range_text
