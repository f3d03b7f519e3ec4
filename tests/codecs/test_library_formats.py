"""Formats beside PLY, OBJ, STL and GLB, with meshio and trimesh as judges of our codecs."""

from __future__ import annotations

import io

import meshio
import numpy as np
import pytest
import trimesh

from msal_cli.codecs import library_formats as other
from msal_cli.codecs import open_mesh
from msal_cli.errors import MsalError, UnsupportedError
from tests.shapes import cube, grid, noisy, torus

QUADS = np.array(
    [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
)

VARIANTS = [
    ("vtk", {"file_format": "vtk", "binary": True}),
    ("vtk", {"file_format": "vtk", "binary": False}),
    ("vtk", {"file_format": "vtk42", "binary": True}),
    ("vtk", {"file_format": "vtk42", "binary": False}),
    ("vtu", {"binary": True}),
    ("vtu", {"binary": True, "compression": None}),
    ("vtu", {"binary": False}),
    ("msh", {"file_format": "gmsh", "binary": True}),
    ("msh", {"file_format": "gmsh", "binary": False}),
    ("msh", {"file_format": "gmsh22", "binary": True}),
    ("msh", {"file_format": "gmsh22", "binary": False}),
    ("mesh", {}),
    ("meshb", {}),
    ("inp", {}),
    ("avs", {}),
    ("vol", {}),
]
IDS = ["-".join(map(str, (name, *more.values()))) for name, more in VARIANTS]


def written(tmp_path, suffix, more, cells=None, **fields) -> bytes:
    vertices, faces = torus(12, 8)
    if cells is None:
        cells = [("triangle", faces)]
    else:
        vertices, _ = cube()
    path = tmp_path / f"source.{suffix}"
    with np.errstate(all="ignore"):
        meshio.Mesh(vertices, cells, **fields).write(path, **more)
    return path.read_bytes()


@pytest.mark.parametrize(("suffix", "more"), VARIANTS, ids=IDS)
def test_reading_replacing_and_reading_again(tmp_path, suffix, more):
    vertices, faces = torus(12, 8)
    data = written(tmp_path, suffix, more)
    file = open_mesh(data, f"a.{suffix}")
    assert file.format == suffix
    assert np.allclose(file.vertices, vertices, rtol=0, atol=1e-10)
    assert np.array_equal(file.faces, faces)
    assert file.n_polygons == len(faces)
    assert file.faces.dtype == np.int32
    assert file.warnings == ()
    assert file.replaced(file.vertices.copy()) is data
    file.check(data, file.vertices)
    moved = noisy(file.vertices, 1)
    output = file.replaced(moved)
    file.check(output, moved)
    again = open_mesh(output, f"a.{suffix}")
    assert np.allclose(again.vertices, moved, rtol=0, atol=1e-10)
    assert np.array_equal(again.faces, faces)
    path = tmp_path / f"again.{suffix}"
    path.write_bytes(output)
    judged = meshio.read(path)
    assert np.allclose(judged.points, moved, rtol=0, atol=1e-10)
    assert np.array_equal(judged.cells[0].data, faces)
    # Encoding and version stay as they are, and so does the result from run to run.
    assert again.encoding == file.encoding
    assert output[:26] == data[:26]
    assert file.replaced(moved) == output


@pytest.mark.parametrize("suffix", ["vtk", "vtu", "msh", "mesh", "inp", "avs", "vol"])
def test_quads_stay_quads(tmp_path, suffix):
    more = {"file_format": "gmsh"} if suffix == "msh" else {}
    data = written(tmp_path, suffix, more, [("quad", QUADS)])
    file = open_mesh(data, f"a.{suffix}")
    assert file.n_polygons == 6
    assert np.array_equal(file.polygons(), QUADS)
    assert np.array_equal(file.faces, cube()[1])
    moved = noisy(file.vertices)
    again = open_mesh(file.replaced(moved), f"a.{suffix}")
    assert np.array_equal(again.polygons(), QUADS)


def test_mixed_polygons(tmp_path):
    _, faces = cube()
    cells = [("triangle", faces[:4]), ("quad", QUADS[2:])]
    file = open_mesh(written(tmp_path, "vtk", {}, cells), "a.vtk")
    assert file.n_polygons == 8
    assert [len(row) for row in file.polygons()] == [3, 3, 3, 3, 4, 4, 4, 4]
    assert np.array_equal(file.faces, faces)


def test_fields_survive_and_normals_follow(tmp_path):
    vertices, faces = grid()
    height = np.arange(len(vertices)) * 1.5
    up = np.tile([0.0, 0.0, 1.0], (len(vertices), 1))
    path = tmp_path / "a.vtk"
    meshio.Mesh(
        vertices, [("triangle", faces)], {"height": height, "Normals": up}, {"id": [faces[:, 0]]}
    ).write(path)
    file = open_mesh(path.read_bytes(), "a.vtk")
    assert set(file.properties) == {"point.height", "point.Normals", "cell.id"}
    turned = vertices[:, [2, 0, 1]]
    path.write_bytes(file.replaced(turned))
    again = meshio.read(path)
    assert np.array_equal(again.point_data["height"], height)
    assert np.array_equal(again.cell_data["id"][0], faces[:, 0])
    assert np.allclose(again.point_data["Normals"], [1, 0, 0])


def test_volume_cells_are_kept_and_told_of(tmp_path):
    tetra = np.array([[0, 1, 2, 4]])
    cells = [("triangle", cube()[1]), ("tetra", tetra)]
    file = open_mesh(written(tmp_path, "vtk", {}, cells), "a.vtk")
    assert any("1 tetra" in one for one in file.warnings)
    path = tmp_path / "b.vtk"
    path.write_bytes(file.replaced(noisy(file.vertices)))
    assert np.array_equal(meshio.read(path).cells_dict["tetra"], tetra)


def test_encoding_and_precision_stay(tmp_path):
    file = open_mesh(written(tmp_path, "vtk", {"binary": True}), "a.vtk")
    moved = noisy(file.vertices)
    assert file.encoded(moved, "binary", "float64") == file.replaced(moved)
    for encoding, precision in (("ascii", "same"), ("same", "float32")):
        with pytest.raises(UnsupportedError, match=r"stays|cannot be changed"):
            file.encoded(file.vertices, encoding, precision)


def off(vertices, faces, head="OFF") -> bytes:
    lines = [head, f"{len(vertices)} {len(faces)} 0"]
    lines += [" ".join(map(repr, map(float, row))) for row in vertices]
    lines += [" ".join(map(str, (len(row), *row))) for row in faces]
    return "\n".join(lines).encode() + b"\n"


def test_off():
    vertices, faces = torus(10, 6)
    data = off(vertices, faces)
    file = open_mesh(data, "a.off")
    assert np.array_equal(file.vertices, vertices)
    assert np.array_equal(file.faces, faces)
    assert file.replaced(file.vertices.copy()) is data
    moved = noisy(vertices)
    output = file.replaced(moved)
    file.check(output, moved)
    assert np.allclose(open_mesh(output, "a.off").vertices, moved, rtol=0, atol=1e-15)


def test_off_with_colours_and_comments_in_any_letters():
    vertices, faces = cube()
    data = off(vertices, faces, "# caf\xe9\n\nCOFF # made by hand").decode().encode("latin-1")
    file = open_mesh(data, "a.off")
    assert np.array_equal(file.vertices, vertices)
    assert file.replaced(noisy(vertices)).tobytes().startswith(data[: data.index(b"8 12 0")])


def test_unreferenced_and_coincident_vertices_keep_their_places():
    vertices, faces = cube()
    vertices = np.concatenate([[[9, 9, 9]], vertices, vertices[:1], [[7, 7, 7]]]).astype(float)
    file = open_mesh(off(vertices, faces + 1), "a.off")
    assert np.array_equal(file.vertices, vertices)
    assert np.array_equal(open_mesh(file.replaced(vertices + 1), "a.off").vertices, vertices + 1)


def vtk(body: str) -> bytes:
    return f"# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\n{body}".encode()


VERTICES, FACES = cube()
GOOD = off(VERTICES, FACES)
POINTS = "POINTS 3 double\n0 0 0 1 0 0 0 1 0\n"

DAMAGED = {
    "empty.off": (b"", "E_TRUNCATED"),
    "empty.vtk": (b"", "E_TRUNCATED"),
    "cut.off": (GOOD[:60], "E_TRUNCATED"),
    "counts.off": (b"OFF\n999999999999 1 0\n0 0 0\n", "E_TRUNCATED"),
    "words.off": (b"OFF\nthree one none\n", "E_FORMAT"),
    "index.off": (GOOD.replace(b"3 0 2 3", b"3 0 2 88"), "E_INDEX"),
    "no_faces.off": (b"OFF\n1 0 0\n0 0 0\n", "E_NO_FACES"),
    "binary.off": (b"OFF BINARY\n" + bytes(60), "E_UNSUPPORTED"),
    "four.off": (b"4OFF\n1 0 0\n0 0 0 1\n", "E_UNSUPPORTED"),
    "nan.off": (GOOD.replace(b"1.0 0.0 0.0", b"nan 0.0 0.0"), "E_NONFINITE"),
    "noise.off": (bytes(range(256)), "E_FORMAT"),
    "noise.vtk": (bytes(range(256)), "E_FORMAT"),
    "noise.vtu": (bytes(range(256)), "E_FORMAT"),
    "noise.msh": (bytes(range(256)), "E_FORMAT"),
    "noise.mesh": (bytes(range(256)), "E_FORMAT"),
    "noise.meshb": (bytes(range(256)), "E_FORMAT"),
    "noise.inp": (bytes(range(256)), "E_FORMAT"),
    "noise.avs": (bytes(range(256)), "E_FORMAT"),
    "noise.vol": (bytes(range(256)), "E_FORMAT"),
    "header.vtk": (b"# vtk DataFile Version 3.0\n", "E_FORMAT"),
    "points.vtk": (vtk(POINTS), "E_NO_FACES"),
    "index.vtk": (vtk(POINTS + "CELLS 1 4\n3 0 1 7\nCELL_TYPES 1\n5\n"), "E_INDEX"),
    "negative.vtk": (vtk(POINTS + "CELLS 1 4\n3 0 1 -1\nCELL_TYPES 1\n5\n"), "E_INDEX"),
    "tetra.vtk": (
        vtk("POINTS 4 double\n0 0 0 1 0 0 0 1 0 0 0 1\nCELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\n"),
        "E_NO_FACES",
    ),
    "curved.vtk": (
        vtk(
            "POINTS 6 double\n0 0 0 1 0 0 0 1 0 .5 0 0 .5 .5 0 0 .5 0\n"
            "CELLS 1 7\n6 0 1 2 3 4 5\nCELL_TYPES 1\n22\n"
        ),
        "E_UNSUPPORTED",
    ),
    "nan.vtk": (
        vtk(POINTS.replace("1 0 0", "nan 0 0") + "CELLS 1 4\n3 0 1 2\nCELL_TYPES 1\n5\n"),
        "E_NONFINITE",
    ),
    "xml.vtu": (b"<?xml version='1.0'?><VTKFile type='UnstructuredGrid'></VTKFile>", "E_FORMAT"),
    "flat.mesh": (
        b"MeshVersionFormatted 2\nDimension 2\nVertices\n3\n0 0 1\n1 0 1\n0 1 1\n"
        b"Triangles\n1\n1 2 3 1\nEnd\n",
        "E_UNSUPPORTED",
    ),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_files_and_their_errors(name, capfd):
    data, code = DAMAGED[name]
    with pytest.raises(MsalError) as caught:
        open_mesh(data, name)
    assert caught.value.code == code
    assert capfd.readouterr() == ("", "")


def test_what_can_be_written_can_be_read_and_the_other_way_round(monkeypatch):
    pytest.importorskip("h5py")
    assert set(other.writable()) == {*other.readable(), "glb"}
    monkeypatch.setattr(other.importlib.util, "find_spec", lambda name: None)
    assert {*other.readable(), "glb"} - set(other.writable()) == {"med"}


def test_trimesh_reads_our_off():
    file = open_mesh(GOOD, "a.off")
    moved = noisy(VERTICES)
    mesh = trimesh.load_mesh(io.BytesIO(file.replaced(moved)), file_type="off", process=False)
    assert np.allclose(mesh.vertices, moved, rtol=0, atol=1e-7)
    assert np.array_equal(mesh.faces, FACES)
