"""`msal info`."""

from __future__ import annotations

import json

import pytest
from jsonschema import Draft202012Validator

from tests.cli.scans import BAD_SCAN, closed_scan, folder_of, msal, msal_on, open_scan, record_of
from tests.report.schemas import info_schema


@pytest.fixture
def scans(tmp_path):
    folder = folder_of(tmp_path, bad=BAD_SCAN, closed=closed_scan())
    folder_of(folder / "below", open=open_scan())
    return folder


def test_a_closed_file(scans):
    made = msal("info", scans / "closed.ply")
    assert (made.exit_code, made.stderr) == (0, "")
    lines = made.stdout.splitlines()
    assert lines[0] == str(scans / "closed.ply")
    told = {line[2:17].strip(): line[18:] for line in lines[1:]}
    assert (told["vertices"], told["surface"]) == ("288", "closed")
    assert told["faces"] == "576 (576 triangles)"
    assert float(told["volume"]) == pytest.approx(59, rel=0.1)


def test_a_folder_is_a_table(scans):
    made = msal("info", scans)
    assert made.exit_code == 3
    head, open_row, row, foot = made.stdout.splitlines()
    if "below" not in open_row:
        open_row, row = row, open_row
    assert head.split() == ["file", "format", "vertices", "faces", "noise", "surface", "problems"]
    name, *cells = row.split()
    assert name.endswith("closed.ply")
    assert cells == ["ply", "288", "576", "0.3", "closed"]
    assert open_row.split()[5:] == ["open", "18", "boundary", "edges"]
    assert "-v" in foot
    assert made.stderr.startswith(f"msal: error: {scans / 'bad.ply'}: ")


def test_the_table_can_be_cut_off_and_leaves_no_row_for_failures(scans):
    made = msal("info", scans / "bad.ply", scans / "closed.ply", "--check", "self-intersections")
    assert made.exit_code == 3
    assert len(made.stdout.splitlines()) == 3
    made = msal("info", scans / "bad.ply", scans / "bad.ply")
    assert "(E_INDEX)" in made.stderr
    assert made.stdout == ""


@pytest.mark.parametrize(
    ("names", "status"), [(["closed.ply"], 0), (["bad.ply"], 1), (["bad.ply", "closed.ply"], 3)]
)
def test_json_has_one_shape_for_one_file_and_for_many(scans, names, status):
    made = msal("info", "--json", *(scans / name for name in names))
    assert made.exit_code == status
    data = json.loads(made.stdout)
    Draft202012Validator(info_schema()).validate(data)
    assert [one["input"] for one in data["records"]] == [str(scans / name) for name in names]
    assert ("bad.ply" in made.stderr) == ("bad.ply" in names)
    for record in data["records"]:
        assert (record["error"] is None) == record["input"].endswith("closed.ply")


def test_standard_input():
    made = msal_on(closed_scan(), "info", "-", "--json")
    record = record_of(made)
    assert (record["input"], record["vertices"]) == ("-", 288)


@pytest.mark.parametrize(
    ("arguments", "status"),
    [(["-", "FOLDER"], 2), (["-", "--include", "*"], 2), (["nowhere.ply"], 2), ([], 2)]
    + [(["FOLDER", "--include", "*.stl"], 5), (["FOLDER", "--format", "zzz"], 2)],
)
def test_wrong_use(scans, arguments, status):
    made = msal("info", *(one.replace("FOLDER", str(scans)) for one in arguments))
    assert (made.exit_code, made.stdout) == (status, "")
    assert "msal: error: " in made.stderr
