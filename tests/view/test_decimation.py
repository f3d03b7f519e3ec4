"""Fewer faces: as many as asked for, between vertices of the file, on the same surface."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.view.scene import coarsen
from tests.shapes import cube, grid, noisy, torus


def areas(vertices, faces):
    corner = vertices[faces]
    doubled = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return np.linalg.norm(doubled, axis=1) / 2


def test_few_faces_stay_as_they_are():
    vertices, faces = torus()
    coarse = coarsen(vertices, faces, len(faces))
    assert np.array_equal(coarse.kept[coarse.faces], faces)


def test_vertices_without_a_face_are_left_out():
    vertices, faces = cube()
    coarse = coarsen(np.concatenate([[[9.0, 9, 9]], vertices]), faces + 1, 100)
    assert np.array_equal(coarse.kept, np.arange(1, 9))


@pytest.mark.parametrize("level", [0.0, 0.1, 3.0])
@pytest.mark.parametrize("most", [2000, 600])
def test_as_many_faces_as_asked_for(level, most):
    vertices, faces = torus(60, 40)
    vertices = noisy(vertices, level=level) if level else vertices
    coarse = coarsen(vertices, faces, most)
    assert 0.7 * most < len(coarse.faces) <= most
    assert np.array_equal(np.unique(coarse.faces), np.arange(len(coarse.kept)))
    assert len(np.unique(np.sort(coarse.faces, axis=1), axis=0)) == len(coarse.faces)
    assert (np.diff(np.sort(coarse.faces, axis=1), axis=1) > 0).all()


def test_the_surface_stays_where_it_is_and_faces_outwards():
    vertices, faces = torus(120, 60)
    coarse = coarsen(vertices, faces, 3000)
    corner = vertices[coarse.kept][coarse.faces]
    volume = np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6
    assert volume == pytest.approx(2 * np.pi**2 * 3.0, rel=0.02)
    assert areas(vertices[coarse.kept], coarse.faces).sum() == pytest.approx(
        4 * np.pi**2 * 3.0, rel=0.02
    )


def test_the_boundary_does_not_move_inwards():
    vertices, faces = grid(40, 40)
    vertices = vertices * [1.0, 1.0, 0.0]
    coarse = coarsen(vertices, faces, 800)
    assert len(coarse.faces) <= 800
    full = areas(vertices, faces).sum()
    assert areas(vertices[coarse.kept], coarse.faces).sum() == pytest.approx(full, rel=0.03)


def test_a_number_that_cannot_be_reached_ends():
    vertices, faces = cube()
    assert len(coarsen(vertices, faces, 1).faces) < len(faces)
