"""GLB: positions and normals replaced in place, all else kept."""

from __future__ import annotations

import copy
import io
import json
import struct

import numpy as np
import pytest

from msal_cli.codecs import gltf
from msal_cli.codecs.conversion import convert
from msal_cli.codecs.mesh_file import PLACEMENT
from msal_cli.errors import ContentError
from tests.codecs.plain_glb import Scene, content_of
from tests.shapes import cube, grid, noisy, torus


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
    output = file.replaced(vertices)
    file.check(output, vertices)
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
    assert any(at >= starts[1] for at in changed), "normals"
    again = gltf.GlbFile(output)
    assert np.array_equal(again.vertices, vertices)
    assert np.array_equal(again.faces, file.faces)
    # Vertex 0 is in no face that moved.
    first = slice(starts[1], starts[1] + 12)
    assert old[first] == new[first]


def test_normals_are_those_of_the_new_faces():
    vertices, faces = grid()
    scene = Scene()
    unit = np.tile([0.0, 0.0, -1.0], (len(vertices), 1))  # against the winding, and kept so
    attributes = {
        "POSITION": scene.positions(vertices),
        "NORMAL": scene.accessor(unit, "<f4", "VEC3"),
    }
    scene.mesh(
        {"attributes": attributes, "indices": scene.accessor(faces.reshape(-1), "<u4", "SCALAR")}
    )
    file = gltf.GlbFile(scene.data())
    tilted = vertices[:, [2, 1, 0]]  # into the plane x = 0, which turns the normal to -x
    output = file.replaced(tilted)
    file.check(output, tilted)
    (_, binary) = content_of(output)
    start = scene.content["bufferViews"][1]["byteOffset"]
    normals = np.frombuffer(binary, "<f4", 3 * len(vertices), start).reshape(-1, 3)
    assert np.allclose(normals, [1.0, 0.0, 0.0])


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
    for more in ({}, second):
        vertices, faces = torus(8, 6)
        scene.mesh(
            {
                "attributes": {"POSITION": scene.positions(vertices)},
                "indices": scene.accessor(faces.reshape(-1), "<u2", "SCALAR"),
            },
            **more,
        )
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
    assert file.replaced(file.vertices) is data
    vertices = noisy(file.vertices, 1)
    vertices[40:90] = file.vertices[40:90]
    output = file.replaced(vertices)
    file.check(output, vertices)
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
    file.check(file.replaced(vertices), vertices)


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
    output = file.replaced(moved)
    file.check(output, moved)
    assert np.allclose(gltf.GlbFile(output).vertices, moved, atol=1e-5)


def test_a_mesh_in_two_places_counts_once():
    scene = simple()
    (primitive,) = scene.content["meshes"][0]["primitives"]
    scene.content["nodes"].append({"mesh": 0, "translation": [5, 0, 0]})
    # As some exporters do it: another mesh of the same lists, with another material.
    scene.mesh({**primitive, "material": 1}, translation=[9, 0, 0])
    file = gltf.GlbFile(scene.data())
    assert (len(file.vertices), len(file.faces), file.n_polygons) == (8, 12, 12)
    assert "instances" in file.properties
    vertices = noisy(file.vertices)
    file.check(file.replaced(vertices), vertices)
    assert "instances" not in gltf.GlbFile(simple().data()).properties


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
    output = bytes(file.replaced(vertices))
    file.check(output, vertices)
    (size,) = struct.unpack_from("<I", output, 12)
    # Of three numbers that are 1 the first one changed, and the others keep their form.
    assert output[20 : 20 + size].rstrip() == text.rstrip().replace(b"1.000e0", b"3.0", 1)


def edited(change) -> bytes:
    """The simple scene with something changed in its description."""
    scene = simple()
    change(scene.content)
    return scene.data()


def setting(*path, value):
    def change(content):
        entry = content
        for key in path[:-1]:
            entry = entry[key]
        if value is None:
            del entry[path[-1]]
        else:
            entry[path[-1]] = value

    return change


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

DAMAGED = {
    "empty": (b"", "E_TRUNCATED"),
    "version 1": (WHOLE[:4] + b"\x01" + WHOLE[5:], "E_UNSUPPORTED"),
    "not JSON first": (WHOLE[:16] + b"XXXX" + WHOLE[20:], "E_FORMAT"),
    "cut": (WHOLE[:-1], "E_TRUNCATED"),
    "JSON beyond the end": (WHOLE[:12] + b"\xff\xff\xff\x7f" + WHOLE[16:], "E_TRUNCATED"),
    "no meshes": (edited(setting("meshes", value=None)), "E_NO_FACES"),
    "accessor out of range": (edited(setting(*PRIMITIVE, "attributes", "POSITION", value=99)),
        "E_FORMAT"),
    "count beyond all": (edited(setting("accessors", 0, "count", value=10**30)), "E_FORMAT"),
    "stride too small": (edited(setting("bufferViews", 0, "byteStride", value=4)), "E_TRUNCATED"),
    "other buffer": (edited(setting("bufferViews", 0, "buffer", value=1)), "E_FORMAT"),
    "sparse": (edited(setting("accessors", 0, "sparse", value={"count": 1})), "E_UNSUPPORTED"),
    "positions are uint": (edited(setting("accessors", 0, "componentType", value=5125)),
        "E_UNSUPPORTED"),
    "Draco": (edited(setting(*PRIMITIVE, "extensions", value={"KHR_draco_mesh_compression": {}})),
        "E_UNSUPPORTED"),
    "meshopt": (edited(setting("bufferViews", 0, "extensions",
        value={"EXT_meshopt_compression": {}})), "E_UNSUPPORTED"),
    "indices are floats": (edited(setting("accessors", 3, "componentType", value=5126)),
        "E_FORMAT"),
    "the same indices for very many lists": (every_list_with_the_same_indices(300, 400),
        "E_TOO_LARGE"),
    "index out of range": (edited(setting("accessors", 0, "count", value=7)), "E_INDEX"),
    "overlapping lists": (edited(setting("bufferViews", 1, "byteOffset", value=4)),
        "E_UNSUPPORTED"),
    "lines only": (edited(setting(*PRIMITIVE, "mode", value=1)), "E_NO_FACES"),
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
    output = file.replaced(vertices)
    file.check(output, vertices)
    again = gltf.GlbFile(output)
    assert np.array_equal(again.vertices, np.rint(vertices))
    bounds = content_of(output)[0]["accessors"][0]
    assert bounds["max"] == again.vertices.max(axis=0).tolist()
    assert all(isinstance(number, int) for number in bounds["max"])
    with pytest.raises(ContentError, match="does not fit"):
        file.replaced(vertices - 2.0 * largest - 70_000.0)
