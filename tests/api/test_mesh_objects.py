"""Objects of other mesh libraries: the same type back, a copy with everything kept."""

import copy
import sys
import types

import meshio
import numpy as np
import pytest
import trimesh

import msal_cli as msal
from msal_cli.mesh import prepare_mesh
from tests.shapes import noisy, torus

VERTICES, FACES = torus(40, 20)
VERTICES = noisy(VERTICES, 3, 0.15)
QUADS = FACES.reshape(-1, 6)[:, [0, 1, 2, 5]]
TRUST = np.linspace(0.0, 1.0, len(VERTICES))
RNG = np.random.default_rng(5)
COLOURS = RNG.integers(0, 255, (len(VERTICES), 4)).astype(np.uint8)
UV = RNG.random((len(VERTICES), 2))


def denoised(vertices=VERTICES, faces=FACES, **options):
    return msal.denoise(vertices, faces, "msal", **options).vertices


# trimesh


def a_trimesh(**options):
    mesh = trimesh.Trimesh(VERTICES, FACES, process=False, **options)
    mesh.vertex_attributes["trust"] = TRUST
    mesh.face_attributes["patch"] = np.arange(len(FACES))
    mesh.metadata["scanner"] = "left"
    return mesh


def test_trimesh_keeps_colours_attributes_and_metadata():
    mesh = a_trimesh(vertex_colors=COLOURS)
    result = msal.denoise(mesh, method="msal")
    assert type(result) is trimesh.Trimesh and result is not mesh
    assert np.array_equal(result.vertices, denoised())
    assert np.array_equal(mesh.vertices, VERTICES)
    assert np.array_equal(result.faces, FACES)
    assert np.array_equal(result.visual.vertex_colors, COLOURS)
    assert np.array_equal(result.vertex_attributes["trust"], TRUST)
    assert np.array_equal(result.face_attributes["patch"], np.arange(len(FACES)))
    assert result.metadata["scanner"] == "left"
    result.vertex_attributes["trust"][0] = 9.0
    assert mesh.vertex_attributes["trust"][0] == 0.0


def test_trimesh_keeps_texture_coordinates_and_makes_normals_anew():
    mesh = a_trimesh(visual=trimesh.visual.TextureVisuals(uv=UV))
    before = mesh.vertex_normals.copy()
    result = msal.denoise(mesh, method="msal")
    assert np.array_equal(result.visual.uv, UV)
    fresh = trimesh.Trimesh(denoised(), FACES, process=False).vertex_normals
    assert np.allclose(result.vertex_normals, fresh)
    assert not np.allclose(result.vertex_normals, before)


def test_arrays_of_an_object_lock_and_weigh_by_name():
    mesh = a_trimesh()
    result = msal.denoise(mesh, method="msal", lock="trust < 0.3", weights="trust")
    assert np.array_equal(result.vertices, denoised(lock=TRUST < 0.3, weights=TRUST))
    with pytest.raises(msal.InputError) as caught:
        msal.denoise(mesh, lock="confidence < 0.3")
    assert caught.value.code == "E_PROPERTY" and "trust" in caught.value.hint


def test_a_primitive_and_a_scene_are_refused_with_what_to_give():
    with pytest.raises(msal.UnsupportedError, match="primitives") as caught:
        msal.denoise(trimesh.primitives.Box())
    assert "to_mesh()" in caught.value.hint
    with pytest.raises(msal.UsageError, match="a Scene alone") as caught:
        msal.denoise(a_trimesh().scene())
    assert "scene.to_mesh()" in caught.value.hint


# meshio


def test_meshio_keeps_cells_and_data():
    lines = np.array([[0, 1], [1, 2]])
    mesh = meshio.Mesh(
        VERTICES,
        [("line", lines), ("quad", QUADS[:300]), ("triangle", FACES[600:])],
        point_data={"trust": TRUST, "Normals": np.tile([0.0, 0.0, 1.0], (len(VERTICES), 1))},
        cell_data={"patch": [np.arange(2), np.arange(300), np.arange(len(FACES) - 600)]},
        field_data={"inside": np.array([1, 2])},
    )
    before = copy.deepcopy(mesh)
    result = msal.denoise(mesh, method="msal", weights="trust")
    assert type(result) is meshio.Mesh
    assert np.array_equal(result.points, denoised(weights=TRUST))
    assert [block.type for block in result.cells] == ["line", "quad", "triangle"]
    assert np.array_equal(result.cells[1].data, QUADS[:300])
    assert np.array_equal(result.cell_data["patch"][1], np.arange(300))
    assert np.array_equal(result.point_data["trust"], TRUST)
    assert np.array_equal(result.field_data["inside"], [1, 2])
    lengths = np.linalg.norm(result.point_data["Normals"], axis=1)
    assert np.allclose(lengths, 1.0) and not (result.point_data["Normals"] == [0, 0, 1]).all()
    assert np.array_equal(mesh.points, before.points)
    assert np.array_equal(mesh.point_data["Normals"], before.point_data["Normals"])


def test_meshio_polygons_float32_and_other_cells():
    pentagon = np.array([[0.0, 0, 0], [1, 0, 0], [2, 1, 0], [1, 2, 0.3], [0, 1, 0]], np.float32)
    mesh = meshio.Mesh(pentagon, [("polygon", np.array([[0, 1, 2, 3, 4]]))])
    result = msal.denoise(mesh, method="al")
    assert result.points.dtype == np.float32
    assert np.array_equal(
        result.points, msal.denoise(pentagon, [[0, 1, 2], [0, 2, 3], [0, 3, 4]], "al").vertices
    )
    for kind, corners in (("tetra", 4), ("triangle6", 6), ("hexahedron", 8)):
        cells = [("triangle", FACES), (kind, np.arange(corners)[None])]
        with pytest.raises(msal.UnsupportedError, match=f"1 {kind} cells"):
            msal.denoise(meshio.Mesh(VERTICES, cells))
    with pytest.raises(msal.ContentError, match="no faces"):
        msal.denoise(meshio.Mesh(VERTICES, [("line", [[0, 1]])]))
    with pytest.raises(msal.ContentError, match=r"\(n, 3\)"):
        msal.denoise(meshio.Mesh(VERTICES[:, :2], [("triangle", FACES)]))


# Classes that look like those of a library, so that these paths run without it


class FakeVectors(list):
    """As ``open3d.utility.Vector3dVector``: made of an array."""

    def __array__(self, dtype=None, copy=None):
        return np.array(list(self), dtype=dtype)


def fake_class(module, name, base=object):
    return types.new_class(name, (base,), exec_body=lambda body: body.update(__module__=module))


class FakeTriangleMesh:
    def __init__(self, other=None):
        self.__dict__.update({} if other is None else copy.deepcopy(other.__dict__))

    def has_vertex_normals(self):
        return hasattr(self, "vertex_normals")

    def has_triangle_normals(self):
        return hasattr(self, "triangle_normals")


class FakeData(dict):
    """As ``pyvista.DataSetAttributes``."""

    active_normals_name = "Normals"


class FakePolyData:
    n_verts = n_lines = n_strips = 0

    def __init__(self, polygons, normals, cell_normals):
        self.points, self.polygons = VERTICES, polygons
        self.faces = np.concatenate([[len(one), *one] for one in polygons])
        self.point_data = FakeData(trust=TRUST, Normals=normals)
        self.cell_data = FakeData(Normals=cell_normals)

    def copy(self, deep):
        return copy.deepcopy(self)


@pytest.mark.parametrize("n_quads", [0, 400, 800])
def test_pyvista_polygons_stay_and_normals_follow(n_quads):
    polygons = [*QUADS[:n_quads].tolist(), *FACES[2 * n_quads :].tolist()]
    before = trimesh.Trimesh(VERTICES, FACES, process=False)
    normals = before.face_normals[: 2 * n_quads : 2], before.face_normals[2 * n_quads :]
    own = fake_class("pyvista.core.pointset", "PolyData", FakePolyData)
    stored = prepare_mesh(VERTICES, FACES).mesh.vertex_normals()
    mesh = own(polygons, stored, np.concatenate(normals))
    result = msal.denoise(mesh, method="msal", lock="trust < 0.2")
    assert type(result) is own and result.polygons == polygons
    assert np.array_equal(result.points, denoised(lock=TRUST < 0.2))
    assert np.array_equal(mesh.points, VERTICES)
    assert np.array_equal(mesh.point_data["Normals"], stored)
    after = trimesh.Trimesh(result.points, FACES, process=False)
    expected = prepare_mesh(result.points, FACES).mesh.vertex_normals()
    assert np.allclose(result.point_data["Normals"], expected, atol=1e-6)
    triangles = result.cell_data["Normals"][n_quads:]
    assert np.allclose(triangles, after.face_normals[2 * n_quads :], atol=1e-6)


def test_open3d_is_known_by_the_module_of_its_class():
    own = fake_class("open3d.cpu.pybind.geometry", "TriangleMesh", FakeTriangleMesh)
    mesh = own()
    mesh.vertices, mesh.triangles = FakeVectors(VERTICES), FakeVectors(FACES)
    mesh.vertex_normals = FakeVectors(np.tile([0.0, 0, 1], (len(VERTICES), 1)))
    mesh.triangle_normals = FakeVectors(np.tile([0.0, 0, 1], (len(FACES), 1)))
    result = msal.denoise(mesh, method="msal")
    assert type(result) is own
    assert np.array_equal(np.asarray(result.vertices), denoised())
    assert not np.array_equal(np.asarray(result.vertex_normals), mesh.vertex_normals)


def test_no_library_is_imported_for_its_objects(monkeypatch):
    for name in ("trimesh", "meshio", "pyvista", "open3d"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(msal.UsageError, match="ImageData") as caught:
        msal.denoise(fake_class("pyvista.core", "ImageData")())
    assert "extract_surface()" in caught.value.hint
    tensors = fake_class("open3d.t.geometry", "TriangleMesh")()
    tensors.vertex = {}
    with pytest.raises(msal.UnsupportedError) as caught:
        msal.denoise(tensors)
    assert "to_legacy()" in caught.value.hint
    with pytest.raises(msal.UsageError, match="a dict alone is no mesh"):
        msal.denoise({})
