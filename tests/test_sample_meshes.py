"""The sample meshes are what their script makes, and have the shape that their page states."""

from __future__ import annotations

import gzip
import struct
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from msal_cli import codecs
from msal_cli.kernels.geometry import area_and_volume, face_normals_and_areas
from msal_cli.mesh import prepare_mesh
from tests.scripts import load_script

FOLDER = Path(__file__).resolve().parents[1] / "sample_meshes"
NAMES = ("bracket", "dragon_egg", "coin", "bear", "vase", "knot", "toadstool", "rock")


@pytest.fixture(scope="module")
def script() -> Iterator[ModuleType]:
    path = list(sys.path)
    yield load_script("sample_meshes/make_sample_meshes.py")
    sys.path[:] = path
    for name in ("make_sample_meshes", "machined", "relief", "shapes"):
        sys.modules.pop(name, None)


@pytest.fixture(scope="module")
def made(script: ModuleType) -> dict[str, bytes]:
    return script.made()


def expanded(name: str, data: bytes) -> bytes:
    """What a file holds, whichever zlib compressed it."""
    if name.endswith(".gz"):
        return gzip.decompress(data)
    if name.endswith(".png"):
        start, pixels = 8, b""
        while start < len(data):
            (length,) = struct.unpack(">I", data[start : start + 4])
            if data[start + 4 : start + 8] == b"IDAT":
                pixels += data[start + 8 : start + 8 + length]
            start += length + 12
        return data[:33] + zlib.decompress(pixels)
    return data


@pytest.mark.ci
def test_the_folder_holds_what_the_script_makes(made: dict[str, bytes]) -> None:
    there = {p.name for p in FOLDER.iterdir() if p.suffix not in (".py", "") and p.is_file()}
    assert there == set(made)
    assert {name.split("_")[0] for name in there if "_noisy" in name} == {
        name.split("_")[0] for name in NAMES
    }
    for name, data in made.items():
        assert expanded(name, (FOLDER / name).read_bytes()) == expanded(name, data), name


@pytest.mark.parametrize("name", NAMES)
def test_surface_is_as_stated(script: ModuleType, name: str) -> None:
    model = next(m for m in script.MODELS if m.name == name)
    (path,) = FOLDER.glob(f"{name}_clean.*")
    mesh = codecs.open_mesh(expanded(path.name, path.read_bytes()), path.name.removesuffix(".gz"))
    ready = prepare_mesh(mesh.vertices, mesh.faces)
    defects = ready.defects
    assert (defects.boundary_edges == 0) == model.closed
    assert not (defects.inconsistent_edges or defects.non_manifold_edges)
    assert not (defects.degenerate_faces or defects.duplicate_faces)
    assert not defects.unreferenced_vertices
    normals, areas = face_normals_and_areas(ready.mesh.vertices, ready.mesh.faces)
    assert areas.min() > 0.5e-4
    if model.closed:
        volume = area_and_volume(ready.mesh.vertices, ready.mesh.faces)[1]
        assert volume > 0, "faces look outwards"
    else:
        assert (normals[:, 2] > 0).all(), "faces look at the camera"
