""".gltf: positions and normals replaced in its buffers, inside its text or beside it."""

from __future__ import annotations

import base64
import json
import os
from pathlib import Path

import numpy as np
import pytest

from msal_cli import codecs
from msal_cli.codecs import detection, gltf, open_mesh
from msal_cli.codecs.companions import write_companions
from msal_cli.codecs.mesh_file import Companion
from msal_cli.errors import MsalError, UnsupportedError
from msal_cli.job import pipeline
from msal_cli.job.settings import Task
from tests.codecs import test_glb
from tests.codecs.plain_glb import content_of
from tests.job.test_pipeline import settings
from tests.shapes import noisy

posix = pytest.mark.skipif(os.name != "posix", reason="links and pipes")
PREFIX = "data:application/octet-stream;base64,"


def scene_of(*uris: str, **node) -> tuple[str, bytes]:
    """The text of two tori in one buffer, laid out by hand, and the buffer."""
    content, binary = content_of(test_glb.two_parts(**node).data())
    content["buffers"] = [{"byteLength": len(binary), "uri": uri} for uri in uris]
    return json.dumps(content, indent=2), binary


def as_text(content, binary) -> bytes:
    """A .gltf with its buffer inside."""
    uri = PREFIX + base64.b64encode(binary).decode()
    content["buffers"] = [{"byteLength": len(binary), "uri": uri}]
    return json.dumps(content, indent=2).encode()


def embedded() -> bytes:
    return as_text(*content_of(test_glb.two_parts(translation=[9, 0, 0]).data()))


def in_folder(folder: Path, name: str = "scan.gltf", buffer: str = "scan.bin") -> Path:
    """A .gltf with its buffer and a picture in a folder."""
    text, binary = scene_of(buffer.replace(" ", "%20"), translation=[9, 0, 0])
    content = json.loads(text)
    content["images"] = [{"uri": "textures/a%20b.png"}, {"uri": "data:image/png;base64,AA=="}]
    (folder / "textures").mkdir(parents=True, exist_ok=True)
    (folder / "textures" / "a b.png").write_bytes(b"picture")
    (folder / buffer).parent.mkdir(parents=True, exist_ok=True)
    (folder / buffer).write_bytes(binary + b"behind")
    (folder / name).write_text(json.dumps(content, indent=1))
    return folder / name


def opened(path: Path) -> codecs.MeshFile:
    return open_mesh(path.read_bytes(), str(path))


def denoised(source: Path, target: Path, iterations: int = 2):
    task = Task(str(source), str(target), source.name)
    return pipeline.denoise_file(task, settings(iterations=iterations))


def tree(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_embedded_buffers_are_replaced_in_the_text():
    data = embedded()
    file = open_mesh(data, "a.gltf")
    assert (file.format, len(file.vertices), len(file.faces)) == ("gltf", 96, 192)
    assert file.replaced(file.vertices.copy()) is data
    vertices = noisy(file.vertices, 1)
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    assert np.allclose(open_mesh(output, "a.gltf").vertices, vertices, atol=1e-6)
    # Without the numbers of bounds, and the base64, the texts are the same.
    old, new = (
        [line for line in one.splitlines() if b"base64" not in line and b"." not in line]
        for one in (data, output)
    )
    assert old == new and len(old) > 100


def test_an_unchanged_file_comes_with_all_that_it_names(tmp_path):
    source = in_folder(tmp_path / "in", buffer="data/my scan.bin")
    record = denoised(source, tmp_path / "out" / "new.gltf", 0)
    assert record.error is None and record.status == "unchanged"
    before, after = tree(tmp_path / "in"), tree(tmp_path / "out")
    after["scan.gltf"] = after.pop("new.gltf")
    assert after == before
    assert "wrote data/my scan.bin" in record.sidecars
    assert "copied textures/a b.png" in record.sidecars


def test_the_buffer_is_written_beside_the_output(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    source = in_folder(tmp_path / "in")
    target = tmp_path / "out" / "scan.gltf"
    record = denoised(source, target)
    assert record.error is None, record.error
    before, after = tree(tmp_path / "in"), tree(tmp_path / "out")
    assert set(after) == {"scan.gltf", "scan.bin", "textures/a b.png"}
    assert len(after["scan.bin"]) == len(before["scan.bin"])
    assert after["scan.bin"].endswith(b"behind")
    assert after["scan.bin"] != before["scan.bin"]
    old, new = json.loads(before["scan.gltf"]), json.loads(after["scan.gltf"])
    assert old.pop("accessors") != new.pop("accessors")
    assert old == new
    scene = trimesh.load_scene(str(target), process=False)
    parts = sorted(scene.geometry)
    assert len(parts) == 2
    file = opened(target)
    assert np.allclose(scene.geometry[parts[0]].vertices, file.vertices[:48], atol=1e-6)
    # With other settings the output of before, and its buffer, are replaced.
    first = after["scan.bin"]
    assert denoised(source, target, 5).error is None
    assert (tmp_path / "out" / "scan.bin").read_bytes() not in (first, before["scan.bin"])
    assert denoised(source, target, 0).error is None
    assert (tmp_path / "out" / "scan.bin").read_bytes() == before["scan.bin"]


@posix
@pytest.mark.parametrize("name", ["scan.gltf", "scan.glb", "scan.ply"])
def test_an_output_is_as_private_as_the_buffer(tmp_path, name):
    source = in_folder(tmp_path / "in")
    (tmp_path / "in/scan.bin").chmod(0o600)
    target = tmp_path / "out" / name
    assert denoised(source, target).error is None
    made = [target, *target.parent.glob("*.bin")]
    assert {path.stat().st_mode & 0o777 for path in made} == {0o600}


@pytest.mark.parametrize(
    ("target", "buffer", "expected"),
    [
        ("new.gltf", "scan.bin", "new.bin"),
        ("sub/new.gltf", "scan.bin", "new.bin"),
        ("sub/scan.gltf", "shared.bin", "scan.bin"),
        ("sub/scan.gltf", "data/scan.bin", "data/scan.bin"),
        ("a #1.gltf", "scan.bin", "a #1.bin"),
    ],
)
def test_a_buffer_is_named_as_its_output_is(tmp_path, target, buffer, expected):
    source = in_folder(tmp_path, buffer=buffer)
    before = tree(tmp_path)
    record = denoised(source, tmp_path / target)
    assert record.error is None, record.error
    # The input and its buffer are as they were.
    assert {name: tree(tmp_path)[name] for name in before} == before
    assert (tmp_path / target).parent.joinpath(expected).is_file()
    moved = opened(tmp_path / target)
    assert moved.names == {0: expected}
    assert not np.array_equal(moved.vertices, opened(source).vertices)


def test_a_foreign_file_is_never_replaced(tmp_path):
    source = in_folder(tmp_path / "in")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "scan.bin").write_bytes(b"precious")
    record = denoised(source, tmp_path / "out" / "scan.gltf")
    assert record.error is not None and record.error.code == "E_SIDECAR"
    assert (tmp_path / "out" / "scan.bin").read_bytes() == b"precious"
    assert not (tmp_path / "out" / "scan.gltf").exists()
    # Nor the buffer of the input, whatever the output is called.
    before = tree(tmp_path / "in")
    record = denoised(source, tmp_path / "in" / "scan.gltf.gz")
    assert record.error is not None and record.error.code == "E_SIDECAR"
    record = denoised(source, source)
    assert record.error is not None and record.error.code == "E_UNSUPPORTED"
    assert tree(tmp_path / "in") == before


@posix
def test_a_link_does_not_lead_the_output_away(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "away").mkdir()
    (tmp_path / "out" / "data").symlink_to(tmp_path / "away")
    with pytest.raises(MsalError, match="outside the output folder"):
        write_companions([Companion("data/a.bin", b"1")], str(tmp_path / "out" / "a.gltf"))
    assert not list((tmp_path / "away").iterdir())


def test_streams_hold_embedded_buffers_only(tmp_path):
    output, record = pipeline.denoise_bytes(embedded(), "-", settings(format="gltf"))
    assert record.error is None and output is not None
    source = in_folder(tmp_path)
    output, record = pipeline.denoise_bytes(source.read_bytes(), "-", settings(format="gltf"))
    assert record.error is not None and record.error.code == "E_UNSUPPORTED"
    assert "without its folder" in record.error.message
    output, record = pipeline.denoise_bytes(source.read_bytes(), str(source), settings())
    assert record.error is not None and "a folder only" in record.error.message
    task = Task(str(source), "s3://bucket/scan.gltf", "scan.gltf")
    record = pipeline.denoise_file(task, settings())
    assert record.error is not None and "a folder only" in record.error.message


def test_from_one_container_to_the_other(tmp_path):
    source = in_folder(tmp_path / "in")
    for name in ("a.glb", "b.gltf"):
        record = denoised(source if name == "a.glb" else tmp_path / "a.glb", tmp_path / name)
        assert record.error is None, record
        assert "textures/a b.png" in tree(tmp_path)
        assert not (tmp_path / "a.bin").exists()
    glb, text = opened(tmp_path / "a.glb"), opened(tmp_path / "b.gltf")
    first = denoised(source, tmp_path / "out" / "x.gltf")
    assert first.error is None
    assert np.array_equal(opened(tmp_path / "out" / "x.gltf").vertices, glb.vertices)
    for key in ("accessors", "meshes", "nodes", "images", "extras"):
        assert key in text.scene.content
        assert glb.scene.content[key] == json.loads((tmp_path / "out" / "x.gltf").read_text())[key]


def test_several_buffers(tmp_path):
    text, binary = scene_of("a.bin", "@", "c.bin", "c.bin")
    content = json.loads(text)
    # Positions of the first torus in the second buffer, those of the other in the third.
    for view, buffer in ((0, 1), (1, 0), (2, 2), (3, 3)):
        content["bufferViews"][view]["buffer"] = buffer
    text = json.dumps(content).replace("@", PREFIX + base64.b64encode(binary).decode())
    for name in ("a.bin", "c.bin"):
        (tmp_path / name).write_bytes(binary)
    (tmp_path / "x.gltf").write_text(text)
    assert denoised(tmp_path / "x.gltf", tmp_path / "out" / "y.gltf").error is None
    after = json.loads((tmp_path / "out" / "y.gltf").read_text())["buffers"]
    assert [one["uri"] for one in after if "base64" not in one["uri"]] == [
        "a.bin",
        "y.bin",
        "y.bin",
    ]
    assert (tmp_path / "out" / "a.bin").read_bytes() == binary
    assert after[1]["uri"] != json.loads(text)["buffers"][1]["uri"]
    new, old = opened(tmp_path / "out" / "y.gltf"), opened(tmp_path / "x.gltf")
    assert (new.vertices != old.vertices).any(axis=1).all()
    assert np.array_equal(new.faces, old.faces)


OUTSIDE = [
    "../scan.bin", "a/../../scan.bin", "%2e%2e/scan.bin", "/etc/passwd", "//host/scan.bin",
    "file:///etc/passwd", "https://host/scan.bin", "C:/scan.bin", "..\\scan.bin", "a\0b",
]  # fmt: skip


@pytest.mark.parametrize("uri", OUTSIDE)
def test_nothing_outside_the_folder_is_read(tmp_path, uri, monkeypatch):
    (tmp_path / "in").mkdir()
    text, binary = scene_of(uri)
    (tmp_path / "scan.bin").write_bytes(binary)
    (tmp_path / "in" / "a.gltf").write_text(text)
    monkeypatch.setattr(os, "open", None)
    with pytest.raises(UnsupportedError, match="not in the folder"):
        gltf.GltfFile(text.encode(), str(tmp_path / "in" / "a.gltf"))


@posix
def test_links_and_pipes_beside_a_scene(tmp_path):
    text, binary = scene_of("a.bin")
    (tmp_path / "in").mkdir()
    name, buffer = str(tmp_path / "in" / "a.gltf"), tmp_path / "in" / "a.bin"
    (tmp_path / "outside.bin").write_bytes(binary)
    buffer.symlink_to(tmp_path / "outside.bin")
    with pytest.raises(UnsupportedError, match="leads out of the folder"):
        gltf.GltfFile(text.encode(), name)
    (tmp_path / "in" / "real.bin").write_bytes(binary)
    buffer.unlink()
    buffer.symlink_to("real.bin")
    assert len(gltf.GltfFile(text.encode(), name).faces) == 192
    buffer.unlink()
    os.mkfifo(buffer)
    with pytest.raises(UnsupportedError, match="not a regular file"):
        gltf.GltfFile(text.encode(), name)
    buffer.unlink()
    buffer.mkdir()
    with pytest.raises(MsalError):
        gltf.GltfFile(text.encode(), name)


def test_buffers_that_are_missing_or_short(tmp_path):
    source = in_folder(tmp_path)
    buffer = tmp_path / "scan.bin"
    whole = buffer.read_bytes()

    def failure() -> tuple[str, str, str]:
        with pytest.raises(MsalError) as caught:
            opened(source)
        assert caught.value.hint
        return caught.value.code, caught.value.where, caught.value.message

    buffer.write_bytes(whole[:100])
    assert failure()[:2] == ("E_TRUNCATED", "buffer 0")
    buffer.unlink()
    assert failure() == ("E_READ", "buffer 0", "the buffer 'scan.bin' is missing beside the .gltf")
    with buffer.open("wb") as file:
        file.truncate(1 << 40)
    assert failure()[0] == "E_TOO_LARGE"
    # One that no surface is in may be missing.
    buffer.write_bytes(whole)
    content = json.loads(source.read_text())
    content["buffers"].append({"uri": "motion.bin", "byteLength": 4})
    source.write_text(json.dumps(content))
    file = opened(source)
    assert len(file.faces) == 192 and file.names == {0: "scan.bin"}


def edited(change) -> bytes:
    content = json.loads(embedded())
    change(content)
    return json.dumps(content).encode()


def with_uri(uri: object) -> bytes:
    return edited(lambda content: content["buffers"][0].update(uri=uri))


def not_finite() -> bytes:
    """A cube one of whose positions is no number."""
    content, binary = content_of(test_glb.simple().data())
    at = content["bufferViews"][0]["byteOffset"] + 3 * 12
    binary = binary[:at] + b"\x00\x00\xc0\x7f" + binary[at + 4 :]
    return as_text(content, binary)


DAMAGED = {
    "a position that is not finite": (not_finite(), "E_NONFINITE", "accessor 0, vertex 3"),
    "no JSON": (embedded()[:-3], "E_FORMAT"),
    "version 1": (edited(lambda content: content.update(asset={"version": "1.0"})),
        "E_UNSUPPORTED"),
    "bad base64": (with_uri(PREFIX + "AA!A"), "E_FORMAT"),
    "short base64": (with_uri(PREFIX + "AAAA"), "E_TRUNCATED"),
    "data that are not base64": (with_uri("data:text/plain,hello"), "E_UNSUPPORTED"),
    "no uri": (edited(lambda content: content["buffers"][0].pop("uri")), "E_FORMAT"),
    "no length": (edited(lambda content: content["buffers"][0].pop("byteLength")), "E_FORMAT"),
    "a missing file": (with_uri("no such file.bin"), "E_READ"),
    "a file elsewhere": (with_uri("../scan.bin"), "E_UNSUPPORTED"),
    "no such buffer": (edited(lambda content: content["bufferViews"][0].update(buffer=1)),
        "E_FORMAT"),
    "very many buffers": (edited(lambda content: content["buffers"].extend([{}] * 20_000)),
        "E_TOO_LARGE"),
}  # fmt: skip


def test_the_content_tells_the_format():
    assert detection.content_format(embedded()) == open_mesh(embedded(), "-").format == "gltf"
