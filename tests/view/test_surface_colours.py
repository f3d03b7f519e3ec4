"""Colours of vertices as files of each format have them."""

import json
import struct

import numpy as np
import pytest

from msal_cli.view.colours import open_coloured_surface

CORNERS = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
RED_GREEN_BLUE = [[255, 0, 0], [0, 128, 0], [0, 0, 255]]


def _colours(tmp_path, name, data):
    path = tmp_path / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return open_coloured_surface(str(path)).colours


def _rows(colours):
    pairs = zip(CORNERS, colours, strict=True)
    return "".join(" ".join(map(str, (*place, *colour))) + "\n" for place, colour in pairs)


@pytest.mark.parametrize("prefix", ["", "diffuse_"])
def test_ply(tmp_path, prefix):
    names = "".join(f"property uchar {prefix}{name}\n" for name in ("red", "green", "blue"))
    text = (
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        f"property float z\n{names}element face 1\nproperty list uchar int vertex_indices\n"
        f"end_header\n{_rows(RED_GREEN_BLUE)}3 0 1 2\n"
    )
    found = _colours(tmp_path, "a.ply", text)
    assert found.vertices.tolist() == RED_GREEN_BLUE and not found.notes


def test_obj(tmp_path):
    text = "v 0 0 0 1 0 0\nv 1 0 0 0 0.5 0\nv 0 1 0 0 0 1\nf 1 2 3\n"
    assert _colours(tmp_path, "a.obj", text).vertices.tolist() == RED_GREEN_BLUE


@pytest.mark.parametrize("head", ["COFF\n3 1 0\n", "OFF 3 1 0\n", "COFF\n# made\n3 1\n"])
def test_off(tmp_path, head):
    text = f"{head}{_rows(RED_GREEN_BLUE)}3 0 1 2\n"
    assert _colours(tmp_path, "a.off", text).vertices.tolist() == RED_GREEN_BLUE


def test_off_with_shares_of_one_and_normals(tmp_path):
    rows = "".join(
        f"{place} 0 0 1 {colour} 1\n"
        for place, colour in (("0 0 0", "1.0 0 0"), ("1 0 0", "0 0.5 0"), ("0 1 0", "0 0 1.0"))
    )
    found = _colours(tmp_path, "a.off", f"CNOFF\n3 1 0\n{rows}3 0 1 2\n")
    assert found.vertices.tolist() == RED_GREEN_BLUE


def test_normals_behind_positions_are_no_colours(tmp_path):
    rows = "".join(f"{x} {y} {z} 0 0 -1\n" for x, y, z in CORNERS)
    assert _colours(tmp_path, "a.off", f"OFF\n3 1 0\n{rows}3 0 1 2\n").vertices is None


def _stl(header, words):
    data = header.ljust(80, b"\0") + struct.pack("<I", len(words))
    for k, word in enumerate(words):
        corners = [(x + 5 * k, y, z) for x, y, z in CORNERS]
        data += struct.pack("<12fH", 0, 0, 1, *np.ravel(corners), word)
    return data


@pytest.mark.parametrize(
    ("header", "words", "colours"),
    [
        # VisCAM.
        (b"", [0x8000 | 31 << 10, 0], [[255, 0, 0]] * 3 + [[204, 204, 204]] * 3),
        # Magics.
        (b"COLOR=\x0a\x14\x1e\xff", [31, 0x8000], [[255, 0, 0]] * 3 + [[10, 20, 30]] * 3),
    ],
)
def test_stl_words(tmp_path, header, words, colours):
    assert _colours(tmp_path, "a.stl", _stl(header, words)).vertices.tolist() == colours


def test_stl_words_that_are_no_colours(tmp_path):
    assert _colours(tmp_path, "a.stl", _stl(b"", [3, 4])).vertices is None


def _glb(colours=None, code=5126):
    parts = [np.array(CORNERS, "<f4").tobytes()]
    accessors = [
        {
            "bufferView": 0,
            "componentType": 5126,
            "count": 3,
            "type": "VEC3",
            "min": [0, 0, 0],
            "max": [1, 1, 0],
        }
    ]
    primitive = {"attributes": {"POSITION": 0}}
    if colours is not None:
        parts.append(np.ascontiguousarray(colours).tobytes())
        kind = f"VEC{len(colours[0])}"
        accessors.append({"bufferView": 1, "componentType": code, "count": 3, "type": kind})
        primitive["attributes"]["COLOR_0"] = 1
    content = {"asset": {"version": "2.0"}, "accessors": accessors}
    offsets = np.cumsum([0, *map(len, parts)]).tolist()
    content["bufferViews"] = [
        {"buffer": 0, "byteOffset": at, "byteLength": len(part)}
        for at, part in zip(offsets, parts, strict=False)
    ]
    content["buffers"] = [{"byteLength": offsets[-1]}]
    content["meshes"] = [{"primitives": [primitive]}]
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    data = b"".join(parts)
    size = 28 + len(text) + len(data)
    return (
        struct.pack("<4sIIII", b"glTF", 2, size, len(text), 0x4E4F534A)
        + text
        + struct.pack("<II", len(data), 0x004E4942)
        + data
    )


@pytest.mark.parametrize(
    ("rows", "code"),
    [
        (np.array([[*colour, 255] for colour in RED_GREEN_BLUE], np.uint8), 5121),
        # Floats are linear: 0.2158605 is what a screen shows as 128 of 255.
        (np.array([[1, 0, 0], [0, 0.2158605, 0], [0, 0, 1]], "<f4"), 5126),
    ],
)
def test_glb(tmp_path, rows, code):
    assert _colours(tmp_path, "a.glb", _glb(rows, code)).vertices.tolist() == RED_GREEN_BLUE


def test_what_cannot_be_read_is_a_note(tmp_path):
    data = _glb(np.eye(3, dtype="<f4")).replace(b'"bufferView": 1', b'"bufferView": 7')
    found = _colours(tmp_path, "a.glb", data)
    assert found.vertices is None and "cannot be read" in found.notes[0]


def test_a_glb_without_vertex_colours_has_none(tmp_path):
    assert _colours(tmp_path, "a.glb", _glb()).vertices is None


def test_black_everywhere_is_not_shown(tmp_path):
    text = f"COFF\n3 1 0\n{_rows([[0, 0, 0]] * 3)}3 0 1 2\n"
    found = _colours(tmp_path, "a.off", text)
    assert found.vertices is None and "black" in found.notes[0]
