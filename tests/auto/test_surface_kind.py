"""What kind of surface a mesh is."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.auto.sample_patch import (
    MACHINED,
    ORGANIC,
    TEXTURED,
    is_seen_from_one_side,
    surface_kind,
)
from msal_cli.mesh import Mesh, prepare_mesh
from tests.shapes import ball, box, cube, grid, torus

CUBE = prepare_mesh(*box(8, 8, 8)).mesh
SLAB = prepare_mesh(box(16, 16, 16)[0] * [1.0, 1.0, 0.2], box(16, 16, 16)[1]).mesh


def prism(sides=6, rows=12):
    """An open six-sided prism with many rows."""
    angle = 2 * np.pi * np.arange(sides * 8) / (sides * 8)
    corner = np.pi / sides
    radius = np.cos(corner) / np.cos(angle % (2 * corner) - corner)
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    count = len(ring)
    vertices = np.concatenate(
        [np.column_stack([ring, np.full(count, 0.2 * row)]) for row in range(rows)]
    )
    k = np.arange(count)
    faces = []
    for row in range(rows - 1):
        a, b = row * count + k, row * count + (k + 1) % count
        faces += [np.column_stack([a, b, b + count]), np.column_stack([a, b + count, a + count])]
    return Mesh(vertices, np.concatenate(faces).astype(np.int32))


def bumpy(height):
    """A sphere with waves as fine as its mesh."""
    vertices, faces = ball(96, 48)
    waves = np.sin(25.0 * vertices[:, :1]) * np.sin(25.0 * vertices[:, 1:2])
    return Mesh(vertices * (1.0 + height * waves), faces)


@pytest.mark.parametrize(
    "mesh", [CUBE, SLAB, prism(), prism(4)], ids=["cube", "slab", "hexagon", "square"]
)
def test_flat_parts_between_sharp_edges_are_machined(mesh):
    assert surface_kind(mesh) == MACHINED


@pytest.mark.parametrize("shape", [ball(96, 48), torus(96, 48), grid()])
def test_smooth_ones_are_organic(shape):
    assert surface_kind(Mesh(*shape)) == ORGANIC


def test_a_scan_from_one_side_is_open_and_faces_one_way():
    assert is_seen_from_one_side(Mesh(*grid()))
    assert not is_seen_from_one_side(Mesh(*ball(96, 48)))
    assert not is_seen_from_one_side(prism())


def test_bumps_are_texture():
    assert surface_kind(bumpy(0.02)) == TEXTURED
    assert surface_kind(bumpy(0.0005)) == ORGANIC


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e9])
def test_it_is_free_of_scale(scale):
    for mesh in (CUBE, bumpy(0.02), Mesh(*ball())):
        assert surface_kind(mesh.with_vertices(mesh.vertices * scale)) == surface_kind(mesh)


def test_few_or_no_edges_between_faces():
    single = Mesh(np.eye(3), np.array([[0, 1, 2]], dtype=np.int32))
    assert surface_kind(single) == ORGANIC
    flat = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]), single.faces)
    assert surface_kind(flat) == ORGANIC
    # Every edge of a coarse cube is an edge: nothing smooth lies between.
    assert surface_kind(Mesh(*cube())) == TEXTURED
