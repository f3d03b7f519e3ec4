"""`msal noise`: the file promise, the seed, folders and streams."""

from __future__ import annotations

import pytest

from msal_cli.analysis.added_noise import KINDS
from msal_cli.cli.noise import _KINDS
from tests.cli.scans import BAD_SCAN, closed_scan, folder_of, msal, ply_text
from tests.shapes import torus


@pytest.fixture
def scan(tmp_path):
    return folder_of(tmp_path, scan=closed_scan()) / "scan.ply"


def test_the_command_offers_every_kind():
    assert tuple(KINDS) == _KINDS


@pytest.mark.parametrize("kind", ["gaussian", "property", "view"])
def test_only_positions_change(scan, kind):
    target = scan.with_name("out.ply")
    words = ["--property", "x"] if kind == "property" else []
    made = msal("noise", scan, "-o", target, "--kind", kind, "--level", "0.3", "--seed", 5, *words)
    assert (made.exit_code, made.stdout) == (0, "")
    assert f"{kind} noise of 0.3 mean edge lengths" in made.stderr
    before, after = scan.read_bytes().splitlines(), target.read_bytes().splitlines()
    changed = [at for at, (a, b) in enumerate(zip(before, after, strict=True)) if a != b]
    start = before.index(b"end_header") + 1
    assert changed
    assert all(start <= at < start + 288 for at in changed)


def test_a_folder_becomes_a_mirrored_tree(tmp_path):
    folder = folder_of(tmp_path / "in", a=closed_scan(), bad=BAD_SCAN)
    folder_of(folder / "below", b=closed_scan(1))
    made = msal("noise", folder, "-o", tmp_path / "out", "--seed", 3)
    assert made.exit_code == 3
    assert "bad.ply" in made.stderr
    found = sorted(
        str(one.relative_to(tmp_path / "out")) for one in (tmp_path / "out").rglob("*.ply")
    )
    assert found == ["a.ply", "below/b.ply"]
    again = msal("noise", folder, "-o", tmp_path / "out", "--seed", 3)
    assert (again.exit_code, "--force" in again.stderr) == (2, True)


@pytest.mark.parametrize(
    "wrong",
    [
        ["--level", "-1"],
        ["--level", "nan"],
        ["--level", "much"],
        ["--seed", "-3"],
        ["--fraction", "1.5"],
        ["--kind", "salt"],
        ["--kind", "view", "--direction", "0,0,0"],
        ["--kind", "view", "--direction", "1,2"],
        ["--kind", "view", "--direction", "up"],
        ["--kind", "view", "--direction", "nan,0,1"],
        ["--kind", "view", "--rings", "1.5"],
        ["--kind", "view", "--rings", "100000"],
        ["--kind", "quantised", "--step", "0"],
        ["--kind", "half", "--border", "2"],
        ["--kind", "property"],
    ],
)
def test_wrong_values_touch_nothing(scan, wrong):
    target = scan.with_name("out.ply")
    made = msal("noise", scan, "-o", target, *wrong)
    assert (made.exit_code, target.exists()) == (2, False)


def test_an_input_is_not_overwritten_and_the_format_is_kept(scan):
    before = scan.read_bytes()
    assert msal("noise", scan, "-o", scan).exit_code == 2
    made = msal("noise", scan, "-o", scan.with_name("out.stl"))
    assert (made.exit_code, scan.with_name("out.stl").exists()) == (1, False)
    assert "the format" in made.stderr
    assert scan.read_bytes() == before


@pytest.mark.parametrize(
    ("kind", "setting", "users"),
    [
        ("gaussian", ["--fraction", "0.2"], "impulsive, outliers"),
        ("gaussian-normal", ["--rings", "2"], "correlated, view"),
        ("correlated", ["--direction", "x"], "view, quantised, grazing, half, ramp"),
        ("view", ["--step", "0.5"], "quantised"),
        ("ramp", ["--border", "0.1"], "half"),
        ("half", ["--property", "x"], "property"),
    ],
)
def test_a_setting_that_the_kind_does_not_use_is_refused(scan, kind, setting, users):
    target = scan.with_name("out.ply")
    made = msal("noise", scan, "-o", target, "--kind", kind, *setting)
    assert (made.exit_code, target.exists()) == (2, False)
    assert f"{setting[0]} means nothing for {kind} noise" in made.stderr
    assert users in made.stderr


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
