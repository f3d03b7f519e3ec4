"""Worst first, in the order that is told."""

from __future__ import annotations

import math

from msal_cli.job.records import Displacement, MeshRecord, Volume
from msal_cli.report.ranking import worst_first
from tests.report.made import failed, gated, written


def moved(name, most_edges, change=None):
    return written(
        name,
        displacement=Displacement(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, most_edges, 1),
        volume=None if change is None else Volume(1.0, 1.0, 0.0, change, True, ""),
    )


def test_the_order():
    planned = MeshRecord("planned", "planned")
    one = gated("one")
    two = gated("two", gates=one.gates[:1] * 2)
    records = [
        moved("little", 0.1),
        written("unknown", displacement=None),
        moved("shrunk", 0.5, -3.0),
        moved("grown", 0.5, 2.0),
        moved("nan", math.nan),
        planned,
        one,
        two,
        failed("failed"),
    ]
    assert [one.input for one in worst_first(records)] == [
        "failed", "two", "one", "planned", "nan", "shrunk", "grown", "little", "unknown",
    ]  # fmt: skip


def test_a_volume_that_means_nothing_does_not_count():
    open_one = moved("open", 0.5)
    volume = Volume(1.0, 2.0, 1.0, 100.0, False, "open")
    records = [moved("closed", 0.5, 1.0), written("open", volume=volume)]
    assert worst_first([open_one, *records])[0].input == "closed"
