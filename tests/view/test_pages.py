"""A scene as a page."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.analysis import surface_distance
from msal_cli.job.comparison import Surface
from msal_cli.view import pages, pictures
from tests.shapes import ball, cube
from tests.view.decoded import decoded
from tests.view.test_viewer import Parts

NAMES = ("before.ply", "after.ply")
VIEW = pictures.View(size=64)


def scene_of(before, after):
    return pictures.scene_of(Surface(*before), Surface(*after), NAMES)


def page(scene, view=VIEW):
    parts = Parts(pages.page_of(scene, view, "msal view a b").decode())
    (box,) = (one for one in parts.attributes("div") if "data-scene" in one)
    return parts, box, decoded(parts.texts["script"][0])


@pytest.fixture(scope="module")
def grown():
    vertices, faces = ball()
    return scene_of((vertices, faces), (1.1 * vertices, faces))


def test_the_page_says_what_the_record_says(grown):
    figures = dict(pages.figures_of(grown))
    assert ("Mean", "0.1") in [row[:2] for row in figures["Displacement"]]
    assert dict(figures["Change"])["Volume"] == "+33.1 %"
    assert dict(figures["Change"])["Flipped faces"] == "0"
    assert dict(figures["Meshes"])["Triangles"] == f"{len(grown.before.faces):,}"
    parts, _, _ = page(grown)
    assert parts.texts["title"] == ["before.ply → after.ply"]
    assert "Made by: msal view a b" in parts.texts["p"]


def test_the_page_has_the_picture_the_view_and_the_scale(grown):
    parts, box, (header, meshes, deviation) = page(grown, pictures.View(size=64, view="top"))
    assert len(meshes) == 2 and header["meshes"][1]["moved"]
    axes = pictures.camera_of(grown, pictures.View(view="top")).axes
    assert header["view"] == pytest.approx(axes.reshape(-1), abs=1e-6)
    assert header["deviation"]["low"] == -header["deviation"]["high"] < -0.09
    assert deviation == pytest.approx(np.full(len(deviation), 0.1), abs=2e-3)
    assert (box["data-deviation"], box["data-shading"]) == (pictures.SIGNED, "smooth")
    assert parts.attributes("img")[0]["src"].startswith("data:image/png;base64,iVBOR")
    assert "data-theme" not in parts.attributes("html")[0]


def test_options_of_the_picture_are_those_of_the_page(grown):
    parts, box, _ = page(grown, pictures.View(size=64, style="dark", shading="flat"))
    assert parts.attributes("html")[0]["data-theme"] == "dark"
    assert box["data-shading"] == "flat"


def test_one_mesh(grown):
    alone = pictures.scene_of(Surface(*cube()), None, ("cube.ply",))
    parts, _, (header, meshes, deviation) = page(alone)
    assert len(meshes) == 1 and deviation is None and "deviation" not in header
    assert parts.texts["h1"] == ["cube.ply"]
    assert dict(pages.figures_of(alone)[0][1])["Vertices"] == "8"


def test_other_faces(monkeypatch):
    monkeypatch.setattr(surface_distance, "is_available", lambda: False)
    parts, _, (_, meshes, deviation) = page(scene_of(ball(), cube()))
    assert deviation is None and len(meshes[1][1]) == 12
    assert any("fcpw" in text for text in parts.texts["p"])


def test_small_numbers_are_written_with_powers():
    assert pages._number(1.42e-5) == "1.42·10⁻⁵"
    assert pages._number(-0.25) == "\N{MINUS SIGN}0.25"
