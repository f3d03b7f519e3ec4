"""The noise estimate against noise that was put in, and its readings as noise or texture."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import special

from benchmarks import ground_truth
from benchmarks.ground_truth import add_plain_noise
from msal_cli.analysis import noise_estimate
from msal_cli.analysis.noise_estimate import (
    NOISE,
    TEXTURE,
    Reading,
    estimate_noise,
    estimate_regions,
)
from msal_cli.analysis.noise_estimate.evidence import gather_evidence
from msal_cli.analysis.noise_estimate.fits import MAX_FREEDOMS, chi_square_table, estimate_white
from msal_cli.mesh import prepare_mesh
from tests.shapes import grid, noisy, torus


@pytest.fixture(scope="module")
def clean():
    return estimate_noise(prepare_mesh(*torus(60, 30)).mesh)


def read_as(noise, probability, level=0.08):
    readings = (Reading(NOISE, level, probability), Reading(TEXTURE, 0.0, 1.0 - probability))
    return dataclasses.replace(noise, readings=readings)


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_chi_square(share):
    freedoms = np.arange(1, MAX_FREEDOMS + 1)
    exact = 2.0 * special.gammaincinv(freedoms / 2.0, share) / freedoms
    assert chi_square_table(share)[1:] == pytest.approx(exact, rel=0.006)
    assert chi_square_table(share)[1:5] == pytest.approx(exact[:4], rel=1e-5)


@pytest.mark.parametrize(
    ("probability", "is_unsure"), [(0.0, False), (0.1, False), (0.2, True), (0.95, False)]
)
def test_unsure_is_where_neither_kind_is_probable(clean, probability, is_unsure):
    assert read_as(clean, probability).is_unsure == is_unsure


def test_an_assumption_decides_only_what_is_unsure(clean):
    unsure, sure = read_as(clean, 0.5), read_as(clean, 0.95)
    assert sure.assume(TEXTURE, 1.0) is sure and unsure.assume(None, 1.0) is unsure
    noise = unsure.assume(NOISE, 2.0)
    assert (noise.mean_edges, noise.file_units, noise.is_negligible) == (0.08, 0.16, False)
    texture = unsure.assume(TEXTURE, 2.0)
    assert (texture.mean_edges, texture.high, texture.is_negligible) == (0.0, 0.0, True)
    assert not noise.is_unsure and not texture.is_unsure


def test_a_clean_shape_and_its_estimate_have_readings(clean):
    assert clean.readings[0].kind == TEXTURE and not clean.is_unsure
    assert sum(reading.probability for reading in clean.readings) == pytest.approx(1.0)


@pytest.mark.parametrize(("edges", "is_below"), [(0.15, False), (0.35, True)])
def test_noise_of_one_region_is_not_below_what_it_reaches(clean, edges, is_below):
    uneven = dataclasses.replace(clean, mean_edges=0.1, rms_edges=0.1, lowest=0.01, highest=0.3)
    assert uneven.is_below(edges) == is_below


def with_noise(shape, level, kind="gaussian-normal", seed=0, fraction=0.1):
    """A mesh with noise of ``level`` mean edge lengths, and its amount in file units."""
    mesh = prepare_mesh(*shape).mesh
    moved = mesh.with_vertices(add_plain_noise(mesh, kind, level, seed, fraction=fraction))
    return moved, level * mesh.mean_edge_length


def uneven_torus():
    """A torus whose sampling varies, by a sine, from half to twice as dense."""
    vertices, faces = torus(200, 60)
    angle = np.arctan2(vertices[:, 1], vertices[:, 0])
    radius = np.hypot(vertices[:, 0], vertices[:, 1])
    angle = angle + 0.6 * np.sin(angle)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), vertices[:, 2]], 1), faces


SHAPES = {"torus": torus(160, 80), "open plane": grid(90, 80), "uneven": uneven_torus()}


@pytest.mark.parametrize("level", [0.05, 0.2, 0.5])
@pytest.mark.parametrize("shape", SHAPES)
def test_gaussian_noise_is_told(shape, level):
    mesh, amount = with_noise(SHAPES[shape], level)
    noise = estimate_noise(mesh)
    assert noise.file_units == pytest.approx(amount, rel=0.06)
    assert noise.file_units == pytest.approx(noise.mean_edges * mesh.mean_edge_length)
    assert noise.low * mesh.mean_edge_length < amount < noise.high * mesh.mean_edge_length
    assert noise.low < noise.mean_edges < noise.high
    assert not noise.is_negligible
    assert not noise.is_uneven
    assert noise.tail < 0.018
    character = noise.character
    assert (character.kind, character.direction, character.rings) == ("white", "normals", 0)
    assert character.axis is None and (character.confidence > 0.9 or shape == "open plane")
    assert noise.rms_edges == pytest.approx(noise.mean_edges, rel=0.05)


def test_creases_do_not_pass_for_noise():
    # A plane folded like a roof again and again: flat but for sharp creases.
    vertices, faces = grid(80, 96)
    vertices[:, 2] = np.abs((vertices[:, 0] + 12.0) % 24.0 - 12.0)
    assert estimate_noise(prepare_mesh(vertices, faces).mesh).is_negligible
    mesh, amount = with_noise((vertices, faces), 0.1)
    assert estimate_noise(mesh).file_units == pytest.approx(amount, rel=0.08)


@pytest.mark.parametrize(("rows", "is_negligible"), [(7, True), (70, False)])
def test_parts_of_few_vertices_do_not_pass_for_noise(rows, is_negligible):
    vertices, faces = grid(rows, 7)
    parts = [vertices + [0.0, 0.0, 9.0 * part] for part in range(40)]
    moved = np.concatenate(parts)
    moved[:, 2] += 0.15 * np.random.default_rng(3).standard_normal(len(moved))
    joined = np.concatenate([faces + len(vertices) * part for part in range(40)])
    noise = estimate_noise(prepare_mesh(moved, joined).mesh)
    assert noise.is_negligible == is_negligible
    assert (noise.character.basis == "parts of few vertices") == is_negligible


@pytest.mark.parametrize(
    ("kind", "flat", "fins", "is_clean"),
    [("white", 9, 0, True), ("white", -1, 0, False), ("white", -1, 40, True)]
    + [("view", 9, 0, False), ("uneven", 9, 0, False), ("uneven", 9, 40, True)],
)
def test_noise_bends_edges_and_leaves_them_manifold(kind, flat, fins, is_clean, monkeypatch):
    verdict = noise_estimate.Verdict(0.85, kind, 0.8, 0.1, 0.1, 0.09, 0.11, 0)
    monkeypatch.setattr(noise_estimate, "classify", lambda *given: verdict)
    vertices, faces = grid(60, 40)
    vertices[:, 2] += 0.1 * np.random.default_rng(3).standard_normal(2400) * (vertices[:, 0] > flat)
    edges = faces[:: len(faces) // 40, :2][:fins]
    vertices = np.concatenate([vertices, vertices[edges[:, 0]] + [0.3, 0.4, 1.0]])
    faces = np.concatenate([faces, np.column_stack([edges, 2400 + np.arange(fins)])])
    assert estimate_noise(prepare_mesh(vertices, faces).mesh).is_negligible == is_clean


@pytest.mark.parametrize(("wide", "spread"), [(1.0, 1.5), (30.0, 30.0)])
def test_evidence_has_the_spread_of_the_edges(wide, spread):
    vertices, faces = grid(20, 20)
    mesh = prepare_mesh(noisy(vertices, level=0.01) * [1.0, wide, 1.0], faces).mesh
    assert gather_evidence(mesh, estimate_white(mesh)).edge_spread == pytest.approx(spread, rel=0.1)


def test_texture_on_a_part_does_not_pass_for_noise():
    vertices, faces = grid(100, 90)
    bumps = 0.15 * np.sin(2.1 * vertices[:, 0]) * np.sin(1.7 * vertices[:, 1])
    vertices[:, 2] = np.where(vertices[:, 1] > 40, bumps, 0.0)
    assert estimate_noise(prepare_mesh(vertices, faces).mesh).low == 0.0
    draw = np.random.default_rng(1)
    vertices[:, 2] += 0.05 * draw.standard_normal(len(vertices))
    noise = estimate_noise(prepare_mesh(vertices, faces).mesh)
    assert noise.low < 0.06 < noise.high
    assert noise.file_units < 0.09
    vertices[:, 2] = 0.1 * np.sin(1.1 * vertices[:, 0]) * np.sin(1.0 * vertices[:, 1])
    assert estimate_noise(prepare_mesh(vertices, faces).mesh).low == 0.0


def test_relief_widens_the_interval_of_white_noise():
    widths = []
    for source in (ground_truth.sources()["rock"](), prepare_mesh(*torus(160, 80)).mesh):
        noise = estimate_noise(ground_truth.corrupted(source, 0.1, 1)[0])
        assert noise.character.kind == "white" and not noise.is_unsure
        widths.append(1.0 - noise.low / noise.mean_edges)
    assert widths[0] > 1.5 * widths[1]


@pytest.mark.parametrize("split", ["by place", "by a slanted plane"])
def test_two_halves_with_noise_of_their_own(split):
    mesh = prepare_mesh(*torus(160, 80)).mesh
    side = mesh.vertices @ ([1.0, 0.0, 0.0] if split == "by place" else [0.5, 0.7, -0.3]) < 0.0
    quiet, loud = (
        add_plain_noise(mesh, "gaussian-normal", 0.05, 1),
        add_plain_noise(mesh, "gaussian-normal", 0.2, 2),
    )
    both = mesh.with_vertices(np.where(side[:, None], quiet, loud))
    noise = estimate_noise(both)
    assert noise.is_uneven and noise.character.kind == "uneven"
    assert noise.lowest == pytest.approx(0.05, rel=0.25)
    assert noise.highest == pytest.approx(0.2, rel=0.25)
    assert noise.lowest < noise.mean_edges < noise.highest
    assert noise.low <= noise.lowest
    assert noise.highest <= noise.high
    if split == "by place":
        field = estimate_regions(both) / mesh.mean_edge_length
        assert np.median(field[side]) == pytest.approx(0.05, rel=0.2)
        assert np.median(field[~side]) == pytest.approx(0.2, rel=0.2)


@pytest.mark.parametrize(("level", "fraction"), [(0.5, 0.5), (0.4, 0.1)])
def test_impulses_are_told_by_their_tail(level, fraction):
    mesh, amount = with_noise(torus(160, 80), level, "impulsive", fraction=fraction)
    noise = estimate_noise(mesh)
    assert noise.tail > 0.02
    rms = amount * np.sqrt(fraction) / mesh.mean_edge_length
    assert noise.rms_edges == pytest.approx(rms, rel=0.2)
    assert noise.mean_edges < noise.rms_edges
    assert noise.low < rms < noise.high
    assert not noise.is_negligible
    assert (noise.character.kind, noise.character.outliers) == ("impulsive", 0.0)


@settings(max_examples=8)
@given(st.integers(-60, 60), st.floats(-100.0, 100.0), st.sampled_from([0.0, 0.05, 0.4]))
def test_size_and_place_do_not_matter(power, shift, level):
    vertices = with_noise(torus(30, 16), level)[0].vertices
    faces = torus(30, 16)[1]
    here = estimate_noise(prepare_mesh(vertices, faces).mesh)
    there = estimate_noise(prepare_mesh((vertices + shift) * 2.0**power, faces).mesh)
    assert there.mean_edges == pytest.approx(here.mean_edges, rel=1e-6, abs=1e-9)
    assert there.tail == here.tail
    doubled = estimate_noise(prepare_mesh(vertices * 2.0**power, faces).mesh)
    assert doubled.mean_edges == here.mean_edges
    assert doubled.file_units == here.file_units * 2.0**power


@given(st.integers(0, 2**32 - 1), st.integers(3, 7), st.integers(3, 7), st.floats(0.0, 3.0))
def test_any_small_mesh_has_an_estimate(seed, rows, columns, level):
    vertices, faces = grid(rows, columns)
    draw = np.random.default_rng(seed)
    vertices = vertices + level * draw.standard_normal(vertices.shape)
    noise = estimate_noise(prepare_mesh(vertices, faces[draw.random(len(faces)) < 0.9]).mesh)
    assert 0.0 <= noise.low <= noise.mean_edges <= noise.high < np.inf
    assert 0.0 <= noise.lowest <= noise.highest < np.inf
    assert 0.0 <= noise.tail <= 1.0
    assert noise.mean_edges <= noise.rms_edges < np.inf
