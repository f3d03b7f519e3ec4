"""What the beginning of a file tells: counts, a forecast of memory, and lies that are refused."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from benchmarks.hostile_headers import lie, lies, ply
from msal_cli import codecs
from msal_cli.codecs import header as first_look
from msal_cli.codecs import open_mesh
from msal_cli.codecs.conversion import convert
from msal_cli.codecs.header import BASE_BYTES, LOOKED_AT, forecast, of_beginning, read_input
from msal_cli.errors import InputError, MsalError
from msal_cli.job.room import forecast as forecast_task
from msal_cli.job.settings import Settings, Task
from msal_cli.storage import gzip_streams
from tests.codecs import plain_ply, plain_stl, test_gltf
from tests.files import run_python, write_sparse
from tests.job.test_pipeline import WRITERS
from tests.ply_files import to_ply
from tests.shapes import grid, noisy, torus


def scan(around=24, across=12):
    vertices, faces = torus(around, across)
    return noisy(vertices, 0, 0.1 / around).astype("<f4"), faces


def forecast_of(data, name, **options):
    return of_beginning(bytes(data[:LOOKED_AT]), len(data), name, **options)


def converted(to, encoding="same"):
    opened = codecs.open_mesh(to_ply(*scan()), "a.ply")
    if to == "ply":
        return bytes(opened.encoded(opened.vertices, encoding, "same"))
    return bytes(convert(opened, opened.vertices, to, encoding)[0])


@pytest.mark.parametrize(
    ("to", "encoding", "vertices"),
    [("ply", "same", 288), ("ply", "ascii", 288), ("stl", "same", 1728), ("glb", "same", 288)]
    + [("obj", "same", None), ("off", "same", None), ("stl", "ascii", None)],
)
def test_headers_tell_the_counts_or_the_size_does(to, encoding, vertices):
    data = converted(to, encoding)
    one = forecast_of(data, f"a.{to}")
    assert (one.format, one.vertices, one.faces) == (to, vertices, vertices and 576)
    low, high = (0, 10**6) if vertices else (4 * len(data), 40 * len(data))
    assert low < one.memory_bytes - BASE_BYTES < high


def test_the_buffers_of_a_gltf_count(tmp_path):
    path = test_gltf.in_folder(tmp_path)
    one = forecast(str(path))
    assert (one.format, one.vertices, one.faces) == ("gltf", 96, 192)
    with (tmp_path / "scan.bin").open("ab") as file:
        file.truncate(100_000_000)
    assert forecast(str(path)).memory_bytes > one.memory_bytes + 100_000_000
    (tmp_path / "scan.bin").unlink()
    assert forecast(str(path)).memory_bytes < one.memory_bytes


def test_a_compressed_file_is_told_by_what_is_in_it():
    vertices, faces = scan(64, 32)
    plain = to_ply(vertices, faces)
    packed = gzip_streams.compress(plain)
    assert len(packed) < LOOKED_AT
    one, two = forecast_of(plain, "a.ply"), forecast_of(packed, "a.ply.gz")
    assert (two.format, two.vertices, two.faces) == ("ply", 2048, 4096)
    assert 0 <= two.memory_bytes - one.memory_bytes - 4 * len(packed) < len(plain)
    rows = np.random.default_rng(0).random((30_000, 3))
    text = "".join("v {:.5f} {:.5f} {:.5f}\n".format(*row) for row in rows).encode()
    packed = gzip_streams.compress(text)
    three, four = forecast_of(text, "a.obj"), forecast_of(packed, "a.obj.gz")
    grown = (four.memory_bytes - BASE_BYTES) / (three.memory_bytes - BASE_BYTES)
    assert 1.0 <= grown < 1.6


HEADER_LIES = {
    "more than there is": (b"vertex 288", b"vertex 1000000000000"),
    "faces": (b"face 576", b"face 99999999999999999999"),
    "negative": (b"vertex 288", b"vertex -5"),
    "no end": (b"end_header", b"end_heaven"),
}


@pytest.mark.parametrize("lie", HEADER_LIES)
def test_a_header_that_lies_tells_nothing(lie):
    data = to_ply(*scan()).replace(*HEADER_LIES[lie])
    one = forecast_of(data, "a.ply")
    assert (one.vertices, one.faces) == (None, None)
    assert BASE_BYTES < one.memory_bytes < BASE_BYTES + 10**6
    packed = forecast_of(gzip_streams.compress(data), "a.ply.gz")
    assert packed.memory_bytes < BASE_BYTES + 10**6 or packed.faces is not None


_CHILD = """
import sys
from msal_cli import methods
from msal_cli.job.pipeline import denoise_file
from msal_cli.job.settings import Settings, Task
parameters = methods.find("msal").validate({})
record = denoise_file(Task(*sys.argv[1:3], "x"), Settings("msal", parameters))
assert record.error is None, record.error
print(next(int(line.split()[1]) * 1024 for line in open("/proc/self/status") if "VmHWM" in line))
"""


def peak(path, target):
    return int(run_python(_CHILD, path, target))


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the system reports no peak")
@pytest.mark.parametrize(
    ("form", "around"),
    [
        pytest.param("ply", 400, marks=pytest.mark.ci),
        *[pytest.param(form, 1000, marks=pytest.mark.slow) for form in ("ply", "ply-ascii", "stl",
            "obj", "stl-ascii", "off", "ply-gz", "vtk", "vtk-ascii")],
    ],
)  # fmt: skip
def test_the_peak_is_within_half_and_all_of_what_is_foreseen(form, around, tmp_path):
    to, _, flavour = form.partition("-")
    data = to_ply(*scan(around, around // 2))
    opened = codecs.open_mesh(data, "a.ply")
    if to != "ply":
        data = convert(opened, opened.vertices, to, flavour or "same")[0]
    elif flavour == "ascii":
        data = opened.encoded(opened.vertices, "ascii", "same")
    path = tmp_path / f"a.{to}"
    if flavour == "gz":
        path, data = path.with_suffix(".ply.gz"), gzip_streams.compress(data)
    path.write_bytes(data)
    target = tmp_path / f"out{''.join(path.suffixes)}"
    real = peak(path, target)
    expected_bytes = forecast_task(Task(str(path), str(target), "x"), Settings("msal")).memory_bytes
    assert real <= 1.03 * expected_bytes <= 2.06 * real


LARGE = [one for one in lies() if one.size is not None]
TERABYTES = {
    "control characters.obj": (b"v 0 0 0\n\1", 10**9, "E_FORMAT"),
    "larger than memory.ply": (ply(4, 1), 10**13, "E_TOO_LARGE"),
    "larger than memory.ply.gz": (b"\x1f\x8b\x08", 10**13, "E_TOO_LARGE"),
}
LARGE += [lie(name, code, data, size=size) for name, (data, size, code) in TERABYTES.items()]


@pytest.mark.parametrize("one", LARGE, ids=lambda one: one.name)
def test_a_lie_is_refused_before_it_is_loaded(one, tmp_path):
    path = write_sparse(tmp_path / one.name, b"".join(one.pieces()), one.size)
    tracemalloc.start()
    with pytest.raises(InputError) as caught:
        read_input(str(path))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert caught.value.code == one.code
    assert caught.value.hint
    assert peak < 10_000_000


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
    opened = open_mesh(WRITERS["scan.ply"](vertices, faces), "a.ply")
    for name in ("a.stl", "a.ply", "a.glb"):
        data = bytes(convert(opened, vertices, name[2:])[0])
        path = tmp_path / name
        path.write_bytes(data + bytes(1_500))
        assert open_mesh(read_input(path), name).n_polygons == len(faces)
        path.write_bytes(data + bytes(10**6))
        with pytest.raises(MsalError) as caught:
            read_input(path)
        assert caught.value.code == "E_TOO_LARGE"
