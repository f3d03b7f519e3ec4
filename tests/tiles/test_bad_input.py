"""Faults in a file that is read in pieces: named with their place, and nothing is left behind."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from tests.cli.scans import msal
from tests.tiles import mesh_files
from tests.tiles.test_any_mesh import by_tiles, in_memory, settings

VERTICES, FACES = mesh_files.scan()
N, M = len(VERTICES), len(FACES)


def with_face(face) -> bytes:
    """The mesh with another last face."""
    return mesh_files.ply(VERTICES, [*FACES.tolist()[:-1], face])


def with_vertex(number: int, value: float, kind: str = "f4") -> bytes:
    """The mesh with another last coordinate of a vertex."""
    vertices = VERTICES.copy()
    vertices[number, 2] = value
    return mesh_files.ply(vertices, FACES, kind=kind)


def with_header(old: str, new: str) -> bytes:
    """The mesh with another header."""
    data = mesh_files.ply(VERTICES, FACES)
    assert data.count(old.encode()) == 1
    return data.replace(old.encode(), new.encode())


def stl_with(number: int, value: float) -> bytes:
    """The mesh as STL, another last coordinate of a facet."""
    data = bytearray(mesh_files.stl(VERTICES, FACES))
    struct.pack_into("<f", data, 84 + 50 * number + 44, value)
    return bytes(data)


GOOD = mesh_files.ply(VERTICES, FACES)
POLYGONS = mesh_files.ply(VERTICES, mesh_files.polygons_of(VERTICES))
STL = mesh_files.stl(VERTICES, FACES)
BAD = {
    "index beyond the end": (".ply", with_face([0, 1, N]), "E_INDEX", f"face {M - 1}"),
    "negative index": (".ply", with_face([0, -1, 2]), "E_INDEX", f"face {M - 1}"),
    "nan in the last vertex": (".ply", with_vertex(N - 1, np.nan), "E_NONFINITE", str(N - 1)),
    "infinity": (".ply", with_vertex(N - 1, -np.inf), "E_NONFINITE", str(N - 1)),
    "nan, float64": (".ply", with_vertex(200, np.nan, "f8"), "E_NONFINITE", "200"),
    "too far": (".ply", with_vertex(200, 1e61, "f8"), "E_RANGE", ""),
    "cut in the last face": (".ply", GOOD[:-1], "E_TRUNCATED", ""),
    "cut in the faces": (".ply", GOOD[:-5000], "E_TRUNCATED", ""),
    "cut in the vertices": (".ply", GOOD[:2000], "E_TRUNCATED", ""),
    "cut polygons": (".ply", POLYGONS[:-3], "E_TRUNCATED", ""),
    "more faces than there are": (
        ".ply", with_header(f"face {M}", f"face {M + 1}"), "E_TRUNCATED", ""
    ),
    "more vertices than there are": (
        ".ply", with_header(f"vertex {N}", f"vertex {N + 9000}"), "E_TRUNCATED", ""
    ),
    "a wild count of corners": (
        ".ply", GOOD[:-13] + b"\xff" + GOOD[-12:], "E_TRUNCATED", f"face {M - 1}"
    ),
    "no faces": (".ply", mesh_files.ply(VERTICES, []), "E_NO_FACES", ""),
    "useless faces only": (".ply", mesh_files.ply(VERTICES, [[1, 1, 2]] * 9), "E_NO_FACES", ""),
    "stl, nan": (".stl", stl_with(M - 1, np.nan), "E_NONFINITE", ""),
    "stl, cut": (".stl", STL[:-7], "E_TRUNCATED", ""),
}  # fmt: skip
"""By the fault: suffix, bytes, code, and what the error must say of the place."""


@pytest.mark.parametrize("name", BAD)
def test_a_fault_is_named_with_its_place(name, tmp_path):
    suffix, data, code, place = BAD[name]
    source = tmp_path / f"scan{suffix}"
    source.write_bytes(data)
    expected = in_memory(source, settings()).error
    error = by_tiles(source, settings(), 60, 101)
    assert (error.code, expected.code) == (code, code)
    assert place in f"{error.where} {error.message}"
    assert error.message == expected.message
    assert sorted(one.name for one in tmp_path.iterdir()) == [source.name]


@pytest.mark.parametrize("at", range(0, len(GOOD), 601))
def test_every_prefix_is_refused(at, tmp_path):
    source = tmp_path / "scan.ply"
    source.write_bytes(GOOD[:at])
    expected = in_memory(source, settings()).error
    assert by_tiles(source, settings(), 60, 101).code == expected.code


def test_a_list_among_the_properties_of_vertices_is_refused_or_read(tmp_path):
    source = tmp_path / "scan.ply"
    header, _, body = GOOD.partition(b"end_header\n")
    element = f"element face {M}".encode()
    header = header.replace(element, b"property list uchar int neighbours\n" + element)
    size = 12 * N
    rows = [body[at : at + 12] + b"\x01" + bytes(4) for at in range(0, size, 12)]
    source.write_bytes(header + b"end_header\n" + b"".join(rows) + body[size:])
    error = by_tiles(source, settings(), 60, 101)
    assert error.code == "E_UNSUPPORTED"
    assert "list" in error.message


@pytest.mark.parametrize("name", ["index beyond the end", "stl, nan"])
def test_the_command_leaves_nothing_behind(name, tmp_path):
    suffix, data, code, _ = BAD[name]
    source = tmp_path / f"scan{suffix}"
    source.write_bytes(data)
    made = msal("denoise", source, "-o", tmp_path / f"out{suffix}", "--tiled")
    assert made.exit_code == 1
    assert code in made.stderr and "Traceback" not in made.stderr
    assert sorted(one.name for one in tmp_path.iterdir()) == [source.name]
