"""`--max-move`, `--lock` and `--weights` on the command line."""

from __future__ import annotations

import json

import pytest

from tests.cli.scans import folder_of, msal, open_scan


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
