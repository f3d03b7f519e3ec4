"""Conversion between formats: what goes across and what is named as lost."""

import io

import meshio
import numpy as np
import pytest
import trimesh

from msal_cli.codecs import open_mesh
from msal_cli.codecs.conversion import convert, stale_warnings
from msal_cli.codecs.detection import WRITABLE
from msal_cli.errors import UnsupportedError
from tests.codecs import plain_stl
from tests.codecs.patching import polygons_of
from tests.codecs.plain_obj import written as obj
from tests.ply_files import XYZ, to_ascii_ply
from tests.shapes import cube, noisy, torus

QUADS = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]


def reopened(data, to):
    return open_mesh(bytes(data), f"output.{to}")


def corners(file) -> np.ndarray:
    return file.vertices[file.faces.reshape(-1)]


@pytest.mark.parametrize("to", WRITABLE)
def test_every_target_holds_the_same_triangles(to):
    vertices, faces = torus(12, 8)
    source = open_mesh(obj(vertices, faces), "a.obj")
    moved = noisy(vertices)
    data, losses = convert(source, moved, to)
    again = reopened(data, to)
    tolerance = 1e-6 if to in ("stl", "glb", "gltf") else 1e-11
    assert np.allclose(corners(again), moved[faces.reshape(-1)], rtol=0, atol=tolerance)
    assert len(again.vertices) == len(vertices)
    assert again.merged_vertices == (3 * len(faces) - len(vertices) if to == "stl" else 0)
    assert losses == (("vertex identity (STL stores corners)",) if to == "stl" else ())


def test_readers_of_other_people(tmp_path):
    vertices, faces = torus(12, 8)
    source = open_mesh(obj(vertices, faces), "a.obj")
    for to in ("ply", "stl", "off", "obj", "glb"):
        data = bytes(convert(source, vertices, to)[0])
        scene = trimesh.load_scene(io.BytesIO(data), file_type=to, process=False)
        (mesh,) = scene.geometry.values()
        assert np.allclose(mesh.triangles.reshape(-1, 3), vertices[faces.reshape(-1)], atol=1e-6)
    for to in ("ply", "off", "vtk", "vtu"):
        path = tmp_path / f"a.{to}"
        path.write_bytes(convert(source, vertices, to)[0])
        mesh = meshio.read(path)
        assert np.allclose(mesh.points, vertices, atol=1e-12)
        assert np.array_equal(mesh.cells[0].data, faces)


@pytest.mark.parametrize(("to", "encoding"), [("ply", "same"), ("ply", "ascii"), ("obj", "same")])
def test_polygons_stay_where_the_target_has_them(to, encoding):
    vertices, _ = cube()
    mixed = [*QUADS[:3], QUADS[3][:3], (QUADS[3][0], *QUADS[3][2:]), *QUADS[4:]]
    for polygons in (QUADS, mixed, [tuple(range(8))]):
        source = open_mesh(obj(vertices, polygons), "a.obj")
        data, losses = convert(source, vertices, to, encoding)
        assert losses == ()
        again = reopened(data, to)
        assert [tuple(row) for row in polygons_of(again)] == polygons
        assert np.array_equal(again.faces, source.faces)
        assert np.array_equal(again.vertices, vertices)


def test_soup_becomes_an_indexed_mesh():
    vertices, faces = cube()
    data = plain_stl.binary(vertices[faces].reshape(-1, 9), header=b"COLOR=\xff")
    source = open_mesh(data, "a.stl")
    moved = source.vertices * 1.5 - 0.25
    for to in ("ply", "obj", "off", "glb", "vtk", "stl"):
        output, losses = convert(source, moved, to, "ascii" if to == "stl" else "same")
        again = reopened(output, to)
        assert len(again.vertices) == 8
        assert np.array_equal(corners(again), moved[source.faces].reshape(-1, 3))
        assert losses == ("colour in the header", "header text")


COLOURS = np.arange(24).reshape(8, 3) * 10


def coloured(kind: str = "uchar") -> bytes:
    vertices, faces = cube()
    colours = COLOURS if kind == "uchar" else COLOURS / 255
    rows = [" ".join(map(str, (*v, *c))) for v, c in zip(vertices, colours, strict=True)]
    names = [f"{kind} {name}" for name in ("red", "green", "blue")]
    return to_ascii_ply([*XYZ, *names], rows, faces, "made")


@pytest.mark.parametrize("kind", ["uchar", "float"])
def test_vertex_colours_go_across_and_back_or_are_named(kind):
    source = open_mesh(coloured(kind), "a.ply")
    for to in ("stl", "off", "vtk"):
        names = {f"vertex.{name} {kind}" for name in ("red", "green", "blue")}
        assert names <= set(convert(source, source.vertices, to)[1])
    for to in ("obj", "glb", "gltf"):
        data, losses = convert(source, source.vertices, to)
        middle = reopened(data, to)
        back, more = convert(middle, middle.vertices, "ply")
        assert (losses, more) == (("comments",), ()) and b"alpha" not in bytes(back)
        mesh = trimesh.load_mesh(io.BytesIO(bytes(back)), file_type="ply", process=False)
        assert np.array_equal(mesh.visual.vertex_colors[:, :3], COLOURS)
    glb, _ = convert(source, source.vertices, "glb")
    (part,) = trimesh.load_scene(io.BytesIO(glb), file_type="glb").geometry.values()
    assert np.array_equal(np.unique(part.visual.vertex_colors[:, :3], axis=0), COLOURS)


def test_vertex_normals_go_across():
    vertices, faces = torus(12, 8)
    text = obj(vertices, [], "\n".join(["vn 0 0 1"] * 96))
    text += "".join(
        "f " + " ".join(f"{i + 1}//{i + 1}" for i in row) + "\n" for row in faces
    ).encode()
    source = open_mesh(text, "a.obj")
    data, losses = convert(source, vertices, "ply")
    assert losses == () and b"property float nx" in bytes(data)[:400]
    mesh = trimesh.load_mesh(io.BytesIO(bytes(data)), file_type="ply", process=False)
    ring = vertices * [1, 1, 0]
    outward = vertices - 3 * ring / np.linalg.norm(ring, axis=1, keepdims=True)
    assert (np.einsum("ij,ij->i", mesh.vertex_normals, outward) > 0.95).all()
    middle = reopened(data, "ply")
    back, losses = convert(middle, middle.vertices, "obj")
    assert losses == () and b"vn " in bytes(back) and b"f 1//1 " in bytes(back)
    assert np.array_equal(reopened(back, "obj").faces, faces)
    assert "vertex.nx float" in convert(middle, middle.vertices, "vtk")[1]


def test_everything_else_is_named():
    more = "mtllib a.mtl\nvt 0 0\nusemtl skin\ng part\ns 1\nv 0 0 inf\n # x\nf 1 2"
    text = obj(cube()[0], QUADS, more)
    text = text.replace(b"f 1 3 4", b"f 1/1 3/1 4/1")
    source = open_mesh(text, "a.obj")
    named = {"texture coordinates", "materials", "groups", "smoothing groups", "comments"}
    named.add("1 face of fewer than three corners (first in line 16)")
    for to in ("ply", "off", "glb", "vtk"):
        data, losses = convert(source, source.vertices, to)
        more = ["positions that are not finite"] * (to != "ply")
        more += ["polygons (triangulated)"] * (to in ("glb", "vtk"))
        assert set(losses) == named.union(more)
        again = reopened(data, to)
        assert again.n_polygons == len(again.faces) - len(QUADS) * (to in ("ply", "off"))
        assert ("without a finite position" in "".join(again.warnings)) == (to == "ply")
        assert np.allclose(corners(again), corners(source))
        assert stale_warnings(source, to, "same", "same") == list(source.warnings)
    for alpha, lost in (255, ()), (7, ("alpha of the vertex colours",)):
        names = [*XYZ, "uchar red", "uchar green", "uchar blue", "uchar alpha"]
        data = to_ascii_ply(names, [f"{x} {x * x} 0 1 2 3 {alpha}" for x in range(3)])
        source = open_mesh(data, "a.ply")
        assert convert(source, source.vertices, "obj")[1] == lost


def test_digits_that_float32_ruins_are_named():
    vertices, faces = cube()
    far = open_mesh(obj(vertices + [4_650_000.123, 0, 0], faces), "a.obj")
    (_, lost) = convert(far, far.vertices, "stl")[1]
    assert "0.5 units" in lost
    near = open_mesh(obj(vertices, faces), "a.obj")
    assert len(convert(near, near.vertices, "stl")[1]) == 1
    assert convert(far, far.vertices, "stl", "ascii")[1] == convert(near, vertices, "stl")[1]


@pytest.mark.parametrize(
    ("to", "encoding", "precision"),
    [
        ("obj", "binary", "same"), ("off", "binary", "same"), ("glb", "ascii", "same"),
        ("glb", "same", "float64"), ("stl", "binary", "float64"), ("vtp", "ascii", "same"),
        ("fbx", "same", "same"), ("", "same", "same"),
    ],
)  # fmt: skip
def test_what_no_format_has_is_refused(to, encoding, precision):
    source = open_mesh(coloured(), "a.ply") if to == "obj" else open_mesh(obj(*cube()), "a.obj")
    with pytest.raises(UnsupportedError) as caught:
        convert(source, source.vertices, to, encoding, precision)
    assert caught.value.hint
