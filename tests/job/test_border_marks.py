from __future__ import annotations

import numpy as np

from msal_cli.codecs import open_mesh
from msal_cli.job.border_marks import MOST_MARKS, count_touching, mark_border
from msal_cli.job.opened_mesh import prepare_mesh
from msal_cli.job.records import MeshRecord
from tests.tiles.tile_files import in_tiles, mixed, noisy_ball, noisy_terrain, ply


def marks_of(data, name="a.ply"):
    mesh_file = open_mesh(data, name)
    return mark_border(prepare_mesh(mesh_file), mesh_file)


def records(several):
    return [MeshRecord(str(i), "written", border_marks=one) for i, one in enumerate(several)]


def test_files_that_touch_have_marks_in_common():
    contents = mixed(in_tiles(*noisy_terrain(61, 61), 3))
    several = [marks_of(data, name) for name, data in contents.items()]
    assert {len(one) for one in several} == {MOST_MARKS}
    assert count_touching(records(several)) >= 6


def test_files_that_do_not_touch_have_none():
    vertices, faces = noisy_terrain()
    several = [marks_of(ply(vertices + (50.0 * i, 0, 0), faces)) for i in range(20)]
    assert count_touching(records(several)) == 0


def test_marks_do_not_depend_on_format_order_or_the_sign_of_zero():
    vertices, faces = noisy_terrain(5, 5)
    soup = vertices[faces.reshape(-1)]
    other = np.arange(len(soup), dtype=np.int32).reshape(-1, 3)[::-1]
    assert marks_of(ply(soup, other, "<f8")) == marks_of(ply(vertices, faces))
    assert marks_of(ply(np.where(vertices == 0.0, -0.0, vertices), faces)) == marks_of(
        ply(vertices, faces)
    )


def test_a_closed_surface_has_none():
    assert marks_of(ply(*noisy_ball())) == ()
