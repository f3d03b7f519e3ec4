"""OBJ files with marks of old systems, and with normals that many faces share."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.codecs import normal_warnings, obj, open_mesh
from msal_cli.job.pipeline import denoise_bytes
from msal_cli.job.settings import Settings
from tests.codecs import plain_ply

AXES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
CORNERS = {
    0: [(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)],
    1: [(0, 0, 0), (0, 0, 1), (0, 1, 1), (0, 1, 0)],
    2: [(0, 1, 0), (0, 1, 1), (1, 1, 1), (1, 1, 0)],
    3: [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)],
    4: [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)],
    5: [(0, 0, 0), (0, 1, 0), (1, 1, 0), (1, 0, 0)],
}


def ball_of_blocks(radius: int) -> bytes:
    """An OBJ of quads, with one normal for all faces of a direction."""
    distance = np.linalg.norm(np.indices((2 * radius + 1,) * 3) - radius, axis=0)
    cells = np.argwhere(distance < radius)
    filled = {tuple(int(x) for x in cell) for cell in cells}
    number: dict[tuple[int, ...], int] = {}
    faces = []
    for cell in sorted(filled):
        for side, axis in enumerate(AXES):
            if tuple(np.add(cell, axis).tolist()) not in filled:
                corners = (tuple(np.add(cell, one).tolist()) for one in CORNERS[side])
                at = [number.setdefault(one, len(number) + 1) for one in corners]
                faces.append("f " + " ".join(f"{one}//{side + 1}" for one in at))
    lines = ["v {} {} {}".format(*one) for one in number]
    lines += ["vn {} {} {}".format(*axis) for axis in AXES]
    return "\n".join([*lines, *faces, ""]).encode()


@pytest.mark.parametrize("end", [b"\x1a", b"\x1a\n", b"\r\n\x1a\x1a"])
def test_the_end_mark_of_old_systems_is_kept(end):
    data = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n" + end
    file = obj.read(data, "a.obj")
    assert len(file.warnings) == 1 and "no statement that is known" in file.warnings[0]
    vertices = file.vertices * 0.5
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    assert output.endswith(b"f 1 2 3\n" + end)


def test_shared_normals_that_cannot_fit_are_counted_in_the_record():
    data = ball_of_blocks(4)
    parameters = {one.name: one.default for one in methods.find("taubin").parameters}
    output, record = denoise_bytes(data, "a.obj", Settings(method="taubin", parameters=parameters))
    assert output is not None and record.status == "written"
    (warning,) = (one for one in record.warnings if " vn " in one)
    after, content = open_mesh(bytes(output), "a.obj"), obj._Reader(bytes(output)).read()
    n_off = 0
    for quad, entry in zip(after.polygons(), content.face_normals[::2, 0], strict=True):
        fans = [quad[[0, 1, 2]], quad[[0, 2, 3]]]
        for corners in after.vertices[np.array(fans)]:
            normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
            cosine = normal @ content.normals.values[entry] / np.linalg.norm(normal)
            if cosine < np.cos(np.radians(30.0)):
                n_off += 1
                break
    n_faces = record.faces
    assert 0.3 * n_faces < n_off < n_faces
    share = f"{n_off} of {n_faces} faces ({100.0 * n_off / n_faces:.1f} %)"
    assert warning.startswith("6 vn are shared by faces that turned apart: " + share)
    assert "(0.0 % before)" in warning


def test_a_file_without_normals_or_of_another_format_has_no_such_warning():
    file = open_mesh(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "a.obj")
    assert normal_warnings(file, file.vertices[:, ::-1].copy()) == ()
    ply = open_mesh(plain_ply.written(plain_ply.cube("ascii", "float")), "a.ply")
    assert normal_warnings(ply, ply.vertices[:, ::-1].copy()) == ()
