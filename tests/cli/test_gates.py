"""`--fail-on`, `--reference`, `--check`, and limits on movement: what is measured and judged."""

import csv
import json

import pytest

from tests.cli.scans import (
    closed_scan,
    folder_of,
    msal,
    msal_on,
    open_scan,
    ply_text,
    record_of,
    records_of,
)
from tests.shapes import torus

MOVED = "max_displacement > 0"
MSAL = ("--method", "msal")
CHECK = ("--check", "self-intersections")


@pytest.fixture
def scans(tmp_path):
    return folder_of(tmp_path / "scans", closed=closed_scan(), open=open_scan())


def test_report_judges_earlier_runs(scans, tmp_path):
    output, page = tmp_path / "out", tmp_path / "page.json"
    assert msal("denoise", scans, *MSAL, "-o", output).exit_code == 0
    made = msal("report", output, "--fail-on", MOVED, "-o", page)
    assert made.exit_code == 4
    assert made.stderr.count(": max_displacement > 0 (") == 2
    assert msal("report", output, "--fail-on", "max_displacement > 99e").exit_code == 0
    # Gates of a report are kept, and count with --check.
    assert msal("report", page).exit_code == 0
    assert msal("report", page, "--check", "-q").exit_code == 4
    assert msal("report", page, "--fail-on", "max_displacement > 99e", "-q").exit_code == 0
    for run in (output, page):
        new = tmp_path / "new.json"
        made = msal("report", run, "--fail-on", "hausdorff > 0", "-o", new)
        assert (made.exit_code, new.exists()) == (2, False)
        assert "name a JSON report of msal denoise --reference" in made.stderr
    made = msal("report", output, "--fail-on", "self_intersections > 0")
    assert made.exit_code == 4
    assert "count them with --check self-intersections" in made.stderr


# --reference

SHARED = (
    *("correspondence", "mean_edge_length", "mean_angular_error_deg", "max_angular_error_deg"),
    *("vertex_error_percent", "displacement", "flipped_faces", "volume_change_percent"),
    *("area_change_percent", "hausdorff", "hausdorff_edges"),
)


@pytest.fixture
def pairs(tmp_path):
    """A folder of two scans and one of what they should be, a.ply and below/b.ply in each."""
    noisy = folder_of(tmp_path / "noisy", a=closed_scan(0))
    truth = folder_of(tmp_path / "truth", a=ply_text(*torus(32, 18)))
    folder_of(noisy / "below", b=closed_scan(1))
    folder_of(truth / "below", b=ply_text(*torus(32, 18)))
    return noisy, truth


def test_figures_against_a_reference_are_those_of_compare(pairs, tmp_path):
    noisy, truth = pairs
    words = ("-o", tmp_path / "out.ply", "--reference", truth / "a.ply", "--json")
    made = msal("denoise", noisy / "a.ply", *words)
    reference = record_of(made)["reference"]
    compared = json.loads(msal("compare", truth / "a.ply", words[1], "--json").stdout)
    assert {name: reference[name] for name in SHARED} == {name: compared[name] for name in SHARED}
    assert reference["path"] == str(truth / "a.ply")
    angle = record_of(made)["normal_change"]["mean_deg"]
    assert reference["mean_angular_error_deg"] != angle
    assert "reference     normals " in made.stderr
    piped = msal_on((noisy / "a.ply").read_bytes(), "denoise", "-", *words)
    assert record_of(piped)["reference"]["vertex_error_percent"] > 0.0


def test_references_of_a_folder_have_the_same_relative_paths(pairs, tmp_path):
    noisy, truth = pairs
    words = ("denoise", noisy, "-o", tmp_path / "out", "--reference", truth)
    first, second = (records_of(msal(*words, "--json")) for _ in range(2))
    for name, path in (("a.ply", truth / "a.ply"), ("b.ply", truth / "below" / "b.ply")):
        assert first[name]["reference"] == second[name]["reference"]
        assert first[name]["reference"]["path"] == str(path)
        assert second[name]["status"] == "up-to-date"
    (truth / "a.ply").unlink()
    made = msal(*words, "--report", tmp_path / "r.csv")
    assert made.exit_code == 0
    assert "no comparison with the reference: 1" in made.stderr
    with (tmp_path / "r.csv").open(newline="") as table:
        rows = {row["input"].rpartition("/")[2]: row for row in csv.DictReader(table)}
    assert rows["a.ply"]["reference.error.message"]
    assert float(rows["b.ply"]["reference.vertex_error_percent"]) > 0.0


# --check self-intersections


@pytest.fixture
def pushed(tmp_path):
    vertices, faces = torus()
    clean = ply_text(vertices, faces)
    vertices[:3] *= -0.9
    return folder_of(tmp_path / "scans", clean=clean, pushed=ply_text(vertices, faces))


def test_self_intersections_are_counted_on_request(pushed, tmp_path):
    words = ("denoise", pushed, "-o", tmp_path / "out", "--json", "--method", "al", "-n", "1")
    assert records_of(msal(*words))["pushed.ply"]["self_intersections"] is None
    counted = records_of(msal(*words, *CHECK))
    assert counted["clean.ply"]["self_intersections"] == {"before": 0, "after": 0, "created": 0}
    counts = counted["pushed.ply"]["self_intersections"]
    assert counts["before"] > 0 and counts["created"] <= counts["after"]
    # The file was made again to be counted, and is current now.
    assert {record["status"] for record in counted.values()} == {"written"}
    assert {one["status"] for one in records_of(msal(*words, *CHECK)).values()} == {"up-to-date"}
    # A gate asks for the count too.
    gate = ("--fail-on", "self_intersections.before > 0")
    made = msal("denoise", pushed, "-o", tmp_path / "gated", *gate)
    assert (made.exit_code, "pushed.ply: self_intersections.before > 0" in made.stderr) == (4, True)
    assert msal("report", tmp_path / "gated", *gate).exit_code == 4


# Limits on movement


@pytest.fixture
def scan(scans):
    return scans / "open.ply"


def test_lengths_have_units_where_that_of_the_files_is_given(scan, tmp_path):
    words = ("denoise", scan, "-q", *MSAL, "--force", "-o")
    plain, metres, micro = (tmp_path / f"{name}.ply" for name in ("plain", "metres", "micro"))
    assert msal(*words, plain, "--max-move", "0.002").exit_code == 0
    assert msal(*words, metres, "--unit", "m", "--max-move", "2mm").exit_code == 0
    assert msal(*words, micro, "--unit", "mm", "--max-move", "2um").exit_code == 0
    assert plain.read_bytes() == metres.read_bytes() == micro.read_bytes()
    gate = ("--fail-on", "max_displacement > 1mm")
    assert msal(*words, plain, "--unit", "m", *gate).exit_code == 4
    assert msal(*words, plain, "--unit", "um", *gate).exit_code == 0
    for more in (gate, ("--max-move", "2mm"), ("--min-noise", "2mm")):
        made = msal(*words, tmp_path / "none.ply", *more)
        assert (made.exit_code, "mesh files have no unit" in made.stderr) == (2, True)
    assert not (tmp_path / "none.ply").exists()
    solid = tmp_path / "a.3mf"
    assert msal(*words, solid).exit_code == 0
    for words in (("denoise", solid, "-o", tmp_path / "b.3mf"), ("compare", solid, solid)):
        made = msal(*words, "--unit", "in")
        assert (made.exit_code, "says that its unit is mm" in made.stderr) == (1, True)
