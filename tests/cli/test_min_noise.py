"""`--min-noise`: files that have hardly any noise stay as they are, byte for byte."""

from __future__ import annotations

import pytest

from msal_cli.analysis.added_noise import add_plain_noise
from msal_cli.mesh import prepare_mesh
from tests.cli.scans import folder_of, msal, ply_text, record_of, records_of
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


def test_it_is_told(scans, tmp_path):
    log = tmp_path / "log"
    words = ("--min-noise", "0.06e", "--log-file", log)
    made = msal("denoise", scans / "fair.ply", "-o", tmp_path / "out.ply", *words)
    assert "byte for byte as it was: noise 0.04" in made.stderr
    assert "below --min-noise 0.06e" in made.stderr
    assert "left as it is: noise 0.04" in log.read_text()


def test_with_auto_a_quiet_file_is_left_alone_before_anything_is_tried(scans, tmp_path):
    words = ("--auto", "--min-noise", "0.06e", "--json")
    made = msal("denoise", scans / "fair.ply", "-o", tmp_path / "out.ply", *words)
    record = record_of(made)
    assert record["status"] == "unchanged"
    assert record["choice"] is None
    assert record["left_alone"]
