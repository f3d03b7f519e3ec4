"""Figures against those of an earlier run."""

from __future__ import annotations

import pytest

from msal_cli.job.comparison_record import ComparisonRecord
from msal_cli.report import baseline


def record(**figures):
    return ComparisonRecord("a", "b", **figures)


def broken(now, then, tolerance=0.02):
    return [
        one.expression for one in baseline.compare_with_baseline(now, then, tolerance) if one.broken
    ]


@pytest.mark.parametrize(
    ("now", "is_broken"), [(9.0, False), (10.0, False), (10.19, False), (10.21, True)]
)
def test_a_figure_may_grow_by_the_tolerance(now, is_broken):
    found = broken(record(vertex_error_percent=now), record(vertex_error_percent=10.0))
    assert bool(found) == is_broken
    assert found in ([], ["vertex_error_percent > 10.2"])


@pytest.mark.parametrize(("now", "is_broken"), [(-1.0, False), (1.0, False), (-1.1, True)])
def test_changes_count_by_their_size(now, is_broken):
    found = broken(record(volume_change_percent=now), record(volume_change_percent=1.0))
    assert bool(found) == is_broken


def test_nothing_is_allowed_to_appear_where_nothing_was():
    assert broken(record(flipped_faces=1), record(flipped_faces=0)) == ["flipped_faces > 1e-06"]
    assert broken(record(flipped_faces=0), record(flipped_faces=0)) == []


def test_a_figure_that_is_not_known_any_more_is_broken_and_a_new_one_is_not():
    (one,) = baseline.compare_with_baseline(record(), record(hausdorff_edges=1.0), 0.02)
    assert (one.broken, one.decided) == (True, False)
    assert "not known" in one.reason
    assert broken(record(hausdorff_edges=1.0), record()) == []
    assert baseline.compare_with_baseline(record(hausdorff_edges=1.0), None, 0.02) == ()


def test_partners_are_found_by_path_or_by_its_end():
    earlier = {"old/x/a.ply": 1, "old/y/a.ply": 2, "old/b.ply": 3}
    assert baseline.partner("old/x/a.ply", earlier) == 1
    assert baseline.partner("y/a.ply", earlier) == 2
    assert baseline.partner("a.ply", earlier) is None
    assert baseline.partner("b.ply", earlier) == 3
    assert baseline.partner("c.ply", earlier) is None
    assert baseline.missing(["x/a.ply", "b.ply"], earlier) == ["old/y/a.ply"]
