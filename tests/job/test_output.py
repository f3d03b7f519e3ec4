"""What an output must hold before it is written, and which of its ways a result takes."""

import dataclasses
import gzip
import os

import numpy as np
import pytest

from msal_cli.codecs import conversion, open_mesh
from msal_cli.errors import InternalError, LossError, OutputError
from msal_cli.job import output
from msal_cli.job.settings import Settings, Task
from tests.cli.scans import ply_text
from tests.codecs import plain_obj, plain_stl
from tests.shapes import cube

VERTICES, FACES = cube()


def obj(vertices, faces=FACES):
    return plain_obj.written(vertices, faces, "mtllib none.mtl")


def opened():
    return open_mesh(obj(VERTICES), "scan.obj", "obj")


def built(vertices=VERTICES, path="out.obj", data=None, **options):
    data = obj(VERTICES) if data is None else data
    settings = Settings("none", {}, **options)
    return output.build_output(opened(), vertices, settings, path, data)


@pytest.mark.parametrize("scale", [1e-6, 1.0, -1e6])
def test_what_is_encoded_anew_is_read_back(scale, monkeypatch):
    def rewritten(data):
        monkeypatch.setattr(type(opened()), "encoded", lambda *given: data)
        return built(vertices, precision="double").data

    vertices = scale * (VERTICES - [0.0, 0.0, 3.0])  # the largest coordinate is 3
    for share, is_accepted in ((0.0, True), (0.9e-5, True), (1.1e-5, False), (1.0, False)):
        other = vertices.copy()
        other[5, 1] += share * 3.0 * scale
        if is_accepted:
            assert rewritten(obj(other)) == obj(other)
            continue
        with pytest.raises(InternalError, match="other positions than it should"):
            rewritten(obj(other))
    with pytest.raises(InternalError, match="has 11 triangles, not 12"):
        rewritten(obj(vertices, FACES[:-1]))
    with pytest.raises(InternalError, match="the obj output cannot be read back"):
        rewritten(b"v 1 2\n")


def test_whole_numbers_are_rounded_when_they_are_encoded_anew(monkeypatch):
    data = ply_text(7 * VERTICES, FACES).replace(b"float", b"int").replace(b".000000", b"")
    whole = open_mesh(data, "in.ply")
    settings = Settings("none", {}, encoding="binary")
    moved = output.as_stored(whole, settings, "out.ply", whole.vertices + 0.375)
    made = output.build_output(whole, moved, settings, "out.ply", data)
    assert (open_mesh(bytes(made.data), "out.ply").vertices == whole.vertices).all()
    other = whole.encoded(whole.vertices + 1.0, "binary", "same")
    monkeypatch.setattr(type(whole), "encoded", lambda *given: other)
    with pytest.raises(InternalError, match="other positions"):
        output.build_output(whole, whole.vertices, settings, "out.ply", data)


def test_what_moves_by_less_than_float32_can_hold_keeps_its_normals():
    data = bytearray(plain_stl.binary(VERTICES[FACES].reshape(-1, 9) + 10.0))
    stl = open_mesh(bytes(data), "in.stl")
    nudged = stl.vertices + 1e-9 * np.arange(stl.vertices.size).reshape(-1, 3)
    nudged = output.as_stored(stl, Settings("none", {}), "out.stl", nudged)
    assert (nudged == stl.vertices).all()
    nudged[0] += 0.5
    made = output.build_output(stl, nudged, Settings("none", {}), "out.stl", data).data
    before, after = (np.frombuffer(d, "V50", offset=84) for d in (bytes(data), bytes(made)))
    assert ((before != after) == (stl.faces == 0).any(axis=1)).all()


def test_a_wrong_writer_is_noticed(monkeypatch):
    wrong = obj(VERTICES + 1.0)
    monkeypatch.setattr(type(opened()), "replaced", lambda self, vertices: wrong)
    with pytest.raises(InternalError):
        built(VERTICES + 2.0)
    monkeypatch.setattr(conversion, "convert", lambda *given: (wrong, ()))
    with pytest.raises(InternalError):
        built(path="out.ply")


def test_what_has_not_changed_is_the_input_itself():
    data = obj(VERTICES)
    assert built(data=data).data is data
    packed = gzip.compress(data)
    assert built(data=packed, path="out.obj.gz").data is packed
    assert built(data=packed, path=None).data is packed
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
    made = bytes(built(path=path, to=to).data)
    assert len(open_mesh(made, "", format_).faces) == len(FACES)


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
    with pytest.raises(OutputError) as caught:
        output.keep_backup(dataclasses.replace(task, backup=250 * "o"), b"old")
    assert "the backup" in caught.value.message
    if os.name == "posix":
        (tmp_path / "scan.obj.orig").unlink()
        (tmp_path / "scan.obj.orig").symlink_to(path)
        with pytest.raises(OutputError, match="exists and is not this file"):
            output.keep_backup(task, b"old")
