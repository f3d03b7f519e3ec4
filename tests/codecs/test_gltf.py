"""glTF and GLB: positions, normals and bounds replaced, all else kept."""

import base64
import copy
import io
import json
import os
import struct
from pathlib import Path

import numpy as np
import pytest

from msal_cli import codecs
from msal_cli.codecs import gltf, open_mesh
from msal_cli.codecs.conversion import convert
from msal_cli.codecs.gltf import write_companions
from msal_cli.codecs.mesh_file import PLACEMENT, Companion
from msal_cli.errors import ContentError, MsalError, UnsupportedError
from msal_cli.job import comparison, pipeline
from msal_cli.job.settings import Task
from tests.codecs.patching import rewritten
from tests.codecs.plain_glb import Scene, content_of
from tests.files import denoise_bytes, posix, tree
from tests.job.test_pipeline import settings
from tests.shapes import cube, noisy, torus

PREFIX = "data:application/octet-stream;base64,"


def scene_of(*uris: str, **node) -> tuple[str, bytes]:
    """The text of two tori in one buffer, laid out by hand, and the buffer."""
    content, binary = content_of(two_parts(**node).data())
    content["buffers"] = [{"byteLength": len(binary), "uri": uri} for uri in uris]
    return json.dumps(content, indent=2), binary


def as_text(content, binary) -> bytes:
    """A .gltf with its buffer inside."""
    uri = PREFIX + base64.b64encode(binary).decode()
    content["buffers"] = [{"byteLength": len(binary), "uri": uri}]
    return json.dumps(content, indent=2).encode()


def embedded() -> bytes:
    return as_text(*content_of(two_parts(translation=[9, 0, 0]).data()))


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


def test_an_unchanged_file_comes_with_all_that_it_names(tmp_path):
    source = in_folder(tmp_path / "in", buffer="data/my scan.bin")
    record = denoised(source, tmp_path / "out" / "new.gltf", 0)
    assert record.error is None and record.status == "unchanged"
    assert comparison.inspect_file(str(source)).references[0] == "data/my scan.bin"
    before, after = tree(tmp_path / "in"), tree(tmp_path / "out")
    after["scan.gltf"] = after.pop("new.gltf")
    assert after == before
    assert any(note.startswith("wrote data/my scan.bin (SHA-256 ") for note in record.sidecars)
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
    for name in ("out", "away"):
        (tmp_path / name).mkdir()
    (tmp_path / "out/data").symlink_to(tmp_path / "away")
    with pytest.raises(MsalError, match="outside the output folder"):
        write_companions([Companion("data/a.bin", b"1")], str(tmp_path / "out/a.gltf"))
    assert not list((tmp_path / "away").iterdir())


def test_streams_hold_embedded_buffers_only(tmp_path):
    output, record = denoise_bytes(embedded(), "-", settings(format="gltf"))
    assert record.error is None and output is not None
    source = in_folder(tmp_path)
    output, record = denoise_bytes(source.read_bytes(), "-", settings(format="gltf"))
    assert record.error is not None and record.error.code == "E_UNSUPPORTED"
    assert "without its folder" in record.error.message
    output, record = denoise_bytes(source.read_bytes(), str(source), settings())
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
    uris = [one["uri"] for one in after if "base64" not in one["uri"]]
    assert uris == ["a.bin", "y.bin", "y.bin"]
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
    with pytest.raises(MsalError, match="not a regular file"):
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
    code, where, message = failure()
    assert (code, where) == ("E_READ", "buffer 0")
    assert message.startswith("the buffer 'scan.bin' beside the .gltf cannot be read: No such file")
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


def simple(normals: bool = True, stride: int = 0, code: str = "<u2") -> Scene:
    vertices, faces = cube()
    scene = Scene()
    attributes = {"POSITION": scene.positions(vertices, stride)}
    if normals:
        unit = (vertices - 0.5) / np.linalg.norm(vertices - 0.5, axis=1, keepdims=True)
        attributes["NORMAL"] = scene.accessor(unit, "<f4", "VEC3", stride)
    attributes["TEXCOORD_0"] = scene.accessor(vertices[:, :2], "<f4", "VEC2")
    indices = scene.accessor(faces.reshape(-1), code, "SCALAR")
    scene.mesh({"attributes": attributes, "indices": indices, "material": 0})
    scene.content["materials"] = [{"name": "skin", "extras": {"a": 1}}]
    return scene


@pytest.mark.parametrize("stride", [0, 12, 20])
@pytest.mark.parametrize("code", ["<u1", "<u2", "<u4"])
def test_only_positions_normals_and_bounds_change(stride, code):
    data = simple(stride=stride, code=code).data()
    file = gltf.GlbFile(data)
    assert np.array_equal(file.vertices, cube()[0]) and np.array_equal(file.faces, cube()[1])
    assert file.properties[-2:] == ("vertex.TEXCOORD_0", "materials") and not file.warnings
    vertices = file.vertices.copy()
    vertices[7] = [3.0, 2.0, 1.5]
    output = rewritten(file, vertices)
    (before, old), (after, new) = content_of(data), content_of(output)
    assert after["accessors"][0]["max"] == [3.0, 2.0, 1.5]
    expected = copy.deepcopy(before)
    expected["accessors"][0]["max"] = [3.0, 2.0, 1.5]
    assert after == expected
    assert len(old) == len(new)
    step = stride or 12
    starts = [before["bufferViews"][k]["byteOffset"] for k in (0, 1)]
    changed = {at for at in range(len(old)) if old[at] != new[at]}
    allowed = {start + step * row + k for start in starts for row in range(8) for k in range(12)}
    assert changed <= allowed
    turned = np.frombuffer(new, "<f4", 3, starts[1] + 7 * step)
    assert np.linalg.norm(turned) == pytest.approx(1.0) and (turned > 0.2).all()
    assert turned.tobytes() != old[starts[1] + 7 * step :][:12]
    again = gltf.GlbFile(output)
    assert np.array_equal(again.vertices, vertices)
    assert np.array_equal(again.faces, file.faces)
    # Vertex 0 is in no face that moved.
    first = slice(starts[1], starts[1] + 12)
    assert old[first] == new[first]


@pytest.mark.parametrize(
    ("more", "is_placed"),
    [
        ({}, False),
        ({"scale": [1, 1, 1], "translation": [0, 0, 0]}, False),
        ({"scale": [0.01, 0.01, 0.01]}, True),
        ({"translation": [1, 2, 3]}, True),
        ({"scale": [1, 1, 0]}, True),
        ({"scale": ["no number"]}, False),
    ],
)
def test_the_place_of_the_only_mesh_is_lost_without_a_scene(more, is_placed):
    scene = simple()
    scene.content["nodes"][0] |= more
    file = gltf.GlbFile(scene.data())
    assert np.array_equal(file.vertices, cube()[0])
    _, losses = convert(file, file.vertices, "ply", "same", "same")
    assert (PLACEMENT in losses) is is_placed
    _, losses = convert(file, file.vertices, "gltf", "same", "same")
    assert not losses


def test_strips_fans_and_faces_without_indices():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 0]], dtype=float)
    expected = {
        5: [[0, 1, 2], [2, 1, 3], [2, 3, 4]],
        6: [[0, 1, 2], [0, 2, 3], [0, 3, 4]],
        4: [[0, 1, 2]],
    }
    for mode, faces in expected.items():
        scene = Scene()
        scene.mesh({"attributes": {"POSITION": scene.positions(corners)}, "mode": mode})
        assert gltf.GlbFile(scene.data()).faces.tolist() == faces


def two_parts(**second) -> Scene:
    scene = Scene()
    vertices, faces = torus(8, 6)
    for more in ({}, second):
        at = scene.positions(vertices)
        indices = scene.accessor(faces.reshape(-1), "<u2", "SCALAR")
        scene.mesh({"attributes": {"POSITION": at}, "indices": indices}, **more)
    return scene


@pytest.mark.parametrize(
    "frame",
    [
        {"translation": [10, 0, 0]},
        {"rotation": [0, 0, 0.6, 0.8], "translation": [10, 0, 0]},
        {"rotation": [0.1, 0.7, 0.1, 0.7], "scale": [0.3, 0.3, 0.3], "translation": [1e5, 0, 9]},
        {"scale": [2, 3, 0.5], "translation": [0, 20, 0]},
        {"scale": [-1, 1, 1], "translation": [0, 20, 0]},
        {"matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 50, 60, 70, 1]},
    ],
)
def test_parts_stand_where_the_scene_puts_them(frame):
    import trimesh

    data = two_parts(**frame).data()
    file = gltf.GlbFile(data)
    assert len(file.vertices) == 96
    assert file.faces.max() == 95
    scene = trimesh.load_scene(io.BytesIO(data), file_type="glb", process=False)
    expected = np.asarray(scene.to_geometry().vertices)
    for axis in range(3):
        assert np.allclose(np.sort(file.vertices[:, axis]), np.sort(expected[:, axis]), atol=1e-5)
    # No part is inside out, not even one that is mirrored.
    assert (np.linalg.det(file.vertices[file.faces]).reshape(2, -1).sum(axis=1) > 0.0).all()
    assert file.replaced(file.vertices) is data
    vertices = noisy(file.vertices, 1)
    vertices[40:90] = file.vertices[40:90]
    output = rewritten(file, vertices)
    again = gltf.GlbFile(output)
    assert np.allclose(again.vertices, vertices, atol=1e-4)
    # Through the frame and back costs a bit: unmoved rows must not go that way.
    before, after = (list(one.scene.parts)[1].slots(one.scene.data) for one in (file, again))
    assert np.array_equal(before.values[:42], after.values[:42])


@pytest.mark.parametrize(
    "frame",
    [
        {"scale": [0, 1, 1]},
        {"matrix": [1, 2, 3]},
        {"matrix": "identity"},
        {"rotation": [0, 0, None, 1]},
        {"scale": [1e300, 1e300, 1e300], "matrix": [float("nan")] * 16},
        {"translation": [0, 1e40, 0]},
        {"scale": [1.5e308, 1.5e308, 1.5e308]},
        {"children": [1]},
    ],
)
def test_frames_that_cannot_be_undone_are_left_out(frame):
    file = gltf.GlbFile(two_parts(**frame).data())
    vertices = noisy(file.vertices)
    rewritten(file, vertices)


@pytest.mark.parametrize("second", [48, 8])
def test_parts_whose_rows_alternate(second):
    """Positions and normals of two meshes in one view, number by number beside one another."""
    scene = Scene()
    vertices, faces = torus(8, 6)
    rows = np.concatenate([vertices, cube()[0] if second == 8 else vertices + 9])
    normals = np.tile([1.0, 0.0, 0.0], (len(rows), 1))
    scene.accessor(np.hstack([rows, normals]), "<f4", "VEC3")
    view = {"bufferView": 0, "componentType": 5126, "type": "VEC3"}
    scene.content["bufferViews"][0]["byteStride"] = 24
    scene.content["accessors"] = [
        {**view, "byteOffset": at, "count": count}
        for at, count in ((0, 48), (12, 48), (48 * 24, second), (48 * 24 + 12, second))
    ]
    for first, triangles in ((0, faces), (2, cube()[1] if second == 8 else faces)):
        indices = scene.accessor(triangles.reshape(-1), "<u2", "SCALAR")
        attributes = {"POSITION": first, "NORMAL": first + 1}
        scene.mesh({"attributes": attributes, "indices": indices})
    file = gltf.GlbFile(scene.data())
    moved = noisy(file.vertices)
    output = rewritten(file, moved)
    assert np.allclose(gltf.GlbFile(output).vertices, moved, atol=1e-5)


def test_a_mesh_in_two_places_counts_once():
    scene = simple()
    (primitive,) = scene.content["meshes"][0]["primitives"]
    scene.content["nodes"].append({"mesh": 0, "translation": [5, 0, 0]})
    # As some exporters do it: another mesh of the same lists, with another material.
    scene.mesh({**primitive, "material": 1}, translation=[9, 0, 0])
    file = gltf.GlbFile(scene.data())
    assert (len(file.vertices), len(file.faces), file.n_polygons) == (8, 12, 12)
    assert file.properties[0] == "instances (2 more places of the same surfaces)"
    vertices = noisy(file.vertices)
    rewritten(file, vertices)
    scene.content["nodes"][1:2] = []
    assert "instances (1 more" in gltf.GlbFile(scene.data()).properties[0]
    scene.mesh({**primitive, "mode": 1, "targets": [{"POSITION": 0}]})
    assert {"morph targets", "points and lines"} < set(gltf.GlbFile(scene.data()).properties)


def test_the_text_of_the_description_is_kept_but_for_bounds():
    scene = simple()
    data = scene.data()
    (size,) = struct.unpack_from("<I", data, 12)
    text = json.dumps(scene.content, indent=3).replace('"keep"', '"keep" : NaN, "k\\u00e9"')
    text = text.replace("1.0", "1.000e0").encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + data[20 + size :]
    data = struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
    file = gltf.GlbFile(data)
    vertices = file.vertices.copy()
    vertices[7] = [3.0, 1.0, 0.5]
    output = rewritten(file, vertices)
    (size,) = struct.unpack_from("<I", output, 12)
    # Of three numbers that are 1 the first one changed, and the others keep their form.
    assert output[20 : 20 + size].rstrip() == text.rstrip().replace(b"1.000e0", b"3.0", 1)


def with_entry(*path, value) -> bytes:
    """The simple scene with one entry of its description replaced, or cut out by None."""
    scene = simple()
    entry = scene.content
    for key in path[:-1]:
        entry = entry[key]
    if value is None:
        del entry[path[-1]]
    else:
        entry[path[-1]] = value
    return scene.data()


def every_list_with_the_same_indices(n_lists: int, n_faces: int) -> bytes:
    """Triangles, each with positions of its own, and one list of indices that all of them use."""
    scene = Scene()
    indices = scene.accessor([0, 1, 2] * n_faces, "<u1", "SCALAR")
    for k in range(n_lists):
        at = scene.positions(np.eye(3) + k)
        scene.mesh({"attributes": {"POSITION": at}, "indices": indices})
    return scene.data()


def nested(depth: int) -> bytes:
    """A description of that many lists, one in another."""
    text = b'{"a":' + b"[" * depth + b"]" * depth + b"}  "
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text


WHOLE = simple().data()
PRIMITIVE = ("meshes", 0, "primitives", 0)

DAMAGED_GLB = {
    "version 1": (WHOLE[:4] + b"\x01" + WHOLE[5:], "E_UNSUPPORTED"),
    "not JSON first": (WHOLE[:16] + b"XXXX" + WHOLE[20:], "E_FORMAT"),
    "cut": (WHOLE[:-1], "E_TRUNCATED"),
    "JSON beyond the end": (WHOLE[:12] + b"\xff\xff\xff\x7f" + WHOLE[16:], "E_TRUNCATED"),
    "no meshes": (with_entry("meshes", value=None), "E_NO_FACES"),
    "primitives are no list": (with_entry(*PRIMITIVE[:3], value={}), "E_FORMAT", "mesh 0"),
    "accessor out of range": (with_entry(*PRIMITIVE, "attributes", "POSITION", value=99),
        "E_FORMAT"),
    "count beyond all": (with_entry("accessors", 0, "count", value=10**30), "E_FORMAT"),
    "stride too small": (with_entry("bufferViews", 0, "byteStride", value=4), "E_TRUNCATED"),
    "other buffer": (with_entry("bufferViews", 0, "buffer", value=1), "E_FORMAT"),
    "sparse": (with_entry("accessors", 0, "sparse", value={"count": 1}), "E_UNSUPPORTED"),
    "positions are uint": (with_entry("accessors", 0, "componentType", value=5125),
        "E_UNSUPPORTED"),
    "Draco": (with_entry(*PRIMITIVE, "extensions", value={"KHR_draco_mesh_compression": {}}),
        "E_UNSUPPORTED"),
    "meshopt": (with_entry("bufferViews", 0, "extensions", value={"EXT_meshopt_compression": {}}),
        "E_UNSUPPORTED"),
    "indices are floats": (with_entry("accessors", 3, "componentType", value=5126), "E_FORMAT"),
    "the same indices for very many lists": (every_list_with_the_same_indices(300, 400),
        "E_TOO_LARGE"),
    "index out of range": (with_entry("accessors", 0, "count", value=7), "E_INDEX"),
    "overlapping lists": (with_entry("bufferViews", 1, "byteOffset", value=4), "E_UNSUPPORTED"),
    "lines only": (with_entry(*PRIMITIVE, "mode", value=1), "E_NO_FACES"),
    "nested deeply": (nested(100_000), "E_FORMAT"),
}  # fmt: skip


QUANTISED = [("<i1", 120), ("<u1", 250), ("<i2", 30_000), ("<u2", 60_000)]


def quantised(code: str, largest: int, *, normalized: bool = False, **node) -> Scene:
    """A torus of whole numbers from 0 to the largest."""
    vertices, faces = torus(8, 6)
    span = vertices.max() - vertices.min()
    whole = np.rint((vertices - vertices.min()) / span * largest)
    scene = Scene()
    bounds = {"min": whole.min(axis=0).astype(int).tolist(), "max": [0, 0, 0]}
    size = np.dtype(code).itemsize
    at = scene.accessor(whole, code, "VEC3", 4 * size, normalized=normalized, **bounds)
    indices = scene.accessor(faces.reshape(-1), "<u2", "SCALAR")
    scene.mesh({"attributes": {"POSITION": at}, "indices": indices}, **node)
    return scene


@pytest.mark.parametrize(("code", "largest"), QUANTISED)
@pytest.mark.parametrize("normalized", [False, True])
def test_quantised_positions_stay_whole_numbers(code, largest, normalized):
    scene = quantised(code, largest, normalized=normalized, scale=[0.5, 0.5, 0.5])
    data = scene.data()
    file = gltf.GlbFile(data)
    assert file.precision == "integer" and "rounded" in file.warnings[0]
    assert file.vertices.max() == largest and np.array_equal(file.vertices, file.vertices.round())
    vertices = file.vertices.copy()
    vertices[5] = [3.4, 2.6, 1.0]
    output = rewritten(file, vertices)
    again = gltf.GlbFile(output)
    assert np.array_equal(again.vertices, np.rint(vertices))
    bounds = content_of(output)[0]["accessors"][0]
    assert bounds["max"] == again.vertices.max(axis=0).tolist()
    assert all(isinstance(number, int) for number in bounds["max"])
    with pytest.raises(ContentError, match="does not fit"):
        file.replaced(vertices - 2.0 * largest - 70_000.0)


def edited(change) -> bytes:
    content = json.loads(embedded())
    change(content)
    return json.dumps(content).encode()


def with_uri(uri: object) -> bytes:
    return edited(lambda content: content["buffers"][0].update(uri=uri))


def not_finite() -> bytes:
    """A cube one of whose positions is no number."""
    content, binary = content_of(simple().data())
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
    "no such buffer": (edited(lambda content: content["bufferViews"][0].update(buffer=1)),
        "E_FORMAT"),
    "very many buffers": (edited(lambda content: content["buffers"].extend([{}] * 20_000)),
        "E_TOO_LARGE"),
}  # fmt: skip
