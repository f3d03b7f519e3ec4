"""Every method, found by name, keeps the same promises."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.analysis.measures import normal_statistics
from msal_cli.errors import UsageError
from msal_cli.kernels import parallel
from msal_cli.mesh import prepare_mesh
from tests.shapes import grid, noisy, torus

ALL = methods.names()


def scan(seed=0, level=0.15, around=24, across=12):
    vertices, faces = torus(around, across)
    return prepare_mesh(noisy(vertices, seed, level), faces).mesh


@pytest.fixture(params=ALL)
def method(request):
    return methods.find(request.param)


def defaults(method, **given):
    return method.validate(given)


def test_al_and_msal_are_there():
    assert {"al", "msal"} <= set(ALL)


def test_it_removes_noise(method):
    # Fine enough that the torus itself is smooth on the scale of the mesh; noise of 0.1 edges.
    vertices, faces = torus(160, 80)
    clean = prepare_mesh(vertices, faces).mesh
    mesh = prepare_mesh(noisy(vertices, 0, 0.17 * clean.mean_edge_length), faces).mesh
    out = mesh.with_vertices(method.denoise(mesh, defaults(method)).vertices)

    def error(one):
        return normal_statistics(clean, one).mean_angular_error_deg

    assert error(out) < 0.7 * error(mesh)


def test_the_input_is_not_written_to(method):
    mesh = scan()
    before = mesh.vertices.copy(), mesh.faces.copy()
    mesh.vertices.flags.writeable = False
    mesh.faces.flags.writeable = False
    out = method.denoise(mesh, defaults(method)).vertices
    assert out is not mesh.vertices
    assert (mesh.vertices == before[0]).all()
    assert (mesh.faces == before[1]).all()


def test_shape_type_and_finiteness(method):
    mesh = scan(level=0.6)
    out = method.denoise(mesh, defaults(method)).vertices
    assert out.shape == mesh.vertices.shape
    assert out.dtype == np.float64
    assert np.isfinite(out).all()


def test_fields_are_per_vertex(method):
    mesh = scan()
    for values in method.denoise(mesh, defaults(method)).fields.values():
        assert values.shape == (len(mesh.vertices),)
        assert np.isfinite(values).all()


def test_a_flat_sheet_stays_flat(method):
    vertices, faces = grid(8, 8)
    mesh = prepare_mesh(vertices, faces).mesh
    out = method.denoise(mesh, defaults(method)).vertices
    assert np.abs(out[:, 2]).max() < 1e-12


def test_threads_do_not_change_a_bit(method, monkeypatch):
    # Small ranges let a small mesh be shared between threads.
    monkeypatch.setattr(parallel, "SMALLEST_RANGE", 100)
    mesh = scan(around=28, across=18)
    results = []
    for count in ("1", "2", "3"):
        monkeypatch.setenv("MSAL_THREADS", count)
        fresh = dataclasses.replace(mesh)
        results.append(method.denoise(fresh, defaults(method)).vertices)
    assert (results[0] == results[1]).all()
    assert (results[0] == results[2]).all()


def test_vertex_order_does_not_matter(method):
    mesh = scan()
    order = np.random.default_rng(1).permutation(len(mesh.vertices))
    place = np.argsort(order)
    shuffled = prepare_mesh(mesh.vertices[order], place[mesh.faces].astype(np.int32))
    out = method.denoise(mesh, defaults(method)).vertices
    other = method.denoise(shuffled.mesh, defaults(method)).vertices + shuffled.origin
    assert np.allclose(out[order], other, atol=1e-9)


def test_scale_does_not_matter(method):
    mesh = scan()
    out = method.denoise(mesh, defaults(method)).vertices
    small = dataclasses.replace(mesh, vertices=mesh.vertices * 2.0**-20)
    assert np.allclose(
        method.denoise(small, defaults(method)).vertices * 2.0**20, out, rtol=0, atol=1e-9
    )


def test_progress_is_told_after_every_sweep(method):
    if "iterations" not in defaults(method):
        pytest.skip("not iterative")
    told = []
    method.denoise(scan(), defaults(method, iterations=3), lambda *at: told.append(at))
    assert told[-1] == (3, 3)
    assert told == sorted(told)


def test_it_can_be_interrupted(method):
    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        method.denoise(scan(), defaults(method), stop)


def test_zero_iterations_return_the_input(method):
    if "iterations" not in defaults(method):
        pytest.skip("not iterative")
    mesh = scan()
    out = method.denoise(mesh, defaults(method, iterations=0)).vertices
    assert (out == mesh.vertices).all()


@pytest.mark.parametrize("dirt", ["spike", "needle", "fold", "bow-tie", "isolated"])
def test_dirt_is_survived(method, dirt):
    vertices, faces = torus()
    vertices = noisy(vertices, 3, 0.1)
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
    out = method.denoise(ready.mesh, defaults(method)).vertices
    assert np.isfinite(out).all()


def test_parameters_describe_themselves(method):
    assert method.summary
    assert len(method.summary) < 100
    assert method.source
    for spec in method.parameters:
        assert spec.help
        assert spec.choices or spec.more, f"{spec.name}: which way is more?"
        assert spec.validate(spec.default) == spec.default
        assert spec.range_text


def test_symbols_are_names_too():
    msal = methods.find("msal")
    assert msal.validate({"n": "7", "K": "0.25"}) == msal.validate({"iterations": 7, "K": 0.25})


@pytest.mark.parametrize(
    ("given", "part"),
    [
        ({"K": "0"}, "K = 0"),
        ({"K": "1.5"}, "0 < K <= 1"),
        ({"K": "nan"}, "K = nan"),
        ({"K": "half"}, "K = half"),
        ({"iterations": "-1"}, "iterations"),
        ({"iterations": "2.5"}, "iterations"),
        ({"iterations": 2.5}, "iterations"),
        ({"normals": "angle"}, "uniform | area"),
        ({"iteration": "3"}, "did you mean iterations"),
    ],
)
def test_bad_parameters_are_refused(given, part):
    with pytest.raises(UsageError) as caught:
        methods.find("msal").validate(given)
    assert part in f"{caught.value} {caught.value.hint}"


def test_unknown_methods_are_refused():
    with pytest.raises(UsageError) as caught:
        methods.find("msa")
    assert "msal" in caught.value.hint
