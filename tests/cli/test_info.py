"""msal info and msal sweep."""

from __future__ import annotations

import json
import shlex

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from PIL import Image

from tests.cli.scans import (
    BAD_SCAN,
    closed_scan,
    folder_of,
    msal,
    msal_on,
    open_scan,
    ply_text,
    record_of,
)
from tests.report.made import load_schema
from tests.shapes import torus


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
    facts = {line[2:17].strip(): line[18:] for line in lines[1:]}
    assert (facts["vertices"], facts["surface"]) == ("576", "closed")
    assert facts["faces"] == "1,152 (1,152 triangles)"
    assert float(facts["volume"]) == pytest.approx(59, rel=0.1)


def test_one_is_singular(tmp_path):
    path = tmp_path / "line.off"
    path.write_text("OFF\n4 1 0\n0 0 0\n1 0 0\n2 0 0\n5 5 5\n3 0 1 2\n")
    text = msal("info", path).stdout
    for words in ("1 (1 triangle)", "1 face\n", "1 vertex\n"):
        assert words in text
    assert "1 triangle\n" in msal("compare", path, path).stdout


def test_a_folder_is_a_table(scans):
    made = msal("info", scans)
    assert made.exit_code == 3
    head, open_row, row, foot = made.stdout.splitlines()
    if "below" not in open_row:
        open_row, row = row, open_row
    assert head.split() == ["file", "format", "vertices", "faces", "noise", "surface", "problems"]
    name, *cells = row.split()
    assert name.endswith("closed.ply")
    assert cells == ["ply", "576", "1,152", "0.3", "closed"]
    assert open_row.split()[5:] == ["open", "18", "boundary", "edges"]
    assert "-v" in foot
    assert made.stderr.startswith(f"msal: error: {scans / 'bad.ply'}: ")


@pytest.mark.parametrize(
    ("names", "status"), [(["closed.ply"], 0), (["bad.ply"], 1), (["bad.ply", "closed.ply"], 3)]
)
def test_json_has_one_shape_for_one_file_and_for_many(scans, names, status):
    made = msal("info", "--json", *(scans / name for name in names))
    assert made.exit_code == status
    data = json.loads(made.stdout)
    Draft202012Validator(load_schema("info")).validate(data)
    assert [one["input"] for one in data["records"]] == [str(scans / name) for name in names]
    assert ("bad.ply" in made.stderr) == ("bad.ply" in names)
    for record in data["records"]:
        assert (record["error"] is None) == record["input"].endswith("closed.ply")


def test_standard_input():
    made = msal_on(closed_scan(), "info", "-", "--json")
    record = record_of(made)
    assert (record["input"], record["vertices"]) == ("-", 576)


@pytest.fixture
def sweep_scans(tmp_path):
    clean = ply_text(*torus())
    return folder_of(tmp_path, a=closed_scan(0), clean=clean, open=open_scan())


def swept(sweep_scans, *options):
    made = msal(
        "sweep", sweep_scans / "a.ply", "-o", sweep_scans / "g.png", "--size", "64", *options
    )
    assert made.exit_code == 0, made.stderr
    return made.stdout, np.asarray(Image.open(sweep_scans / "g.png"))


def compared(sweep_scans, *words):
    """What a command for a.ply with the output OUT makes, compared with a.ply."""
    output = sweep_scans / "made.ply"
    made = msal(*(output if word == "OUT" else word for word in words), "--force")
    assert made.exit_code == 0, made.stderr
    return json.loads(msal("compare", sweep_scans / "a.ply", output, "--json").stdout)


def test_the_commands_make_what_the_numbers_say(sweep_scans):
    options = ("--rows", "iterations=1,3", "--columns", "K=0.25,1", "--set", "mollify=2")
    words, _ = swept(sweep_scans, *options, "--json")
    data = json.loads(words)
    assert data["schema"] == "msal.sweep/1"
    assert [cell["parameters"] for cell in data["cells"]] == [
        {"iterations": n, "K": k} for n in (1, 3) for k in (0.25, 1.0)
    ]
    for cell in data["cells"]:
        command = shlex.split(cell["command"])
        assert command[:2] == ["msal", "denoise"]
        compared_record = compared(sweep_scans, *command[1:])
        # The file has six decimals.
        moved = pytest.approx(compared_record["displacement"]["mean"], rel=1e-3)
        assert cell["mean_displacement"] == moved
        change = pytest.approx(compared_record["volume_change_percent"], rel=1e-2)
        assert cell["volume_change_percent"] == change


def test_what_msal_chooses_is_shown_and_the_nearest_is_named(sweep_scans):
    columns = ("--columns", "iterations=1,40", "--method", "al")
    data = json.loads(swept(sweep_scans, *columns, "--json")[0])
    plain, auto = data["choices"]
    assert plain["command"].endswith("-o OUT") and auto["command"].endswith("-o OUT --auto")
    for cell, words in ((plain, ()), (auto, ("--auto",))):
        compared_record = compared(
            sweep_scans, "denoise", sweep_scans / "a.ply", "-o", "OUT", *words
        )
        assert cell["mean_displacement"] == pytest.approx(
            compared_record["displacement"]["mean"], rel=1e-3
        )
    risks = {cell["command"]: cell["risk_edges"] for cell in data["cells"] + data["choices"]}
    assert data["nearest"] == min(risks, key=risks.get)
    # Forty sweeps flatten the shape itself.
    assert data["cells"][1]["risk_edges"] > 2.0 * max(plain["risk_edges"], auto["risk_edges"])
    words, _ = swept(sweep_scans, *columns)
    assert words.splitlines()[-1].endswith(data["nearest"])
