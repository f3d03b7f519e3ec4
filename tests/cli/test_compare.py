"""`msal compare`."""

from __future__ import annotations

import json

import pytest
from jsonschema import Draft202012Validator

from msal_cli import codecs
from tests.cli.scans import BAD_SCAN, closed_scan, folder_of, msal
from tests.report.schemas import compare_schema

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


def test_more_files_are_a_table_with_a_row_for_each(scans):
    names = [scans / f"{name}.ply" for name in ("b", "a", "bad")]
    made = msal("compare", scans / "a.ply", *names)
    head, first, second, *rest = made.stdout.splitlines()
    assert "angle" in head and "vertex error" in head
    assert "b.ply" in first and "a.ply" in second and "0.00°" in second
    assert made.exit_code == 3 and "2 compared, 1 not" in rest[-1]
    data = json.loads(msal("compare", scans / "a.ply", *names[:2], "--json").stdout)
    Draft202012Validator(SCHEMA).validate(data)
    assert [one["after"] for one in data["records"]] == [str(name) for name in names[:2]]
    gate = msal("compare", scans / "a.ply", *names[:2], "--fail-on", "vertex_error_percent > 1")
    assert gate.exit_code == 4 and "b.ply" in gate.stderr and "a.ply:" not in gate.stderr


@pytest.mark.parametrize("words", [("a.ply", "."), ("a.ply", "b.ply", "."), (".", ".", ".")])
def test_folders_are_compared_in_pairs_only(scans, words):
    made = msal("compare", *(scans / word for word in words))
    assert made.exit_code == 2 and "two folders" in made.stderr


def test_a_file_that_cannot_be_read(scans):
    made = msal("compare", scans / "a.ply", scans / "bad.ply", "--json")
    assert made.exit_code == 1
    data = json.loads(made.stdout)
    ONE.validate(data)
    assert data["error"]["code"] == "E_INDEX"
    assert str(scans / "bad.ply") in made.stderr
    assert "Traceback" not in made.stderr


@pytest.mark.parametrize("order", [("bad", "a"), ("a", "bad")])
def test_the_file_at_fault_is_the_one_that_is_named(scans, order):
    made = msal("compare", *(scans / f"{name}.ply" for name in order))
    assert made.exit_code == 1
    assert made.stderr.startswith(f"msal: error: {scans / 'bad.ply'}: ")
    assert "a.ply" not in made.stderr.splitlines()[0].replace("bad.ply", "")


def test_a_file_that_is_not_there(scans):
    made = msal("compare", scans / "a.ply", scans / "none.ply")
    assert (made.exit_code, made.stdout) == (2, "")
    assert "none.ply" in made.stderr


@pytest.fixture
def folders(tmp_path):
    a = folder_of(tmp_path / "A", one=closed_scan(0), gone=closed_scan(1))
    folder_of(a / "below", two=closed_scan(2))
    b = folder_of(tmp_path / "B", one=closed_scan(3), new=closed_scan(1))
    folder_of(b / "below", two=closed_scan(2))
    return a, b


def test_folders_are_matched_by_relative_path(folders):
    a, b = folders
    made = msal("compare", a, b, "--json")
    assert made.exit_code == 3
    data = json.loads(made.stdout)
    Draft202012Validator(SCHEMA).validate(data)
    found = {one["after"].removeprefix(f"{b}/"): one for one in data["records"]}
    assert list(found) == ["below/two.ply", "gone.ply", "one.ply", "new.ply"]
    assert found["one.ply"]["before"] == str(a / "one.ply")
    assert found["one.ply"]["mean_angular_error_deg"] > 0.0
    assert found["below/two.ply"]["mean_angular_error_deg"] == 0.0
    codes = [found[name]["error"]["code"] for name in ("gone.ply", "new.ply")]
    assert codes == ["E_NO_PARTNER"] * 2
    assert found["new.ply"]["before"] == str(a / "new.ply")


def test_folders_as_a_table(folders):
    a, b = folders
    made = msal("compare", a, b, "--exclude", "gone.ply", "--exclude", "new.ply")
    assert (made.exit_code, made.stderr) == (0, "")
    head, *rows = made.stdout.splitlines()
    assert head.split()[:2] == ["after", "angle"]
    assert "below/two.ply  " in rows[0]
    assert "B/one.ply  " in rows[1]
    assert rows[-1].startswith("2 compared")
    partly = msal("compare", a, b)
    assert partly.exit_code == 3
    assert "there is no 'gone.ply' in" in partly.stdout


def test_a_file_and_a_folder_are_refused(folders):
    a, b = folders
    assert msal("compare", a / "one.ply", b).exit_code == 2
    assert msal("compare", a, b, "--heatmap", a / "h.ply").exit_code == 2


def test_a_heat_map(scans):
    target = scans / "heat.ply"
    made = msal("compare", scans / "a.ply", scans / "b.ply", "--heatmap", target)
    assert made.exit_code == 0
    assert "pale to dark for 0 to" in made.stderr
    data = target.read_bytes()
    opened = codecs.open_mesh(data, "heat.ply")
    assert opened.properties == (
        "vertex.red uchar",
        "vertex.green uchar",
        "vertex.blue uchar",
        "vertex.deviation float",
    )
    told = json.loads(msal("compare", scans / "a.ply", scans / "b.ply", "--json").stdout)
    assert f"the largest is {told['displacement']['max']:.6g})".encode() in data


@pytest.mark.parametrize("name", ["a.ply", "b.ply", "heat.obj", "."])
def test_a_heat_map_that_cannot_be(scans, name):
    before = (scans / "a.ply").read_bytes()
    made = msal("compare", scans / "a.ply", scans / "b.ply", "--heatmap", scans / name)
    assert (made.exit_code, made.stdout) == (2, "")
    assert (scans / "a.ply").read_bytes() == before


def test_a_heat_map_in_a_folder_that_is_not_there(scans):
    target = scans / "none" / "heat.ply"
    made = msal("compare", scans / "a.ply", scans / "b.ply", "--heatmap", target)
    assert made.exit_code == 1
    assert "the output folder does not exist" in made.stderr
    assert "normal angle" in made.stdout
