"""`--max-move`, `--lock` and `--weights` on the command line."""

from __future__ import annotations

import json

import pytest

from tests.cli.scans import closed_scan, folder_of, msal, open_scan, record_of


@pytest.fixture
def scan(tmp_path):
    return folder_of(tmp_path / "in", scan=open_scan()) / "scan.ply"


def test_the_report_tells_what_was_kept(scan, tmp_path):
    words = ("--method", "msal", "--max-move", "0.001e", "--lock", "boundary", "--json")
    made = msal("denoise", scan, "-o", tmp_path / "a.ply", *words)
    assert made.exit_code == 0
    document = json.loads(made.stdout)
    (record,) = document["records"]
    assert record["clamped_vertices"] > 0
    assert record["locked_vertices"] == record["boundary_edges"]
    assert record["displacement"]["max_edges"] <= 0.001
    assert document["settings"]["max_move"] == "0.001e"
    assert document["settings"]["lock"] == ["boundary"]
    assert "vertices cut to the longest move; 18 vertices locked" in made.stderr


def test_a_gate_at_the_limit_holds(scan, tmp_path):
    words = ("-n", "4", "--max-move", "0.001e", "--fail-on", "max_displacement > 0.001e")
    assert msal("denoise", scan, "-o", tmp_path / "a.ply", *words).exit_code == 0
    words = ("-n", "4", "--max-move", "0.001e", "--fail-on", "clamped_vertices > 0")
    assert msal("denoise", scan, "-o", tmp_path / "b.ply", *words).exit_code == 4


def test_without_the_options_nothing_is_said(scan, tmp_path):
    made = msal("denoise", scan, "-o", tmp_path / "a.ply", "--json")
    record = record_of(made)
    assert record["clamped_vertices"] is record["locked_vertices"] is None
    assert "constraints" not in made.stderr


def test_they_are_part_of_what_is_current(scan, tmp_path):
    output = tmp_path / "out"

    def is_current(*words):
        return "is up to date" in msal("denoise", scan.parent, "-o", output, *words).stderr

    assert not is_current()
    assert not is_current("--max-move", "0.1e")
    assert is_current("--max-move", "0.10e")
    assert not is_current("--max-move", "0.1")
    assert not is_current("--max-move", "0.1", "--lock", "boundary")
    assert not is_current("--lock", "boundary")
    assert is_current("--lock", " boundary")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--max-move", "0"), "no length above 0"),
        (("--max-move", "3%"), "no length above 0"),
        (("--lock", "confidence"), "neither 'boundary' nor"),
        (("--weights", "q", "--method", "al"), "al has none with the schedule plain"),
        (("--weights", "q", "--method", "taubin"), "taubin has none"),
    ],
)
def test_what_means_nothing_is_refused_before_any_work(scan, tmp_path, words, said):
    output = tmp_path / "out"
    made = msal("denoise", scan, "-o", output, *words)
    assert made.exit_code == 2
    assert said in made.stderr
    assert "hint: " in made.stderr
    assert not output.exists()


def test_a_property_that_is_not_there_fails_that_file(tmp_path):
    scans = folder_of(tmp_path / "in", a=closed_scan())
    made = msal("denoise", scans, "-o", tmp_path / "out", "--weights", "confidence")
    assert made.exit_code == 1
    assert "(E_PROPERTY)" in made.stderr
    assert "they have: x, y, z" in made.stderr
    assert not (tmp_path / "out" / "a.ply").exists()


def test_lengths_have_units_where_that_of_the_files_is_said(scan, tmp_path):
    given = ("denoise", scan, "-q", "--method", "msal", "--force", "-o")
    plain, metres, micro = (tmp_path / f"{name}.ply" for name in ("plain", "metres", "micro"))
    assert msal(*given, plain, "--max-move", "0.002").exit_code == 0
    assert msal(*given, metres, "--unit", "m", "--max-move", "2mm").exit_code == 0
    assert msal(*given, micro, "--unit", "mm", "--max-move", "2um").exit_code == 0
    assert plain.read_bytes() == metres.read_bytes() == micro.read_bytes()
    gate = ("--fail-on", "max_displacement > 1mm")
    assert msal(*given, plain, "--unit", "m", *gate).exit_code == 4
    assert msal(*given, plain, "--unit", "um", *gate).exit_code == 0
    for more in (gate, ("--max-move", "2mm"), ("--min-noise", "2mm")):
        made = msal(*given, tmp_path / "none.ply", *more)
        assert (made.exit_code, "mesh files have no unit" in made.stderr) == (2, True)
    assert not (tmp_path / "none.ply").exists()


def test_compare_and_report_take_units_too(scan, tmp_path):
    assert msal("denoise", scan, "-q", "-n", "4", "-o", tmp_path / "out/").exit_code == 0
    for words in (("compare", scan, tmp_path / "out" / scan.name), ("report", tmp_path / "out")):
        gate = ("--fail-on", "displacement.max > 1mm")
        assert [msal(*words, *gate, "--unit", unit).exit_code for unit in ("m", "um")] == [4, 0]
        assert msal(*words, *gate).exit_code == 2
