"""`--min-noise`: files that have hardly any noise stay as they are, byte for byte."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from msal_cli import codecs
from msal_cli.analysis.added_noise import add_plain_noise
from msal_cli.mesh import prepare_mesh
from tests.cli.scans import folder_of, msal, msal_on, ply_text, record_of, records_of
from tests.shapes import torus


def torus_with(level):
    """The bytes of a torus with noise of so many mean edge lengths."""
    vertices, faces = torus(60, 30)
    mesh = prepare_mesh(vertices, faces).mesh
    return ply_text(add_plain_noise(mesh, "gaussian-normal", level, 1), faces)


@pytest.fixture
def scans(tmp_path):
    """Files with noise of 0, 0.04 and 0.2 mean edge lengths."""
    folder = folder_of(tmp_path / "in", clean=torus_with(0.0), fair=torus_with(0.04))
    return folder_of(folder, loud=torus_with(0.2))


def test_quiet_files_stay_byte_for_byte(scans, tmp_path):
    gates = {
        "noise_estimate.mean_edges > 0.1e": [False, False, True],
        "noise_estimate.high_edges > 0.1e and not noise_estimate.negligible": [False, False, True],
        "noise_estimate.tail > 0.5 or noise_estimate.uneven": [False] * 3,
    }
    words = [word for gate in gates for word in ("--fail-on", gate)]
    words += ["--method", "msal"]
    made = msal("denoise", scans, "-o", tmp_path / "out", "--min-noise", "0.06e", "--json", *words)
    assert made.exit_code == 4
    records = records_of(made)
    for at, name in enumerate(("clean", "fair", "loud")):
        record = records[f"{name}.ply"]
        is_kept = name != "loud"
        output = (tmp_path / "out" / f"{name}.ply").read_bytes()
        assert (output == (scans / f"{name}.ply").read_bytes()) == is_kept
        assert record["status"] == ("unchanged" if is_kept else "written")
        assert (record["left_alone"] is not None) == is_kept
        assert record["method"]["name"] == ("none" if is_kept else "msal")
        for gate, (expression, broken) in zip(record["gates"], gates.items(), strict=True):
            assert (gate["expression"], gate["decided"]) == (expression, True)
            assert gate["broken"] == broken[at]
    assert records["clean.ply"]["displacement"]["max"] == 0.0


@pytest.mark.parametrize(
    ("level", "name", "is_kept"),
    [("auto", "clean", True), ("auto", "fair", False), ("1e3", "loud", True)],
)
def test_levels(scans, tmp_path, level, name, is_kept):
    source, target = scans / f"{name}.ply", tmp_path / "out.ply"
    assert msal("denoise", source, "-o", target, "--min-noise", level).exit_code == 0
    assert (target.read_bytes() == source.read_bytes()) == is_kept


def test_without_it_a_method_by_name_denoises_every_file(scans, tmp_path):
    words = ("--method", "msal", "--json")
    made = msal("denoise", scans / "clean.ply", "-o", tmp_path / "out.ply", *words)
    record = record_of(made)
    assert record["status"] == "written"
    assert record["left_alone"] is None
    assert record["noise_estimate"]["negligible"]


def test_it_is_told(scans, tmp_path):
    log = tmp_path / "log"
    words = ("--min-noise", "0.06e", "--log-file", log)
    made = msal("denoise", scans / "fair.ply", "-o", tmp_path / "out.ply", *words)
    assert "byte for byte as it was: noise 0.04" in made.stderr
    assert "below --min-noise 0.06e" in made.stderr
    assert "left as it is: noise 0.04" in log.read_text()


def test_a_stream_and_a_packed_file(scans, tmp_path):
    data = (scans / "clean.ply").read_bytes()
    assert msal_on(data, "denoise", "-", "--min-noise", "auto").stdout_bytes == data
    packed = tmp_path / "scan.ply.gz"
    packed.write_bytes(gzip.compress(data))
    msal("denoise", packed, "-o", tmp_path / "out.ply.gz", "--min-noise", "auto")
    assert (tmp_path / "out.ply.gz").read_bytes() == packed.read_bytes()


def test_in_place(scans):
    before = {path.name: path.read_bytes() for path in scans.iterdir()}
    assert msal("denoise", scans, "--in-place", "--min-noise", "0.06e").exit_code == 0
    after = {path.name: path.read_bytes() for path in scans.glob("*.ply")}
    assert after["clean.ply"] == before["clean.ply"]
    assert after["loud.ply"] != before["loud.ply"]


def test_another_format_has_the_same_positions(scans, tmp_path):
    output = tmp_path / "out.obj"
    made = msal("denoise", scans / "clean.ply", "-o", output, "--min-noise", "auto", "--json")
    record = record_of(made)
    assert record["status"] == "written"
    assert record["left_alone"]
    both = [
        codecs.open_mesh(path.read_bytes(), path.name).vertices
        for path in (scans / "clean.ply", output)
    ]
    assert np.array_equal(both[0], both[1])


def test_another_level_is_another_result(scans, tmp_path):
    def status(*words):
        made = msal("denoise", scans / "fair.ply", "-o", tmp_path / "out", *words, "--json")
        record = record_of(made)
        return record["status"]

    (tmp_path / "out").mkdir()
    assert status("--min-noise", "0.06e") == "unchanged"
    assert status("--min-noise", "0.060e") == "up-to-date"
    assert status("--min-noise", "auto") == "written"
    assert status() == "written"


def test_with_auto_a_quiet_file_is_left_alone_before_anything_is_tried(scans, tmp_path):
    words = ("--auto", "--min-noise", "0.06e", "--json")
    made = msal("denoise", scans / "fair.ply", "-o", tmp_path / "out.ply", *words)
    record = record_of(made)
    assert record["status"] == "unchanged"
    assert record["choice"] is None
    assert record["left_alone"]


@pytest.mark.parametrize("wrong", ["0", "-1", "3%", "much", "0.1ee", "nan"])
def test_what_is_no_level(scans, tmp_path, wrong):
    made = msal("denoise", scans, "-o", tmp_path / "out", "--min-noise", wrong)
    assert made.exit_code == 2
    assert "--min-noise" in made.stderr
    assert "no length above 0" in made.stderr
    assert not (tmp_path / "out").exists()


def test_the_field(scans, tmp_path):
    msal("denoise", scans / "loud.ply", "-o", tmp_path / "out.ply", "--fields", "noise")
    made = codecs.open_mesh((tmp_path / "out.fields.ply").read_bytes(), "fields.ply")
    assert any("noise" in one for one in made.properties)
