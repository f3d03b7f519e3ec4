"""`msal compare`, and `--baseline`: regressions are status 4, and named."""

import json

import pytest
from jsonschema import Draft202012Validator

from msal_cli import codecs
from tests.cli.scans import BAD_SCAN, closed_scan, folder_of, msal, ply_text
from tests.report.made import load_schema
from tests.shapes import noisy, torus

SCHEMA = load_schema("compare")


def test_two_files_in_words_as_one_object_and_as_a_heat_map(scans):
    words, target = ("compare", scans / "a.ply", scans / "b.ply"), scans / "heat.ply"
    made = msal(*words)
    assert (made.exit_code, made.stderr) == (0, "")
    assert made.stdout.startswith(f"before  {scans / 'a.ply'}: 576 vertices, 1,152 triangles\n")
    data = json.loads(msal(*words, "--json").stdout)
    Draft202012Validator(SCHEMA).validate(data)
    assert (data["before"], data["after"]) == (str(scans / "a.ply"), str(scans / "b.ply"))
    assert 0.0 < data["mean_angular_error_deg"] < 90.0
    assert data["displacement"]["max"] > 0.0
    made = msal(*words, "--heatmap", target)
    assert made.exit_code == 0
    assert "pale to dark for 0 to" in made.stderr
    properties = codecs.open_mesh(target.read_bytes(), "heat.ply").properties
    assert properties[0] == "vertex.red uchar" and properties[3] == "vertex.deviation float"
    assert f"the largest is {data['displacement']['max']:.6g})".encode() in target.read_bytes()


def test_more_files_are_a_table_with_a_row_for_each(scans):
    names = [scans / f"{name}.ply" for name in ("b", "a", "bad")]
    words = ("--fail-on", "vertex_error_percent > 1", "--check", "self-intersections")
    made = msal("compare", scans / "a.ply", *names, *words)
    head, first, second, *rest = made.stdout.splitlines()
    assert "angle" in head and "intersecting" in head
    assert "b.ply" in first and "a.ply" in second and "0.00°" in second
    assert made.exit_code == 3 and "2 compared, 1 not" in rest[-1]
    assert "b.ply: broken" in made.stderr and "a.ply: broken" not in made.stderr


def test_a_warning_in_the_table_names_its_pair(scans):
    vertices, faces = torus(32, 18)
    folder_of(scans, turned=ply_text(vertices, faces[:, ::-1]))
    made = msal("compare", scans / "a.ply", scans / "b.ply", scans / "turned.ply")
    (warning,) = [line for line in made.stdout.splitlines() if line.startswith("warning: ")]
    pair = f"{scans / 'a.ply'} and {scans / 'turned.ply'}"
    assert warning.startswith(f"warning: {pair}: after: the surface is inside out")


@pytest.fixture
def folders(tmp_path):
    a = folder_of(tmp_path / "A", one=closed_scan(0), gone=closed_scan(1))
    folder_of(a / "below", two=closed_scan(2))
    b = folder_of(tmp_path / "B", one=closed_scan(3), new=closed_scan(1), **{"one.fields": b"ply"})
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
    assert {found[f"{name}.ply"]["error"]["code"] for name in ("gone", "new")} == {"E_NO_PARTNER"}
    assert found["new.ply"]["before"] == str(a / "new.ply")
    (a / "one.ply").write_bytes(BAD_SCAN)
    made = msal("compare", a / "one.ply", b / "one.ply", "--json")
    data = json.loads(made.stdout)
    assert (data["at_fault"], data["error"]["where"]) == ("before", "face 0, line 587")
    assert f"{a / 'one.ply'}: face 0, line 587: " in made.stderr


def scan(level):
    vertices, faces = torus()
    return ply_text(noisy(vertices, 0, level), faces)


@pytest.fixture
def moved(tmp_path):
    """Two folders of three files, what was known of them, and a fourth file without a partner."""
    truth = folder_of(tmp_path / "truth", a=scan(0.0), b=scan(0.0), c=scan(0.0))
    new = folder_of(tmp_path / "new", a=scan(0.05), b=scan(0.05), c=scan(0.05))
    known = tmp_path / "known.json"
    known.write_bytes(msal("compare", truth, new, "--json").stdout_bytes)
    folder_of(truth, d=scan(0.0))
    return truth, new, known


def test_a_missing_partner_does_not_hide_a_broken_baseline(moved):
    truth, new, known = moved
    given = ("compare", truth, new, "--baseline", known)
    assert msal(*given).exit_code == 3
    folder_of(new, b=scan(0.06))
    assert msal(*given, "--tolerance", "50%").exit_code == 3
    made = msal(*given, "--tolerance", "1%")
    assert made.exit_code == 4 and "there is no 'd.ply'" in made.stdout
    assert "vertex_error_percent > " in made.stderr and "tolerance 1 %" in made.stderr
    # What cannot be read weighs more.
    folder_of(new, a=b"ply")
    assert msal(*given).exit_code == 3
