"""The hybrid filter: against a plain twin, on edges, rims and flats, and on real pairs."""

import functools

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.mesh import prepare_mesh
from tests import paper
from tests.methods import runs
from tests.shapes import cube, noisy, roof


def result(vertices, faces, **given):
    ready = prepare_mesh(vertices, faces)
    method = methods.find("hybrid")
    return ready, method.denoise(ready.mesh, method.validate(given))


run = functools.partial(runs.run_in_file, "hybrid")


def lloyd(values, count):
    """K-means from the middle values of ``count`` equal parts, by the slowest means."""
    order = sorted(values)
    centres = [order[(2 * j + 1) * len(order) // (2 * count)] for j in range(count)]
    while True:
        label = [min(range(count), key=lambda j, x=x: (abs(x - centres[j]), j)) for x in values]
        mine = [[x for x, at in zip(values, label, strict=True) if at == j] for j in range(count)]
        moved = [np.mean(m) if m else c for m, c in zip(mine, centres, strict=True)]
        if np.allclose(moved, centres, rtol=0, atol=1e-13):
            return np.array(label)
        centres = moved


def twin(v, faces, sweeps, presmooth=3, count=3, angle=25.0, K=0.5, r=0.25, rim=frozenset()):
    """The method's description, vertex by vertex; also which vertices are features."""
    rings = paper.one_rings(len(v), faces)
    first = min(presmooth, sweeps)
    x = paper.algorithm_1(v, faces, first, None, 1)
    n = paper.normal_field(x, faces, 0)
    s = np.zeros(len(v))
    for i in range(len(v)):
        around = x[faces[(faces == i).any(axis=1)]]
        crossed = np.cross(around[:, 1] - around[:, 0], around[:, 2] - around[:, 0])
        unit = crossed / np.linalg.norm(crossed, axis=1)[:, None]
        s[i] = np.mean(1 - unit @ n[i])
    label = lloyd(np.log(np.maximum(s, 1e-6)).tolist(), count)
    highest = (label == count - 1) & (s > 1 - np.cos(np.radians(angle) / 2))
    feature = np.array([highest[i] and highest[rings[i]].any() for i in range(len(v))])
    x[feature] = paper.algorithm_1(v, faces, first, K, 1)[feature]
    for j in range(sweeps - first):
        n = paper.normal_field(x, faces, 0)
        U = np.array([np.mean(x[ring] - x[i], axis=0) for i, ring in enumerate(rings)])
        u = (U * n).sum(axis=1)
        out = x.copy()
        for i, ring in enumerate(rings):
            if feature[i]:
                out[i] += K**j * np.mean([n[k] * ((x[k] - x[i]) @ n[k]) for k in ring], axis=0)
            else:
                t = np.zeros(3) if i in rim else U[i] - u[i] * n[i]
                out[i] += 0.5 * (u[i] - 0.5 * np.mean(u[ring])) * n[i] + 0.5 * r * t
        x = out
    return x, feature


SHAPES = {
    "torus": runs.SHAPES["torus"],
    "roof": (noisy(roof(7, 7, 0.7)[0], 2, 0.1), roof(7, 7, 0.7)[1]),
    "cube": (noisy(cube()[0], 3, 0.02), cube()[1]),
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    "given",
    [
        {},
        {"K": 0.8, "r": 0.0},
        {"count": 2, "angle": 0.0, "r": 1.0},
        {"presmooth": 1, "angle": 40.0},
    ],
    ids=str,
)
def test_it_does_what_it_says(shape, given):
    vertices, faces = SHAPES[shape]
    mesh = prepare_mesh(vertices, faces).mesh
    rim = set(np.flatnonzero(mesh.topology.boundary).tolist())
    expected, feature = twin(vertices, faces, 6, rim=rim, **given)
    names = {"count": "clusters", "angle": "crease_angle_deg", "r": "regularize"}
    ready, out = result(vertices, faces, **{names.get(k, k): x for k, x in given.items()})
    assert (out.fields["feature"] == feature).all()
    size = np.ptp(vertices, axis=0).max()
    assert np.abs(out.vertices + ready.origin - expected).max() <= 1e-12 * size


def test_vertices_whose_normal_cannot_be_told_stay():
    # A disk folded flat along x through its middle, vertex 0: two of its faces look up, two down.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.2, 1, 0], [-1, 0, 0], [-0.2, 1, 0]], dtype=float)
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]], dtype=np.int32)
    mesh = prepare_mesh(vertices, faces).mesh
    assert not mesh.topology.boundary[0]
    assert (mesh.vertex_normals()[0] == 0).all()
    assert (run(vertices, faces, regularize=1.0)[0] == vertices[0]).all()
