"""`msal view`."""

import io
import os
import sys
import webbrowser

from PIL import Image

from tests.cli.scans import msal


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
        (scans / "b.ply",),
    ]
    assert len({picture(*one) for one in options}) == len(options)


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
