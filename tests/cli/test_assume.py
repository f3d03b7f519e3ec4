"""Files of which noise and texture cannot be told apart: what is said, and `--assume`."""

from __future__ import annotations

import dataclasses
import json

import pytest

from msal_cli.analysis.noise_estimate import NOISE, TEXTURE, Reading, estimate_noise
from msal_cli.job.choice import prepare
from msal_cli.job.settings import ADAPTIVE, Settings
from msal_cli.mesh import prepare_mesh
from tests.cli.scans import closed_scan, folder_of, msal
from tests.shapes import noisy, torus

READINGS = (Reading(NOISE, 0.08, 0.6), Reading(TEXTURE, 0.0, 0.4))


def read_as_either(mesh):
    return dataclasses.replace(estimate_noise(mesh), readings=READINGS)


@pytest.fixture
def scan(tmp_path, monkeypatch):
    monkeypatch.setattr("msal_cli.auto.adaptive.estimate_noise", read_as_either)
    monkeypatch.setattr("msal_cli.auto.search.estimate_noise", read_as_either)
    return folder_of(tmp_path / "in", scan=closed_scan()) / "scan.ply"


def test_an_unsure_file_is_named_everywhere(scan, tmp_path):
    page = tmp_path / "run.html"
    words = ("--json", "--report", page, "--fail-on", "noise_estimate.unsure")
    made = msal("denoise", scan, "-o", tmp_path / "o.ply", *words)
    assert made.exit_code == 4
    (record,) = json.loads(made.stdout)["records"]
    assert record["noise_estimate"]["unsure"]
    assert record["noise_estimate"]["readings"] == [
        {"kind": "noise", "level_edges": 0.08, "probability": 0.6},
        {"kind": "texture", "level_edges": 0.0, "probability": 0.4},
    ]
    said = "noise of 0.08 e (60 %) or texture (40 %): filtered mildly, --assume noise or texture"
    assert said in made.stderr
    looked_at = page.read_text().partition("<h2>Look at these")[2]
    assert "noise of 0.08 e (60 %) or texture (40 %)" in looked_at


@pytest.mark.parametrize("words", [(), ("--auto", "--auto-budget", "1.01")])
def test_an_assumption_decides_what_is_done(scan, tmp_path, words):
    records = {}
    for assume in ("noise", "texture"):
        output = tmp_path / f"{assume}.ply"
        made = msal("denoise", scan, "-o", output, "--json", "-q", "--assume", assume, *words)
        (records[assume],) = json.loads(made.stdout)["records"]
        # The estimate stays what it is.
        assert records[assume]["noise_estimate"]["unsure"]
        assert records[assume]["choice"]["wishes"]["assume"] == assume
        assert records[assume]["choice"]["among"] == ("all" if words else "family")
    assert records["noise"]["status"] == "written"
    assert records["noise"]["choice"]["noise_edges"] == 0.08
    assert records["texture"]["status"] == "unchanged"
    assert (tmp_path / "texture.ply").read_bytes() == scan.read_bytes()


@pytest.mark.parametrize(("assume", "is_left"), [(None, True), ("noise", False), ("texture", True)])
def test_the_least_noise_is_compared_with_what_is_assumed(monkeypatch, assume, is_left):
    quiet = prepare_mesh(noisy(torus(40, 20)[0], 0, 0.005), torus(40, 20)[1]).mesh
    for place in ("auto.adaptive", "analysis.noise_estimate"):
        monkeypatch.setattr(f"msal_cli.{place}.estimate_noise", read_as_either)
    given = {} if assume is None else {"assume": assume}
    settings = Settings(ADAPTIVE, given, min_noise="0.06e")
    made = prepare(quiet, settings, lambda done, total: None)
    assert ("left_alone" in made.known) == is_left
    assert made.noise.is_unsure
