"""Anisotropic diffusion and the hybrid filter: literal twins, identities, edges and flats."""

import functools

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.kernels.curvature import edge_curvatures
from msal_cli.kernels.faces import flaps
from msal_cli.kernels.geometry import area_and_volume
from msal_cli.mesh import prepare_mesh
from tests import paper
from tests.methods import runs
from tests.methods.plain_normals import edge_faces, normals_and_areas
from tests.methods.runs import assert_twin, denoise, free_vertices, scan, small_scan
from tests.shapes import box, cube, noisy, roof

diffused = functools.partial(denoise, "anisotropic_diffusion")


def twin(mesh, variant, tau, iterations, threshold, r, free):
    """Vertex by vertex, from the formulas; the step's limit of stability left out."""
    x = mesh.vertices.copy()
    faces = mesh.faces
    edges = {edge: two for edge, two in edge_faces(faces).items() if len(two) == 2}
    n = len(x)
    lam = threshold * mesh.mean_edge_length
    for _ in range(iterations):
        cross = np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])
        areas = np.linalg.norm(cross, axis=1) / 2
        normals = cross / (2 * areas[:, None])
        mass, volume = np.zeros(n), np.zeros((n, 3))
        for f, face in enumerate(faces):
            mass[face] += areas[f] / 3
            volume[face] += cross[f] / 6
        curvature, feature = np.zeros((n, 3)), np.zeros(n, dtype=bool)
        ring = [[] for _ in range(n)]
        for (i, k), (f, g) in edges.items():
            length = np.linalg.norm(x[k] - x[i])
            angle = np.arccos(np.clip(normals[f] @ normals[g], -1, 1))
            both = normals[f] + normals[g]
            inward = x[next(p for p in faces[g] if p not in (i, k))] - x[i]
            sign = -np.sign(inward @ normals[f])  # convex: the other face falls away
            size = 2 * length * np.sin(angle / 2)
            w = 1.0 if size <= lam else lam**2 / (r * (lam - size) ** 2 + lam**2)
            vector = sign * size * both / np.linalg.norm(both)
            for p, q in ((i, k), (k, i)):
                curvature[p] += w * vector / 2
                feature[p] |= size > lam
                ring[p].append(q)
        pull = np.zeros((n, 3))
        if variant == "pmc":
            along = volume.copy()
            for p in np.flatnonzero(feature):
                mean = (curvature[p] + curvature[ring[p]].mean(axis=0)) / 2
                unit = mean / np.linalg.norm(mean)
                along[p] = np.sign(unit @ volume[p]) * np.linalg.norm(volume[p]) * unit
            length = np.linalg.norm(along, axis=1)
            f = (curvature * along).sum(axis=1) / length**2
            for p in range(n):
                beside = [q for q in ring[p] if feature[q] or not feature[p]]
                if beside:
                    pull[p] = np.average(f[beside], weights=length[beside]) * along[p]
        move = -(tau * mesh.mean_edge_length**2 / mass)[:, None] * (curvature - pull)
        x = np.where(free[:, None], x + move, x)
    return x


@pytest.mark.parametrize("variant", ["amc", "pmc"])
@pytest.mark.parametrize(
    ("shape", "boundary"), [("torus", "fixed"), ("grid", "fixed"), ("grid", "free")]
)
@pytest.mark.parametrize(("threshold", "falloff"), [(0.3, 10.0), (0.15, 3.0), (5.0, 10.0)])
def test_it_agrees_with_the_literal_twin(variant, shape, boundary, threshold, falloff):
    mesh = small_scan(shape)
    free = free_vertices(mesh, boundary)
    given = {"variant": variant, "boundary": boundary, "threshold": threshold, "falloff": falloff}
    found = diffused(mesh, time_step=0.01, iterations=3, **given)
    expected = twin(mesh, variant, 0.01, 3, threshold, falloff, free)
    # Angles by arccos lose half the digits where faces are flat, which the noise prevents.
    assert_twin(mesh, found, expected)


def test_the_automatic_threshold_is_that_by_hand():
    mesh = scan()
    lengths = np.linalg.norm(
        edge_curvatures(mesh.vertices, flaps(mesh.faces, mesh.topology))[0], axis=1
    )
    middle = np.median(lengths)
    spread = np.median(np.abs(lengths - middle))
    for shape, height in (("cad", middle), ("organic", middle + 1.4826 * spread)):
        by_itself = diffused(mesh, shape=shape)
        by_hand = diffused(mesh, threshold=height / mesh.mean_edge_length)
        assert np.abs(by_itself - by_hand).max() < 1e-9
    assert np.abs(diffused(mesh, shape="cad") - diffused(mesh, shape="organic")).max() > 0.01


def test_a_clean_box_is_left_alone():
    vertices, faces = box(6, 6, 6)
    mesh = prepare_mesh(vertices, faces).mesh
    assert (diffused(mesh) == mesh.vertices).all()


@pytest.mark.parametrize("variant", ["amc", "pmc"])
def test_no_time_step_is_too_long(variant):
    mesh = scan(level=0.2)
    moved = diffused(mesh, variant=variant, time_step=1000.0, iterations=60)
    before, _ = area_and_volume(mesh.vertices, mesh.faces)
    assert area_and_volume(moved, mesh.faces)[0] < before
    assert np.abs(moved).max() < 1.05 * np.abs(mesh.vertices).max()


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


def hybrid_twin(v, faces, sweeps, presmooth=3, count=3, angle=25.0, K=0.5, r=0.25, rim=frozenset()):
    """The method's description, vertex by vertex; also which vertices are features."""
    rings = paper.one_rings(len(v), faces)
    first = min(presmooth, sweeps)
    x = paper.algorithm_1(v, faces, first, None, 1)
    n = paper.normal_field(x, faces, 0)
    of_faces, _ = normals_and_areas(x, faces)
    s = np.array([np.mean(1 - of_faces[(faces == i).any(axis=1)] @ n[i]) for i in range(len(v))])
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


HYBRID_SHAPES = {
    "torus": runs.SHAPES["torus"],
    "roof": (noisy(roof(7, 7, 0.7)[0], 2, 0.1), roof(7, 7, 0.7)[1]),
    "cube": (noisy(cube()[0], 3, 0.02), cube()[1]),
}


@pytest.mark.parametrize("shape", HYBRID_SHAPES)
@pytest.mark.parametrize(
    "given",
    [{}, {"K": 0.8, "r": 0.0}, {"count": 2, "angle": 0.0, "r": 1.0}]
    + [{"presmooth": 1, "angle": 40.0}],
    ids=str,
)
def test_it_does_what_it_says(shape, given):
    vertices, faces = HYBRID_SHAPES[shape]
    mesh = prepare_mesh(vertices, faces).mesh
    rim = set(np.flatnonzero(mesh.topology.boundary).tolist())
    expected, feature = hybrid_twin(vertices, faces, 6, rim=rim, **given)
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
