"""Parts of a mesh with their halos, against the whole mesh: the same bits at the own vertices."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.errors import InternalError, TooLargeError
from msal_cli.kernels.operators import AnisotropicLaplacian
from msal_cli.mesh import Mesh, prepare_mesh
from msal_cli.methods import guided_normal
from tests import shapes
from tests.methods.parts import run_in_parts


def closed_mesh(seed=0, around=100, across=9):
    """A noisy torus, with vertices and faces in no order."""
    vertices, faces = shapes.torus(around, across)
    return shuffled(shapes.noisy(vertices, seed), faces, seed)


def open_mesh(seed=0, rows=60, columns=16):
    """A noisy bent sheet with a hole, an edge of three faces and a hub."""
    vertices, faces = shapes.grid(rows, columns)
    vertices[:, 2] = 3 * np.sin(vertices[:, 0] / 3)
    middle = vertices[faces].mean(axis=1)
    faces = faces[np.hypot(middle[:, 0] - 8, middle[:, 1] - 30) > 3]
    at = 5 * columns + 5
    fin = np.array([[5.5, 5.0, 4.0], [4.0, 9.0, 9.0]])
    n = len(vertices)
    faces = np.concatenate([faces, [[at, at + 1, n], [at, n, n + 1]]]).astype(np.int32)
    return shuffled(shapes.noisy(np.concatenate([vertices, fin]), seed), faces, seed)


def shuffled(vertices, faces, seed):
    generator = np.random.default_rng(seed)
    order = generator.permutation(len(vertices))
    number = np.argsort(order).astype(np.int32)
    faces = number[faces][generator.permutation(len(faces))]
    return prepare_mesh(vertices[order], faces).mesh


MESHES = {"closed": closed_mesh(), "open": open_mesh()}

AUTO = {"iterations": 1, "vertex_iterations": 3, "sliding": "auto"}
CASES = [
    ("al", {}),
    ("al", {"iterations": 0}),
    ("al", {"mollify": 0, "iterations": 1}),
    ("al", {"mollify": 3, "normals": "area", "boundary": "fixed"}),
    ("al", {"schedule": "constant"}),
    ("al", {"schedule": "multiscale"}),
    ("al", {"schedule": "robust", "quantile": 0.9}),
    ("al", {"schedule": "wiener", "noise": 0.1}),
    ("al", {"weights": "tukey", "schedule": "multiscale"}),
    ("al", {"weights": "lorentz", "deviation": "median", "schedule": "robust"}),
    ("al", {"scaling": "mass", "iterations": 6}),
    ("al", {"scaling": "edge", "weights": "huber", "schedule": "wiener", "noise": 0.2}),
    ("msal", {}),
    ("msal", {"iterations": 2, "K": 0.8, "boundary": "fixed"}),
    ("msal", {"schedule": "robust"}),
    ("msal", {"schedule": "wiener", "noise": 0.1}),
    ("msal", {"weights": "none", "deviation": "median"}),
    ("bilateral", {}),
    ("bilateral", {"closeness": 0.5, "similarity": 0.5, "schedule": "multiscale"}),
    ("umbrella", {}),
    ("umbrella", {"boundary": "free", "schedule": "multiscale", "mollify": 2}),
    ("umbrella", {"boundary": "fixed", "schedule": "wiener", "noise": 0.1, "iterations": 1}),
    ("umbrella", {"schedule": "robust", "mollify": 0}),
    ("scale_dependent_umbrella", {}),
    ("scale_dependent_umbrella", {"schedule": "constant", "boundary": "free"}),
    ("taubin", {"iterations": 4}),
    ("taubin", {"iterations": 2, "boundary": "free"}),
    ("hc", {"iterations": 3}),
    ("hc", {"iterations": 2, "boundary": "fixed"}),
    ("windowed_sinc", {"iterations": 7}),
    ("mean_curvature_flow", {"variant": "explicit", "iterations": 3}),
    ("mean_curvature_flow", {"variant": "explicit", "areas": "ring", "boundary": "free"}),
    ("mean_curvature_flow", {"variant": "explicit", "schedule": "robust"}),
    ("anisotropic_diffusion", {"iterations": 3}),
    ("anisotropic_diffusion", {"iterations": 4, "variant": "amc", "shape": "organic"}),
    ("anisotropic_diffusion", {"iterations": 2, "schedule": "multiscale", "boundary": "free"}),
    ("normal_threshold", {"iterations": 2, "vertex_iterations": 3}),
    ("normal_threshold", {"iterations": 7, "vertex_iterations": 2, "neighbours": "edge"}),
    ("bilateral_normal", {"iterations": 3, "vertex_iterations": 2}),
    ("bilateral_normal", {"iterations": 2, "vertex_iterations": 2, "sliding": "undone"}),
    ("bilateral_normal", {"iterations": 6, "vertex_iterations": 1, "neighbours": "edge"}),
    ("bilateral_normal", AUTO),
    ("normal_diffusion", {"iterations": 2, "normal_iterations": 3, "vertex_iterations": 2}),
    (
        "normal_diffusion",
        {"iterations": 1, "normal_iterations": 4, "sliding": "undone", "boundary": "free"},
    ),
    ("normal_diffusion", {"iterations": 1, "normal_iterations": 1, "similarity": 0.5}),
    ("wiener", {"noise": 0.1, "iterations": 2, "mollify": 1}),
    ("wiener", {"noise": 0.1, "iterations": 1, "normal_iterations": 0, "mollify": 0}),
    ("guided_normal", {"iterations": 3, "vertex_iterations": 3}),
    ("guided_normal", {"iterations": 2, "vertex_iterations": 2, "sliding": "undone"}),
    ("blend", {"members": "0.7*al(iterations=2)"}),
    ("blend", {"members": "1*msal(iterations=2)", "relax": 2}),
    ("blend", {"members": "0.5*guided_normal(iterations=2)+0.3*msal", "relax": 1}),
    ("blend", {"members": "0.4*msal(schedule=robust)+0.2*msal(iterations=2)+0.4*taubin"}),
]


def describe(case):
    name, given = case
    return "-".join([name, *(f"{word}={value}" for word, value in given.items())])


@pytest.mark.parametrize("case", CASES, ids=describe)
@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES.keys())
def test_parts_give_the_bits_of_the_whole(mesh, case):
    name, given = case
    method = methods.find(name)
    parameters = method.validate(given)
    rings = method.reach(parameters)
    whole = method.denoise(mesh, parameters)
    vertices, fields, _ = run_in_parts(method, mesh, parameters, rings)
    assert vertices.tobytes() == whole.vertices.tobytes()
    assert fields.keys() == whole.fields.keys()
    for field, values in fields.items():
        assert values.tobytes() == whole.fields[field].tobytes(), field


LOOSE = [("al", {"iterations": 0}), ("bilateral_normal", AUTO)]
TIGHT = [case for case in CASES if case not in LOOSE and case[0] not in ("guided_normal", "blend")]
"""Those whose reach is the least that there is; noise in all directions is not undone."""


@pytest.mark.parametrize("case", TIGHT, ids=describe)
def test_a_ring_less_is_not_enough(case):
    """Otherwise the test above could not fail."""
    name, given = case
    method = methods.find(name)
    parameters = method.validate(given)
    rings = method.reach(parameters)
    differs = False
    for mesh in MESHES.values():
        whole = method.denoise(mesh, parameters)
        vertices, _, _ = run_in_parts(method, mesh, parameters, rings - 1)
        differs |= vertices.tobytes() != whole.vertices.tobytes()
    assert differs


def test_faces_near_one_are_within_the_halo(monkeypatch):
    """One ring is enough for the faces near one on the open mesh, and not on the closed one."""
    monkeypatch.setattr(guided_normal, "NEAR_RINGS", 1)
    method = methods.find("guided_normal")
    parameters = method.validate({"iterations": 2, "vertex_iterations": 2})
    rings = method.reach(parameters)
    whole = method.denoise(MESHES["open"], parameters).vertices
    enough, less = (
        run_in_parts(method, MESHES["open"], parameters, count)[0] for count in (rings, rings - 1)
    )
    assert enough.tobytes() == whole.tobytes() != less.tobytes()
    with pytest.raises(TooLargeError, match="uneven"):
        run_in_parts(method, MESHES["closed"], parameters, rings)


def test_sliding_is_measured_over_all_parts():
    """Noise along the normals alone, which ``auto`` finds, and undoes the sliding."""
    vertices, faces = shapes.torus(100, 9)
    smooth = Mesh(vertices, faces)
    noise = np.random.default_rng(4).normal(scale=0.05, size=(len(vertices), 1))
    mesh = shuffled(vertices + noise * smooth.vertex_normals(), faces, 4)
    method = methods.find("bilateral_normal")
    kept, undone, auto = (
        method.denoise(mesh, method.validate({**AUTO, "sliding": sliding})).vertices
        for sliding in ("kept", "undone", "auto")
    )
    assert auto.tobytes() == undone.tobytes() != kept.tobytes()
    parameters = method.validate(AUTO)
    vertices, _, _ = run_in_parts(method, mesh, parameters, method.reach(parameters))
    assert vertices.tobytes() == auto.tobytes()


def soup(seed):
    """Random triangles between vertices that are near in the order: edges of any kind."""
    generator = np.random.default_rng(seed)
    n = int(generator.integers(30, 200))
    vertices = generator.normal(size=(n, 3))
    again = generator.integers(0, n, 5)
    vertices[again] = vertices[again[::-1]]
    first = generator.integers(0, n, 3 * n)
    others = first[:, None] + generator.integers(1, 7, (3 * n, 2))
    faces = np.column_stack([first, others % n]).astype(np.int32)
    return prepare_mesh(vertices, faces).mesh


@pytest.mark.parametrize("case", CASES, ids=describe)
def test_parts_of_a_soup(case):
    name, given = case
    method = methods.find(name)
    parameters = method.validate(given)
    rings = method.reach(parameters)
    for seed in range(3):
        mesh = soup(seed)
        whole = method.denoise(mesh, parameters)
        vertices, _, _ = run_in_parts(method, mesh, parameters, rings, count=2 + seed)
        assert vertices.tobytes() == whole.vertices.tobytes()


def constrained(mesh):
    """The mesh with vertices that are fixed, and others that are trusted more or less."""
    generator = np.random.default_rng(3)
    n = len(mesh.vertices)
    return mesh.with_constraints(generator.random(n) < 0.1, generator.random(n))


@pytest.mark.parametrize("case", CASES[::3], ids=describe)
def test_parts_keep_constraints(case):
    name, given = case
    method = methods.find(name)
    parameters = method.validate(given)
    mesh = constrained(MESHES["open"])
    whole = method.denoise(mesh, parameters)
    vertices, _, _ = run_in_parts(method, mesh, parameters, method.reach(parameters), count=2)
    assert vertices.tobytes() == whole.vertices.tobytes()


def test_a_sweep_is_not_done_twice(monkeypatch):
    measured = []
    measure = AnisotropicLaplacian.measure

    def count(self, positions, heights, sigma):
        measured.append(len(positions))
        return measure(self, positions, heights, sigma)

    monkeypatch.setattr(AnisotropicLaplacian, "measure", count)
    method = methods.find("msal")
    parameters = method.validate({"schedule": "robust", "iterations": 4})
    _, _, rounds = run_in_parts(method, MESHES["open"], parameters, method.reach(parameters))
    assert len(measured) == 3 * 4
    # The mean edge length, and two rounds for the quantile of each sweep.
    assert rounds == 1 + 2 * 4 + 1


WHOLE = [
    ("bilateral", {"variant": "fleishman"}),
    ("bilateral_non_iterative", {}),
    ("mean_curvature_flow", {}),
    ("mean_curvature_flow", {"variant": "explicit", "volume": "restore"}),
    ("l0", {}),
    ("static_dynamic", {}),
    ("blend", {"members": "0.5*al+0.5*l0"}),
    ("blend", {"members": "0.5:0.2*al", "levels": "0.1:0.2"}),
    ("bilateral_normal", {"variant": "global"}),
]


@pytest.mark.parametrize("case", WHOLE, ids=describe)
def test_these_need_the_whole_mesh(case):
    name, given = case
    method = methods.find(name)
    assert method.reach(method.validate(given)) is None


@pytest.mark.parametrize("name", ["al", "msal"])
def test_noise_is_not_estimated_on_a_part(name):
    method = methods.find(name)
    parameters = method.validate({"schedule": "wiener"})
    with pytest.raises(InternalError, match="noise of a part"):
        run_in_parts(method, MESHES["open"], parameters, 30, count=2)
