"""What an output must hold before it is written, and which of its ways a result takes."""

from __future__ import annotations

import gzip
import os

import pytest

from msal_cli.codecs import conversion, open_mesh
from msal_cli.errors import InternalError, LossError, OutputError
from msal_cli.job import output
from msal_cli.job.settings import Settings, Task
from tests.shapes import cube

VERTICES, FACES = cube()


def obj(vertices, faces=FACES):
    lines = ["v " + " ".join(map(repr, map(float, vertex))) for vertex in vertices]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in faces]
    return "\n".join(["mtllib none.mtl", *lines, ""]).encode()


def opened(vertices=VERTICES):
    return open_mesh(obj(vertices), "scan.obj", "obj")


def check(data, vertices=VERTICES, target="obj"):
    output._check_reopened(data, target, opened(vertices), vertices)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_positions_may_differ_by_rounding_and_not_by_more(scale, sign):
    vertices = scale * (VERTICES - [0.0, 0.0, 3.0])
    span = 3.0 * scale  # the largest coordinate is -3
    for share, is_accepted in ((0.0, True), (0.9e-5, True), (1.1e-5, False), (1.0, False)):
        other = vertices.copy()
        other[5, 1] += sign * share * span
        if is_accepted:
            check(obj(other), vertices)
        else:
            with pytest.raises(InternalError, match="other positions than it should"):
                check(obj(other), vertices)


def test_whole_numbers_are_rounded_when_they_are_encoded_anew():
    rows = "".join(f"{x} {y} {z}\n" for x, y, z in 7 * cube()[0].astype(int))
    faces = "".join(f"3 {a} {b} {c}\n" for a, b, c in cube()[1])
    header = "ply\nformat ascii 1.0\nelement vertex 8\n"
    header += "".join(f"property int {name}\n" for name in "xyz")
    header += "element face 12\nproperty list uchar int vertex_indices\nend_header\n"
    data = (header + rows + faces).encode()
    mesh_file = open_mesh(data, "in.ply")
    vertices = mesh_file.vertices + 0.375
    encoded = mesh_file.encoded(vertices, "binary", "same")
    output._check_reopened(encoded, "ply", mesh_file, vertices)
    with pytest.raises(InternalError, match="other positions"):
        output._check_reopened(encoded, "ply", mesh_file, vertices + 0.5)


def test_an_output_has_all_triangles_and_can_be_read():
    with pytest.raises(InternalError, match=r"has 11 triangles, not 12"):
        check(obj(VERTICES, FACES[:-1]))
    with pytest.raises(InternalError, match="the obj output cannot be read back"):
        check(b"v 1 2\n")
    # What msal cannot read it cannot check.
    check(b"v 1 2\n", target="unknown")


def built(vertices=VERTICES, path="out.obj", data=None, is_compressed=False, **options):
    data = obj(VERTICES) if data is None else data
    settings = Settings("none", {}, **options)
    source = output.Source(data, "scan.obj", is_compressed)
    return output.build_output(opened(), vertices, settings, path, source)


def test_what_has_not_changed_is_the_input_itself():
    data = obj(VERTICES)
    assert built(data=data).data is data
    packed = gzip.compress(data)
    assert built(data=packed, path="out.obj.gz", is_compressed=True).data is packed
    assert built(data=packed, path=None, is_compressed=True).data is packed
    assert built().references == ("none.mtl",)


@pytest.mark.parametrize("path", ["out.stl", "out.stl.gz"])
def test_a_conversion_is_read_back_and_says_what_is_lost(path):
    result = built(path=path)
    data = gzip.decompress(result.data) if path.endswith("gz") else result.data
    again = open_mesh(bytes(data), "out.stl", "stl")
    assert again.vertices[again.faces] == pytest.approx(VERTICES[FACES])
    assert result.references == ()
    assert result.losses and all(loss.startswith("lost in stl: ") for loss in result.losses)
    with pytest.raises(LossError, match="obj to stl would lose "):
        built(path=path, strict=True)


@pytest.mark.parametrize(
    ("path", "to", "format_"),
    [("out.STL", None, "stl"), ("out.obj", ".PLY", "ply"), ("out.txt", None, "obj")]
    + [(None, None, "obj"), (None, "off", "off")],
)
def test_the_format_is_that_which_is_asked_for(path, to, format_):
    assert output._target(opened(), path, Settings("none", {}, to=to)) == format_


def test_a_wrong_writer_is_noticed(monkeypatch):
    mesh_file = opened()
    wrong = obj(VERTICES + 1.0)
    monkeypatch.setattr(type(mesh_file), "encoded", lambda self, *given: wrong)
    with pytest.raises(InternalError):
        built(precision="double")
    monkeypatch.setattr(type(mesh_file), "replaced", lambda self, vertices: wrong)
    with pytest.raises(InternalError):
        built(VERTICES + 2.0)
    monkeypatch.setattr(conversion, "convert", lambda *given: (wrong, ()))
    with pytest.raises(InternalError):
        built(path="out.ply")


def test_a_backup_is_kept_once_and_is_no_link_to_the_original(tmp_path):
    path = tmp_path / "scan.obj"
    path.write_bytes(b"old")
    task = Task(str(path), str(path), "scan.obj", backup=".orig")
    for _ in range(2):
        output.keep_backup(task, b"old")
        assert (tmp_path / "scan.obj.orig").read_bytes() == b"old"
    with pytest.raises(OutputError, match="exists and is not this file"):
        output.keep_backup(task, b"new")
    assert (tmp_path / "scan.obj.orig").read_bytes() == b"old"
    if os.name == "posix":
        (tmp_path / "scan.obj.orig").unlink()
        (tmp_path / "scan.obj.orig").symlink_to(path)
        with pytest.raises(OutputError, match="exists and is not this file"):
            output.keep_backup(task, b"old")
