"""`msal compare --baseline`: regressions are status 4, and named."""

from __future__ import annotations

import json

import pytest

from tests.cli.scans import folder_of, msal, ply_text
from tests.shapes import noisy, torus


def scan(level):
    vertices, faces = torus()
    return ply_text(noisy(vertices, 0, level), faces)


@pytest.fixture
def files(tmp_path):
    return folder_of(tmp_path, truth=scan(0.0), good=scan(0.05), same=scan(0.05), worse=scan(0.051))


def baseline_of(folder, *given):
    path = folder / "known.json"
    path.write_bytes(msal("compare", *given, "--json").stdout_bytes)
    return path


@pytest.mark.parametrize(
    ("name", "tolerance", "status"),
    [("same", "0%", 0), ("worse", "5%", 0), ("worse", "1%", 4), ("truth", "0%", 0)],
)
def test_two_files(files, name, tolerance, status):
    known = baseline_of(files, files / "truth.ply", files / "good.ply")
    given = ("compare", files / "truth.ply", files / f"{name}.ply")
    made = msal(*given, "--baseline", known, "--tolerance", tolerance)
    assert made.exit_code == status
    assert ("vertex_error_percent > " in made.stderr) == (status == 4)
    assert ("tolerance 1 %" in made.stderr) == (status == 4)


def test_the_gates_of_a_baseline_are_in_the_object(files):
    known = baseline_of(files, files / "truth.ply", files / "good.ply")
    given = ("compare", files / "truth.ply", files / "worse.ply", "--json")
    made = msal(*given, "--baseline", known, "--tolerance", "0.5%", "--fail-on", "hausdorff < 0")
    assert made.exit_code == 4
    gates = json.loads(made.stdout)["gates"]
    assert gates[0]["expression"] == "hausdorff < 0"
    broken = {next(iter(one["values"])) for one in gates if one["broken"]}
    assert {"vertex_error_percent", "displacement.rms_edges"} <= broken


def test_folders_that_have_moved(files, tmp_path):
    truth = folder_of(tmp_path / "truth", a=scan(0.0), b=scan(0.0), c=scan(0.0))
    old = folder_of(tmp_path / "old", a=scan(0.05), b=scan(0.05), c=scan(0.05))
    known = baseline_of(tmp_path, truth, old)
    new = folder_of(tmp_path / "new", a=scan(0.05), b=scan(0.06), c=scan(0.05))
    made = msal("compare", truth, new, "--baseline", known)
    assert made.exit_code == 4
    named = [line for line in made.stderr.splitlines() if "broken: vertex_error" in line]
    assert [line.partition(": ")[0] for line in named] == [str(new / "b.ply")]
    good = msal("compare", truth, new, "--baseline", known, "--exclude", "b.ply")
    assert good.exit_code == 0
    for folder in (truth, new):
        (folder / "b.ply").unlink()
    gone = msal("compare", truth, new, "--baseline", known)
    assert gone.exit_code == 4
    assert "b.ply: in the baseline, and not here" in gone.stderr


def test_a_report_of_denoising_is_a_baseline_too(files, tmp_path):
    output, report = tmp_path / "out" / "a.ply", tmp_path / "run.json"
    given = ("denoise", files / "good.ply", "-o", output, "--method", "msal")
    given += ("--reference", files / "truth.ply")
    assert msal(*given, "--report", report).exit_code == 0
    again = ("compare", files / "truth.ply", output, "--baseline", report)
    assert msal(*again).exit_code == 0
    bad = msal("compare", files / "truth.ply", files / "good.ply", "--baseline", report)
    assert bad.exit_code == 4


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[]", b'{"schema": "msal.info/1"}', b"\xff", b'{"schema": []}',
                b'{"schema": "msal.compare/1", "records": 5}',
                b'{"schema": "msal.compare/1", "records": [{"after": 1}]}']
)  # fmt: skip
def test_a_baseline_that_is_none(files, content):
    known = files / "known.json"
    known.write_bytes(content)
    made = msal("compare", files / "truth.ply", files / "good.ply", "--baseline", known)
    assert (made.exit_code, made.stdout) == (1, "")
    assert "this is no baseline" in made.stderr
    assert "Traceback" not in made.stderr


@pytest.mark.parametrize("tolerance", ["2", "-1%", "much", "nan%", "1e3%"])
def test_a_tolerance_that_is_no_percentage(files, tolerance):
    known = baseline_of(files, files / "truth.ply", files / "good.ply")
    given = ("compare", files / "truth.ply", files / "good.ply", "--baseline", known)
    assert msal(*given, "--tolerance", tolerance).exit_code == 2


def test_wrong_use(files):
    given = ("compare", files / "truth.ply", files / "good.ply")
    assert msal(*given, "--tolerance", "2%").exit_code == 2
    assert msal(*given, "--baseline", files / "none.json").exit_code in (1, 2)


@pytest.fixture
def moved(tmp_path):
    """Two folders of three files, what was known of them, and a fourth file without a partner."""
    truth = folder_of(tmp_path / "truth", a=scan(0.0), b=scan(0.0), c=scan(0.0))
    new = folder_of(tmp_path / "new", a=scan(0.05), b=scan(0.05), c=scan(0.05))
    known = baseline_of(tmp_path, truth, new)
    folder_of(truth, d=scan(0.0))
    return truth, new, known


def test_a_missing_partner_does_not_hide_a_broken_baseline(moved):
    truth, new, known = moved
    given = ("compare", truth, new, "--baseline", known)
    assert msal(*given).exit_code == 3
    folder_of(new, b=scan(0.06))
    made = msal(*given)
    assert made.exit_code == 4
    assert "there is no 'd.ply'" in made.stdout
    # What cannot be read weighs more.
    folder_of(new, a=b"ply")
    assert msal(*given).exit_code == 3


def test_a_partner_that_the_baseline_knew_and_is_gone_breaks_it(moved):
    truth, new, known = moved
    (new / "c.ply").unlink()
    made = msal("compare", truth, new, "--baseline", known)
    assert made.exit_code == 4
    assert "c.ply: in the baseline, and not here" in made.stderr


def test_missing_partners_are_ignored_on_demand(moved):
    truth, new, known = moved
    (new / "c.ply").unlink()
    given = ("compare", truth, new, "--ignore-missing")
    made = msal(*given, "--baseline", known)
    assert (made.exit_code, made.stderr) == (
        0,
        f"2 files have no partner, only in {truth}: left out\n",
    )
    assert "2 compared;" in made.stdout
    assert len(json.loads(msal(*given, "--json").stdout)["records"]) == 2
    folder_of(new, b=scan(0.06))
    assert msal(*given, "--baseline", known).exit_code == 4
    for name in ("a", "b"):
        (new / f"{name}.ply").unlink()
    folder_of(new, z=scan(0.0))
    assert msal(*given).exit_code == 5
    assert msal("compare", truth / "a.ply", new / "z.ply", "--ignore-missing").exit_code == 2
