"""Readings of a roughness: noise or texture, and what follows if either is assumed."""

from __future__ import annotations

import dataclasses

import pytest

from msal_cli.analysis.noise_estimate import NOISE, TEXTURE, Reading, estimate_noise
from msal_cli.mesh import prepare_mesh
from tests.shapes import torus


@pytest.fixture(scope="module")
def clean():
    return estimate_noise(prepare_mesh(*torus(60, 30)).mesh)


def read_as(noise, probability, level=0.08):
    readings = (Reading(NOISE, level, probability), Reading(TEXTURE, 0.0, 1.0 - probability))
    return dataclasses.replace(noise, readings=readings)


@pytest.mark.parametrize(
    ("probability", "is_unsure"), [(0.0, False), (0.1, False), (0.2, True), (0.95, False)]
)
def test_unsure_is_where_neither_kind_is_probable(clean, probability, is_unsure):
    assert read_as(clean, probability).is_unsure == is_unsure
    both = (Reading(NOISE, 0.02, 0.5), Reading(NOISE, 0.05, 0.45), Reading(TEXTURE, 0.0, 0.05))
    assert not dataclasses.replace(clean, readings=both).is_unsure


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
