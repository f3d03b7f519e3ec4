"""Sample meshes; files through the whole way: unchanged byte for byte, or refused."""

import gzip
import os
import struct
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from benchmarks.hostile_headers import MOST_BYTES, MOST_SECONDS, lies, refused
from msal_cli import codecs
from msal_cli.codecs import detection
from msal_cli.kernels.geometry import area_and_volume, face_normals_and_areas
from msal_cli.mesh import prepare_mesh
from tests.codecs import test_gltf, test_obj, test_off, test_ply, test_stl, test_threemf, test_vtk
from tests.files import SAMPLES, denoise_bytes, load_script
from tests.fuzz import survival
from tests.job.test_pipeline import settings
from tests.storage import test_gzip_streams

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
    there = {p.name for p in SAMPLES.iterdir() if p.suffix not in (".py", "") and p.is_file()}
    assert there == set(made)
    assert {name.split("_")[0] for name in there if "_noisy" in name} == {
        name.split("_")[0] for name in NAMES
    }
    for name, data in made.items():
        assert expanded(name, (SAMPLES / name).read_bytes()) == expanded(name, data), name


@pytest.mark.parametrize("name", NAMES)
def test_surface_is_as_stated(script: ModuleType, name: str) -> None:
    model = next(m for m in script.MODELS if m.name == name)
    (path,) = SAMPLES.glob(f"{name}_clean.*")
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


# Files through the whole way


def meshes_in(folder: Path) -> list[Path]:
    paths = (path for path in sorted(folder.rglob("*")) if detection.format_of_name(path.name))
    return [path for path in paths if detection.format_of_name(path.name) in detection.OWN_FORMATS]


def require_same(name: str, data: bytes) -> None:
    """Through the whole way of a file; a small one also displaced, encoded anew and read again."""
    output, record = denoise_bytes(data, name, settings(iterations=0))
    assert record.error is None, record.error
    assert record.status == "unchanged"
    assert output is not None and bytes(output) == data
    if len(data) <= 200_000:
        format = "gz" if name.endswith(".gz") else detection.format_of_name(name)
        assert survival.outcome(data, format) == "ok"


@pytest.mark.parametrize("path", meshes_in(SAMPLES), ids=lambda path: path.name)
def test_sample_meshes(path):
    require_same(path.name, path.read_bytes())


def real_scans():
    paths = meshes_in(Path(os.environ["MSAL_DATA"])) if os.environ.get("MSAL_DATA") else [Path()]
    for path in paths:
        is_large = path.stat().st_size > 1_500_000
        yield pytest.param(path, id=path.name, marks=[pytest.mark.ci] if is_large else [])


@pytest.mark.parametrize("path", list(real_scans()))
def test_real_scans(path, real_data):
    require_same(path.name, path.read_bytes())


TRIANGLE = "v {0} 0 0\nv 0 {0} 0\nv 0 0 {0}\nf 1 2 3\n"
OTHER_FACES = "v 0 0 0\nv 1 0 0\nv 0 1 0\n{}\n"

UNUSABLE = {
    "too far.obj": (TRIANGLE.format("1e61").encode(), "E_RANGE"),
    "too near.obj": (TRIANGLE.format("1e-61").encode(), "E_RANGE"),
    "extent beyond a double.obj": (
        TRIANGLE.format("1e308").replace("v 0", "v -1e308").encode(),
        "E_RANGE",
    ),
    "one point.obj": (TRIANGLE.format("0").encode(), "E_NO_FACES"),
    "repeated corners.obj": (OTHER_FACES.format("f 1 1 2\nf 3 2 3").encode(), "E_NO_FACES"),
    "another format.obj": (b"ply\nformat ascii 1.0\nend_header\n", "E_FORMAT"),
    "another format.stl": (TRIANGLE.format("1").encode(), "E_FORMAT"),
    "another format in gzip.ply.gz": (gzip.compress(b"glTF" + bytes(40), mtime=0), "E_FORMAT"),
    "gzip in gzip.ply.gz": (gzip.compress(gzip.compress(b"ply\n", mtime=0), mtime=0), "E_FORMAT"),
    "empty in gzip.ply.gz": (gzip.compress(b"", mtime=0), "E_TRUNCATED"),
    "no such format.fbx": (b"Kaydara FBX Binary", "E_UNSUPPORTED"),
    "no format": (b"hello world", "E_FORMAT"),
}
"""Files that parse, or that no reader takes: what the way of a file refuses beside its codec."""

TABLES = {
    ".ply": test_ply.DAMAGED,
    ".obj": test_obj.DAMAGED,
    ".stl": test_stl.DAMAGED,
    ".glb": test_gltf.DAMAGED_GLB,
    ".gltf": test_gltf.DAMAGED,
    ".3mf": test_threemf.DAMAGED,
    ".ply.gz": test_gzip_streams.DAMAGED,
    "": UNUSABLE | test_off.DAMAGED | test_vtk.DAMAGED | test_vtk.DAMAGED_XML,
}
MALFORMED = {
    name + suffix: (*row, "")[:3] for suffix, table in TABLES.items() for name, row in table.items()
}
"""Content, code and a part of the place by file name; the suffix tells the format."""


@pytest.mark.parametrize("name", MALFORMED)
def test_the_record_has_the_code_and_the_reason(name):
    data, code, place = MALFORMED[name]
    output, record = denoise_bytes(data, name, settings(iterations=0))
    assert output is None
    assert record.status == "failed"
    error = record.error
    assert error is not None
    assert (error.code, place in error.where) == (code, True), error
    assert error.hint and 0 < len(error.message) < 300 and not error.message.endswith(".")
    assert "Traceback" not in error.message and "\n" not in error.message


reads_proc = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc and writes holes")


@reads_proc
@pytest.mark.ci
def test_every_lie_is_refused(tmp_path):
    all_lies = list(lies())
    assert len(all_lies) >= 50
    assert len({lie.name for lie in all_lies}) == len(all_lies)
    found = refused(all_lies, tmp_path)
    assert [(lie.name, lie.code) for lie in all_lies] == [
        (lie.name, code) for lie, (code, _, _) in zip(all_lies, found, strict=True)
    ]
    # Generous, since the machine may be slow; the table has the figures.
    assert max(seconds for _, seconds, _ in found) < 10 * MOST_SECONDS
    assert sum(grown for _, _, grown in found) < MOST_BYTES
