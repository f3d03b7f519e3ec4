"""The gate: what is refused, what is put aside, and the way back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli import mesh
from msal_cli.errors import TooLargeError
from msal_cli.kernels import spatial_order
from msal_cli.mesh import MAX_FACES, cached_by_mesh, prepare_mesh
from tests.shapes import cube, grid, noisy, torus


def soup(vertices, faces):
    """Every corner its own vertex."""
    return vertices[faces.reshape(-1)], np.arange(faces.size, dtype=np.int32).reshape(-1, 3)


def wound(faces):
    """Faces with their lowest corner first, in order."""
    return sorted(tuple(np.roll(face, -face.argmin()).tolist()) for face in faces)


@pytest.mark.parametrize("is_renumbered", [False, True])
@given(seed=st.integers(0, 10**6), as_soup=st.booleans(), loose=st.integers(0, 5))
def test_the_way_back(is_renumbered, seed, as_soup, loose):
    vertices, faces = torus(7, 5)
    vertices = noisy(vertices, seed, 0.2)
    if as_soup:
        vertices, faces = soup(vertices, faces)
    vertices = np.concatenate([vertices, np.full((loose, 3), vertices[0] if seed % 2 else np.nan)])
    with pytest.MonkeyPatch.context() as patch:
        # A large mesh in random order is renumbered; a row may belong to any block.
        patch.setattr(spatial_order, "is_random", lambda faces: True)
        patch.setattr(spatial_order, "BLOCK_BYTES", 200)
        if is_renumbered:
            patch.setattr(mesh, "LARGE_VERTICES", 1)
        ready = prepare_mesh(vertices, faces)
    assert ready.defects.unreferenced_vertices == loose
    assert ready.defects.welded_vertices == len(vertices) - loose - 35
    assert (ready.defects.boundary_edges, ready.defects.components) == (0, 1)
    same = ready.to_file_vertices(ready.mesh.vertices, vertices)
    assert np.array_equal(same, vertices, equal_nan=True)
    rng = np.random.default_rng(seed)
    moved = ready.mesh.vertices + rng.normal(size=ready.mesh.vertices.shape)
    some = rng.random(len(moved)) < 0.5
    moved[some] = ready.mesh.vertices[some]
    out = ready.to_file_vertices(moved, vertices)
    first = len(vertices) - loose
    assert np.array_equal(out[first:], vertices[first:], equal_nan=True)
    place = np.arange(len(vertices)) if ready.vertex_map is None else ready.vertex_map
    assert np.allclose(out[faces] - ready.origin, moved[place[faces]], rtol=0, atol=1e-14)
    assert wound(ready.mesh.faces) == wound(place[faces])
    assert (wound(ready.mesh.faces) == wound(faces)) == (not as_soup and not is_renumbered)
    assert ready.seam_gap(out) == 0.0


def test_dirt_is_counted_and_put_aside():
    vertices, faces = torus()
    dirty = np.concatenate([faces, faces[:3], faces[5:7, ::-1], [[0, 0, 1]]])
    ready = prepare_mesh(vertices, dirty)
    assert ready.defects.duplicate_faces == 5
    assert ready.defects.degenerate_faces == 1
    assert ready.defects.boundary_edges == 0
    assert ready.defects.non_manifold_edges == 0
    assert len(ready.mesh.faces) == len(faces)
    assert ready.defects.volume_objection == ""


def test_inconsistent_winding_is_reported_and_mended_for_the_mathematics():
    vertices, faces = torus()
    mixed = faces.copy()
    mixed[::9] = mixed[::9, ::-1]
    ready = prepare_mesh(vertices, mixed)
    assert ready.defects.inconsistent_edges > 0
    assert ready.defects.turned_faces == len(mixed[::9])
    straight = prepare_mesh(vertices, faces)
    assert (ready.mesh.vertex_normals() == straight.mesh.vertex_normals()).all()


@pytest.mark.parametrize(
    ("shape", "objection"),
    [
        (torus(), ""),
        (grid(), "open (18 boundary edges)"),
        ((cube()[0], np.concatenate([cube()[1], [[0, 1, 7]]])), "open"),
    ],
)
def test_why_a_volume_is_not_to_be_trusted(shape, objection):
    assert prepare_mesh(*shape).defects.volume_objection.startswith(objection)
    assert bool(prepare_mesh(*shape).defects.volume_objection) == bool(objection)


def test_far_from_the_origin_nothing_is_lost():
    vertices, faces = torus()
    far = np.round(vertices * 1000) / 1000 + [4_650_000.0, 1_250_000.0, 300.0]
    ready = prepare_mesh(far, faces)
    near = np.round(vertices * 1000) / 1000
    edges = ready.mesh.vertices[faces[:, 0]] - ready.mesh.vertices[faces[:, 1]]
    assert np.allclose(edges, near[faces[:, 0]] - near[faces[:, 1]], rtol=0, atol=2e-9)
    assert np.abs(ready.mesh.vertices).max() < 5


def test_more_faces_than_can_be_counted_are_refused():
    # One row of zeros, repeated without taking memory.
    faces = np.broadcast_to(np.zeros(3, dtype=np.int32), (MAX_FACES + 1, 3))
    with pytest.raises(TooLargeError, match="357,913,942 triangles"):
        prepare_mesh(np.zeros((3, 3)), faces)


def test_what_is_kept_with_a_mesh_depends_on_all_that_is_given():
    calls = []

    @cached_by_mesh
    def pair(mesh, first=1, second=2):
        calls.append((first, second))
        return first, second

    mesh, other = (prepare_mesh(*torus(6, 4)).mesh for _ in range(2))
    found = [pair(mesh), pair(mesh, second=3), pair(mesh, 2), pair(mesh, second=3), pair(other)]
    assert found == [(1, 2), (1, 3), (2, 2), (1, 3), (1, 2)]
    assert calls == [(1, 2), (1, 3), (2, 2), (1, 2)]
