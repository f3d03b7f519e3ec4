"""The sample meshes are what their script makes, and have the shape that their page states."""

from __future__ import annotations

import gzip
import struct
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from msal_cli import codecs
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


def sample(name: str, kind: str) -> Path:
    (path,) = FOLDER.glob(f"{name}_{kind}.*")
    return path


def geometry(path: Path) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any], list[int]]:
    """Positions, welded triangles and polygon sizes."""
    mesh = codecs.open_mesh(expanded(path.name, path.read_bytes()), path.name.removesuffix(".gz"))
    return mesh.vertices, mesh.faces, [len(polygon) for polygon in mesh.polygons()]


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
    vertices, faces, _ = geometry(sample(name, "clean"))
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, uses = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
    assert len(np.unique(edges, axis=0)) == len(edges), "consistently wound"
    assert uses.max() == 2
    assert (uses.min() == 2) == model.closed
    assert len(np.unique(faces)) == len(vertices), "no unreferenced vertex"
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    assert np.linalg.norm(normal, axis=1).min() > 1e-4, "no degenerate face"
    if model.closed:
        assert (a * np.cross(b, c)).sum() > 0, "faces look outwards"
    else:
        assert (normal[:, 2] > 0).all(), "faces look at the camera"
