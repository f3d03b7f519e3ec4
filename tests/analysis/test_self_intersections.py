"""Faces that intersect each other, before and after."""

import numpy as np

from msal_cli.analysis.measures import count_self_intersections, self_intersection_change
from msal_cli.mesh import prepare_mesh
from tests.shapes import torus


def pushed(vertices, number):
    """A vertex on the other side of the tube, or of the whole."""
    vertices = vertices.copy()
    vertices[number] = -0.9 * vertices[number]
    return vertices


def test_what_is_created_is_neither_the_difference_nor_all():
    vertices, faces = torus(10, 6)
    before, after = pushed(vertices, 0), pushed(vertices, 30)
    ready = prepare_mesh(before, faces)
    moved = ready.mesh.with_vertices(after - ready.origin)
    change = self_intersection_change(ready.mesh, moved)
    assert change.before == count_self_intersections(ready.mesh) > 0
    assert change.after == count_self_intersections(moved) > 0
    assert change.after - change.before < change.created <= change.after
    still = self_intersection_change(
        ready.mesh, ready.mesh.with_vertices(ready.mesh.vertices.copy())
    )
    assert (still.before, still.after, still.created) == (change.before, change.before, 0)


def test_faces_without_area_are_left_out():
    # The third face closes a gap that has no width, and touches the first all along an edge.
    vertices = np.array([(0, 0, 0), (2, 0, 0), (1, 2, 0), (1, 0, 0), (1, -2, 0)], dtype=float)
    faces = np.array([(0, 1, 2), (3, 0, 4), (0, 3, 1)], dtype=np.int32)
    ready = prepare_mesh(vertices, faces)
    assert ready.defects.degenerate_faces == 1
    # Those with an area touch along half an edge, and share a vertex only.
    assert count_self_intersections(ready.mesh) == 1
