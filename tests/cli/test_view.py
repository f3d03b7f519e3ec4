"""`msal view`."""

import io
import os
import sys
import webbrowser

import numpy as np
from PIL import Image

from tests.cli.scans import msal


def seen(path):
    return np.asarray(Image.open(path))


def test_a_pair_is_three_panels(scans):
    made = msal("view", scans / "a.ply", scans / "b.ply", "-o", scans / "p.png", "--size", 100)
    assert (made.exit_code, made.stdout) == (0, "")
    image = seen(scans / "p.png").astype(int)
    assert 300 < image.shape[1] < 420
    parts = np.array_split(image, 3, axis=1)
    # Clay is nearly grey; the deviation is not.
    spread = [np.ptp(part, axis=2).max() for part in parts]
    assert spread[0] < 60 and spread[1] < 60 < 100 < spread[2]


def test_options_change_the_picture(scans):
    def picture(*options):
        made = msal("view", scans / "a.ply", "-o", scans / "o.png", "--size", "80", *options)
        assert made.exit_code == 0, made.stderr
        return (scans / "o.png").read_bytes()

    options = [
        (),
        ("--turn", "70"),
        ("--tilt", "-40"),
        ("--view", "top"),
        ("--up=-x",),
        ("--shading", "flat"),
        ("--size", "81"),
    ]
    assert len({picture(*one) for one in options}) == len(options)


def test_a_page_holds_both_meshes_and_a_picture(scans):
    made = msal("view", scans / "a.ply", scans / "b.ply", "-o", scans / "p.html", "--size", "80")
    assert made.exit_code == 0, made.stderr
    page = (scans / "p.html").read_text("utf-8")
    assert page.startswith("<!") and "data:image/jpeg;base64," in page
    for word in ("a.ply", "b.ply", "576", "Displacement", "Normal angle", "Mean edge before"):
        assert word in page
    msal("view", scans / "a.ply", "-o", scans / "one.HTML", "--size", "80")
    assert len((scans / "one.HTML").read_bytes()) < len(page)


def test_without_a_name_the_page_is_in_the_current_folder(scans, tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for _ in range(2):
        made = msal("view", scans / "a.ply", scans / "b.ply", "--size", "80")
        assert made.exit_code == 0 and "wrote b.view.html" in made.stderr
    assert os.listdir(folder) == ["b.view.html"]
    (folder / "b.view.html").write_text("notes of mine")
    assert msal("view", scans / "b.ply").exit_code == 2
    assert (folder / "b.view.html").read_text() == "notes of mine"
    if sys.platform == "linux":
        assert opened == []
    monkeypatch.setenv("DISPLAY", ":0")
    msal("view", scans / "a.ply", "-q", "--size", "80")
    assert opened[-1] == (folder / "a.view.html").as_uri()


def test_standard_output_takes_a_picture(scans):
    made = msal("view", scans / "a.ply", "-o", "-", "--size", "64")
    assert Image.open(io.BytesIO(made.stdout_bytes)).format == "PNG"
    assert made.stderr == ""
