"""Totals count what happened; plain data is strict JSON data."""

from __future__ import annotations

import json

import numpy as np
import pytest

from msal_cli.job.records import MeshRecord, Volume
from msal_cli.report.document import plain, totals
from tests.report.made import failed, written


def test_totals_count_by_status_and_leave_out_what_earlier_runs_did():
    records = [
        written("a"),
        written("b", vertices=10, status="unchanged"),
        written("c", status="up-to-date"),
        MeshRecord("d", "planned"),
        failed("e"),
    ]
    sums = totals(records)
    assert (sums.files, sums.written, sums.unchanged, sums.up_to_date) == (5, 1, 1, 1)
    assert (sums.planned, sums.failed) == (1, 1)
    assert sums.vertices == 35957
    assert sums.work_seconds == pytest.approx(1.9)


def test_the_volume_spread_is_over_valid_volumes_only():
    def volume(percent, valid=True):
        return Volume(1.0, 1.0, 0.0, percent, valid, "" if valid else "open")

    changes = [-3.0, 1.0, -0.5]
    records = [written(str(one), volume=volume(one)) for one in changes]
    records.append(written("open", volume=volume(-99.0, valid=False)))
    records.append(written("flat", volume=volume(None)))
    spread = totals(records).volume_change_percent
    assert (spread.files, spread.lowest, spread.median, spread.highest) == (3, -3.0, -0.5, 1.0)
    assert totals([failed()]).volume_change_percent is None


def test_plain_data():
    made = plain(
        {"a": float("nan"), "b": (1, float("-inf")), "c": "x\udcff", "d": True, 3: None}
        | {"n": np.float64(1.5), "i": np.int32(7), "t": np.bool_(True), "z": np.float32("nan")}
    )
    assert made == {
        "a": None,
        "b": [1, None],
        "c": "x\\udcff",
        "d": True,
        "3": None,
        "n": 1.5,
        "i": 7,
        "t": True,
        "z": None,
    }
    assert {type(made["n"]), type(made["i"]), type(made["t"])} == {float, int, bool}
    json.dumps(made, allow_nan=False)


def test_what_is_no_data_is_refused():
    with pytest.raises(TypeError, match="object"):
        plain([object()])
