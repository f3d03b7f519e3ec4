"""The clean training meshes: sound, true to their surfaces, and the same for the same seed."""

import numpy as np
import pytest

pytest.importorskip("manifold3d")
pytest.importorskip("skimage")
pytest.importorskip("fast_simplification")
pytest.importorskip("fcpw")

from manifold3d import Manifold

from training import designs, solids, triangulations
from training.connectivity import build_edges, edge_lengths, face_crosses, shape_quality, to_unit
from training.shapes import RECIPES, Recipe, build_shape
from training.surface import LabelledMesh, PolyhedralSurface

pytestmark = pytest.mark.ci

SOME = (0, 4, 8, 11)
"""Recipes of the quick set, of several triangulations."""


@pytest.fixture(scope="module")
def some_shapes() -> list[tuple[Recipe, LabelledMesh]]:
    return [
        (RECIPES[k], build_shape(RECIPES[k], np.random.default_rng([7, k]), 0.12)) for k in SOME
    ]


@pytest.fixture(scope="module")
def notched_cube() -> LabelledMesh:
    """A cube of side 2 with a notch: every point of an edge has two coordinates of a few values."""
    notch = Manifold.cube((1.0, 1.0, 4.0), True).translate((1.0, 1.0, 0.0))
    return solids.to_labelled_mesh(Manifold.cube((2.0, 2.0, 2.0), True) - notch)


def test_shapes_are_sound_meshes(some_shapes):
    for recipe, mesh in some_shapes:
        name, vertices, faces = recipe.name, mesh.vertices, mesh.faces
        assert np.isfinite(vertices).all(), name
        assert np.array_equal(np.unique(faces), np.arange(len(vertices))), name
        # No edge has three faces, and all faces are wound alike: build_edges raises otherwise.
        edges = build_edges(faces, len(vertices))
        assert edges.is_boundary.any() != recipe.is_closed, name
        assert len(np.unique(np.sort(faces, axis=1), axis=0)) == len(faces), name
        assert shape_quality(vertices, faces).min() > 1e-3, name
        assert edge_lengths(vertices, edges.ends).mean() == pytest.approx(1.0), name
        assert len(np.unique(vertices, axis=0)) == len(vertices), name


@pytest.mark.parametrize(
    "name", ["isotropic", "graded", "adaptive", "scattered", "subdivided", "jagged"]
)
def test_triangulations_keep_sharp_edges_exact(notched_cube, name):
    surface = PolyhedralSurface(notched_cube)
    make = getattr(triangulations, f"make_{name}")
    mesh = make(notched_cube, surface, 500, np.random.default_rng(5))
    assert 250 < len(mesh.vertices) < 1300
    # All faces are flat to the sides' planes, so none cuts an edge off.
    normals = to_unit(face_crosses(mesh.vertices, mesh.faces))
    assert np.abs(np.abs(normals).max(axis=1) - 1.0).max() < 1e-9
    planes = np.array([-1.0, 0.5, 1.0])
    gap = np.abs(mesh.vertices[:, :, None] - planes).min(axis=2).min(axis=1)
    assert gap.max() < 1e-9
    areas = np.linalg.norm(face_crosses(mesh.vertices, mesh.faces), axis=1) / 2.0
    assert areas.sum() == pytest.approx(6 * 4 - 2 * 0.25, rel=1e-9)


def test_an_assembly_leaves_out_designs_without_faces(monkeypatch):
    triangle = np.eye(3), np.array([[0, 1, 2]])
    nothing = np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    parts = iter([triangle, nothing, triangle, nothing])
    monkeypatch.setattr(designs, "MAKERS", {lambda _: next(parts): 1.0})
    points, faces = designs.make_assembly(np.random.default_rng(1))
    assert len(points) and sorted(faces.reshape(-1)) == list(range(len(points)))
