"""Outliers from the command line: counted, repeated, forbidden, and within the constraints."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli import auto as selection
from msal_cli import codecs, methods
from msal_cli.analysis.added_noise import add_plain_noise
from msal_cli.analysis.noise_estimate import estimate_noise
from msal_cli.auto import adaptive
from msal_cli.mesh import prepare_mesh
from tests.cli.scans import folder_of, msal, ply_text, record_of
from tests.shapes import torus

SPIKED = np.arange(40, 1800, 88)


def spiked_scan(level):
    """A torus with noise, and 20 of its 1,800 vertices two edges off along the normals."""
    mesh = prepare_mesh(*torus(60, 30)).mesh
    vertices = add_plain_noise(mesh, "gaussian-normal", level, 1)
    vertices[SPIKED] += 2.0 * mesh.mean_edge_length * mesh.vertex_normals()[SPIKED]
    return ply_text(vertices, mesh.faces)


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    folder = tmp_path_factory.mktemp("despike") / "in"
    return folder_of(folder, quiet=spiked_scan(0.0), loud=spiked_scan(0.15))


def run(*words, code=0):
    made = msal("denoise", *words, "--json")
    return record_of(made, code), made


def vertices_of(path):
    return codecs.open_mesh(path.read_bytes(), path.name).vertices


def true_vertices():
    return torus(60, 30)[0]


def test_the_plain_command_brings_them_back_and_leaves_the_rest(scans, tmp_path):
    record, made = run(scans / "quiet.ply", "-o", tmp_path / "o.ply")
    assert (record["despiked"], record["status"]) == (20, "written")
    assert record["choice"]["reason"].endswith("clean; the rest left as it is")
    assert record["displacement"]["moved_vertices"] == 20
    assert "; 20 outlier vertices brought back" in made.stderr
    assert np.abs(vertices_of(tmp_path / "o.ply") - true_vertices()).max() < 0.1
    # Without them there is no noise.
    assert record["noise_estimate"]["negligible"]


@pytest.mark.parametrize("how", [(), ("--auto-budget", "3")])
def test_the_options_repeat_the_bytes(scans, tmp_path, how):
    record, _ = run(scans / "quiet.ply", "-o", tmp_path / "a.ply", *how)
    by_hand = record["choice"]["repeat"]
    assert by_hand[-1] == "--despike"
    again, _ = run(scans / "quiet.ply", "-o", tmp_path / "b.ply", *by_hand)
    assert again["despiked"] == record["despiked"] == 20
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()
    assert again["noise_estimate"] == record["noise_estimate"]
    assert record["noise_estimate"]["tail"] < 0.02


def test_they_stay_where_this_is_forbidden(scans, tmp_path):
    record, made = run(scans / "quiet.ply", "-o", tmp_path / "o.ply", "--no-despike")
    assert record["despiked"] is None
    assert "brought back" not in made.stderr
    assert "--despike" not in record["choice"]["repeat"]


def test_a_method_by_name_is_the_method_alone(scans, tmp_path):
    plain, _ = run(scans / "loud.ply", "-o", tmp_path / "a.ply", "--method", "msal")
    assert plain["despiked"] is None
    asked, _ = run(scans / "loud.ply", "-o", tmp_path / "b.ply", "--method", "msal", "--despike")
    assert asked["despiked"] == 20
    errors = [
        np.abs(vertices_of(tmp_path / name) - true_vertices()).max() for name in ("a.ply", "b.ply")
    ]
    assert errors[1] < 0.5 * errors[0]


def test_locked_vertices_stay(scans, tmp_path):
    before = vertices_of(scans / "quiet.ply")
    record, _ = run(scans / "quiet.ply", "-o", tmp_path / "o.ply", "--lock", "x > 0")
    locked = before[:, 0] > 0
    assert record["despiked"] == 20 - int(locked[SPIKED].sum())
    assert (vertices_of(tmp_path / "o.ply")[locked] == before[locked]).all()


def test_a_choice_that_damages_leaves_the_outliers_too(scans, tmp_path, monkeypatch):
    def collapsing(mesh, *given, **named):
        values = methods.find("umbrella").validate({"iterations": 1000})
        return selection.Choice("umbrella", values, "collapse", None, estimate_noise(mesh))

    monkeypatch.setattr(adaptive, "choose_adaptive", collapsing)
    record, _ = run(scans / "quiet.ply", "-o", tmp_path / "o.ply")
    # A milder choice takes its place.
    assert record["method"]["name"] != "umbrella"
    assert np.abs(vertices_of(tmp_path / "o.ply") - true_vertices()).max() < 1.5
