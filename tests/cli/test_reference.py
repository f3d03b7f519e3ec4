"""`msal denoise --reference`: the figures of `msal compare` in the report."""

from __future__ import annotations

import csv
import json

import pytest
from jsonschema import Draft202012Validator

from tests.cli.scans import closed_scan, folder_of, msal, msal_on
from tests.cli.scans import ply_text as as_ply
from tests.report.schemas import report_schema
from tests.shapes import grid, torus

SHARED = (
    "correspondence",
    "mean_edge_length",
    "mean_angular_error_deg",
    "max_angular_error_deg",
    "vertex_error_percent",
    "displacement",
    "flipped_faces",
    "volume_change_percent",
    "area_change_percent",
    "hausdorff",
    "hausdorff_edges",
)


@pytest.fixture
def scans(tmp_path):
    folder = folder_of(tmp_path / "scans", a=closed_scan(0))
    folder_of(folder / "below", b=closed_scan(1))
    return folder


@pytest.fixture
def truth(tmp_path):
    folder = folder_of(tmp_path / "truth", a=as_ply(*torus()))
    folder_of(folder / "below", b=as_ply(*torus()))
    return folder


def records(made):
    data = json.loads(made.stdout)
    Draft202012Validator(report_schema()).validate(data)
    return data["records"]


def test_the_figures_are_those_of_compare(scans, truth, tmp_path):
    output = tmp_path / "out.ply"
    made = msal("denoise", scans / "a.ply", "-o", output, "--reference", truth / "a.ply", "--json")
    (record,) = records(made)
    told = json.loads(msal("compare", truth / "a.ply", output, "--json").stdout)
    assert {name: record["reference"][name] for name in SHARED} == {n: told[n] for n in SHARED}
    assert record["reference"]["path"] == str(truth / "a.ply")
    assert record["reference"]["mean_angular_error_deg"] != record["normal_change"]["mean_deg"]
    assert "reference     normals " in made.stderr


def test_a_folder_is_matched_by_relative_path_and_reruns_are_measured_too(scans, truth, tmp_path):
    given = ("denoise", scans, "-o", tmp_path / "out", "--reference", truth, "--json")
    first, second = records(msal(*given)), records(msal(*given))
    assert [one["status"] for one in second] == ["up-to-date"] * 2
    for one, again in zip(first, second, strict=True):
        assert one["reference"] == again["reference"]
        assert one["reference"]["mean_angular_error_deg"] > 0.0
    assert {one["reference"]["path"] for one in first} == {
        str(truth / "a.ply"),
        str(truth / "below" / "b.ply"),
    }


def test_a_reference_that_is_missing_is_told_and_the_output_is_written(scans, truth, tmp_path):
    (truth / "a.ply").unlink()
    report = tmp_path / "r.csv"
    made = msal("denoise", scans, "-o", tmp_path / "out", "--reference", truth, "--report", report)
    assert made.exit_code == 0
    assert (tmp_path / "out" / "a.ply").exists()
    assert "no comparison with the reference: 1" in made.stderr
    with report.open(newline="") as table:
        rows = {row["input"].rpartition("/")[2]: row for row in csv.DictReader(table)}
    assert rows["a.ply"]["reference.error.message"]
    assert float(rows["b.ply"]["reference.vertex_error_percent"]) > 0.0


def test_a_gate_is_judged_against_the_reference_alone(scans, truth, tmp_path):
    given = ("denoise", scans / "a.ply", "--fail-on", "mean_angular_error_deg > 89")
    good = msal(*given, "-o", tmp_path / "a.ply", "--reference", truth / "a.ply")
    assert good.exit_code == 0
    (truth / "flat.ply").write_bytes(as_ply(*grid()))
    # The faces are not the same: there is no such angle, and that of the denoising is another.
    none = msal(*given, "-o", tmp_path / "b.ply", "--reference", truth / "flat.ply")
    assert none.exit_code == 4
    assert "not decided" in none.stderr


@pytest.mark.parametrize(
    "words", [["-o", "out.ply", "--reference", "none.ply"], ["-o", "-", "--reference", "TRUTH"]]
)
def test_a_reference_that_cannot_be_is_refused(scans, truth, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = [str(truth / "a.ply") if word == "TRUTH" else word for word in words]
    made = msal("denoise", scans / "a.ply", *words)
    assert (made.exit_code, made.stdout) == (2, "")
    assert not (tmp_path / "out.ply").exists()


def test_a_stream_into_a_file(scans, truth, tmp_path):
    given = ("denoise", "-", "-o", tmp_path / "out.ply", "--json")
    data = (scans / "a.ply").read_bytes()
    made = msal_on(data, *given, "--reference", truth / "a.ply")
    assert records(made)[0]["reference"]["vertex_error_percent"] > 0.0
    refused = msal_on(data, *given, "--reference", truth)
    assert refused.exit_code == 2
