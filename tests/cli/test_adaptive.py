"""The plain command: parameters chosen for each mesh, reported like those of --auto."""

from __future__ import annotations

import json

import pytest

from msal_cli import auto as selection
from msal_cli import methods
from msal_cli.analysis.added_noise import add_plain_noise
from msal_cli.analysis.noise_estimate import estimate_noise
from msal_cli.auto import adaptive
from msal_cli.mesh import prepare_mesh
from tests.cli.scans import closed_scan, folder_of, msal, ply_text, records_of
from tests.shapes import torus


def scan_with(level):
    vertices, faces = torus(60, 30)
    mesh = prepare_mesh(vertices, faces).mesh
    return ply_text(add_plain_noise(mesh, "gaussian-normal", level, 1), faces)


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    folder = folder_of(tmp_path_factory.mktemp("plain") / "in", loud=scan_with(0.2))
    return folder_of(folder, clean=scan_with(0.0))


def run(*words):
    made = msal("denoise", *words, "--json")
    assert made.exit_code == 0, made.stderr
    return records_of(made), made


def test_the_record_has_the_choice(scans, tmp_path):
    records, made = run(scans, "-o", tmp_path / "out")
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


@pytest.mark.parametrize(
    "words",
    [
        ("-n", "4"),
        ("-K", "0.5"),
        ("--mollify", "1"),
        ("--set", "K=0.5"),
        ("--schedule", "multiscale"),
    ],
)
def test_any_parameter_is_the_filter_of_the_paper(scans, tmp_path, words):
    records, _ = run(scans, "-o", tmp_path / "a", *words)
    msal("denoise", scans, "-o", tmp_path / "b", "--method", "msal")
    assert {record["method"]["name"] for record in records.values()} == {"msal"}
    assert all(record["choice"] is None for record in records.values())
    for name in ("loud.ply", "clean.ply"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


@pytest.mark.parametrize("word", [None, "--auto"])
def test_a_choice_that_damages_is_softened_or_rejected(tmp_path, monkeypatch, word):
    """A collapse is never written: a milder result or the input is, and the reason says why."""

    def collapsing(mesh, *given, **named):
        values = methods.find("umbrella").validate({"iterations": 1000})
        return selection.Choice("umbrella", values, "collapse", None, estimate_noise(mesh))

    monkeypatch.setattr(adaptive, "choose_adaptive", collapsing)
    monkeypatch.setattr("msal_cli.job.choice.choose_method", collapsing)
    scan = tmp_path / "scan.ply"
    scan.write_bytes(closed_scan())
    words = [] if word is None else [word]
    records, _ = run(scan, "-o", tmp_path / "mild.ply", *words)
    record = records["scan.ply"]
    assert (record["status"], record["method"]["name"]) == ("written", "al")
    assert record["method"]["parameters"]["noise"] == pytest.approx(
        0.5 * record["noise_estimate"]["mean_edges"], abs=1e-3
    )
    assert "; rejected, for the volume changed by -" in record["choice"]["reason"]
    (warning,) = record["warnings"]
    assert warning.startswith("the first choice would damage the mesh (the volume changed by -")
    options = record["choice"]["repeat"]
    run(scan, "-o", tmp_path / "by hand.ply", *options)
    assert (tmp_path / "mild.ply").read_bytes() == (tmp_path / "by hand.ply").read_bytes()
    # Where nothing milder would do, the input comes back.
    monkeypatch.setattr("msal_cli.job.pipeline.MILDER", (0.0,))
    records, _ = run(scan, "-o", tmp_path / "out.ply", *words)
    record = records["scan.ply"]
    assert (record["status"], record["method"]["name"]) == ("unchanged", "none")
    assert (tmp_path / "out.ply").read_bytes() == scan.read_bytes()
    assert record["displacement"]["max"] == 0.0
    assert "; rejected, for the volume changed by -" in record["choice"]["reason"]
    (warning,) = record["warnings"]
    assert warning.startswith("every choice would damage the mesh (the volume changed by -")
    # By name it is done, with a warning.
    words = ("--method", "umbrella", "-n", "1000", "--force")
    records, _ = run(scan, "-o", tmp_path / "b.ply", *words)
    assert records["scan.ply"]["status"] == "written"
    assert any("damage" in one for one in records["scan.ply"]["warnings"])
