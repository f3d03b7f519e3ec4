"""The part of a mesh that stands for the whole, and what kind of surface it is."""

import numpy as np
import pytest

from msal_cli.auto import samples
from msal_cli.mesh import Mesh, prepare_mesh
from tests.shapes import ball, box, grid, noisy, torus


@pytest.fixture(scope="module")
def large():
    vertices, faces = torus(250, 120)
    return Mesh(noisy(vertices, 0, 0.01), faces)


def places_of(part, mesh):
    """Which vertices of ``mesh`` the part's are."""
    number = {tuple(vertex): at for at, vertex in enumerate(mesh.vertices.tolist())}
    return np.array([number[tuple(vertex)] for vertex in part.mesh.vertices.tolist()])


def test_a_small_mesh_stands_for_itself():
    vertices, faces = torus()
    mesh = Mesh(vertices, faces)
    part = samples.select_patch(mesh, 10_000)
    assert part.mesh is mesh
    assert part.judged.all()
    assert samples.select_patch(mesh, 240).mesh is mesh
    assert len(samples.select_patch(mesh, 220).mesh.vertices) < 288


def test_patches_of_a_large_mesh(large):
    part = samples.select_patch(large, 10_000)
    # Those at the cut that no whole face has are left out.
    assert 0.9 * 10_000 < len(part.mesh.vertices) <= 10_000
    used = np.zeros(len(large.vertices), dtype=bool)
    at = places_of(part, large)
    used[at] = True
    # Judged are those that are more than so many rings from all others.
    far = used.copy()
    rows = np.split(large.topology.ring, large.topology.ring_start[1:-1])
    for _ in range(samples.MARGIN):
        far &= np.array([far[row].all() for row in rows])
    assert (part.judged == far[at]).all()
    assert 0.6 < part.judged.mean() < 0.95
    # Faces are those of the mesh, wound as they were, all that lie inside.
    ours = {tuple(face) for face in at[part.mesh.faces].tolist()}
    theirs = {tuple(face) for face in large.faces.tolist()}
    assert ours <= theirs
    assert len(ours) == len(part.mesh.faces)


def test_it_is_the_same_with_any_number_of_threads_and_at_another_scale(large, monkeypatch):
    first = samples.select_patch(large, 10_000)
    for threads, scale in (("1", 1.0), ("2", 2.0**30)):
        monkeypatch.setenv("MSAL_THREADS", threads)
        again = samples.select_patch(Mesh(scale * large.vertices, large.faces.copy()), 10_000)
        assert (again.mesh.vertices == scale * first.mesh.vertices).all()
        assert (again.mesh.faces == first.mesh.faces).all()
        assert (again.judged == first.judged).all()


def test_held_vertices_are_neither_judged_nor_held(large):
    held = np.zeros(len(large.vertices), dtype=bool)
    held[::3] = True
    for mesh in (large, Mesh(*torus(40, 30))):
        some = held[: len(mesh.vertices)]
        part = samples.select_patch(mesh.with_constraints(some, np.ones(len(some))), 10_000)
        assert part.mesh.fixed_vertices is None
        assert part.mesh.trust is None
        assert not (part.judged & some[places_of(part, mesh)]).any()
        assert part.judged.any()


def test_patches_begin_where_somebody_is_judged(large):
    # All but one end is locked.
    held = large.vertices[:, 0] < 3.0
    part = samples.select_patch(large.with_constraints(held, None), 10_000)
    free = int((~held).sum())
    assert part.judged.sum() > 0.5 * min(free, 10_000)
    unmarked = samples.select_patch(large.with_constraints(np.ones_like(held), None), 10_000)
    assert not unmarked.judged.any()
    assert len(unmarked.mesh.faces)


CUBE = prepare_mesh(*box(8, 8, 8)).mesh
SLAB = prepare_mesh(box(16, 16, 16)[0] * [1.0, 1.0, 0.2], box(16, 16, 16)[1]).mesh


def prism(sides=6, rows=12):
    """An open prism with many rows."""
    vertices, faces = grid(rows, sides * 8 + 1)
    angle, corner = 2 * np.pi * (vertices[:, 0] % (sides * 8)) / (sides * 8), np.pi / sides
    radius = np.cos(corner) / np.cos(angle % (2 * corner) - corner)
    places = radius * np.cos(angle), radius * np.sin(angle), 0.2 * vertices[:, 1]
    return prepare_mesh(np.stack(places, axis=1), faces).mesh


def bumpy(height):
    """A sphere with waves as fine as its mesh."""
    vertices, faces = ball(96, 48)
    waves = np.sin(25.0 * vertices[:, :1]) * np.sin(25.0 * vertices[:, 1:2])
    return Mesh(vertices * (1.0 + height * waves), faces)


@pytest.mark.parametrize(
    "mesh", [CUBE, SLAB, prism(), prism(4)], ids=["cube", "slab", "hexagon", "square"]
)
def test_flat_parts_between_sharp_edges_are_machined(mesh):
    assert samples.surface_kind(mesh) == samples.MACHINED


@pytest.mark.parametrize("shape", [ball(96, 48), torus(96, 48), grid()])
def test_smooth_ones_are_organic(shape):
    assert samples.surface_kind(Mesh(*shape)) == samples.ORGANIC


def test_a_scan_from_one_side_is_open_and_faces_one_way():
    assert samples.is_seen_from_one_side(Mesh(*grid()))
    assert not samples.is_seen_from_one_side(Mesh(*ball(96, 48)))
    assert not samples.is_seen_from_one_side(prism())


def test_bumps_are_texture():
    assert samples.surface_kind(bumpy(0.02)) == samples.TEXTURED
    assert samples.surface_kind(bumpy(0.0005)) == samples.ORGANIC


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e9])
def test_it_is_free_of_scale(scale):
    for mesh in (CUBE, bumpy(0.02), Mesh(*ball())):
        assert samples.surface_kind(
            mesh.with_vertices(mesh.vertices * scale)
        ) == samples.surface_kind(mesh)
