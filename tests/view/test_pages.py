"""A scene as a page: what it says, that nothing from outside is markup, and its policy."""

import numpy as np
import pytest

from msal_cli.codecs.mesh_file import Surface
from msal_cli.job.display_names import escape_for_display
from msal_cli.mesh import Mesh
from msal_cli.view import pages, pictures
from msal_cli.view.scene import encode_scene
from tests.html_pages import Page, assert_self_contained
from tests.report.made import HOSTILE_NAMES
from tests.shapes import ball, cube
from tests.view.decoded import decoded

MESH = Mesh(*cube())
VIEW = pictures.View(size=64)


def scene_of(before, after):
    return pictures.scene_of(Surface(*before), Surface(*after), ("before.ply", "after.ply"))


def parts_of(scene, view=VIEW, **options):
    facts = [("displacement", "mean 0.1, max 0.2")] if scene.record is not None else []
    data = pages.page_of(scene, view, "msal view a b", facts, **options)
    return Page(data.decode("utf-8", "strict"))


def page(scene, view=VIEW):
    parts = parts_of(scene, view)
    (box,) = (one for one in parts.attributes("div") if "data-scene" in one)
    return parts, box, decoded(parts.texts["script"][0])


def pair(name="scan.ply"):
    return pictures.Scene((name, f"other {name}"), MESH, MESH, np.arange(8.0))


@pytest.fixture(scope="module")
def grown():
    vertices, faces = ball()
    return scene_of((vertices, faces), (1.1 * vertices, faces))


def test_the_page_says_what_the_record_says(grown):
    parts, _, _ = page(grown)
    assert parts.texts["title"] == ["before.ply → after.ply"]
    assert "Made by: msal view a b" in parts.texts["p"]
    assert parts.texts["th"][:3] == ["Before", "After", "Displacement"]


def test_the_page_has_the_picture_the_view_and_the_scale(grown):
    parts, box, (header, meshes, deviation) = page(grown, pictures.View(size=64, view="top"))
    assert len(meshes) == 2 and header["meshes"][1]["moved"]
    axes = pictures.camera_of(grown, pictures.View(view="top")).axes
    assert header["view"] == pytest.approx(axes.reshape(-1), abs=1e-6)
    assert header["deviation"]["low"] == -header["deviation"]["high"] < -0.09
    assert deviation == pytest.approx(np.full(len(deviation), 0.1), abs=2e-3)
    assert (box["data-deviation"], box["data-shading"]) == (pictures.SIGNED, "smooth")
    assert parts.attributes("img")[0]["src"].startswith("data:image/jpeg;base64,/9j/")


def test_one_mesh(grown):
    alone = pictures.scene_of(Surface(*cube()), None, ("cube.ply",))
    parts, _, (header, meshes, deviation) = page(alone)
    assert len(meshes) == 1 and deviation is None and "deviation" not in header
    assert parts.texts["h1"] == ["cube.ply"]
    assert "Split" not in parts.texts["th"]
    assert parts.texts["th"][:2] == ["Mesh", "Mean edge"] and "8 vertices" in str(parts.texts)


@pytest.mark.parametrize("name", [*HOSTILE_NAMES, "\udcff.ply", "$title${x}.ply"])
def test_names_stay_text(name):
    plain, hostile = parts_of(pair()), parts_of(pair(name))
    assert [(tag, sorted(found)) for tag, found in plain.tags] == [
        (tag, sorted(found)) for tag, found in hostile.tags
    ]
    titles = pictures.titles_of(pair(name).names)
    assert hostile.texts["title"] == hostile.texts["h1"] == [escape_for_display(" → ".join(titles))]
    assert hostile.attributes("img")[0]["alt"].startswith(escape_for_display(titles[0]))
    # A script is the same text whatever the names are.
    assert plain.texts["script"] == hostile.texts["script"]


def test_nothing_is_loaded_or_run_but_what_is_there():
    assert_self_contained(parts_of(pair()))
    for code in (pages.viewer_script(), pages.viewer_style()):
        for word in ("http", "//cdn", "@import", "fetch(", "innerHTML", "eval(", "url("):
            assert word not in code


def test_a_fragment_for_other_pages():
    drawn = encode_scene(MESH, MESH)
    parts = Page(pages.embed_scene("worst-1", drawn, picture=b"JPEG", deviation='"<'))
    (box,) = parts.attributes("div")
    assert (box["data-scene"], box["data-start"]) == ("worst-1", "click")
    assert box["data-deviation"] == '"<'
    (data,) = parts.attributes("script")
    assert data == {"type": "application/octet-stream", "id": "worst-1"}
    assert parts.texts["script"] == [drawn.text]
