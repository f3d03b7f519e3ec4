"""`msal sweep`."""

from __future__ import annotations

import json
import shlex

import numpy as np
import pytest
from PIL import Image

from tests.cli.scans import closed_scan, folder_of, msal, open_scan, ply_text
from tests.shapes import torus


@pytest.fixture
def scans(tmp_path):
    clean = ply_text(*torus())
    return folder_of(tmp_path, a=closed_scan(0), clean=clean, open=open_scan())


def swept(scans, *options):
    made = msal("sweep", scans / "a.ply", "-o", scans / "g.png", "--size", "64", *options)
    assert made.exit_code == 0, made.stderr
    return made.stdout, np.asarray(Image.open(scans / "g.png"))


def test_every_pair_is_a_cell(scans):
    words, image = swept(scans)
    assert len(words.splitlines()) == 16 + 3
    _, smaller = swept(scans, "--rows", "iterations=1,2", "--columns", "K=0.5")
    # The column of the input has the two choices too.
    assert smaller.shape[0] < 0.8 * image.shape[0]
    assert smaller.shape[1] < 0.5 * image.shape[1]


def test_the_commands_make_what_the_numbers_say(scans):
    options = ("--rows", "iterations=1,3", "--columns", "K=0.25,1", "--set", "mollify=2")
    words, _ = swept(scans, *options, "--json")
    data = json.loads(words)
    assert data["schema"] == "msal.sweep/1"
    assert [cell["parameters"] for cell in data["cells"]] == [
        {"iterations": n, "K": k} for n in (1, 3) for k in (0.25, 1.0)
    ]
    for cell in data["cells"]:
        command = shlex.split(cell["command"])
        assert command[:2] == ["msal", "denoise"]
        output = scans / "made.ply"
        made = msal(*(str(output) if word == "OUT" else word for word in command[1:]), "--force")
        assert made.exit_code == 0, made.stderr
        told = json.loads(msal("compare", scans / "a.ply", output, "--json").stdout)
        # The file has six decimals.
        moved = pytest.approx(told["displacement"]["mean"], rel=1e-3)
        assert cell["mean_displacement"] == moved
        change = pytest.approx(told["volume_change_percent"], rel=1e-2)
        assert cell["volume_change_percent"] == change


def test_what_msal_chooses_is_shown_and_the_nearest_is_named(scans):
    columns = ("--columns", "iterations=1,40", "--method", "al")
    data = json.loads(swept(scans, *columns, "--json")[0])
    plain, auto = data["choices"]
    assert plain["command"].endswith("-o OUT") and auto["command"].endswith("-o OUT --auto")
    for cell, words in ((plain, ()), (auto, ("--auto",))):
        made = msal("denoise", scans / "a.ply", "-o", scans / "made.ply", "--force", *words)
        assert made.exit_code == 0
        told = json.loads(msal("compare", scans / "a.ply", scans / "made.ply", "--json").stdout)
        assert cell["mean_displacement"] == pytest.approx(told["displacement"]["mean"], rel=1e-3)
    risks = {cell["command"]: cell["risk_edges"] for cell in data["cells"] + data["choices"]}
    assert data["nearest"] == min(risks, key=risks.get)
    # Forty sweeps flatten the shape itself.
    assert data["cells"][1]["risk_edges"] > 2.0 * max(plain["risk_edges"], auto["risk_edges"])
    words, _ = swept(scans, *columns)
    assert words.splitlines()[-1].endswith(data["nearest"])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--rows", "K"), "NAME=VALUE"),
        (("--rows", "K=0.5,,1"), "NAME=VALUE"),
        (("--rows", "K=0.5,2"), "K = 2"),
        (("--columns", "k=0.5"), "no parameter"),
        (("--columns", "K=0.5,0.50"), "twice"),
        (("--columns", "K=0.5", "--rows", "K=1"), "two places"),
        (("--columns", "K=0.5", "--set", "K=1"), "two places"),
        (("--columns", "K=0.5", "--set", "mollify=1", "--set", "mollify=2"), "twice"),
        (("--columns", "iterations=" + ",".join(map(str, range(1, 102)))), "100 cells"),
        (("--method", "nothing"), "no method"),
        (("-o", "g.ply"), "NAME.png"),
    ],
)
def test_what_cannot_be_tried_is_said(scans, monkeypatch, options, said):
    monkeypatch.chdir(scans)
    made = msal("sweep", "a.ply", "-o", "g.png", *options)
    assert made.exit_code == 2
    assert said in made.stderr
    assert not (scans / "g.png").exists()


def test_a_reference_must_have_the_same_faces(scans):
    made = msal("sweep", scans / "a.ply", "-o", scans / "g.png", "--reference", scans / "open.ply")
    assert made.exit_code == 1
    assert "open.ply" in made.stderr and "same vertices and faces" in made.stderr
