"""`msal denoise` over files: what it writes, says, reports and refuses."""

import json
import signal
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from msal_cli import methods
from msal_cli.batch import run as run_module
from msal_cli.batch.interrupts import Terminated
from msal_cli.batch.schedule import Finished
from msal_cli.cli.denoise import command
from msal_cli.errors import OutputError
from tests.cli.scans import BAD_SCAN, msal
from tests.files import run_python, tree
from tests.report.made import load_schema

# One file


def test_one_file_is_written_and_told(scan, tmp_path):
    output = tmp_path / "out.ply"
    made = msal("denoise", scan, "-o", output)
    assert (made.exit_code, made.stdout) == (0, "")
    assert made.stderr.startswith(f"{scan} -> {output} in ")
    assert "576 vertices, 1,152 faces, 1 component\n" in made.stderr
    assert len(made.stderr.splitlines()) <= 8
    assert "stored as     ply ascii" in msal("denoise", scan, "-o", output, "-v").stderr
    # A bad file is an error with place, code and hint.
    scan.write_bytes(BAD_SCAN)
    made = msal("denoise", scan, "-o", tmp_path / "new.ply")
    error, hint = made.stderr.splitlines()
    assert (made.exit_code, (tmp_path / "new.ply").exists()) == (1, False)
    assert error.startswith(f"msal: error: {scan}: ") and error.endswith("(E_INDEX)")
    assert "9999" in error and hint.startswith("hint: ")


def test_options_reach_the_method(scan, tmp_path):
    output = tmp_path / "out.ply"
    made = msal(
        *("denoise", scan, "-o", output, "--json", "-q", "-n", "2", "-K", "0.25", "--mollify", "0"),
        *("--set", "normals=area", "--set", "n=2"),
    )
    assert (made.exit_code, made.stderr) == (0, "")
    data = json.loads(made.stdout)
    Draft202012Validator(load_schema("report")).validate(data)
    given = {"iterations": 2, "K": 0.25, "mollify": 0, "normals": "area"}
    expected = methods.find("msal").validate({}) | given
    assert data["settings"]["parameters"] == expected
    assert data["records"][0]["method"] == {"name": "msal", "parameters": expected}
    assert data["command"][:2] == ["msal", "denoise"]
    assert data["started"] <= data["finished"] and data["started"].endswith("Z")


def test_the_schedules_offered_are_those_of_the_methods():
    (option,) = [one for one in command.params if one.name == "schedule"]
    assert tuple(option.type.choices) == methods.find("al").spec("schedule").choices


# Dry run


def test_a_dry_run_lists_and_touches_nothing(mixed, tmp_path):
    output = tmp_path / "out"
    (mixed / "empty.ply").write_bytes(b"")
    before = tree(tmp_path, has_own=True)
    made = msal("denoise", mixed, "-o", output, "--dry-run", "--report", tmp_path / "r.json")
    assert made.exit_code == 3
    assert f"{mixed / 'closed.ply'} -> {output / 'closed.ply'}: " in made.stdout
    assert "576 vertices, about 0.17 s" in made.stdout
    assert "bad.ply: " in made.stdout and "(E_INDEX)" in made.stdout
    sums, last = made.stderr.splitlines()[-2:]
    assert sums.startswith("2 files to denoise, ")
    assert sums.endswith(" s on an idle machine, 2 will fail")
    assert last == "dry run: no report is written"
    made = msal("denoise", mixed, "-o", output, "--dry-run", "--json", "-q", "--auto")
    records = {Path(one["input"]).name: one for one in json.loads(made.stdout)["records"]}
    failed = {name for name, one in records.items() if one["status"] == "failed"}
    assert failed == {"bad.ply", "empty.ply"}
    assert records["closed.ply"]["planned"]["seconds"] > 1.0
    assert tree(tmp_path, has_own=True) == before


# What ends a run


class Ending:
    """A run that is ended after its first file."""

    def __init__(self, error):
        self.error = error
        self.run = run_module.run

    def __call__(self, plan, settings, *, on_event, **options):
        def heard(event):
            on_event(event)
            if isinstance(event, Finished):
                raise self.error

        return self.run(plan, settings, on_event=heard, **options)


@pytest.mark.parametrize(
    ("error", "status", "words"),
    [
        (OutputError("the disk is full"), 1, "msal: error: the disk is full (E_WRITE)"),
        (KeyboardInterrupt(), 130, "msal: interrupted"),
        (Terminated(signal.SIGTERM), 143, "msal: interrupted"),
    ],
)
def test_a_run_that_is_ended_reports_what_was_done(
    mixed, tmp_path, monkeypatch, error, status, words
):
    (mixed / "bad.ply").unlink()
    report = tmp_path / "r.json"
    with monkeypatch.context() as patched:
        patched.setattr(run_module, "run", Ending(error))
        made = msal(
            *("denoise", mixed, "-o", tmp_path / "out", "-j", "1", "--report", report),
            *("--method", "msal"),
        )
    assert made.exit_code == status
    lines = made.stderr.splitlines()
    assert lines[-1] == words
    assert lines[-2] == "the same command again goes on from here"
    assert any("1 written, 1 not done" in line for line in lines)
    data = json.loads(report.read_bytes())
    assert data["interrupted"] is True
    assert sorted(one["status"] for one in data["records"]) == ["planned", "written"]
    again = msal("denoise", mixed, "-o", tmp_path / "out", "--method", "msal")
    assert "1 written, 1 up to date" in again.stderr


def test_a_report_that_cannot_be_written_is_fatal_but_json_is_printed(scan, tmp_path, monkeypatch):
    def full(*given, **named):
        raise OutputError("the disk is full")

    monkeypatch.setattr("msal_cli.cli.report_files.write", full)
    made = msal("denoise", scan, "-o", tmp_path / "o.ply", "--json", "--report", tmp_path / "r.csv")
    assert made.exit_code == 1
    assert "the disk is full" in made.stderr
    assert json.loads(made.stdout)["totals"]["written"] == 1
    assert (tmp_path / "o.ply").exists()


def test_what_is_not_asked_for_is_not_imported(scan, tmp_path):
    """A small mesh takes a tenth of a second, most of it imports."""
    unwanted = ("view", "report.gates", "report.html", "job.fields")
    code = (
        "import sys; from msal_cli.cli.main import program\n"
        "try: program.main(sys.argv[1:])\n"
        "except SystemExit: pass\n"
        f"print([n for n in {unwanted} if 'msal_cli.' + n in sys.modules], 'PIL' in sys.modules)"
    )
    words = ("denoise", scan, "-o", tmp_path / "o.ply", "-q", "--method", "msal")
    assert run_python(code, *words) == "[] False\n"
