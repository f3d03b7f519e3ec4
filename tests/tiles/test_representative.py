"""The choice for a mesh in tiles, made on a part of it."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.auto import NONE, Wishes
from msal_cli.errors import ContentError, UsageError
from msal_cli.job.choice import prepare
from msal_cli.job.plain_data import as_data, from_data
from msal_cli.job.records import ChoiceMade, NoiseEstimate
from msal_cli.job.settings import ADAPTIVE, AUTO, Settings
from msal_cli.mesh import Mesh, prepare_mesh
from msal_cli.tiles import representative
from msal_cli.tiles.plan import load_plan, read_globals
from tests.shapes import grid, torus
from tests.tiles.fakes import FakeMesh, open_fake, run_stages

WHOLE_ONLY = ("l0",)
CHEAP = Wishes(budget=6.0)


@pytest.fixture(autouse=True)
def reaches(monkeypatch):
    """A reach for all methods but one, and for blends without it."""

    def reach(method, parameters):
        needs_whole = any(name in str(parameters.get("members")) for name in WHOLE_ONLY)
        return None if method.name in WHOLE_ONLY or needs_whole else 3

    monkeypatch.setattr(methods.Method, "reach", reach)


def in_tiles(folder, vertices, faces, settings, n_tiles=4):
    """The scratch folder of a run that has got as far as ``choose``."""
    folder.mkdir()
    with pytest.MonkeyPatch.context() as patch:
        made = FakeMesh(vertices, faces.astype(np.uint32))
        plan, scratch = open_fake(patch, folder, made, tile_vertices=-(-len(vertices) // n_tiles))
        replace(plan, settings=asdict(settings)).save(scratch)
        run_stages(scratch)
    return scratch


@pytest.fixture
def mesh():
    return along_normals(*torus(64, 32), 0.03)


def along_normals(vertices, faces, level):
    """The mesh with noise of a level, or of one for each vertex, along its normals."""
    heights = level * np.random.default_rng(0).normal(size=len(vertices))
    return vertices + heights[:, None] * Mesh(vertices, faces).vertex_normals(), faces


def run(folder, mesh, settings, **more):
    scratch = in_tiles(folder, *mesh, settings, **more)
    result = representative.run_choose(scratch)
    # It is written as JSON.
    return json.loads(json.dumps(result))


@pytest.fixture
def small_parts(monkeypatch):
    monkeypatch.setattr(representative, "PATCH_VERTICES", 400)
    monkeypatch.setattr(representative, "MOST_PATCHES", 4)


@pytest.mark.parametrize(
    "settings",
    [Settings(ADAPTIVE), Settings(AUTO, asdict(CHEAP))],
    ids=["adaptive", "auto"],
)
def test_a_small_mesh_is_looked_at_as_a_whole(tmp_path, mesh, settings):
    result = run(tmp_path / "s", mesh, settings)
    alone = prepare(prepare_mesh(*mesh).mesh, settings, lambda done, total: None)
    assert result["is_whole"] and result["vertices"] == len(mesh[0])
    assert result["method"] == alone.method.name
    assert result["parameters"] == dict(alone.parameters)
    assert result["known"]["choice"] == json.loads(json.dumps(as_data(alone.known["choice"])))


def test_the_part_is_as_noisy_as_the_whole(tmp_path, mesh, small_parts):
    vertices, faces = mesh
    scratch = in_tiles(tmp_path / "s", vertices, faces, Settings(ADAPTIVE), n_tiles=4)
    result = representative.run_choose(scratch)
    assert not result["is_whole"]
    assert 4 * 380 < result["vertices"] <= 4 * 400
    whole = prepare(prepare_mesh(vertices, faces).mesh, Settings(ADAPTIVE), lambda *step: None)
    assert result["method"] == whole.method.name
    assert result["noise_estimate"]["file_units"] == pytest.approx(whole.noise.file_units, rel=0.15)
    scratch.finish("choose", 0, result)
    representative.reduce_choose(scratch)
    assert read_globals(scratch)["rings"] == 3
    assert read_globals(scratch)["choice"]["method"] == result["method"]


def test_patches_are_faces_of_the_mesh_itself(tmp_path, mesh, small_parts):
    vertices, faces = mesh
    scratch = in_tiles(tmp_path / "s", vertices, faces, Settings("msal"))
    part = representative.read_part(scratch, load_plan(scratch)).ready
    corners = (part.mesh.vertices + part.origin)[part.mesh.faces]
    known = {tuple(corner.round(9).ravel()) for corner in vertices[faces]}
    assert len(corners) > 1000
    assert all(tuple(corner.round(9).ravel()) in known for corner in corners)
    # In the order of the file.
    assert len({tuple(corner.round(9).ravel()) for corner in corners}) == len(corners)


def test_lengths_become_those_of_the_whole(tmp_path, mesh, small_parts):
    result = run(tmp_path / "s", mesh, Settings(ADAPTIVE))
    doubled = representative.to_whole_units(result, result["mean_edge_length"] / 2)
    assert doubled["parameters"]["noise"] == 2 * result["parameters"]["noise"]
    assert doubled["noise_estimate"]["mean_edges"] == 2 * result["noise_estimate"]["mean_edges"]
    assert doubled["noise_estimate"]["file_units"] == result["noise_estimate"]["file_units"]
    choice = from_data(ChoiceMade, doubled["known"]["choice"])
    assert f"noise={doubled['parameters']['noise']!r}" in choice.repeat
    assert choice.noise_edges == 2 * result["known"]["choice"]["noise_edges"]
    assert from_data(NoiseEstimate, doubled["noise_estimate"]).kind == "white"
    whole = result | {"is_whole": True}
    assert representative.to_whole_units(whole, 1.0) == whole


def test_a_named_method_gets_the_estimate_in_place_of_its_own(tmp_path, mesh):
    vertices, faces = mesh
    ready = prepare_mesh(vertices, faces).mesh
    from msal_cli.analysis.noise_estimate import estimate_noise

    level = estimate_noise(ready).file_units
    for name, given in (
        ("wiener", {}),
        ("learned", {}),
        ("al", {"schedule": "wiener"}),
        ("blend", {"members": "0.4*wiener+0.6*al(schedule=wiener,iterations=2)"}),
    ):
        values = methods.find(name).validate(given)
        result = run(tmp_path / name, mesh, Settings(name, values))
        if name == "blend":
            assert result["parameters"]["members"].count("noise=") == 2
            continue
        # To the last bit what the method would have estimated in memory.
        assert result["parameters"]["noise"] * ready.mean_edge_length == level
    values = methods.find("al").validate({})
    assert run(tmp_path / "plain", mesh, Settings("al", values))["parameters"] == values


def test_no_noise_is_not_estimated_by_each_tile(tmp_path):
    values = methods.find("wiener").validate({})
    result = run(tmp_path / "s", grid(40, 40), Settings("wiener", values))
    assert result["parameters"]["noise"] == representative.LEAST_NOISE


def test_a_choice_that_needs_the_whole_gives_way(tmp_path, mesh, monkeypatch):
    wished = Settings(AUTO, asdict(CHEAP))
    first = run(tmp_path / "first", mesh, wished)
    members = first["parameters"].get("members", f"1*{first['method']}")
    global_one = members.split("*")[1].split("(")[0]
    monkeypatch.setattr("tests.tiles.test_representative.WHOLE_ONLY", (global_one,))
    second = run(tmp_path / "second", mesh, wished)
    assert global_one not in second["parameters"].get("members", second["method"])
    assert any("needs the whole mesh" in warning for warning in second["warnings"])
    assert not any("needs the whole mesh" in warning for warning in first["warnings"])


def test_weights_by_local_noise_give_way(tmp_path, mesh, monkeypatch):
    vertices, faces = torus(64, 32)
    uneven, _ = along_normals(vertices, faces, np.where(vertices[:, 0] > 0, 0.05, 0.005))

    def reach(method, parameters):
        return None if parameters.get("levels") else 3

    monkeypatch.setattr(methods.Method, "reach", reach)
    for name in (ADAPTIVE, AUTO):
        settings = Settings(name, asdict(CHEAP) if name == AUTO else {})
        alone = prepare(prepare_mesh(uneven, faces).mesh, settings, lambda *step: None)
        assert alone.parameters["levels"]
        result = run(tmp_path / name, (uneven, faces), settings)
        assert not result["parameters"].get("levels")
        assert result["warnings"]


def test_a_named_method_that_needs_the_whole_is_refused(tmp_path, mesh):
    values = methods.find("l0").validate({})
    with pytest.raises(UsageError, match="l0 needs the whole mesh") as refused:
        run(tmp_path / "s", mesh, Settings("l0", values))
    assert "msal" in refused.value.hint and "l0" not in refused.value.hint


def test_a_clean_mesh_stays_as_it_is(tmp_path):
    result = run(tmp_path / "s", torus(64, 32), Settings(ADAPTIVE))
    assert result["method"] == NONE
    assert "left as it is" in result["known"]["choice"]["reason"]
    left = run(tmp_path / "n", torus(64, 32), Settings("msal", {}, min_noise="auto"))
    assert left["method"] == NONE
    assert "none to speak of" in left["known"]["left_alone"]


def test_outliers_are_told_of_and_stay(tmp_path, mesh):
    vertices, faces = mesh
    spiked = vertices.copy()
    spiked[::97] *= 1.5
    result = run(tmp_path / "s", (spiked, faces), Settings(ADAPTIVE))
    assert result["known"]["despiked"] == 0
    assert any("outliers" in warning for warning in result["warnings"])


def test_tiles_without_faces_are_passed_over(tmp_path, mesh, small_parts):
    vertices, faces = mesh
    lonely = np.column_stack([np.linspace(10, 20, 6000), np.zeros(6000), np.zeros(6000)])
    scattered = (np.concatenate([vertices, lonely]), faces)
    result = run(tmp_path / "s", scattered, Settings("msal"), n_tiles=16)
    assert result["vertices"] >= 500
    with pytest.raises(ContentError, match="no tile has a face"):
        run(tmp_path / "none", (lonely, np.array([[0, 3000, 5999]])), Settings("msal"))
