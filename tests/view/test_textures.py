"""Images of mesh files: at texture coordinates, missing, and hostile."""

import io
import os
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from msal_cli.errors import ContentError
from msal_cli.view.surface_colours import open_coloured_surface
from msal_cli.view.textures import decode_texture, read_texture, sample_texture

# Rows from the top: red, green / blue, white.
FOUR = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8)
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
PLACES = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
EXPECTED = [[0, 0, 255], [255, 255, 255], [0, 255, 0], [255, 0, 0]]


def _png(image=FOUR):
    data = io.BytesIO()
    Image.fromarray(image).save(data, "PNG")
    return data.getvalue()


def _obj(folder, image_name, library="newmtl skin\nmap_Kd {}\n"):
    (folder / "a.mtl").write_text(library.format(image_name))
    text = f"mtllib a.mtl\n{SQUARE}{PLACES}usemtl skin\nf 1/1 2/2 3/3\nf -4/-4 -2/-2 -1/-1\n"
    (folder / "a.obj").write_text(text)
    return open_coloured_surface(str(folder / "a.obj")).colours


def test_corners_of_an_image_are_at_the_corners_of_its_coordinates():
    # v downwards.
    places = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.5, 0.25], [1.25, 0.0], [np.nan, 0]])
    shown = sample_texture(FOUR, places)
    assert shown[:4].tolist() == FOUR.reshape(-1, 3).tolist()
    assert shown[4].tolist() == [127.5, 127.5, 0.0]
    assert shown[5].tolist() == [255, 0, 0]  # the image repeats
    assert np.isnan(shown[6]).all()


def test_obj(tmp_path):
    (tmp_path / "skin of it.png").write_bytes(_png())
    found = _obj(tmp_path, "skin of it.png")
    assert found.vertices.tolist() == EXPECTED and not found.notes


def test_ply(tmp_path):
    (tmp_path / "skin.png").write_bytes(_png())
    rows = "".join(f"{x} {y} 0 {x} {y}\n" for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)))
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\ncomment TextureFile skin.png\nelement vertex 4\n"
        "property float x\nproperty float y\nproperty float z\nproperty float s\n"
        "property float t\nelement face 2\nproperty list uchar int vertex_indices\n"
        f"end_header\n{rows}3 0 1 2\n3 0 2 3\n"
    )
    found = open_coloured_surface(str(tmp_path / "a.ply")).colours
    assert found.vertices.tolist() == EXPECTED and not found.notes


@pytest.mark.parametrize(
    "name", ["none.png", "../a.png", "/etc/passwd", "C:\\a.png", "https://a.b/c.png", "a.mtl", "."]
)
def test_an_image_that_cannot_be_had_is_a_note(tmp_path, name):
    (tmp_path / "in").mkdir()
    (tmp_path / "a.png").write_bytes(_png())
    found = _obj(tmp_path / "in", name)
    assert found.vertices is None and len(found.notes) == 1


def test_a_missing_library_is_a_note(tmp_path):
    (tmp_path / "a.obj").write_text(f"mtllib none.mtl\n{SQUARE}usemtl b\nf 1 2 3\nf 1 3 4\n")
    found = open_coloured_surface(str(tmp_path / "a.obj")).colours
    assert found.vertices is None and "none.mtl" in found.notes[0]


@pytest.mark.skipif(not hasattr(os, "symlink"), reason="there are no links")
def test_a_link_out_of_the_folder_is_refused(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "a.png").write_bytes(_png())
    (tmp_path / "in" / "a.png").symlink_to(tmp_path / "a.png")
    with pytest.raises(ContentError, match="not in the folder"):
        read_texture("a.png", tmp_path / "in")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes")
def test_a_pipe_is_refused(tmp_path):
    os.mkfifo(tmp_path / "a.png")
    with pytest.raises(ContentError, match="not a regular file"):
        read_texture("a.png", tmp_path)


def test_an_image_of_too_many_pixels_is_not_decoded():
    def chunk(kind, data):
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    head = struct.pack(">IIBBBBB", 100_000, 100_000, 8, 2, 0, 0, 0)
    bomb = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"\0" * 9999))
    with pytest.raises(ContentError, match=r"pixels|cannot be read"):
        decode_texture(bomb + chunk(b"IEND", b""), "bomb.png")


@pytest.mark.parametrize("end", [0, 1, 8, 30, 50, -5])
def test_every_kind_of_broken_image_is_a_content_error(end):
    image = np.random.default_rng(0).integers(0, 255, (40, 40, 3)).astype(np.uint8)
    with pytest.raises(ContentError):
        decode_texture(_png(image)[: end if end >= 0 else len(_png(image)) // 2], "a.png")
