"""The part of a mesh that stands for the whole, and what kind of surface it is."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.auto.sample_patch import (
    MACHINED,
    MARGIN,
    ORGANIC,
    PATCH,
    TEXTURED,
    _in_space,
    is_seen_from_one_side,
    select_patch,
    surface_kind,
)
from msal_cli.mesh import Mesh, prepare_mesh
from tests.shapes import ball, box, cube, grid, noisy, torus


@pytest.fixture(scope="module")
def large():
    vertices, faces = torus(250, 120)
    return Mesh(noisy(vertices, 0, 0.01), faces)


def confetti(count):
    """Separate triangles in space, of one size."""
    draw = np.random.default_rng(0)
    corners = draw.uniform(0.0, 100.0, (count, 1, 3)) + draw.normal(size=(count, 3, 3))
    return Mesh(corners.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3))


def places_of(part, mesh):
    """Which vertices of ``mesh`` the part's are."""
    number = {tuple(vertex): at for at, vertex in enumerate(mesh.vertices.tolist())}
    return np.array([number[tuple(vertex)] for vertex in part.mesh.vertices.tolist()])


def test_a_small_mesh_stands_for_itself():
    vertices, faces = torus()
    mesh = Mesh(vertices, faces)
    part = select_patch(mesh, 10_000)
    assert part.mesh is mesh
    assert part.judged.all()
    assert select_patch(mesh, 240).mesh is mesh
    assert len(select_patch(mesh, 220).mesh.vertices) < 288


def test_patches_of_a_large_mesh(large):
    part = select_patch(large, 10_000)
    # Those at the cut that no whole face has are left out.
    assert 0.9 * 10_000 < len(part.mesh.vertices) <= 10_000
    used = np.zeros(len(large.vertices), dtype=bool)
    at = places_of(part, large)
    used[at] = True
    # Judged are those that are more than so many rings from all others.
    far = used.copy()
    rows = np.split(large.topology.ring, large.topology.ring_start[1:-1])
    for _ in range(MARGIN):
        far &= np.array([far[row].all() for row in rows])
    assert (part.judged == far[at]).all()
    assert 0.6 < part.judged.mean() < 0.95
    # Faces are those of the mesh, wound as they were, all that lie inside.
    ours = {tuple(face) for face in at[part.mesh.faces].tolist()}
    theirs = {tuple(face) for face in large.faces.tolist()}
    assert ours <= theirs
    assert len(ours) == len(part.mesh.faces)


def test_it_is_the_same_with_any_number_of_threads_and_at_another_scale(large, monkeypatch):
    first = select_patch(large, 10_000)
    for threads, scale in (("1", 1.0), ("2", 2.0**30)):
        monkeypatch.setenv("MSAL_THREADS", threads)
        again = select_patch(Mesh(scale * large.vertices, large.faces.copy()), 10_000)
        assert (again.mesh.vertices == scale * first.mesh.vertices).all()
        assert (again.mesh.faces == first.mesh.faces).all()
        assert (again.judged == first.judged).all()


def test_confetti_has_parts_of_full_size():
    mesh = confetti(10_000)
    part = select_patch(mesh, 10_000)
    assert 0.99 * 10_000 <= len(part.mesh.vertices) <= 10_000
    assert len(part.mesh.faces) == len(part.mesh.vertices) // 3
    assert part.judged.all()


def test_held_vertices_are_neither_judged_nor_held(large):
    held = np.zeros(len(large.vertices), dtype=bool)
    held[::3] = True
    for mesh in (large, Mesh(*torus(40, 30))):
        some = held[: len(mesh.vertices)]
        part = select_patch(mesh.with_constraints(some, np.ones(len(some))), 10_000)
        assert part.mesh.fixed_vertices is None
        assert part.mesh.trust is None
        assert not (part.judged & some[places_of(part, mesh)]).any()
        assert part.judged.any()


def test_patches_begin_where_somebody_is_judged(large):
    # All but one end is locked.
    held = large.vertices[:, 0] < 3.0
    part = select_patch(large.with_constraints(held, None), 10_000)
    free = int((~held).sum())
    assert part.judged.sum() > 0.5 * min(free, 10_000)
    unmarked = select_patch(large.with_constraints(np.ones_like(held), None), 10_000)
    assert not unmarked.judged.any()
    assert len(unmarked.mesh.faces)


def test_the_order_in_space_halves_the_box_again_and_again():
    steps = np.arange(4.0)
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    draw = np.random.default_rng(0).permutation(len(grid))
    order = grid[draw][_in_space(grid[draw])].astype(int)
    # z decides between halves first, then y, then x; then the same within a half's halves.
    octants = [tuple(place) for place in order[::8] // 2]
    assert octants == [(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
    for first in range(0, len(order), 8):
        assert [tuple(place) for place in order[first : first + 8] % 2] == octants


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


def test_patches_lie_all_over_the_mesh(large):
    part = select_patch(large, 4 * PATCH)
    x, y, _ = part.mesh.vertices.T
    quadrants = {(a > 0, b > 0) for a, b in zip(x.tolist(), y.tolist(), strict=True)}
    assert len(quadrants) == 4


def test_vertices_without_faces_are_no_part_of_it(large):
    stray = np.random.default_rng(0).uniform(-1e6, 1e6, (20_000, 3))
    mesh = Mesh(np.concatenate([stray, large.vertices]), large.faces + len(stray))
    part = select_patch(mesh, 10_000)
    plain = select_patch(large, 10_000)
    assert (part.mesh.vertices == plain.mesh.vertices).all()
    assert (part.judged == plain.judged).all()
    few = Mesh(np.concatenate([stray, torus()[0]]), torus()[1] + len(stray))
    assert len(select_patch(few, 10_000).mesh.vertices) == 288
