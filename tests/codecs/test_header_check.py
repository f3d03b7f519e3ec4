"""Large files that lie: refused by their size and beginning, before they are loaded."""

from __future__ import annotations

import gzip
import struct
import tracemalloc

import pytest

from msal_cli.codecs import header as first_look
from msal_cli.codecs import open_mesh
from msal_cli.codecs.header import read_input
from msal_cli.errors import InputError, MsalError
from msal_cli.job import inspection
from tests.codecs import plain_glb, plain_ply, plain_stl
from tests.job.test_pipeline import WRITERS
from tests.shapes import grid, torus

GIGABYTE = 10**9
VERTICES = "element vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
FACES = "element face {}\nproperty list uchar int vertex_indices\n"


def ply_header(encoding: str, n_vertices: int = 4, n_faces: int = 1) -> bytes:
    lines = f"ply\nformat {encoding} 1.0\n" + VERTICES.format(n_vertices) + FACES.format(n_faces)
    return (lines + "end_header\n").encode()


def glb_header(length: int, json_bytes: int) -> bytes:
    return struct.pack("<4sIIII", b"glTF", 2, length, json_bytes, 0x4E4F534A) + b'{"a":1}'


BINARY = "binary_little_endian"
TEXT = ply_header("ascii") + b"0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n"

# name: beginning, size of the sparse file, code, a word of the message
LIES = {
    "endless header.ply": (b"ply\nformat ascii 1.0\ncomment ", GIGABYTE, "E_TOO_LARGE", "65536"),
    "endless comments.ply": (
        b"ply\nformat ascii 1.0\n" + b"comment a\n" * 9_000, GIGABYTE, "E_TOO_LARGE", "1000 lines",
    ),
    "10^12 vertices.ply": (ply_header(BINARY, 10**12), GIGABYTE, "E_TRUNCATED", "at the least"),
    "10^12 lines.ply": (ply_header("ascii", 10**12), GIGABYTE, "E_TRUNCATED", "at the least"),
    "2^64-1 faces.ply": (ply_header(BINARY, 4, 2**64 - 1), GIGABYTE, "E_TRUNCATED", "at the least"),
    "2^70 vertices.ply": (ply_header(BINARY, 2**70), GIGABYTE, "E_FORMAT", "whole number"),
    "-1 vertices.ply": (ply_header(BINARY, -1), GIGABYTE, "E_FORMAT", "whole number"),
    "four vertices.ply": (ply_header(BINARY), GIGABYTE, "E_TOO_LARGE", "at the most"),
    "text and a hole.ply": (TEXT, GIGABYTE, "E_FORMAT", "hole"),
    "2^32-1 facets.stl": (bytes(80) + b"\xff" * 4, GIGABYTE, "E_TRUNCATED", "4294967295 facets"),
    "one facet.stl": (bytes(80) + b"\1\0\0\0", GIGABYTE, "E_TOO_LARGE", "at the most"),
    "text and a hole.stl": (b"solid a\nfacet normal 0 0 1\n" * 99, GIGABYTE, "E_FORMAT", "hole"),
    "length.glb": (glb_header(2**32 - 1, 8), GIGABYTE, "E_TRUNCATED", "4294967295"),
    "JSON beyond.glb": (glb_header(1000, 2**32 - 1), GIGABYTE, "E_TRUNCATED", "4294967315"),
    "huge JSON.glb": (
        glb_header(GIGABYTE, GIGABYTE - 20), GIGABYTE, "E_TOO_LARGE", "description",
    ),
    "short.glb": (glb_header(28, 8), GIGABYTE, "E_TOO_LARGE", "at the most"),
    "binary.obj": (b"v 0 0 0\n\1", GIGABYTE, "E_FORMAT", "control"),
    "text and a hole.obj": (b"v 0 0 0\n" * 9999, GIGABYTE, "E_FORMAT", "hole"),
    "member and a hole.ply.gz": (gzip.compress(TEXT, mtime=0), GIGABYTE, "E_FORMAT", "hole"),
    "larger than memory.ply": (ply_header(BINARY), 10**13, "E_TOO_LARGE", "memory"),
    "larger than memory.off": (b"OFF\n", 10**13, "E_TOO_LARGE", "memory"),
    "larger than memory.ply.gz": (b"\x1f\x8b\x08", 10**13, "E_TOO_LARGE", "memory"),
}  # fmt: skip


def sparse(path, beginning: bytes, size: int) -> str:
    """A file that takes no room on the disk however large it is."""
    with path.open("wb") as file:
        file.write(beginning)
        try:
            file.truncate(size)
        except OSError:
            pytest.skip("this file system has no files so large")
    if path.stat().st_blocks * 512 > max(1 << 20, 2 * len(beginning)):
        pytest.skip("this file system has no sparse files")
    return str(path)


@pytest.mark.parametrize("name", LIES)
def test_a_lie_is_refused_before_it_is_loaded(name, tmp_path):
    beginning, size, code, word = LIES[name]
    path = sparse(tmp_path / name, beginning, size)
    tracemalloc.start()
    with pytest.raises(InputError, match=word) as caught:
        read_input(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert caught.value.code == code
    assert caught.value.hint or "whole number" in word
    assert peak < 10_000_000


@pytest.mark.parametrize("name", ["2^32-1 facets.stl", "10^12 vertices.ply"])
def test_the_way_of_a_file_begins_with_a_look(name, tmp_path):
    path = sparse(tmp_path / name, *LIES[name][:2])
    record = inspection.inspect_file(path)
    assert record.error is not None and record.error.code == "E_TRUNCATED"


def whole_files():
    vertices, faces = torus(60, 40)
    for name, writer in WRITERS.items():
        yield name, writer(vertices, faces)
    yield "quads.ply", plain_ply.written(plain_ply.cube("binary_big_endian", "double"))
    yield "part.stl", plain_stl.text(vertices[faces].reshape(-1, 9)).encode()


@pytest.mark.parametrize(("name", "data"), list(whole_files()), ids=lambda one: str(one)[:12])
def test_whole_files_pass(name, data, tmp_path, monkeypatch):
    monkeypatch.setattr(first_look, "LOOKED_AT", 512)
    monkeypatch.setattr(first_look, "MAX_BEHIND", 64)
    path = tmp_path / name
    path.write_bytes(data)
    assert read_input(path) == data
    if name == "scan.obj":
        return  # half of it is a mesh too
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(MsalError):
        open_mesh(read_input(path), name)


def test_bytes_behind_the_mesh_are_carried_along_within_reason(tmp_path, monkeypatch):
    monkeypatch.setattr(first_look, "LOOKED_AT", 512)
    monkeypatch.setattr(first_look, "MAX_BEHIND", 2_000)
    vertices, faces = grid(8, 8)
    for name in ("a.stl", "a.ply", "a.glb"):
        writer = {
            "a.stl": lambda: plain_stl.binary(vertices[faces].reshape(-1, 9)),
            "a.ply": lambda: WRITERS["scan.ply"](vertices, faces),
            "a.glb": lambda: _glb(vertices, faces),
        }[name]
        path = tmp_path / name
        path.write_bytes(writer() + bytes(1_500))
        assert open_mesh(read_input(path), name).n_polygons == len(faces)
        path.write_bytes(writer() + bytes(10**6))
        with pytest.raises(MsalError) as caught:
            read_input(path)
        assert caught.value.code == "E_TOO_LARGE"


def _glb(vertices, faces) -> bytes:
    scene = plain_glb.Scene()
    at = scene.positions(vertices)
    indices = scene.accessor(faces.reshape(-1), "<u2", "SCALAR")
    scene.mesh({"attributes": {"POSITION": at}, "indices": indices})
    return scene.data()


def test_what_cannot_be_opened_is_an_error_of_reading(tmp_path):
    for path in (tmp_path / "missing.ply", tmp_path, "a\0b.ply"):
        with pytest.raises(InputError) as caught:
            read_input(path)
        assert caught.value.code == "E_READ"
