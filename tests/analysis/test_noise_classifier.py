"""The trees that say what kind of noise a mesh has."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.analysis.noise_estimate import estimate_noise
from msal_cli.analysis.noise_estimate.classifier import (
    KIND_NAMES,
    LEVELS,
    MISSING,
    Forest,
    classify,
    load_classifier,
    measured_level,
)
from msal_cli.analysis.noise_estimate.evidence import gather_evidence
from msal_cli.analysis.noise_estimate.white import estimate_white
from msal_cli.mesh import prepare_mesh
from tests.analysis.test_noise_kinds import with_noise
from tests.shapes import torus


def make_forest():
    """Two trees: the first splits number 1 at 0.5, the second adds 7 to output 1 always."""
    return Forest(
        features=np.array([1, 0, 0, 0], dtype=np.int16),
        thresholds=np.array([0.5, 0, 0, 0], dtype=np.float32),
        left=np.array([1, 1, 2, 3], dtype=np.int32),
        right=np.array([2, 1, 2, 3], dtype=np.int32),
        values=np.array([0, -2, 3, 7], dtype=np.float32),
        roots=np.array([0, 3], dtype=np.int32),
        outputs=np.array([0, 1], dtype=np.int16),
        start=np.array([10.0, 20.0]),
        depth=1,
    )


@pytest.mark.parametrize(("number", "expected"), [(0.5, 8.0), (0.6, 13.0), (MISSING, 8.0)])
def test_a_forest_adds_the_leaves_of_each_output(number, expected):
    assert make_forest().evaluate(np.array([9.0, number])).tolist() == [expected, 27.0]


def test_the_level_of_a_kind_is_the_one_measured_for_it():
    numbers = np.full(len(LEVELS), MISSING)
    numbers[LEVELS.index("white")] = -3.0
    numbers[LEVELS.index("axis_colour")] = -1.0
    assert measured_level(numbers, "view", 0) == -3.0
    assert measured_level(numbers, "view", 1) == -1.0
    assert measured_level(numbers, "correlated", 2) == -3.0


@pytest.fixture(scope="module")
def white():
    """The numbers of a torus with white noise."""
    mesh, _ = with_noise(prepare_mesh(*torus(120, 60)).mesh, "gaussian-normal", 0.2)
    return gather_evidence(mesh, estimate_white(mesh)).numbers


def test_a_kind_that_is_not_possible_is_never_given(white):
    assert classify(white, set(KIND_NAMES)).kind == "white"
    others = set(KIND_NAMES) - {"white"}
    verdict = classify(white, others)
    assert verdict.kind in others
    assert verdict.noise == classify(white, set(KIND_NAMES)).noise


def test_the_numbers_are_those_that_the_trees_were_grown_on(white):
    trained = load_classifier()
    assert trained.kinds.features.max() < len(white)
    assert len(trained.kinds.start) == len(KIND_NAMES)
    assert trained.rings.features.max() < len(white)
    assert np.isfinite(white).all()


def test_an_exported_part_has_no_noise():
    """A plate with bars on it: whole coordinates, long triangles."""
    manifold3d = pytest.importorskip("manifold3d")
    solid = manifold3d.Manifold.cube((40, 20, 2))
    for x in range(3, 36, 6):
        solid += manifold3d.Manifold.cube((3, 14 - x % 4, 3)).translate((x, 3, 1))
        solid -= manifold3d.Manifold.cylinder(9, 1.2, 1.2, 24).translate((x + 4.4, 10, -1))
    mesh = solid.to_mesh64()
    vertices, faces = np.array(mesh.vert_properties)[:, :3], np.array(mesh.tri_verts)
    noise = estimate_noise(prepare_mesh(vertices, faces.astype(np.int32)).mesh)
    assert noise.is_negligible
    assert noise.mean_edges == 0.0
