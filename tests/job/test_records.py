"""Records become plain data and come back; errors survive pickling."""

from __future__ import annotations

import json
import pickle

import pytest

from msal_cli import errors
from msal_cli.job.plain_data import as_data, from_data
from msal_cli.job.records import (
    Displacement,
    Failure,
    InfoRecord,
    MeshRecord,
    MethodUsed,
    Seconds,
    Volume,
)


def test_a_record_survives_json():
    record = MeshRecord(
        input="a.ply",
        status="written",
        output="out/a.ply",
        volume=Volume(1.0, 0.9, -0.1, -10.0, True, ""),
        displacement=Displacement(*[0.5] * 8, moved_vertices=3),
        method=MethodUsed("msal", {"K": 0.5, "iterations": 4}),
        seconds=Seconds(read=1.0, total=2.0),
        warnings=("one", "two"),
        error=Failure("E_FORMAT", "broken", "mend it", "line 3"),
    )
    assert from_data(MeshRecord, json.loads(json.dumps(as_data(record)))) == record
    # Unknown fields of later versions are dropped.
    assert from_data(MeshRecord, as_data(record) | {"from_the_future": 1}) == record
    info = InfoRecord("a.ply", bounds=((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), polygon_sizes={"3": 7})
    assert from_data(InfoRecord, json.loads(json.dumps(as_data(info)))) == info


def all_errors(kind=errors.MsalError):
    yield kind
    for child in kind.__subclasses__():
        yield from all_errors(child)


@pytest.mark.parametrize("kind", sorted(set(all_errors()), key=lambda kind: kind.__name__))
def test_errors_survive_pickling_and_stand_in_the_tree(kind):
    error = kind("what", where="vertex 3", hint="do this", path="a.ply", code="E_OTHER")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind
    assert vars(again) == vars(error)
    assert str(again) == "what"
    assert kind.__name__ in errors.__doc__
    assert kind("what").code.startswith("E_")
