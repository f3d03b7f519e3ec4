"""A scene as a page: what it says and holds, read back by a twin of its script; fewer faces."""

import numpy as np
import pytest

from msal_cli.codecs.mesh_file import Surface
from msal_cli.job.display_names import escape_for_display
from msal_cli.mesh import Mesh
from msal_cli.view import pages, pictures, scene
from msal_cli.view.scene import encode_scene
from tests.html_pages import Page, assert_self_contained
from tests.report.made import HOSTILE_NAMES
from tests.shapes import ball, cube, fan, grid, noisy, torus
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


SHAPES = {
    "torus": torus(),
    "grid": grid(),
    "cube": cube(),
    "fan": fan(np.arange(5.0)),
    "one face": (np.eye(3), np.array([[0, 1, 2]], dtype=np.int32)),
    "a point": (np.ones((3, 3)), np.array([[0, 1, 2]], dtype=np.int32)),
    "a line": (np.outer(np.arange(3.0), [1.0, 0, 0]), np.array([[0, 1, 2]], dtype=np.int32)),
    "thin": (torus()[0] * [1000.0, 1.0, 0.001], torus()[1]),
}


def places(header, ticks, low):
    return ticks * header["step"] + low


@pytest.mark.parametrize("name", SHAPES)
def test_positions_come_back_within_the_rounding(name):
    vertices, faces = SHAPES[name]
    drawn = scene.encode_scene(Mesh(vertices, faces))
    header, [(ticks, found)], deviation = decoded(drawn.text)
    assert deviation is None
    assert drawn.counts == ((len(faces), len(faces)),) and len(found) == len(faces)
    got = places(header, ticks, vertices[faces.reshape(-1)].min(axis=0))
    nearest = np.abs(got[found].mean(axis=1)[:, None] - vertices[faces].mean(axis=1)[None])
    assert nearest.max(axis=2).min(axis=1).max() <= drawn.rounding * (1 + 1e-9)
    assert nearest.max(axis=2).min(axis=0).max() <= drawn.rounding * (1 + 1e-9)


@pytest.mark.parametrize(("shift", "most"), [(0.0, 576), (4_650_000.0, 576), (0.0, 200)])
def test_a_vertex_keeps_its_number_on_both_sides(shift, most):
    vertices, faces = torus()
    before, after = noisy(vertices) + shift, vertices + shift
    values = np.arange(float(len(vertices)))
    drawn = scene.encode_scene(Mesh(before, faces), Mesh(after, faces), values, max_faces=most)
    header, [(ticks, found), (moved, same)], deviation = decoded(drawn.text)
    assert header["meshes"][1]["moved"] and same is found
    assert drawn.counts == ((576, len(found)),) * 2 and len(found) <= most
    low = np.minimum(before.min(axis=0), after.min(axis=0))
    who = np.rint(deviation).astype(int)
    for got, given in ((ticks, before), (moved, after)):
        off = np.abs(places(header, got, low) - given[who])
        assert off.max() <= drawn.rounding * (1 + 1e-6)
    assert most < 576 or {tuple(np.roll(f, -f.argmin())) for f in who[found]} == {
        tuple(np.roll(f, -f.argmin())) for f in faces
    }


def test_meshes_with_other_faces_stand_side_by_side():
    first, second = Mesh(*torus()), Mesh(*cube())
    drawn = scene.encode_scene(first, second, np.arange(8.0))
    _, [(_, before), (ticks, after)], deviation = decoded(drawn.text)
    assert (len(before), len(after)) == (len(first.faces), len(second.faces))
    assert len(ticks) == len(deviation) == 8
    assert drawn.counts[1] == (12, 12)


def test_the_scale_of_colours():
    mesh = Mesh(*torus())
    n = len(mesh.vertices)

    def scale(values, **options):
        return decoded(scene.encode_scene(mesh, mesh, values, **options).text)[0]["deviation"]

    signed = scale(np.linspace(-1.0, 3.0, n), ends=(-2.0, 2.0))
    assert [signed[key] for key in ("least", "most", "low", "high")] == [-1.0, 3.0, -2.0, 2.0]
    unsigned = scale(np.linspace(0.0, 3.0, n), ends=(0.0, 3.0))
    assert unsigned["low"] == 0.0 and unsigned["colours"] != signed["colours"]
    for flat in (np.zeros(n), np.full(n, np.nan), np.full(n, 2.0)):
        assert scale(flat, ends=(0.0, 0.0))["high"] > 0.0 and scale(flat)["span"] > 0


# Decimation: as many faces as asked for, between vertices of the file, on the same surface


def areas(vertices, faces):
    corner = vertices[faces]
    doubled = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return np.linalg.norm(doubled, axis=1) / 2


@pytest.mark.parametrize("level", [0.0, 0.1, 3.0])
@pytest.mark.parametrize("most", [2000, 600])
def test_as_many_faces_as_asked_for(level, most):
    vertices, faces = torus(60, 40)
    vertices = noisy(vertices, level=level) if level else vertices
    kept, coarse = scene.coarsen(vertices, faces, most)
    assert 0.7 * most < len(coarse) <= most
    assert np.array_equal(np.unique(coarse), np.arange(len(kept)))
    assert len(np.unique(np.sort(coarse, axis=1), axis=0)) == len(coarse)
    assert (np.diff(np.sort(coarse, axis=1), axis=1) > 0).all()


def test_the_surface_stays_where_it_is_and_faces_outwards():
    vertices, faces = torus(120, 60)
    kept, coarse = scene.coarsen(vertices, faces, 3000)
    corner = vertices[kept][coarse]
    normals = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    outward = Mesh(vertices, faces).vertex_normals()[kept][coarse].sum(axis=1)
    assert ((normals * outward).sum(axis=1) > 0.0).all()
    volume = np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6
    assert volume == pytest.approx(2 * np.pi**2 * 3.0, rel=0.02)
    assert areas(vertices[kept], coarse).sum() == pytest.approx(4 * np.pi**2 * 3.0, rel=0.02)


def test_the_boundary_does_not_move_inwards():
    vertices, faces = grid(40, 40)
    vertices = vertices * [1.0, 1.0, 0.0]
    kept, coarse = scene.coarsen(vertices, faces, 800)
    assert len(coarse) <= 800
    full = areas(vertices, faces).sum()
    assert areas(vertices[kept], coarse).sum() == pytest.approx(full, rel=0.03)
