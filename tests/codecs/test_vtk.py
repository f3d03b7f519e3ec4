"""VTK's legacy files, and what meshio writes and reads of them and of VTU."""

from __future__ import annotations

import meshio
import numpy as np
import pytest

from msal_cli.codecs import open_mesh
from tests.codecs.patching import changed_lines, patched, texts_between_numbers
from tests.shapes import grid, noisy, torus

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [1, 0, 1]], dtype=float)
CODES = {"float": ">f4", "double": ">f8", "int": ">i4", "vtktypeint64": ">i8", "char": ">i1"}


def numbers(values, kind: str, is_text: bool) -> bytes:
    values = np.asarray(values)
    if is_text:
        return " ".join(str(one) for one in values.reshape(-1).tolist()).encode() + b"\n"
    return values.astype(CODES[kind]).tobytes() + b"\n"


class Writer:
    """A file put together piece by piece, as text or binary."""

    def __init__(self, is_text: bool, dataset: str, version: str = "4.2") -> None:
        word = "ASCII" if is_text else "BINARY"
        self.is_text = is_text
        self.data = (
            f"# vtk DataFile Version {version}\na title\n{word}\nDATASET {dataset}\n".encode()
        )

    def add(self, line: str, values=(), kind: str = "int") -> Writer:
        self.data += line.encode() + b"\n"
        if len(values):
            self.data += numbers(values, kind, self.is_text)
        return self

    def points(self, values=POINTS, kind: str = "double") -> Writer:
        return self.add(f"POINTS {len(values)} {kind}", values, kind)


def counted(rows) -> list[int]:
    return [number for row in rows for number in (len(row), *row)]


ENCODINGS = pytest.mark.parametrize("is_text", [True, False], ids=["ascii", "binary"])


@ENCODINGS
@pytest.mark.parametrize("kind", ["float", "double"])
def test_polygonal_data(is_text, kind):
    rows = [[0, 1, 3, 2], [0, 1, 5, 4], [1, 3, 5]]
    writer = Writer(is_text, "POLYDATA").points(kind=kind)
    writer.add("VERTICES 1 2", [1, 0]).add("LINES 1 3", [2, 0, 1])
    writer.add("POLYGONS 3 14", counted(rows))
    file, moved, output = patched(writer.data, "a.vtk")
    assert [one.tolist() for one in file.polygons()] == rows
    assert len(file.faces) == 5
    assert file.encoding == ("ascii" if is_text else "binary_big_endian")
    assert file.precision == {"float": "float32", "double": "float64"}[kind]
    if is_text:
        assert changed_lines(writer.data, output) == [5]
    else:
        at = writer.data.index(b"POINTS 6 ") + len(f"POINTS 6 {kind}\n")
        size = POINTS.size * np.dtype(CODES[kind]).itemsize
        assert output[:at] == writer.data[:at]
        assert output[at + size :] == writer.data[at + size :]
        assert np.array_equal(
            np.frombuffer(output[at : at + size], CODES[kind]).reshape(-1, 3),
            moved.astype(CODES[kind]),
        )


@ENCODINGS
def test_strips_become_triangles_that_face_one_way(is_text):
    writer = Writer(is_text, "POLYDATA", "3.0").points()
    writer.add("TRIANGLE_STRIPS 1 6", [5, 0, 1, 2, 3, 4])
    file, _, _ = patched(writer.data, "a.vtk")
    assert file.faces.tolist() == [[0, 1, 2], [2, 1, 3], [2, 3, 4]]
    assert file.warnings == ("1 triangle strips are read as triangles, and kept",)


@ENCODINGS
@pytest.mark.parametrize("version", ["2.0", "5.1"])
def test_unstructured_grids_with_pixels_and_volumes(is_text, version):
    cells = [[0, 1, 2, 3], [0, 1, 3], [0, 1, 2, 4], [0, 1], [0, 1, 5, 4], [2, 3, 0, 1, 4]]
    types = [8, 5, 10, 3, 9, 7]
    writer = Writer(is_text, "UNSTRUCTURED_GRID", version).points()
    if version == "5.1":
        offsets = np.cumsum([0, *map(len, cells)])
        writer.add(f"CELLS {len(offsets)} {offsets[-1]}")
        writer.add("OFFSETS vtktypeint64", offsets, "vtktypeint64")
        writer.add("CONNECTIVITY vtktypeint64", np.concatenate(cells), "vtktypeint64")
    else:
        writer.add(f"CELLS {len(cells)} {len(counted(cells))}", counted(cells))
    writer.add(f"CELL_TYPES {len(types)}", types)
    file, _, _ = patched(writer.data, "a.vtk")
    assert [one.tolist() for one in file.polygons()] == [[0, 1, 3, 2], [0, 1, 3], *cells[4:]]
    assert file.warnings == ("other cells (1 tetra) are kept; their corners move with the surface",)


@ENCODINGS
def test_a_structured_grid_of_one_layer(is_text):
    x, y = np.meshgrid(np.arange(3.0), np.arange(4.0))
    points = np.stack([x, y, x * y], axis=-1).reshape(-1, 3)
    writer = Writer(is_text, "STRUCTURED_GRID").add("DIMENSIONS 3 4 1").points(points)
    file, _, _ = patched(writer.data, "a.vtk")
    assert file.n_polygons == 6
    assert file.polygons()[0].tolist() == [0, 1, 4, 3]


@ENCODINGS
def test_attributes_stay_and_normals_follow(is_text):
    vertices, faces = grid()
    n, m = len(vertices), len(faces)
    writer = Writer(is_text, "POLYDATA", "5.1")
    writer.add("FIELD FieldData 1").add("TIME 1 1 double", [1.5], "double")
    writer.add("METADATA\nINFORMATION 0\n\n"[:-1]).points(vertices)
    writer.add("METADATA\nINFORMATION 1\nNAME L2_NORM LOCATION vtkDataArray\nDATA 2 0 1\n")
    writer.add(f"POLYGONS {m + 1} {3 * m}")
    writer.add("OFFSETS vtktypeint64", 3 * np.arange(m + 1), "vtktypeint64")
    writer.add("CONNECTIVITY vtktypeint64", faces, "vtktypeint64")
    writer.add(f"CELL_DATA {m}").add("SCALARS id int 1\nLOOKUP_TABLE default", np.arange(m))
    writer.add(f"POINT_DATA {n}").add("SCALARS h float\nLOOKUP_TABLE t", np.arange(n), "float")
    writer.add("LOOKUP_TABLE t 1", [1, 2, 3, 4], "char")
    writer.add("NORMALS up float", np.tile([0.0, 0.0, 2.0], (n, 1)), "float")
    writer.add("VECTORS v double", vertices, "double")
    writer.add("FIELD more 1").add(f"w 2 {n} float", np.zeros(2 * n), "float")
    turned = vertices[:, [2, 0, 1]]
    file, _, output = patched(writer.data, "a.vtk", np.r_[turned[:-1], vertices[-1:]])
    assert file.warnings == ()
    assert file.properties == (
        "field TIME", "cell.id", "point.h", "point.t", "point.up", "point.v", "point.w"
    )  # fmt: skip
    if is_text:
        lines = output.splitlines()
        row = lines[lines.index(b"NORMALS up float") + 1].split()
        assert np.allclose(np.array(row[:3], dtype=float), [1, 0, 0], atol=1e-6)
        assert texts_between_numbers(output) == texts_between_numbers(writer.data)
        assert len(changed_lines(writer.data, output)) == 2
    else:
        at = output.index(b"NORMALS up float\n") + len(b"NORMALS up float\n")
        assert np.frombuffer(output[at : at + 12], ">f4").tolist() == [1, 0, 0]
        assert output[at + 12 * n :] == writer.data[at + 12 * n :]


def test_strings_in_binary_files_are_passed():
    vertices, faces = grid()
    writer = Writer(False, "POLYDATA").points(vertices)
    writer.add(f"POLYGONS {len(faces)} {4 * len(faces)}", counted(faces.tolist()))
    writer.add("POINT_DATA " + str(len(vertices))).add("FIELD f 2")
    writer.add(f"names 1 {len(vertices)} string")
    for k in range(len(vertices)):
        text = b"x" * (k % 3) if k else b"y" * 100
        length = bytes([0xC0 | len(text)]) if len(text) < 64 else bytes([0x80, len(text)])
        writer.data += length + text
    writer.data += b"\n"
    writer.add(f"Normals 3 {len(vertices)} float", np.tile([0, 0, 1], (len(vertices), 1)), "float")
    file = open_mesh(writer.data, "a.vtk")
    assert file.properties == ("point.names", "point.Normals")
    assert file.warnings == ()


def grid_of(cells, types, points=POINTS) -> bytes:
    writer = Writer(True, "UNSTRUCTURED_GRID").points(points)
    writer.add(f"CELLS {len(cells)} {len(counted(cells))}", counted(cells))
    return writer.add(f"CELL_TYPES {len(types)}", types).data


TRIANGLE = grid_of([[0, 1, 2]], [5])

DAMAGED = {
    "empty.vtk": (b"", "E_TRUNCATED"),
    "points.vtk": (Writer(True, "UNSTRUCTURED_GRID").points().data, "E_NO_FACES"),
    "curved.vtk": (grid_of([[0, 1, 2, 3, 4, 5]], [22]), "E_UNSUPPORTED"),
    "index.vtk": (grid_of([[0, 1, 9]], [5]), "E_INDEX"),
    "nan.vtk": (grid_of([[0, 1, 2]], [5], POINTS * np.nan), "E_NONFINITE"),
    "corners.vtk": (grid_of([[0, 1, 2, 3]], [5]), "E_FORMAT"),
    "kinds.vtk": (grid_of([[0, 1, 2]], [5, 5]), "E_FORMAT"),
    "int.vtk": (TRIANGLE.replace(b"POINTS 6 double", b"POINTS 6 int"), "E_UNSUPPORTED"),
    "cells.vtk": (TRIANGLE.replace(b"CELLS 1 4", b"CELLS 2 4"), "E_FORMAT"),
    "many points.vtk": (TRIANGLE.replace(b"POINTS 6 ", b"POINTS 99999999999 "), "E_TRUNCATED"),
    "cut.vtk": (Writer(False, "POLYDATA").points().data[:-9], "E_TRUNCATED"),
    "many.vtk": (Writer(False, "POLYDATA").add("POINTS 99999999999 float").data, "E_TRUNCATED"),
    "image.vtk": (
        Writer(True, "STRUCTURED_POINTS").add("DIMENSIONS 2 2 1").data, "E_UNSUPPORTED",
    ),
    "no points.vtk": (
        Writer(True, "POLYDATA").add("POLYGONS 1 4", [3, 0, 1, 2]).data, "E_FORMAT",
    ),
}  # fmt: skip


MESHIO = [
    ("vtk", {"file_format": "vtk", "binary": True}),
    ("vtk", {"file_format": "vtk", "binary": False}),
    ("vtk", {"file_format": "vtk42", "binary": True}),
    ("vtk", {"file_format": "vtk42", "binary": False}),
    ("vtu", {"binary": True}),
    ("vtu", {"binary": True, "compression": None}),
    ("vtu", {"binary": False}),
]


@pytest.mark.parametrize(("suffix", "more"), MESHIO)
def test_meshio_reads_what_became_of_its_files(tmp_path, suffix, more):
    vertices, faces = torus(12, 8)
    path = tmp_path / f"a.{suffix}"
    meshio.Mesh(vertices, [("triangle", faces)]).write(path, **more)
    file = open_mesh(path.read_bytes(), path.name)
    assert np.allclose(file.vertices, vertices, rtol=0, atol=1e-10)
    assert np.array_equal(file.faces, faces)
    moved = noisy(file.vertices, 1)
    path.write_bytes(file.replaced(moved))
    judged = meshio.read(path)
    assert np.allclose(judged.points, moved, rtol=0, atol=1e-10)
    assert np.array_equal(judged.cells[0].data, faces)
