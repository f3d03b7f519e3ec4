"""Dataclasses with shared methods beside those of the standard library."""

import copy
import dataclasses

import numpy as np
import pytest

from msal_cli import light_dataclass


def build(dataclass):
    @dataclass(frozen=True, slots=True)
    class Point:
        x: float
        y: float = 2.0

    @dataclass(frozen=True)
    class Shape(Point):
        names: list = dataclasses.field(default_factory=list, compare=False)
        secret: int = dataclasses.field(default=7, repr=False, kw_only=True)
        sums: float = dataclasses.field(default=0.0, init=False)

        def __post_init__(self):
            object.__setattr__(self, "sums", self.x + self.y)

    return Point, Shape


(POINT, OURS), (_, THEIRS) = build(light_dataclass.dataclass), build(dataclasses.dataclass)
CALLS = [((1.0,), {}), ((1.0, 3.0, ["a"]), {"secret": 8}), ((), {"y": 4.0, "x": 0.5})]
WRONG = [((), {}), ((1, 2, [], 8), {}), ((1,), {"x": 2}), ((1,), {"z": 2}), ((1,), {"sums": 2.0})]


def test_they_are_as_those_of_the_library():
    ours, theirs = ([kind(*values, **given) for values, given in CALLS] for kind in (OURS, THEIRS))
    assert [repr(one) for one in ours] == [repr(one) for one in theirs]
    assert [dataclasses.asdict(one) for one in ours] == [dataclasses.asdict(one) for one in theirs]
    assert [hash(one) for one in ours] == [hash(one) for one in theirs]
    assert ours[0] == OURS(1.0, names=["b"]) != OURS(1.0, secret=1) and ours[0] != theirs[0]
    assert dataclasses.replace(ours[0], x=2.0) == OURS(2.0) == copy.deepcopy(OURS(2.0))
    assert copy.copy(POINT(3)) == POINT(3) and not hasattr(POINT(3), "__dict__")
    assert "x=array([[0., 0." in repr(POINT(np.zeros((99, 9))))


@pytest.mark.parametrize("kind", [OURS, THEIRS])
def test_wrong_calls_and_changes_are_refused(kind):
    for values, given in WRONG:
        with pytest.raises(TypeError):
            kind(*values, **given)
    with pytest.raises(dataclasses.FrozenInstanceError):
        kind(1.0).x = 2.0
