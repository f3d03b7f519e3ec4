"""Two meshes against each other: identities, hand cases, and what cannot be compared."""

import numpy as np
import pytest

from msal_cli.codecs.mesh_file import Surface
from msal_cli.errors import ContentError
from msal_cli.job import comparison
from msal_cli.job.comparison import compare_meshes
from tests.shapes import cube, grid, torus


def between(before, after, **options):
    return compare_meshes(Surface(*before), Surface(*after), "a", "b", **options)


def test_a_mesh_and_itself():
    made = between(torus(), torus())
    assert made.correspondence == "vertices"
    assert made.mean_angular_error_deg == made.max_angular_error_deg == 0.0
    assert made.vertex_error_percent == made.displacement.max == 0.0
    assert made.volume_change_percent == made.area_change_percent == 0.0
    assert made.flipped_faces == made.seam_gap == 0
    assert made.hausdorff == 0.0
    inches, metres = (Surface(*torus(), unit=unit) for unit in ("in", "m"))
    assert "in before, m after" in compare_meshes(inches, metres, "a", "b").warnings[0]
    assert compare_meshes(inches, inches, "a", "b").warnings == made.warnings


def test_a_mesh_that_was_shifted_far_from_the_origin():
    vertices, faces = cube()
    made = between((vertices + 1e6, faces), (vertices + 1e6 + [0.3, 0.0, 0.4], faces))
    edge = made.mean_edge_length
    assert edge == pytest.approx((12 + 6 * np.sqrt(2)) / 18)
    assert made.displacement.mean == pytest.approx(0.5)
    assert made.displacement.max_edges == pytest.approx(0.5 / edge)
    assert made.vertex_error_percent == pytest.approx(50.0 / edge)
    assert made.mean_angular_error_deg == pytest.approx(0.0, abs=1e-6)
    assert made.volume_change_percent == pytest.approx(0.0, abs=1e-6)


def test_a_mesh_turned_inside_out_has_flipped_faces_and_lost_more_than_it_had():
    vertices, faces = torus()
    made = between((vertices, faces), (vertices * [1, 1, -1], faces))
    assert made.flipped_faces > 0
    assert made.max_angular_error_deg > 90.0
    assert made.volume_change_percent == pytest.approx(-200.0)
    assert (made.inside_out_before, made.inside_out_after) == (False, True)


def test_a_seam_that_opened_is_told():
    vertices, faces = cube()
    doubled = np.concatenate([vertices, vertices[:1]])
    faces = faces.copy()
    faces[0, faces[0] == 0] = 8
    moved = doubled.copy()
    moved[8] += [0.0, 0.0, -0.25]
    made = between((doubled, faces), (moved, faces))
    assert made.seam_gap == 0.25
    assert "0.25 apart" in made.warnings[0]
    assert made.displacement.max == 0.0


def test_meshes_of_other_faces_are_compared_as_surfaces():
    vertices, faces = cube()
    other = faces[::-1]
    made = between((vertices, faces), (vertices + 5.0, other))
    assert made.correspondence == "surface"
    assert made.mean_angular_error_deg is made.displacement is made.flipped_faces is None
    assert made.hausdorff == pytest.approx(5 * np.sqrt(3))
    assert made.hausdorff_edges == pytest.approx(5 * np.sqrt(3) / made.mean_edge_length)
    assert made.volume_change_percent == pytest.approx(0.0, abs=1e-9)
    expected = 100.0 * made.distance_to_before.mean / made.mean_edge_length
    assert made.vertex_error_percent == expected


def test_the_deviation_of_each_vertex():
    vertices, faces = grid(3, 3)
    raised = np.concatenate([vertices, [[0.5, 0.5, 0.5]]])
    got = comparison.deviations(Surface(vertices, faces), Surface(raised, faces))
    assert got == pytest.approx([0.0] * 9 + [0.5])


def test_a_position_that_is_not_finite():
    vertices, faces = cube()
    broken = vertices.copy()
    broken[3, 1] = np.nan
    with pytest.raises(ContentError) as caught:
        between((vertices, faces), (broken, faces))
    assert (caught.value.path, caught.value.where) == ("b", "vertex 3")


def test_one_of_two_surfaces_with_other_faces_is_inside_out():
    vertices, faces = cube()
    made = between(cube(), (2.0 * vertices, faces[::-1, ::-1]), to_surface=False)
    assert made.correspondence == "surface"
    assert made.volume_change_percent == pytest.approx(700.0)
    assert (made.inside_out_before, made.inside_out_after) == (False, True)
    assert made.warnings == ("after: the surface is inside out: its normals point inwards",)


def test_an_open_surface_has_no_volume_and_no_inside():
    made = between(grid(), grid(), to_surface=False)
    assert (made.volume.valid, made.volume.reason) == (False, "open (18 boundary edges)")
    assert made.volume.before is made.volume.after is made.volume.change is None
    assert made.volume_change_percent is None
    assert made.inside_out_before is made.inside_out_after is False
