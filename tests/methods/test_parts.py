"""Parts of a mesh with their halos, against the whole mesh: the same bits at the own vertices."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.mesh import prepare_mesh
from tests import shapes
from tests.methods.parts import run_in_parts


def closed_mesh(seed=0, around=48, across=20):
    """A noisy torus, with vertices and faces in no order."""
    vertices, faces = shapes.torus(around, across)
    return shuffled(shapes.noisy(vertices, seed), faces, seed)


def open_mesh(seed=0, rows=36, columns=22):
    """A noisy bent sheet with a hole, an edge of three faces and a hub."""
    vertices, faces = shapes.grid(rows, columns)
    vertices[:, 2] = 3 * np.sin(vertices[:, 0] / 3)
    middle = vertices[faces].mean(axis=1)
    faces = faces[np.hypot(middle[:, 0] - 10, middle[:, 1] - 18) > 3]
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


TIGHT = [case for case in CASES if case[1].get("iterations") != 0]


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
