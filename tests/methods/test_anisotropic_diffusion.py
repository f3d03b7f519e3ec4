"""Anisotropic diffusion: identities, a literal twin, and measured figures."""

import functools

import numpy as np
import pytest

from msal_cli.kernels.curvature import edge_curvatures
from msal_cli.kernels.faces import flaps
from msal_cli.kernels.geometry import area_and_volume
from msal_cli.mesh import prepare_mesh
from tests.methods.plain_normals import edge_faces
from tests.methods.runs import assert_twin, denoise, free_vertices, scan, small_scan
from tests.shapes import box

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
