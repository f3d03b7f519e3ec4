"""`msal view`, `msal info` and `msal sweep`."""

import io
import json
import os
import shlex
import sys
import webbrowser

import pytest
from jsonschema import Draft202012Validator
from PIL import Image

from tests.cli.scans import closed_scan, folder_of, msal, msal_on, record_of
from tests.report.made import load_schema


def test_options_change_the_picture(scans):
    def picture(*options):
        made = msal("view", scans / "a.ply", "-o", scans / "o.png", "--size", "80", *options)
        assert made.exit_code == 0, made.stderr
        return (scans / "o.png").read_bytes()

    given = ",--turn 70,--tilt -40,--view top,--up=-x,--shading flat,--size 81"
    pictures = {picture(*one.split()) for one in given.split(",")} | {picture(scans / "b.ply")}
    assert len(pictures) == 8


def test_without_a_name_the_page_is_in_the_current_folder(scans, tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for _ in range(2):
        made = msal("view", scans / "a.ply", scans / "b.ply", "--size", "80")
        assert made.exit_code == 0 and "wrote b.view.html" in made.stderr
    assert os.listdir(folder) == ["b.view.html"]
    (folder / "b.view.html").write_text("notes of mine")
    assert msal("view", scans / "b.ply").exit_code == 2
    assert (folder / "b.view.html").read_text() == "notes of mine"
    if sys.platform == "linux":
        assert opened == []
    monkeypatch.setenv("DISPLAY", ":0")
    msal("view", scans / "a.ply", "-q", "--size", "80")
    assert opened[-1] == (folder / "a.view.html").as_uri()


def test_standard_output_takes_a_picture(scans):
    made = msal("view", scans / "a.ply", "-o", "-", "--size", "64")
    assert Image.open(io.BytesIO(made.stdout_bytes)).format == "PNG"
    assert made.stderr == ""


def test_one_is_singular(tmp_path):
    path = tmp_path / "line.off"
    path.write_text("OFF\n4 1 0\n0 0 0\n1 0 0\n2 0 0\n5 5 5\n3 0 1 2\n")
    text = msal("info", path).stdout
    for words in ("1 (1 triangle)", "1 degenerate face", "1 unreferenced vertex\n"):
        assert words in text
    assert "1 triangle\n" in msal("compare", path, path).stdout


def test_a_folder_is_a_table(mixed):
    made = msal("info", mixed)
    assert made.exit_code == 3
    head, open_row, row, foot = made.stdout.splitlines()
    if "below" not in open_row:
        open_row, row = row, open_row
    assert head.split() == ["file", "format", "vertices", "faces", "noise", "surface", "problems"]
    name, *cells = row.split()
    assert name.endswith("closed.ply")
    assert cells == ["ply", "576", "1,152", "0.31", "closed"]
    assert open_row.split()[5:] == ["open", "18", "boundary", "edges"]
    assert "-v" in foot
    assert made.stderr.startswith(f"msal: error: {mixed / 'bad.ply'}: ")


@pytest.mark.parametrize(
    ("names", "status"), [(["closed.ply"], 0), (["bad.ply"], 1), (["bad.ply", "closed.ply"], 3)]
)
def test_json_has_one_shape_for_one_file_and_for_many(mixed, names, status):
    made = msal("info", "--json", *(mixed / name for name in names))
    assert made.exit_code == status
    data = json.loads(made.stdout)
    Draft202012Validator(load_schema("info")).validate(data)
    assert [one["input"] for one in data["records"]] == [str(mixed / name) for name in names]
    assert ("bad.ply" in made.stderr) == ("bad.ply" in names)
    for record in data["records"]:
        assert (record["error"] is None) == record["input"].endswith("closed.ply")


def test_standard_input():
    made = msal_on(closed_scan(), "info", "-", "--json")
    record = record_of(made)
    assert (record["input"], record["vertices"]) == ("-", 576)


def test_a_file_may_be_called_like_standard_input(tmp_path, monkeypatch):
    (tmp_path / "-").write_bytes(closed_scan())
    monkeypatch.chdir(tmp_path)
    assert record_of(msal_on(b"", "info", "./-", "--json"))["vertices"] == 576


def test_the_commands_of_a_sweep_make_what_its_numbers_say(tmp_path):
    scan = folder_of(tmp_path, a=closed_scan()) / "a.ply"
    grid = ("--rows", "iterations=1,40", "--columns", "mollify=0,2", "--method", "al")
    words = ("sweep", scan, "-o", tmp_path / "g.png", "--size", "64", *grid, "--reference", scan)
    data = json.loads(msal(*words, "--json").stdout)
    assert data["schema"] == "msal.sweep/1"
    assert [cell["parameters"] for cell in data["cells"]] == [
        {"iterations": n, "mollify": passes} for n in (1, 40) for passes in (0, 2)
    ]
    plain, auto = data["choices"]
    assert plain["command"].endswith("-o OUT") and auto["command"].endswith("-o OUT --auto")
    cells = data["cells"] + data["choices"]
    for cell in cells:
        _, *command = shlex.split(cell["command"].replace("OUT", str(tmp_path / "made.ply")))
        assert msal(*command, "--force").exit_code == 0
        made = json.loads(msal("compare", scan, tmp_path / "made.ply", "--json").stdout)
        # The file has six decimals.
        moved = pytest.approx(made["displacement"]["mean"], rel=1e-3)
        assert cell["mean_displacement"] == moved
        change = pytest.approx(made["volume_change_percent"], rel=1e-2)
        assert cell["volume_change_percent"] == change
    risks = {cell["command"]: cell["risk_edges"] for cell in cells}
    assert data["nearest"] == min(risks, key=risks.get)
    # Forty sweeps flatten the shape itself.
    assert data["cells"][3]["risk_edges"] > 2.0 * max(plain["risk_edges"], auto["risk_edges"])
    errors = {cell["command"]: cell["mean_angular_error_deg"] for cell in cells}
    assert data["nearest_to_reference"] == min(errors, key=errors.get)
    *_, by_risk, to_reference = msal(*words).stdout.splitlines()
    assert by_risk.endswith(data["nearest"])
    assert to_reference.endswith(data["nearest_to_reference"])
