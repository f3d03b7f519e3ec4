"""What is chosen for each mesh: the plain command, --auto, --assume, --min-noise, --despike."""

import dataclasses
import json

import numpy as np
import pytest

from msal_cli import auto as selection
from msal_cli import codecs, methods
from msal_cli.analysis.noise_estimate import NOISE, TEXTURE, Reading, estimate_noise
from msal_cli.auto import adaptive, candidates
from msal_cli.auto.blends import build_recipe
from msal_cli.auto.candidates import Candidate
from tests.cli.scans import closed_scan, folder_of, msal, record_of, records_of, torus_scan
from tests.shapes import torus

SPIKED = np.arange(40, 1800, 88)
READINGS = (Reading(NOISE, 0.08, 0.6), Reading(TEXTURE, 0.0, 0.4))


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    folder = tmp_path_factory.mktemp("choice")
    folder_of(folder / "in", clean=torus_scan(0.0), fair=torus_scan(0.04), loud=torus_scan(0.2))
    folder_of(folder / "spiked", quiet=torus_scan(0.0, SPIKED, 2.0))
    return folder / "in"


def denoise(*words):
    return record_of(msal("denoise", *words, "--json"))


def vertices_of(path):
    return codecs.open_mesh(path.read_bytes(), path.name).vertices


@pytest.fixture
def collapse(monkeypatch):
    """Let the plain command and --auto choose what destroys the mesh."""

    def choose_umbrella(mesh, *given, **named):
        values = methods.find("umbrella").validate({"iterations": 1000})
        return selection.Choice("umbrella", values, "collapse", None, estimate_noise(mesh))

    monkeypatch.setattr(adaptive, "choose_adaptive", choose_umbrella)
    monkeypatch.setattr("msal_cli.auto.search.choose_method", choose_umbrella)


# The plain command


def test_the_plain_command_reports_its_choice(scans, tmp_path):
    made = msal("denoise", scans, "-o", tmp_path / "out", "--exclude", "fair.ply", "--json")
    records = records_of(made)
    loud, clean = records["loud.ply"], records["clean.ply"]
    assert (loud["status"], clean["status"]) == ("written", "unchanged")
    assert (tmp_path / "out" / "clean.ply").read_bytes() == (scans / "clean.ply").read_bytes()
    assert clean["method"] == {"name": "none", "parameters": {}}
    assert loud["method"]["name"] == "al"
    assert loud["method"]["parameters"]["schedule"] == "wiener"
    for record in records.values():
        assert (record["choice"]["among"], record["choice"]["wishes"]) == ("family", {})
        assert record["warnings"] == []
    assert loud["choice"]["reason"].startswith("noise 0.2 e; AL with Wiener fidelity")
    assert loud["choice"]["risk_edges"] > 0.0
    assert "chosen: al 1, none 1" in made.stderr
    assert json.loads(made.stdout)["settings"]["method"] == "adaptive"


@pytest.mark.parametrize("words", [[], ["--auto"]])
def test_a_choice_that_damages_is_softened_or_rejected(tmp_path, monkeypatch, collapse, words):
    """A collapse is never written: a milder result or the input is, and the reason says why."""
    scan = tmp_path / "scan.ply"
    scan.write_bytes(closed_scan())
    record = denoise(scan, "-o", tmp_path / "mild.ply", *words)
    assert (record["status"], record["method"]["name"]) == ("written", "al")
    noise = 0.5 * record["noise_estimate"]["mean_edges"]
    assert record["method"]["parameters"]["noise"] == pytest.approx(noise, abs=1e-3)
    assert "; rejected, for the volume changed by -" in record["choice"]["reason"]
    (warning,) = record["warnings"]
    assert warning.startswith("the first choice would damage the mesh (the volume changed by -")
    denoise(scan, "-o", tmp_path / "by hand.ply", *record["choice"]["repeat"])
    assert (tmp_path / "mild.ply").read_bytes() == (tmp_path / "by hand.ply").read_bytes()
    # Where nothing milder would do, the input comes back.
    monkeypatch.setattr("msal_cli.job.choice.MILDER", (0.0,))
    record = denoise(scan, "-o", tmp_path / "out.ply", *words)
    assert (record["status"], record["method"]["name"]) == ("unchanged", "none")
    assert (tmp_path / "out.ply").read_bytes() == scan.read_bytes()
    assert record["displacement"]["max"] == 0.0
    assert "; rejected, for the volume changed by -" in record["choice"]["reason"]
    (warning,) = record["warnings"]
    assert warning.startswith("every choice would damage the mesh (the volume changed by -")
    # By name it is done, with a warning.
    record = denoise(scan, "-o", tmp_path / "b.ply", "--method", "umbrella", "-n", "1000")
    assert record["status"] == "written"
    assert any("damage" in warning for warning in record["warnings"])


def choose_by(monkeypatch, filters):
    """Let the plain command choose filters with so many sweeps by strength, and as much of what
    they move as the wishes ask for."""

    def choose(mesh, wishes):
        name, sweeps = filters[max(wishes.strength, 0.0)]
        members = [Candidate(name, {"iterations": sweeps}, 1.0)]
        monkeypatch.setitem(candidates._LABELS, ("umbrella", None), ("umbrella", ""))
        name, values, label = build_recipe(members, np.ones(1), 0.1, share=wishes.share)
        return selection.Choice(name, values, label, None, estimate_noise(mesh))

    monkeypatch.setattr(adaptive, "choose_adaptive", choose)


def test_less_of_what_damages_is_less_of_what_is_milder(tmp_path, monkeypatch):
    scan = tmp_path / "scan.ply"
    scan.write_bytes(closed_scan())
    choose_by(monkeypatch, {0.0: ("umbrella", 40)})
    moved = []
    for words in ([], ["--keep", "texture"], ["--strength", "-1"], ["--strength", "-2"]):
        record = denoise(scan, "-o", tmp_path / "out.ply", "--force", *words)
        assert "; rejected, for the volume changed by -" in record["choice"]["reason"]
        moved.append(record["displacement"]["mean_edges"])
    assert moved == pytest.approx([moved[0], 0.9 * moved[0], 0.8 * moved[0], 0.6 * moved[0]], 1e-3)
    denoise(scan, "-o", tmp_path / "by hand.ply", *record["choice"]["repeat"])
    assert (tmp_path / "out.ply").read_bytes() == (tmp_path / "by hand.ply").read_bytes()


def test_where_more_would_damage_the_next_lesser_wish_is_done(tmp_path, monkeypatch):
    scan = tmp_path / "scan.ply"
    scan.write_bytes(closed_scan())
    choose_by(monkeypatch, {0.0: ("taubin", 2), 1.0: ("taubin", 4), 2.0: ("umbrella", 1000)})
    made = {}
    for strength in ("0", "1", "2"):
        made[strength] = denoise(scan, "-o", tmp_path / f"{strength}.ply", "--strength", strength)
    assert (tmp_path / "2.ply").read_bytes() == (tmp_path / "1.ply").read_bytes()
    moved = [record["displacement"]["mean_edges"] for record in made.values()]
    assert moved[0] < moved[1] == moved[2]
    assert made["2"]["choice"]["wishes"] == {"strength": 2.0}
    (warning,) = made["2"]["warnings"]
    assert warning.startswith("--strength 2 would damage the mesh (the volume changed by -")
    assert not made["1"]["warnings"]


# --assume


@pytest.fixture
def unsure(tmp_path, monkeypatch):
    """A scan of which noise and texture cannot be told apart."""

    def estimate(mesh):
        return dataclasses.replace(estimate_noise(mesh), readings=READINGS)

    for place in ("auto.adaptive", "auto.search", "analysis.noise_estimate"):
        monkeypatch.setattr(f"msal_cli.{place}.estimate_noise", estimate)
    return folder_of(tmp_path / "in", scan=closed_scan()) / "scan.ply"


def test_an_unsure_file_is_named_everywhere(unsure, tmp_path):
    page = tmp_path / "run.html"
    words = ("--json", "--report", page, "--fail-on", "noise_estimate.unsure")
    made = msal("denoise", unsure, "-o", tmp_path / "o.ply", *words)
    noise = record_of(made, 4)["noise_estimate"]
    assert noise["unsure"]
    assert noise["readings"] == [
        {"kind": "noise", "level_edges": 0.08, "probability": 0.6},
        {"kind": "texture", "level_edges": 0.0, "probability": 0.4},
    ]
    line = "noise of 0.08 e (60 %) or texture (40 %): filtered mildly, --assume noise or texture"
    assert line in made.stderr
    looked_at = page.read_text().partition("<h2>Look at these")[2]
    assert "noise of 0.08 e (60 %) or texture (40 %)" in looked_at


@pytest.mark.parametrize("words", [(), ("--auto",)])
def test_an_assumption_decides_what_is_done(unsure, tmp_path, words):
    records = {}
    for assume in ("noise", "texture"):
        record = denoise(unsure, "-o", tmp_path / f"{assume}.ply", "--assume", assume, *words)
        # The estimate stays what it is.
        assert record["noise_estimate"]["unsure"]
        assert record["choice"]["wishes"]["assume"] == assume
        assert record["choice"]["among"] == ("all" if words else "family")
        records[assume] = record
    assert records["noise"]["status"] == "written"
    assert records["noise"]["choice"]["noise_edges"] == 0.08
    assert records["texture"]["status"] == "unchanged"
    assert (tmp_path / "texture.ply").read_bytes() == unsure.read_bytes()


# --min-noise


def test_quiet_files_stay_byte_for_byte(scans, tmp_path):
    gates = {
        "noise_estimate.mean_edges > 0.1e": [False, False, True],
        "noise_estimate.high_edges > 0.1e and not noise_estimate.negligible": [False, False, True],
        "noise_estimate.tail > 0.5 or noise_estimate.uneven": [False] * 3,
    }
    words = [word for gate in gates for word in ("--fail-on", gate)]
    words += ["--method", "msal", "-v"]
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
    assert "left as it is: noise 0.04" in made.stderr


# --despike


@pytest.fixture
def spiked(scans):
    return scans.parent / "spiked"


def test_the_plain_command_brings_outliers_back_and_leaves_the_rest(spiked, tmp_path):
    made = msal("denoise", spiked / "quiet.ply", "-o", tmp_path / "o.ply", "--json")
    record = record_of(made)
    assert (record["despiked"], record["status"]) == (20, "written")
    assert record["choice"]["reason"].endswith("clean; the rest left as it is")
    assert record["choice"]["repeat"][-1] == "--despike"
    assert record["displacement"]["moved_vertices"] == 20
    assert "; 20 outlier vertices brought back" in made.stderr
    assert np.abs(vertices_of(tmp_path / "o.ply") - torus(60, 30)[0]).max() < 0.1
    # Without them there is no noise.
    assert record["noise_estimate"]["negligible"]
    record = denoise(spiked / "quiet.ply", "-o", tmp_path / "o.ply", "--no-despike")
    assert record["despiked"] is None
    assert "--despike" not in record["choice"]["repeat"]
