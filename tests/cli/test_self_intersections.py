"""`--check self-intersections`, and gates that name them."""

from __future__ import annotations

import json

import pytest

from tests.cli.scans import folder_of, msal, msal_on, ply_text, records_of
from tests.shapes import torus

CHECK = ("--check", "self-intersections")


def scan(is_pushed):
    vertices, faces = torus()
    vertices = vertices.copy()
    if is_pushed:
        vertices[:3] = -0.9 * vertices[:3]
    return ply_text(vertices, faces)


@pytest.fixture
def scans(tmp_path):
    return folder_of(tmp_path / "scans", clean=scan(False), pushed=scan(True))


def test_they_are_counted_on_demand(scans, tmp_path):
    given = ("denoise", scans, "-o", tmp_path / "out", "--json", "--method", "al", "-n", "1")
    counted = records_of(msal(*given))
    assert counted["pushed.ply"]["self_intersections"] is None
    counted = records_of(msal(*given, *CHECK))
    assert counted["clean.ply"]["self_intersections"] == {"before": 0, "after": 0, "created": 0}
    counts = counted["pushed.ply"]["self_intersections"]
    assert counts["before"] > 0 and counts["created"] <= counts["after"]
    # It was made again to be counted, and is current now.
    assert {one["status"] for one in counted.values()} == {"written"}
    assert {one["status"] for one in records_of(msal(*given, *CHECK)).values()} == {"up-to-date"}


def test_a_gate_has_them_counted(scans, tmp_path):
    gate = ("--fail-on", "self_intersections > 0")
    good = msal("denoise", scans / "clean.ply", "-o", tmp_path / "a.ply", "--json", *gate)
    assert good.exit_code == 0, good.stderr
    assert records_of(good)["clean.ply"]["self_intersections"]["created"] == 0
    before = ("--fail-on", "self_intersections.before > 0")
    bad = msal("denoise", scans, "-o", tmp_path / "out", *before)
    assert bad.exit_code == 4
    assert "pushed.ply: broken: self_intersections.before > 0" in bad.stderr
    later = msal("report", tmp_path / "out", *before)
    assert later.exit_code == 4


def test_what_was_not_counted_cannot_be_judged_later(scans, tmp_path):
    assert msal("denoise", scans, "-o", tmp_path / "out").exit_code == 0
    made = msal("report", tmp_path / "out", "--fail-on", "self_intersections > 0")
    assert made.exit_code == 4
    assert "count them with --check self-intersections" in made.stderr


def test_info(scans):
    counts = [
        json.loads(msal("info", scans / name, "--json", *CHECK).stdout)["records"][0]
        for name in ("clean.ply", "pushed.ply")
    ]
    assert counts[0]["self_intersections"] == 0 < counts[1]["self_intersections"]
    assert "intersecting    0 pairs of faces" in msal("info", scans / "clean.ply", *CHECK).stdout
    piped = msal_on(scan(True), "info", "-", "--json", *CHECK)
    count = json.loads(piped.stdout)["records"][0]["self_intersections"]
    assert count == counts[1]["self_intersections"]
    plain = json.loads(msal("info", scans / "pushed.ply", "--json").stdout)
    assert plain["records"][0]["self_intersections"] is None
