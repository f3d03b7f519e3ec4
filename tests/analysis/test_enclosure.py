"""What closed surfaces enclose, whichever side their normals point to."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.analysis.enclosure import measure_enclosure
from msal_cli.analysis.harm import harmful_change
from msal_cli.analysis.measures import area_and_volume, measure_surface_change
from msal_cli.mesh import prepare_mesh
from tests.shapes import cube, grid, torus


def together(*parts):
    """Several (vertices, faces) as one, far from the origin, with a vertex that no face uses."""
    vertices = [np.zeros((1, 3))] + [part for part, _ in parts]
    firsts = np.cumsum([len(part) for part in vertices])
    faces = [own + first for (_, own), first in zip(parts, firsts, strict=False)]
    ready = prepare_mesh(np.concatenate(vertices) + 1e4, np.concatenate(faces))
    return ready, [len(own) for _, own in parts]


def box(size, at=0.0, turned=False):
    vertices, faces = cube()
    return size * (vertices - 0.5) + [at, 0.0, 0.0], faces[:, ::-1] if turned else faces


def enclosed(ready):
    return measure_enclosure(ready).volume(ready.mesh, area_and_volume(ready.mesh)[1])


@pytest.mark.parametrize(
    ("parts", "volume", "turned"),
    [
        ([box(1.0)], 1.0, [0]),
        ([box(1.0, turned=True)], 1.0, [1]),
        ([box(1.0), box(2.0, 5.0)], 9.0, [0, 0]),
        # A part that is mirrored, and is inside out by that.
        ([box(2.0), box(2.0, 5.0, turned=True)], 16.0, [0, 1]),
        ([box(1.0), box(2.0, 5.0, turned=True)], 9.0, [0, 1]),
        ([box(1.0, turned=True), box(2.0, 5.0, turned=True)], 9.0, [1, 1]),
        # Cavities, one of them in a part that is inside out as a whole.
        ([box(2.0), box(1.0, turned=True)], 7.0, [0, 0]),
        ([box(2.0, turned=True), box(1.0)], 7.0, [1, 1]),
        ([box(2.0, turned=True), box(1.0), box(1.0, 5.0)], 8.0, [1, 1, 0]),
        # A part within a part, which overlap.
        ([box(2.0), box(1.0)], 9.0, [0, 0]),
    ],
)
def test_boxes_by_hand(parts, volume, turned):
    ready, counts = together(*parts)
    found = measure_enclosure(ready)
    assert enclosed(ready) == pytest.approx(volume)
    assert found.is_inside_out == any(turned)
    inward = np.zeros(sum(counts), bool) if found.inward is None else found.inward
    assert (inward == np.repeat(np.array(turned, dtype=bool), counts)).all()
    assert (found.n_turned, found.n_parts) == (sum(turned), len(turned))
    signs = np.broadcast_to(found.outward_signs(ready.mesh), len(ready.mesh.vertices))
    of_vertices = np.repeat(
        [1.0, *(-1.0 if is_turned else 1.0 for is_turned in turned)], [1] + [8] * len(turned)
    )
    used = ready.mesh.topology.has_ring
    assert (signs[used] == of_vertices[used]).all()


def test_words():
    assert measure_enclosure(together(box(1.0), box(1.0, 5.0))[0]).words == ""
    assert measure_enclosure(together(box(1.0, turned=True))[0]).words == (
        "the surface is inside out: its normals point inwards"
    )
    ready = together(box(1.0), box(1.0, 5.0, turned=True))[0]
    assert measure_enclosure(ready).words == "1 of 2 parts is inside out: normals point inwards"
    some = together(box(1.0), box(1.0, 5.0, turned=True), box(1.0, 9.0, turned=True))[0]
    assert measure_enclosure(some).words == "2 of 3 parts are inside out: normals point inwards"


def test_an_open_surface_has_no_inside():
    vertices, faces = grid()
    ready = together(box(1.0, turned=True), (vertices + 9.0, faces))[0]
    assert not measure_enclosure(ready).is_inside_out


def test_parts_that_cancel_out_are_not_harmed_by_a_small_change():
    vertices, faces = torus()
    ready = together((vertices, faces), (vertices + 9.0, faces[:, ::-1]))[0]
    mesh = ready.mesh
    after = mesh.with_vertices(mesh.vertices * [1.0, 1.0, 0.9])
    raw = measure_surface_change(mesh, after)
    change = measure_enclosure(ready).change(mesh, after, raw)
    assert change.volume_after / change.volume_before == pytest.approx(0.9)
    assert harmful_change(mesh, after, change, has_volume=True) is None
    assert change.normals is raw.normals
