"""The k-d tree of a sample, and what a plan says."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from msal_cli.errors import TooLargeError
from msal_cli.kernels.tile_cut import count_labels, label_positions
from msal_cli.tiles.opening import build_tree
from msal_cli.tiles.plan import TilePlan
from tests.tiles.fakes import FakeMesh, open_fake
from tests.tiles.test_cut import make_grid


def count(points: np.ndarray, n_levels: int) -> np.ndarray:
    axes, thresholds = build_tree(points, n_levels)
    labels = label_positions(points, np.array(axes, np.uint64), np.array(thresholds))
    return count_labels(labels, 1 << n_levels)


def test_leaves_get_equal_shares():
    points = np.random.default_rng(0).normal(size=(4096, 3))
    assert (count(points, 6) == 64).all()


def test_nodes_are_split_across_the_longest_side_and_stray_points_do_not_count():
    points = np.random.default_rng(0).uniform(size=(1000, 3)) * [1, 10, 3]
    points[0] = [1e6, 0, 0]
    axes, thresholds = build_tree(points, 2)
    assert axes == [1, 1, 1]
    assert thresholds == pytest.approx([5, 2.5, 7.5], abs=0.5)


def test_a_coordinate_that_most_have_in_common_does_not_make_one_huge_tile():
    rng = np.random.default_rng(0)
    # A long wall with a few furnishings: nine in ten have y = 0.
    points = rng.uniform(size=(1000, 3)) * [1, 100, 1]
    points[:900, 1] = 0.0
    assert count(points, 4).max() <= 1.2 * 1000 / 16


@pytest.mark.parametrize("n", [0, 1, 5, 200])
def test_points_that_cannot_be_told_apart_share_a_leaf(n):
    assert sorted(count(np.zeros((n, 3)), 3).tolist()) == [0] * 7 + [n]


def test_minus_zero_is_zero():
    points = np.array([[0.0, 1, 0], [-0.0, 1, 0], [-1.0, 1, 0], [1.0, 1, 0]])
    axes, thresholds = build_tree(points, 1)
    labels = label_positions(points, np.array(axes, np.uint64), np.array(thresholds))
    assert labels[0] == labels[1]


def test_far_too_large_extents_are_split_all_the_same():
    points = np.array([[-1.7e308, 0, 0], [1.7e308, 0, 0], [1, 0, 0], [2, 0, 0]])
    assert count(points, 1).tolist() == [2, 2]


def test_a_plan_is_saved_and_read_again(monkeypatch, tmp_path):
    plan, scratch = open_fake(monkeypatch, tmp_path, make_grid(20))
    loaded = TilePlan.load(scratch)
    assert loaded is not None
    assert loaded.pieces == plan.pieces
    assert loaded.vertex_chunks == plan.vertex_chunks
    assert json.dumps(dataclasses.asdict(loaded)) == json.dumps(dataclasses.asdict(plan))
    assert plan.n_tiles == 8
    assert plan.vertex_chunks[-1] == (300, 400)
    assert plan.source["format"] is None


def test_a_sample_of_a_large_file_lies_all_over_it(monkeypatch, tmp_path):
    monkeypatch.setattr("msal_cli.tiles.opening._SAMPLE", 512)
    monkeypatch.setattr("msal_cli.tiles.opening._SAMPLE_PER_TILE", 16)
    for whole in (40, 0):
        monkeypatch.setattr("msal_cli.tiles.opening._READ_WHOLE", whole)
        plan, _ = open_fake(
            monkeypatch, tmp_path, make_grid(90), tile_vertices=600, chunk_vertices=700
        )
        assert plan.n_tiles == 16
        mesh = make_grid(90)
        axes = np.array(plan.split_axis, np.uint64)
        labels = label_positions(mesh.vertices, axes, np.array(plan.split_at))
        assert count_labels(labels, 16).max() < 1.5 * 8100 / 16


def test_vertices_that_cannot_be_numbered_are_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(FakeMesh, "n_vertices", 2**32 - 1)
    with pytest.raises(TooLargeError, match="4,294,967,294"):
        open_fake(monkeypatch, tmp_path, make_grid(5))
    assert not list(tmp_path.iterdir())
