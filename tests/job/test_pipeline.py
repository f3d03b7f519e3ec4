"""One file from start to end: bytes kept, records, failures that leave nothing behind."""

import dataclasses
import functools
import gzip
import hashlib
import itertools
import time

import numpy as np
import pytest

from msal_cli import codecs, methods
from msal_cli.analysis.added_noise import AddedNoise
from msal_cli.codecs import header
from msal_cli.codecs.detection import format_of_name, output_name
from msal_cli.job import comparison, output, pipeline
from msal_cli.job.pipeline import denoise_file
from msal_cli.job.settings import Limits, Settings, Task
from msal_cli.methods import _contract
from tests.cli.scans import ply_text
from tests.codecs import plain_obj, plain_stl
from tests.files import denoise_bytes
from tests.ply_files import to_ply
from tests.shapes import noisy, torus


def settings(method="msal", **given):
    own = {key: given.pop(key) for key in list(given) if key in Settings.__dataclass_fields__}
    return Settings(method, methods.find(method).validate(given), **own)


def obj_text(vertices, faces):
    more = "# a scan\nmtllib none.mtl\ng part\nusemtl skin"
    return plain_obj.written(np.round(vertices, 6), faces, more)


def ply_binary(vertices, faces):
    return to_ply(vertices.astype("<f4"), faces, quality=np.full(len(vertices), 0.5))


def stl_binary(vertices, faces):
    return plain_stl.binary(vertices[faces].reshape(-1, 9))


def stl_ascii(vertices, faces):
    return plain_stl.text(vertices[faces].reshape(-1, 9)).encode()


WRITERS = {
    "scan.obj": obj_text,
    "scan.ply": ply_binary,
    "ascii.ply": ply_text,
    "scan.stl": stl_binary,
    "ascii.stl": stl_ascii,
}


@pytest.fixture(params=WRITERS)
def scan(request, tmp_path):
    """A noisy torus in a file of each format."""
    vertices, faces = torus()
    path = tmp_path / "in" / request.param
    path.parent.mkdir()
    path.write_bytes(WRITERS[request.param](noisy(vertices, 1, 0.1), faces))
    return path


def denoised(path, out, **given):
    return pipeline.denoise_file(Task(str(path), str(out), path.name), settings(**given))


def test_a_scan_is_denoised_and_told_of(scan, tmp_path):
    out = tmp_path / "deep" / "er" / scan.name
    record = denoised(scan, out)
    assert (record.error, record.status, record.output) == (None, "written", str(out))
    assert (record.vertices, record.faces) in {(288, 576), (3 * 576, 576)}
    assert (record.components, record.seam_gap, record.volume.valid) == (1, 0.0, True)
    assert record.volume.after < record.volume.before
    assert 0 < record.displacement.mean < record.displacement.p95 < record.displacement.max
    assert record.displacement.max_edges == pytest.approx(
        record.displacement.max / record.mean_edge_length
    )
    assert record.normal_change.mean_deg > 1
    assert record.method.parameters["K"] == 0.5
    assert record.input_sha256 == hashlib.sha256(scan.read_bytes()).hexdigest()
    assert record.output_sha256 == hashlib.sha256(out.read_bytes()).hexdigest()
    assert stages_added(record) == pytest.approx(record.seconds.total, rel=1e-9)
    assert [entry.name for entry in out.parent.iterdir()] == [out.name]


def stages_added(record):
    spent = dataclasses.asdict(record.seconds)
    assert spent.pop("total") > 0.0
    return sum(spent.values())


@pytest.fixture
def seconds_by_looks(monkeypatch):
    """A clock that goes on by a second whenever somebody looks at it."""
    monkeypatch.setattr(time, "perf_counter", functools.partial(next, itertools.count(1000.0)))


@pytest.mark.parametrize("broken", ["", "read", "sweeps", "write"])
def test_every_moment_belongs_to_one_stage(scan, tmp_path, seconds_by_looks, broken):
    def fail(stage, done, total):
        if stage == broken:
            raise RuntimeError("on purpose")

    task = Task(str(scan), str(tmp_path / scan.name), scan.name)
    record = denoise_file(task, settings(), fail)
    assert record.status == ("failed" if broken else "written")
    # What is between two stages takes seconds here, too, and none of them may be lost.
    assert stages_added(record) == record.seconds.total
    spent = dataclasses.asdict(record.seconds)
    # Nothing is chosen without --auto.
    assert spent.pop("choose") == 0.0
    assert spent[broken] > 0.0 if broken else min(spent.values()) > 0.0


def test_threads_pipes_and_gzip_give_the_same_bytes(scan, tmp_path, monkeypatch):
    outs = [tmp_path / str(i) / scan.name for i in range(2)]
    denoised(scan, outs[0])
    monkeypatch.setenv("MSAL_THREADS", "3")
    denoised(scan, outs[1])
    data, record = denoise_bytes(
        scan.read_bytes(), "standard input", settings(format=scan.suffix[1:])
    )
    assert record.error is None
    packed = scan.with_name(scan.name + ".gz")
    packed.write_bytes(gzip.compress(scan.read_bytes(), mtime=12345))
    assert denoised(packed, tmp_path / packed.name).error is None
    unpacked = gzip.decompress((tmp_path / packed.name).read_bytes())
    assert outs[0].read_bytes() == outs[1].read_bytes() == bytes(data) == unpacked


def test_a_conversion_by_option_has_the_same_bytes_and_no_materials(tmp_path):
    scan = tmp_path / "in/scan.obj"
    scan.parent.mkdir()
    scan.write_bytes(obj_text(noisy(torus()[0]), torus()[1]))
    scan.with_name("none.mtl").write_bytes(b"newmtl skin\n")
    assert denoised(scan, tmp_path / "same/scan.obj").sidecars == ("copied none.mtl",)
    by_option, by_name = (tmp_path / name / output_name(scan.name, "off") for name in "ab")
    for out, options in ((by_option, {"to": "off"}), (by_name, {})):
        record = denoised(scan, out, **options)
        assert (record.error, record.sidecars) == (None, ())
        assert [entry.name for entry in out.parent.iterdir()] == ["scan.off"]
    assert by_option.read_bytes() == by_name.read_bytes()
    assert len(codecs.open_mesh(by_option.read_bytes(), by_option.name).faces) == 576
    scan.with_name("none.mtl").unlink()
    lost = denoised(scan, tmp_path / "lost/scan.obj")
    assert lost.status == "written"
    assert any("none.mtl is missing" in warning for warning in lost.warnings)


@pytest.mark.parametrize("max_move", [None, "0.3e"])
@pytest.mark.parametrize(
    ("code", "offset", "given"),
    [("<i2", 0.0, {}), ("<f4", 1e7, {}), ("<f8", 1e7, {"precision": "float32"})]
    + [("<f8", 1e7, {"to": "glb"}), ("<i2", 0.0, {"encoding": "ascii"})]
    + [("<i2", 0.0, {"to": "obj"})],
)
def test_figures_are_those_of_the_output(tmp_path, code, offset, given, max_move):
    scan, out = tmp_path / "scan.ply", tmp_path / f"out.{given.get('to', 'ply')}"
    vertices, faces = torus()
    scan.write_bytes(to_ply((8.0 * noisy(vertices) + [0.0, offset, 0.0]).astype(code), faces))
    record = denoised(scan, out, max_move=max_move, **given)
    made = comparison.compare_files(str(scan), str(out))
    wanted = (made.displacement, made.volume, made.area, made.flipped_faces)
    assert (record.displacement, record.volume, record.area, record.flipped_faces) == wanted
    assert record.normal_change.max_deg == made.max_angular_error_deg
    assert (record.status == "written") == (scan.read_bytes() != out.read_bytes())
    is_whole = code == "<i2" and "to" not in given
    assert any("whole numbers" in text for text in record.warnings) == is_whole
    if "precision" in given:
        assert any("rounds positions to 1 units" in warning for warning in record.warnings)
        assert denoised(scan, out, **given, strict=True).error.code == "E_LOSS"
    else:
        assert not max_move or record.displacement.max_edges <= 0.3
    noise = AddedNoise("uniform", 0.01)
    words = output.add_noise_to_file(scan.read_bytes(), "scan.ply", "-", noise)[1]
    assert (", 0 of 288 vertices moved" in words) == (code == "<i2")


def test_a_failure_leaves_the_old_output(tmp_path):
    scan, out = tmp_path / "scan.ply", tmp_path / "out/scan.ply"
    scan.write_bytes(ply_binary(*torus())[:-9])
    out.parent.mkdir()
    out.write_bytes(b"old")
    record = denoised(scan, out)
    assert record.error.code == "E_TRUNCATED" and record.error.hint
    assert [entry.read_bytes() for entry in out.parent.iterdir()] == [b"old"]


@pytest.mark.parametrize("is_nan", [True, False])
def test_a_defect_is_a_record_too(scan, tmp_path, monkeypatch, is_nan):
    def nonfinite(self, mesh, parameters, on_sweep=None):
        vertices = mesh.vertices.copy()
        vertices[5, 1] = np.nan
        return _contract.Result(vertices)

    def broken(*_):
        raise ZeroDivisionError("oops")

    if is_nan:
        monkeypatch.setattr(_contract.Method, "denoise", nonfinite)
    else:
        monkeypatch.setattr("msal_cli.analysis.measures.measure_surface_change", broken)
    record = denoised(scan, tmp_path / scan.name)
    assert record.error.code == "E_INTERNAL"
    if is_nan:
        assert record.error.where == "vertex 5"
    else:
        assert "ZeroDivisionError: oops" in record.error.message
    assert not (tmp_path / scan.name).exists()


def test_inspection(scan):
    info = comparison.inspect_file(str(scan))
    assert info.error is None and info.noise_estimate.readings
    assert (info.closed, info.winding, info.volume_valid) == (True, "consistent", True)
    counts = info.triangles, info.polygon_sizes, info.bytes
    assert counts == (576, {"3": 576}, scan.stat().st_size)
    missing = scan.parent / "none.ply"
    assert comparison.inspect_file(str(missing)).error.code == "E_READ"
    assert denoised(missing, scan.with_name("out.ply")).error.code == "E_READ"
    lost = denoised(scan, scan / "out.ply")
    assert (lost.error.code, lost.displacement, lost.volume) == ("E_WRITE", None, None)


@pytest.mark.parametrize(
    ("name", "to", "expected"),
    [("a.ply", None, "a.ply"), ("a.PLY.gz", "stl", "a.stl.gz")]
    + [("dir/a.b.stl", ".PLY", "dir/a.b.ply"), (".hidden", "ply", ".hidden.ply")],
)
def test_output_names(name, to, expected):
    assert output_name(name, to) == expected
    assert [*map(format_of_name, ("a.PLY", "a.stl.gz", "a.off"))] == ["ply", "stl", "off"]
    for name in ("a.txt", "a", ".ply", "a.gz"):
        assert format_of_name(name) == ""


class TestLimits:
    @pytest.fixture
    def path(self, tmp_path):
        (tmp_path / "a.obj").write_bytes(obj_text(*torus()))
        return tmp_path / "a.obj"

    def done(self, path, **limits):
        task = Task(str(path), str(path.with_name("out" + path.suffix)), path.name)
        return denoise_file(task, Settings("msal"), limits=Limits(**limits))

    def test_a_forecast_beyond_the_limit_is_refused_before_anything_is_read(
        self, path, monkeypatch
    ):
        monkeypatch.setattr(header, "read_whole", None)
        record = self.done(path, memory_bytes=52_000_000)
        assert record.error.code == "E_MEMORY" and record.error.where == "forecast"
        assert "52 MB" in record.error.message and "53 MB" in record.error.message
        assert "--memory-limit" in record.error.hint
        assert record.input_sha256 is None
        assert not path.with_name("out.obj").exists()

    @pytest.mark.parametrize(
        "failure", [MemoryError(), RuntimeError("can't start new thread")], ids=repr
    )
    def test_want_of_memory_has_one_code_whatever_it_shows_itself_as(
        self, path, failure, monkeypatch
    ):
        def starve(*arguments, **options):
            raise failure

        monkeypatch.setattr(codecs, "open_mesh", starve)
        assert self.done(path).error.code == "E_MEMORY"


def measured(tmp_path, vertices, faces, method="taubin", name="a.ply", **given):
    path = tmp_path / name
    path.write_bytes(ply_binary(vertices, faces))
    return denoise_file(Task(str(path), str(tmp_path / "out.ply"), name), settings(method, **given))


def test_a_mesh_that_is_inside_out_has_the_figures_of_the_other_side(tmp_path):
    vertices, faces = torus()
    vertices = noisy(vertices)
    plain = measured(tmp_path, vertices, faces, "al")
    turned = measured(tmp_path, vertices, faces[:, ::-1], "al")
    assert (plain.inside_out, turned.inside_out) == (False, True)
    assert plain.volume.change_percent < -1.0
    assert turned.volume.change_percent == pytest.approx(plain.volume.change_percent)
    assert turned.volume.change == pytest.approx(plain.volume.change)
    assert turned.volume.before == pytest.approx(plain.volume.before)
    assert "W_INSIDE_OUT" in turned.warning_codes
    assert turned.warnings[0] == (
        "the surface is inside out: its normals point inwards (W_INSIDE_OUT)"
    )
    assert "W_INSIDE_OUT" not in plain.warning_codes
    info = comparison.inspect_file(str(tmp_path / "a.ply"))
    assert info.inside_out is True
    assert info.warnings == ("the surface is inside out: its normals point inwards",)
    assert info.volume == pytest.approx(2.0 * np.pi**2 * 3.0, rel=0.1)
