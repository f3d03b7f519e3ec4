"""`msal compare`."""

from __future__ import annotations

import json

import pytest
from jsonschema import Draft202012Validator

from msal_cli.report.schema import compare_schema
from tests.cli.scans import BAD_SCAN, closed_scan, folder_of, msal

SCHEMA = compare_schema()
ONE = Draft202012Validator({**SCHEMA["$defs"]["ComparisonRecord"], "$defs": SCHEMA["$defs"]})


@pytest.fixture
def scans(tmp_path):
    return folder_of(tmp_path, a=closed_scan(0), b=closed_scan(1), bad=BAD_SCAN)


def test_two_files_in_words(scans):
    made = msal("compare", scans / "a.ply", scans / "b.ply")
    assert (made.exit_code, made.stderr) == (0, "")
    lines = made.stdout.splitlines()
    assert lines[0] == f"before  {scans / 'a.ply'}: 288 vertices, 576 triangles"
    assert lines[1].startswith(f"after   {scans / 'b.ply'}")
    told = {line[2:20].strip(): line[21:] for line in lines[2:]}
    assert {"normal angle", "vertex error", "displacement", "volume", "area"} <= told.keys()


def test_two_files_as_one_object(scans):
    made = msal("compare", scans / "a.ply", scans / "b.ply", "--json")
    data = json.loads(made.stdout)
    ONE.validate(data)
    assert (data["before"], data["after"]) == (str(scans / "a.ply"), str(scans / "b.ply"))
    assert {
        "mean_angular_error_deg",
        "vertex_error_percent",
        "displacement",
        "volume_change_percent",
        "hausdorff",
    } <= data.keys()
    assert 0.0 < data["mean_angular_error_deg"] < 90.0
    assert data["displacement"]["max"] > 0.0


def test_a_file_that_cannot_be_read(scans):
    made = msal("compare", scans / "a.ply", scans / "bad.ply", "--json")
    assert made.exit_code == 1
    data = json.loads(made.stdout)
    ONE.validate(data)
    assert data["error"]["code"] == "E_INDEX"
    assert str(scans / "bad.ply") in made.stderr
    assert "Traceback" not in made.stderr


def test_a_file_that_is_not_there(scans):
    made = msal("compare", scans / "a.ply", scans / "none.ply")
    assert (made.exit_code, made.stdout) == (1, "")
    assert "none.ply" in made.stderr
