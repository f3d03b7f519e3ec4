"""`msal noise`: the file promise, the seed, folders and streams."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli import codecs
from msal_cli.analysis.added_noise import KINDS
from msal_cli.cli.noise import _KINDS
from tests.cli.scans import BAD_SCAN, closed_scan, folder_of, msal, msal_on, ply_text
from tests.shapes import torus


@pytest.fixture
def scan(tmp_path):
    return folder_of(tmp_path, scan=closed_scan()) / "scan.ply"


def test_the_command_offers_every_kind():
    assert tuple(KINDS) == _KINDS


@pytest.mark.parametrize("kind", KINDS)
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


def test_the_same_seed_gives_the_same_bytes(scan):
    for name, seed in (("a", 7), ("b", 7), ("c", 8)):
        assert (
            msal("noise", scan, "-o", scan.with_name(f"{name}.ply"), "--seed", seed).exit_code == 0
        )
    a, b, c = (scan.with_name(f"{name}.ply").read_bytes() for name in "abc")
    assert a == b != c


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


def test_what_comes_in_by_a_stream_goes_out_by_one(scan, tmp_path):
    target = tmp_path / "noisy.ply"
    msal("noise", scan, "-o", target, "--seed", 2)
    assert msal_on(scan.read_bytes(), "noise", "-", "--seed", 2).stdout_bytes == target.read_bytes()


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


def files_vertices(path):
    return codecs.open_mesh(path.read_bytes(), path.name).vertices


def test_noise_by_a_property_leaves_alone_what_has_none(scan):
    vertices, faces = torus()
    lines = [f"{x:.6f} {y:.6f} {z:.6f} {max(x, 0.0):.6f}" for x, y, z in vertices]
    text = scan.read_text().split("end_header")[0]
    text = text.replace("float z", "float z\nproperty float amount") + "end_header\n"
    text += "\n".join(lines) + "\n" + "".join(f"3 {a} {b} {c}\n" for a, b, c in faces)
    source, target = scan.with_name("amount.ply"), scan.with_name("out.ply")
    source.write_text(text)
    made = msal("noise", source, "-o", target, "--kind", "property", "--property", "amount")
    assert made.exit_code == 0
    assert "times amount" in made.stderr
    moved = (files_vertices(target) != files_vertices(source)).any(axis=1)
    assert not moved[vertices[:, 0] <= 0.0].any()
    assert moved[vertices[:, 0] > 0.5].all()
    words = ("--kind", "property", "--property", "Amount", "--force")
    wrong = msal("noise", source, "-o", target, *words)
    assert (wrong.exit_code, "E_PROPERTY" in wrong.stderr) == (1, True)
    assert "amount" in wrong.stderr


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


@pytest.mark.parametrize("kind", ["correlated", "outliers", "property"])
def test_seams_stay_closed_whatever_the_kind(tmp_path, kind):
    vertices, faces = torus()
    corners = vertices[faces.reshape(-1)]
    soup = np.arange(len(corners)).reshape(-1, 3)
    (tmp_path / "soup.ply").write_bytes(ply_text(corners, soup))
    words = ["--property", "z"] if kind == "property" else []
    made = msal("noise", tmp_path / "soup.ply", "-o", tmp_path / "out.ply", "--kind", kind, *words)
    assert made.exit_code == 0
    after = files_vertices(tmp_path / "out.ply")
    assert (after != files_vertices(tmp_path / "soup.ply")).any()
    for at in range(len(vertices)):
        places = after[faces.reshape(-1) == at]
        assert (places == places[0]).all()
