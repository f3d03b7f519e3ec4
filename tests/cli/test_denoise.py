"""`msal denoise` over files: what it writes, says and refuses; its fields; and `msal noise`."""

import json
import re
import signal
from pathlib import Path

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from msal_cli import codecs, methods
from msal_cli.batch import run as run_module
from msal_cli.batch.interrupts import Terminated
from msal_cli.batch.lock import FolderLock
from msal_cli.batch.schedule import Finished
from msal_cli.cli.denoise import command
from msal_cli.errors import OutputError
from msal_cli.job import fields
from tests.cli.scans import BAD_SCAN, closed_scan, folder_of, msal, ply_text, record_of
from tests.codecs import plain_ply
from tests.files import run_python, tree
from tests.report.made import load_schema
from tests.shapes import ball, torus

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


def test_in_place_folders_within_one_another_know_what_was_done(tmp_path):
    scan = folder_of(tmp_path / "in/sub", a=closed_scan()) / "a.ply"
    options = ("--in-place", "--no-backup", "--method", "al")
    places = (scan.parent, scan.parent.parent, scan)
    for locked, place in (places[:2], places[1:]):
        with FolderLock(str(locked)):
            assert msal("denoise", place, *options).exit_code == 2
    results = [(msal("denoise", place, *options).exit_code, scan.read_bytes()) for place in places]
    assert results == 3 * [(0, results[0][1])] and results[0][1] != closed_scan()


# Dry run


def test_a_dry_run_lists_and_touches_nothing(mixed, tmp_path):
    output = tmp_path / "out"
    (mixed / "empty.ply").write_bytes(b"")
    before = tree(tmp_path, has_own=True)
    made = msal("denoise", mixed, "-o", output, "--dry-run", "--report", tmp_path / "r.json")
    assert made.exit_code == 3
    assert f"{mixed / 'closed.ply'} -> {output / 'closed.ply'}: " in made.stdout
    assert "about 576 vertices, 0.17 s" in made.stdout
    assert "bad.ply: " in made.stdout and "(E_INDEX)" in made.stdout
    sums, error, _, last = made.stderr.splitlines()[-4:]
    assert sums.startswith("2 files to denoise, ") and sums.endswith(" s on an idle machine")
    assert re.search("error: 2 of 4 files would fail, the first is .*bad.ply: .*E_INDEX", error)
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


def test_a_result_of_another_input_is_not_replaced_unseen(scans, tmp_path):
    folder_of(tmp_path / "new", a=closed_scan(2))
    for source, count in ((scans / "a.ply", 0), (tmp_path / "new/a.ply", 1)):
        made = msal("denoise", source, "-o", f"{tmp_path}/out/", "-n", "1")
        said = f"'{tmp_path}/out/a.ply', which was made of '{scans}/a.ply'; give each"
        assert (made.exit_code, made.stderr.count(said)) == (0, count)


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


def test_a_folder_becomes_a_mirrored_tree(tmp_path):
    folder = folder_of(tmp_path / "in", a=closed_scan(), bad=BAD_SCAN)
    folder_of(folder / "below", b=closed_scan(1))
    made = msal("noise", folder, "-o", tmp_path / "out", "--seed", 3)
    assert made.exit_code == 3
    assert "bad.ply" in made.stderr
    assert list(tree(tmp_path / "out")) == ["a.ply", "below/b.ply"]
    again = msal("noise", folder, "-o", tmp_path / "out", "--seed", 3)
    assert (again.exit_code, "--force" in again.stderr) == (2, True)


def test_noise_beyond_the_numbers_of_the_file_asks_for_a_lower_level(tmp_path):
    text = ply_text(*torus()).decode().splitlines()
    start = text.index("end_header") + 1
    for at in range(start, start + 288):
        text[at] = " ".join(str(1e38 * float(word)) for word in text[at].split())
    (tmp_path / "far.ply").write_text("\n".join(text) + "\n")
    made = msal("noise", tmp_path / "far.ply", "-o", tmp_path / "out.ply", "--level", "20")
    assert (made.exit_code, (tmp_path / "out.ply").exists()) == (1, False)
    assert "choose a lower --level" in made.stderr
    assert "--precision" not in made.stderr


def table(path):
    """The columns of the vertices of a PLY, by name."""
    vertex = plain_ply.read(path.read_bytes()).element("vertex")
    names = [name for name, *_ in vertex.properties]
    return dict(zip(names, np.array(vertex.rows).T, strict=True))


def test_the_fields_of_a_file(scan, tmp_path):
    output = tmp_path / "out.ply"
    words = ("--method", "msal", "--fields", ",".join(fields.KINDS), "--json")
    made = msal("denoise", scan, "-o", output, *words)
    entry = record_of(made)["fields"]
    assert entry["path"] == str(tmp_path / "out.fields.ply")
    assert (entry["names"], entry["coloured"]) == (list(fields.KINDS), "lambda")
    rows = table(tmp_path / "out.fields.ply")
    assert rows["lambda"] == pytest.approx(rows["sigma"] / rows["sigma"].max(), rel=1e-6)
    before = codecs.open_mesh(scan.read_bytes(), "a.ply").vertices
    after = codecs.open_mesh(output.read_bytes(), "a.ply")
    moves = np.linalg.norm(after.vertices - before, axis=1)
    assert np.abs(rows["displacement"]) == pytest.approx(moves, abs=2e-6)
    with_fields = codecs.open_mesh((tmp_path / "out.fields.ply").read_bytes(), "a.ply")
    assert with_fields.vertices == pytest.approx(after.vertices, abs=1e-6)
    assert np.array_equal(with_fields.faces, after.faces)


def test_a_file_of_somebody_else_is_not_replaced(scan, tmp_path):
    theirs = tmp_path / "a.fields.ply"
    theirs.write_bytes(b"mine")
    made = msal("denoise", scan, "-o", tmp_path / "a.ply", "--fields", "sigma")
    assert made.exit_code == 1
    assert theirs.read_bytes() == b"mine"
    assert not (tmp_path / "a.ply").exists()


def test_outward_is_away_from_the_solid_where_the_surface_is_inside_out(tmp_path):
    vertices, faces = ball()
    for name, one in (("plain", faces), ("turned", faces[:, ::-1])):
        scan, output = tmp_path / f"{name}.ply", tmp_path / f"{name}_out.ply"
        scan.write_bytes(ply_text(vertices, one))
        given = ("--method", "umbrella", "--fields", "displacement,curvature")
        assert msal("denoise", scan, "-o", output, *given).exit_code == 0
    plain, turned = (table(tmp_path / f"{one}_out.fields.ply") for one in ("plain", "turned"))
    for name in ("displacement", "curvature"):
        assert turned[name] == pytest.approx(plain[name], abs=1e-6)
    assert turned["displacement"].mean() < 0.0
    assert turned["curvature"].mean() > 0.0
