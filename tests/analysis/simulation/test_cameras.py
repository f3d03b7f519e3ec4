"""Simulated depth cameras, and their fusion."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.analysis.simulation import ScannerSettings, simulate_scan
from msal_cli.analysis.simulation.depth_camera import (
    DISTANCE,
    quantise_disparities,
    smooth_depths,
    triangulate,
)
from msal_cli.analysis.simulation.frames import build_frame, turn, turn_back
from msal_cli.analysis.simulation.fusion import spread_directions
from msal_cli.analysis.simulation.surface import Surface, closest_on_triangles
from msal_cli.errors import TooLargeError
from msal_cli.kernels.geometry import face_normals
from msal_cli.mesh import Mesh, prepare_mesh
from tests.shapes import ball, cube

pytest.importorskip("fcpw")

SPHERE = prepare_mesh(*ball(96, 48)).mesh
QUIET = {"level": 0.0, "smoothing": 0.0, "step": 0.0}


def depth(cells=32, mesh=SPHERE, **settings):
    return simulate_scan(mesh, ScannerSettings("depth", cells=cells, **settings))


def fusion(cells=24, mesh=SPHERE, **settings):
    return simulate_scan(mesh, ScannerSettings("fusion", cells=cells, **settings))


def two_steps() -> Mesh:
    """Two squares that look up, one before the other by more than a camera bridges."""
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=float)
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    vertices = np.concatenate([square * 3.0, square + [0.0, 0.0, 2.0]])
    return prepare_mesh(vertices, np.concatenate([faces, faces + 4])).mesh


def test_rays_meet_the_nearest_face_exactly():
    surface = Surface(prepare_mesh(*cube()).mesh)
    ways = np.array([[0.0, 0.0, -1.0], [0.0, 0.6, -0.8], [0.0, 0.0, 1.0]])
    distances, faces = surface.cast_rays(np.array([0.1, -0.2, 3.0]), ways)
    assert distances == pytest.approx([2.5, np.inf, np.inf], abs=1e-14)
    assert (faces >= 0).tolist() == [True, False, False]
    assert surface.face_normals(faces[:1]) == pytest.approx(np.array([[0.0, 0.0, 1.0]]))


def test_the_nearest_point_of_a_triangle():
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]] * 4, dtype=float)
    points = np.array([[0.2, 0.2, 3], [-1, -1, 1], [0.4, -2, 0], [1, 1, 1]], dtype=float)
    expected = [[0.2, 0.2, 0], [0, 0, 0], [0.4, 0, 0], [0.5, 0.5, 0]]
    assert closest_on_triangles(points, corners) == pytest.approx(np.array(expected))


def test_a_quiet_camera_sees_the_surface_itself():
    made = depth(**QUIET)
    assert np.array_equal(made.vertices, made.true_vertices)
    distance = Surface(SPHERE).closest_points(made.vertices) - made.vertices
    assert np.abs(distance).max() < 1e-12


def test_a_camera_sees_one_side_with_an_open_border():
    made = depth(**QUIET, direction=(0.0, -1.0, 0.0))
    defects = prepare_mesh(made.vertices, made.faces).defects
    assert (defects.components, defects.non_manifold_edges) == (1, 0)
    assert defects.boundary_edges > 40
    assert made.vertices[:, 1].max() < 0.0
    # All faces look at the camera, and out of the sphere.
    ways = (face_normals(made.vertices, made.faces) * made.vertices[made.faces].mean(axis=1)).sum(1)
    assert (ways > 0.5).all()


def test_the_same_seed_makes_the_same_scan_only():
    first, again, other = (depth(seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(first.vertices, again.vertices)
    assert len(first.vertices) != len(other.vertices) or not np.array_equal(
        first.vertices, other.vertices
    )


def test_noise_goes_along_the_rays_with_the_level_head_on():
    made = depth(96, level=0.3, smoothing=0.0, step=0.0)
    steps = made.vertices - made.true_vertices
    camera = np.array([0.0, 0.0, DISTANCE])
    rays = made.true_vertices - camera
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    along = (steps * rays).sum(axis=1)
    assert np.linalg.norm(steps - along[:, None] * rays, axis=1).max() < 1e-9
    cosines = -(rays * made.true_vertices).sum(axis=1)
    # Depth counts along the axis; the nearest pole is nearer than the centre by a quarter.
    front = cosines > 0.97
    expected = 0.3 * made.cell * ((DISTANCE - 1.0) / DISTANCE) ** 2
    assert along[front].std() == pytest.approx(expected, rel=0.2)
    side = (cosines > 0.4) & (cosines < 0.6)
    assert along[side].std() > 1.6 * along[front].std()


def test_noise_is_shared_as_far_as_is_asked():
    def share(correlation):
        made = depth(64, level=0.2, smoothing=0.0, step=0.0, correlation=correlation)
        mesh = prepare_mesh(made.true_vertices, made.faces).mesh
        heights = (made.vertices - made.true_vertices)[:, 2]
        rows = np.repeat(np.arange(len(heights)), np.diff(mesh.topology.ring_start))
        return (heights[rows] * heights[mesh.topology.ring]).mean() / (heights**2).mean()

    assert abs(share(0.0)) < 0.1
    assert share(1.5) > 0.6


def test_the_camera_smooths_its_noise():
    rough, smooth = (
        depth(64, level=0.3, smoothing=width, step=0.0, seed=1) for width in (0.0, 1.0)
    )
    inner = np.linalg.norm(smooth.true_vertices[:, :2], axis=1) < 0.7
    kept = np.linalg.norm(rough.true_vertices[:, :2], axis=1) < 0.7
    before = (rough.vertices - rough.true_vertices)[kept, 2].std()
    assert (smooth.vertices - smooth.true_vertices)[inner, 2].std() < 0.6 * before


def test_smoothing_stops_at_jumps_and_borders():
    depths = np.full((6, 8), 5.0)
    depths[:, 4:] = 9.0
    depths[0, 0] = np.inf
    noise = np.zeros_like(depths)
    noise[3, 1] = 1.0
    made = smooth_depths(depths + noise, depths, 1.0, 1.0)
    assert np.isinf(made[0, 0])
    assert made[:, 4:] == pytest.approx(9.0, abs=1e-12)
    assert 5.1 < made[3, 1] < 5.3
    assert made[1:, :4].min() > 5.0 - 1e-12


def test_disparities_are_multiples_and_the_step_is_that_at_the_centre():
    depths = np.array([[2.0, 3.9, 4.0, 4.01, 6.0, np.inf]])
    made = quantise_disparities(depths, 0.1, 4.0)
    whole = 1.0 / (made[0, :5] * (0.1 / 16.0))
    assert whole == pytest.approx(np.round(whole), abs=1e-9)
    assert np.isinf(made[0, 5])
    assert np.abs(made[0, :5] - depths[0, :5])[1:4].max() <= 0.051
    assert np.abs(made[0, :5] - depths[0, :5])[0] <= 0.051 / 4.0


def test_triangles_are_cut_at_jumps_and_gaps():
    depths = np.array([[1.0, 1.0, 9.0], [1.0, 1.0, 9.0], [1.0, np.inf, 9.0]])
    faces = triangulate(depths, 2.0)
    assert sorted(map(sorted, faces.tolist())) == [[0, 1, 4], [0, 3, 4], [3, 4, 6]]


def test_one_surface_behind_another_is_cut_off_from_it():
    made = depth(40, two_steps(), **QUIET)
    defects = prepare_mesh(made.vertices, made.faces).defects
    assert defects.components == 2
    assert np.ptp(made.vertices[made.faces][:, :, 2], axis=1).max() < 1e-9


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (-3.0, 0.2, 0.1)])
def test_a_frame_is_turned_back(direction):
    frame = build_frame(direction)
    assert frame @ frame.T == pytest.approx(np.eye(3), abs=1e-15)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    assert np.cross(frame[2], direction) == pytest.approx(np.zeros(3), abs=1e-14)
    points = np.random.default_rng(0).normal(size=(5, 3))
    assert turn_back(turn(points, frame), frame) == pytest.approx(points)
    assert np.array_equal(build_frame((0.0, 0.0, 2.0)), np.eye(3))


def test_an_image_that_is_too_large_is_refused():
    with pytest.raises(TooLargeError, match="pixels"):
        simulate_scan(SPHERE, ScannerSettings("depth", cell_edges=0.001))


def test_directions_are_spread_over_the_sphere():
    directions = spread_directions(50)
    assert np.linalg.norm(directions, axis=1) == pytest.approx(1.0)
    assert np.abs(directions.mean(axis=0)).max() < 0.02
    assert (directions.T @ directions / 50) == pytest.approx(np.eye(3) / 3.0, abs=0.03)


def test_a_fusion_closes_the_sphere():
    pytest.importorskip("skimage")
    made = fusion(**QUIET, misalignment=0.0, views=14)
    defects = prepare_mesh(made.vertices, made.faces).defects
    assert (defects.boundary_edges, defects.components, defects.non_manifold_edges) == (0, 1, 0)
    radii = np.linalg.norm(made.vertices, axis=1)
    assert np.abs(radii - 1.0).mean() < 0.2 * made.cell
    outward = face_normals(made.vertices, made.faces) * made.vertices[made.faces].mean(axis=1)
    assert (outward.sum(axis=1) > 0.0).mean() > 0.99


def test_a_fusion_is_the_same_for_the_same_seed_and_rougher_with_noise():
    pytest.importorskip("skimage")
    first, again, quiet = (
        fusion(views=6, seed=2, level=level, misalignment=0.0) for level in (1.5, 1.5, 0.0)
    )
    assert np.array_equal(first.vertices, again.vertices)

    def roughness(made):
        return np.abs(np.linalg.norm(made.vertices, axis=1) - 1.0).mean()

    assert roughness(first) > 1.3 * roughness(quiet)


def test_a_single_view_leaves_the_far_side_open():
    pytest.importorskip("skimage")
    made = fusion(**QUIET, views=1)
    assert prepare_mesh(made.vertices, made.faces).defects.boundary_edges > 20
    (direction,) = spread_directions(1)
    along = made.vertices @ direction
    assert along.max() > 0.9
    assert along.min() > -0.6
