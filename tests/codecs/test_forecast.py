"""What is forecast of a file from its beginning: hand-made headers, lies, and real peaks."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from msal_cli import codecs, methods
from msal_cli.codecs.header import _COSTS, BASE_BYTES, LOOKED_AT, forecast, of_beginning
from msal_cli.job.settings import Settings, Task
from msal_cli.job.settings import forecast as forecast_task
from msal_cli.storage import gzip_streams
from tests.codecs import test_gltf
from tests.shapes import noisy, torus


def ply(vertices, faces, encoding="binary_little_endian"):
    rows = np.empty(len(faces), dtype=[("n", "u1"), ("corners", "<i4", 3)])
    rows["n"], rows["corners"] = 3, faces
    header = (
        f"ply\nformat {encoding} 1.0\nelement vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    if encoding == "ascii":
        lines = ["{:.6f} {:.6f} {:.6f}".format(*one) for one in vertices]
        lines += ["3 {} {} {}".format(*one) for one in faces]
        return (header + "\n".join(lines) + "\n").encode()
    return header.encode() + vertices.astype("<f4").tobytes() + rows.tobytes()


def scan(around=24, across=12):
    vertices, faces = torus(around, across)
    return noisy(vertices, 0, 0.1 / around), faces


def told(data, name, **options):
    return of_beginning(bytes(data[:LOOKED_AT]), len(data), name, **options)


def converted(to, encoding="same"):
    opened = codecs.open_mesh(ply(*scan()), "a.ply")
    if to == "ply":
        return bytes(opened.encoded(opened.vertices, encoding, "same"))
    return bytes(codecs.convert(opened, opened.vertices, to, encoding)[0])


@pytest.mark.parametrize(
    ("to", "encoding", "vertices"),
    [("ply", "same", 288), ("ply", "ascii", 288), ("stl", "same", 1728), ("glb", "same", 288)],
)
def test_headers_tell_the_counts(to, encoding, vertices):
    one = told(converted(to, encoding), f"a.{to}")
    assert (one.format, one.vertices, one.faces) == (to, vertices, 576)
    assert BASE_BYTES < one.memory_bytes < BASE_BYTES + 10**6


def test_the_buffers_of_a_gltf_count(tmp_path):
    path = test_gltf.in_folder(tmp_path)
    one = forecast(str(path))
    assert (one.format, one.vertices, one.faces) == ("gltf", 96, 192)
    with (tmp_path / "scan.bin").open("ab") as file:
        file.truncate(100_000_000)
    assert forecast(str(path)).memory_bytes > one.memory_bytes + 100_000_000
    (tmp_path / "scan.bin").unlink()
    assert forecast(str(path)).memory_bytes < one.memory_bytes


@pytest.mark.parametrize(("to", "encoding"), [("obj", "same"), ("off", "same"), ("stl", "ascii")])
def test_other_formats_do_not_tell_but_their_size_does(to, encoding):
    data = converted(to, encoding)
    one = told(data, f"a.{to}")
    assert (one.format, one.vertices, one.faces) == (to, None, None)
    assert BASE_BYTES + 4 * len(data) < one.memory_bytes < BASE_BYTES + 40 * len(data)


def test_quads_count_as_faces_but_cost_two_triangles():
    header = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 4000\nproperty float x\n"
        "property float y\nproperty float z\nelement face {}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    quads = header.format(3000).encode() + bytes(12 * 4000 + 17 * 3000)
    triangles = header.format(6000).encode() + bytes(12 * 4000 + 13 * 6000)
    one, two = told(quads, "a.ply"), told(triangles, "a.ply")
    assert (one.faces, two.faces) == (3000, 6000)
    extra = int(_COSTS["ply"].per_byte * (len(triangles) - len(quads)))
    assert one.memory_bytes == pytest.approx(two.memory_bytes - extra, abs=200)


def test_a_compressed_file_is_told_by_what_is_in_it():
    vertices, faces = scan(64, 32)
    plain = ply(vertices, faces)
    packed = gzip_streams.compress(plain)
    assert len(packed) < LOOKED_AT
    one, two = told(plain, "a.ply"), told(packed, "a.ply.gz")
    assert (two.format, two.vertices, two.faces) == ("ply", 2048, 4096)
    assert 0 <= two.memory_bytes - one.memory_bytes - 2 * len(packed) < len(plain)
    rows = np.random.default_rng(0).random((30_000, 3))
    text = "".join("v {:.5f} {:.5f} {:.5f}\n".format(*row) for row in rows).encode()
    packed = gzip_streams.compress(text)
    three, four = told(text, "a.obj"), told(packed, "a.obj.gz")
    grown = (four.memory_bytes - BASE_BYTES) / (three.memory_bytes - BASE_BYTES)
    assert 1.0 <= grown < 1.6


def test_a_method_and_a_conversion_need_more():
    data = ply(*scan())
    plain = told(data, "a.ply")
    assert told(data, "a.ply", method_bytes_per_face=1000).memory_bytes == (
        plain.memory_bytes + 576_000
    )
    assert told(data, "a.ply", to="obj").memory_bytes > plain.memory_bytes
    assert methods.find("static_dynamic").bytes_per_face > 500
    assert methods.find("msal").bytes_per_face == 0


LIES = {
    "more than there is": (b"vertex 288", b"vertex 1000000000000"),
    "faces": (b"face 576", b"face 99999999999999999999"),
    "negative": (b"vertex 288", b"vertex -5"),
    "no number": (b"vertex 288", b"vertex x"),
    "no end": (b"end_header", b"end_heaven"),
    "type": (b"float x", b"flaot x"),
    "format": (b"binary_little_endian", b"binary_middle_endian"),
}


@pytest.mark.parametrize("lie", LIES)
def test_a_header_that_lies_tells_nothing(lie):
    data = ply(*scan()).replace(*LIES[lie])
    one = told(data, "a.ply")
    assert (one.vertices, one.faces) == (None, None)
    assert BASE_BYTES < one.memory_bytes < BASE_BYTES + 10**6
    packed = told(gzip_streams.compress(data), "a.ply.gz")
    assert packed.memory_bytes < BASE_BYTES + 10**6 or packed.faces is not None


def test_no_beginning_of_anything_raises():
    generator = np.random.default_rng(0)
    whole = [ply(*scan()), ply(*scan(), "ascii"), converted("glb"), converted("stl")]
    whole += [gzip_streams.compress(one) for one in whole[:2]]
    for data in whole:
        for _ in range(25):
            broken = bytearray(data[: generator.integers(0, len(data))])
            for at in generator.integers(0, max(1, min(len(broken), 600)), 3):
                if len(broken):
                    broken[at % len(broken)] = generator.integers(0, 256)
            for name in ("a.ply", "a.stl", "a.glb", "a.obj", "a.gz", "a", ""):
                one = told(bytes(broken), name)
                assert one.memory_bytes < BASE_BYTES + 50 * (256 << 20)


def test_a_file_that_is_not_there_is_not_told(tmp_path):
    assert forecast(str(tmp_path / "none.ply")).memory_bytes is None
    assert forecast(str(tmp_path)).memory_bytes is None
    assert forecast("a\0b.ply").memory_bytes is None


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
    ran = subprocess.run(
        [sys.executable, "-c", _CHILD, str(path), str(target)], capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stderr
    return int(ran.stdout)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak is not told")
@pytest.mark.parametrize(
    ("form", "around"),
    [
        ("ply", 400),
        *[pytest.param(form, 1000, marks=pytest.mark.slow) for form in ("ply", "ply-ascii", "stl",
            "obj", "stl-ascii", "off", "ply-gz", "vtk", "vtk-ascii")],
    ],
)  # fmt: skip
def test_the_peak_is_within_half_and_all_of_what_is_foreseen(form, around, tmp_path):
    to, _, flavour = form.partition("-")
    data = ply(*scan(around, around // 2))
    opened = codecs.open_mesh(data, "a.ply")
    if to != "ply":
        data = codecs.convert(opened, opened.vertices, to, flavour or "same")[0]
    elif flavour == "ascii":
        data = opened.encoded(opened.vertices, "ascii", "same")
    path = tmp_path / f"a.{to}"
    if flavour == "gz":
        path, data = path.with_suffix(".ply.gz"), gzip_streams.compress(data)
    path.write_bytes(data)
    target = tmp_path / f"out{''.join(path.suffixes)}"
    peak(path, target)  # compiles the kernels
    real = peak(path, target)
    expected_bytes = forecast_task(Task(str(path), str(target), "x"), Settings("msal")).memory_bytes
    assert real <= 1.03 * expected_bytes <= 2.06 * real
