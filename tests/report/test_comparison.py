"""Comparisons against those of an earlier run; the texts are in ``golden``."""

from __future__ import annotations

import json

import pytest

from msal_cli.errors import FormatError
from msal_cli.job.records import ComparisonRecord, Reference
from msal_cli.report.comparison import (
    compare_with_baseline,
    find_partner,
    list_missing,
    read_comparisons,
)
from msal_cli.report.data import json_bytes, plain_record, render_json
from tests.report.made import RUN, failed, written


def record(**figures):
    return ComparisonRecord("a", "b", **figures)


def broken(now, then, tolerance=0.02):
    return [gate.expression for gate in compare_with_baseline(now, then, tolerance) if gate.broken]


@pytest.mark.parametrize(
    ("now", "is_broken"), [(9.0, False), (10.0, False), (10.19, False), (10.21, True)]
)
def test_a_figure_may_grow_by_the_tolerance(now, is_broken):
    found = broken(record(vertex_error_percent=now), record(vertex_error_percent=10.0))
    assert found == (["vertex_error_percent > 10.2"] if is_broken else [])


@pytest.mark.parametrize(("now", "is_broken"), [(-1.0, False), (1.0, False), (-1.1, True)])
def test_changes_count_by_their_size(now, is_broken):
    found = broken(record(volume_change_percent=now), record(volume_change_percent=1.0))
    assert bool(found) == is_broken


def test_a_figure_that_is_not_known_any_more_is_broken_and_a_new_one_is_not():
    (gate,) = compare_with_baseline(record(), record(hausdorff_edges=1.0), 0.02)
    assert (gate.broken, gate.decided) == (True, False)
    assert "not known" in gate.reason
    assert broken(record(hausdorff_edges=1.0), record()) == []
    assert compare_with_baseline(record(hausdorff_edges=1.0), None, 0.02) == ()


def test_partners_are_found_by_path_or_by_its_end():
    earlier = {"old/x/a.ply": 1, "old/y/a.ply": 2, "old/b.ply": 3}
    names = ["old/x/a.ply", "y/a.ply", "a.ply", "b.ply", "c.ply"]
    assert [find_partner(name, earlier) for name in names] == [1, 2, None, 3, None]
    assert list_missing(["x/a.ply", "b.ply"], earlier) == ["old/y/a.ply"]


def test_a_baseline_comes_back_from_one_pair_from_many_and_from_a_report():
    pair, bad = record(hausdorff=0.5), ComparisonRecord("a", "c", error=failed().error)
    assert read_comparisons(json_bytes(plain_record(pair)), "x") == {"b": pair}
    many = {"schema": pair.schema, "records": [plain_record(one) for one in (pair, bad)]}
    assert read_comparisons(json_bytes(many), "x") == {"b": pair}
    reference = Reference("t.ply", hausdorff_edges=0.5)
    records = [written("a.ply", reference=reference), written("b.ply"), failed()]
    assert read_comparisons(render_json(RUN, records), "x") == {"out/a.ply": reference}


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"{", "it is not JSON"),
        (b'{"schema": "x"}', "missing or unsupported schema"),
        (json.dumps({"schema": ComparisonRecord.schema, "records": 3}).encode(), "no list"),
        (json.dumps({"schema": ComparisonRecord.schema, "records": [3]}).encode(), "cannot be int"),
        (render_json(RUN, [written()]), "no file in it was measured"),
    ],
)
def test_what_is_no_baseline(content, reason):
    with pytest.raises(FormatError, match=reason) as caught:
        read_comparisons(content, "x.json")
    assert caught.value.path == "x.json"
