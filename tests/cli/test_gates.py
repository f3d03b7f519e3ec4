"""`--fail-on`: exit status 4, and the gate, the file and the value by name, in every report."""

from __future__ import annotations

import csv
import json

import pytest
from jsonschema import Draft202012Validator

from tests.cli.scans import (
    BAD_SCAN,
    closed_scan,
    folder_of,
    msal,
    open_scan,
)
from tests.report.schemas import report_schema

MOVED = "max_displacement > 0"
MSAL = ("--method", "msal")


@pytest.fixture
def scans(tmp_path):
    return folder_of(tmp_path / "scans", closed=closed_scan(), open=open_scan())


def test_every_report_has_the_gates(scans, tmp_path):
    expressions = ("abs(volume_change) > 99%", MOVED)
    given = [word for one in expressions for word in ("--fail-on", one)]
    reports = [tmp_path / f"r.{suffix}" for suffix in ("json", "jsonl", "csv")]
    asked = [word for one in reports for word in ("--report", one)]
    made = msal("denoise", scans, *MSAL, "-o", tmp_path / "out", *given, *asked, "--json")
    assert made.exit_code == 4
    data = json.loads(made.stdout)
    Draft202012Validator(report_schema()).validate(data)
    assert data["totals"]["gate_broken"] == 2
    closed, opened = (record["gates"] for record in data["records"])
    assert [one["expression"] for one in closed] == list(expressions)
    assert [(one["broken"], one["decided"]) for one in closed] == [(False, True), (True, True)]
    assert [(one["broken"], one["decided"]) for one in opened] == [(True, False), (True, True)]
    assert closed[1]["values"]["max_displacement"] == data["records"][0]["displacement"]["max"]
    assert "open" in opened[0]["reason"]
    assert json.loads(reports[0].read_text())["records"] == data["records"]
    lines = [json.loads(line) for line in reports[1].read_text().splitlines()]
    assert lines == data["records"]
    with reports[2].open(newline="") as table:
        rows = list(csv.DictReader(table))
    assert rows[0]["gates"].startswith("held: abs(volume_change) > 99% (volume_change is ")
    said = made.stderr
    assert "broke a gate: 2\n" in said
    assert "closed.ply: broken: max_displacement > 0 (max_displacement is " in said
    assert "open.ply: not decided: abs(volume_change) > 99% (volume_change is not known" in said
    assert "2 broke a gate" in said


def test_failures_win_over_gates_and_are_not_judged(scans, tmp_path):
    (scans / "bad.ply").write_bytes(BAD_SCAN)
    made = msal("denoise", scans, *MSAL, "-o", tmp_path / "out", "--fail-on", MOVED, "--json")
    assert made.exit_code == 3
    gates = [len(record["gates"]) for record in json.loads(made.stdout)["records"]]
    assert sorted(gates) == [0, 1, 1]


@pytest.mark.parametrize(
    "expression", ["volume_chnge > 1%", "volume_change > 1", "max_displacement", "import os", ""]
)
def test_what_means_nothing_is_refused_before_any_work(scans, tmp_path, expression):
    output = tmp_path / "out"
    made = msal("denoise", scans, *MSAL, "-o", output, "--fail-on", expression)
    assert made.exit_code == 2
    assert f"the gate {expression!r}, column " in made.stderr
    assert "hint: " in made.stderr
    assert not output.exists()
    assert msal("report", scans, "--fail-on", expression).exit_code == 2


def test_report_judges_earlier_runs(scans, tmp_path):
    output, page = tmp_path / "out", tmp_path / "page.json"
    assert msal("denoise", scans, *MSAL, "-o", output).exit_code == 0
    made = msal("report", output, "--fail-on", MOVED, "-o", page)
    assert made.exit_code == 4
    assert made.stderr.count("broken: max_displacement > 0") == 2
    assert msal("report", output, "--fail-on", "max_displacement > 99e").exit_code == 0
    # Those of a report are kept, and count where somebody asks for the status.
    assert msal("report", page).exit_code == 0
    assert msal("report", page, "--check", "-q").exit_code == 4
    assert msal("report", page, "--fail-on", "max_displacement > 99e", "-q").exit_code == 0


def test_compare_judges_pairs(tmp_path):
    first = folder_of(tmp_path / "first", a=closed_scan(0), b=closed_scan(1))
    second = folder_of(tmp_path / "second", a=closed_scan(0), b=closed_scan(2))
    gate = ("--fail-on", "mean_angular_error_deg > 1 or abs(volume_change) > 1%")
    assert msal("compare", first / "a.ply", second / "a.ply", *gate).exit_code == 0
    made = msal("compare", first / "b.ply", second / "b.ply", *gate, "--json")
    assert made.exit_code == 4
    (result,) = json.loads(made.stdout)["gates"]
    assert result["broken"] and result["decided"]
    assert f"{second / 'b.ply'}: broken: mean_angular_error_deg > 1" in made.stderr
    made = msal("compare", first, second, *gate)
    assert made.exit_code == 4
    assert made.stderr.count("broken: ") == 1
    (second / "b.ply").write_bytes(BAD_SCAN)
    assert msal("compare", first, second, *gate).exit_code == 3
    assert msal("compare", first, second, "--fail-on", "seconds > 1").exit_code == 2


@pytest.mark.parametrize("name", ["mean_angular_error_deg", "hausdorff"])
def test_a_gate_against_a_reference_that_is_not_there_is_refused(scans, tmp_path, name):
    output, report = tmp_path / "out", tmp_path / "r.json"
    gate = ("--fail-on", f"{name} > 0")
    made = msal("denoise", scans, "-o", output, *gate)
    assert made.exit_code == 2
    assert f"{name} is measured against a reference" in made.stderr
    assert "give --reference TRUTH" in made.stderr
    assert not output.exists()
    assert msal("denoise", scans, "-o", output, "--report", report).exit_code == 0
    for run in (output, report):
        page = tmp_path / "page.json"
        made = msal("report", run, *gate, "-o", page)
        assert made.exit_code == 2
        assert "name a JSON report of msal denoise --reference" in made.stderr
        assert not page.exists()
