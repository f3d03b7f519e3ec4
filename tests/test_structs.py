"""Data classes that are made quickly, against those of the standard library."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from dataclasses import KW_ONLY, field
from functools import partial

import pytest

from msal_cli.structs import dataclass


def declare(decorator, **options):
    @decorator(**options)
    class Base:
        """A class."""

        a: int
        b: list = field(default_factory=list)
        _: KW_ONLY
        c: str = field(default="c", repr=False, compare=False)

    @decorator(**options)
    class Inner(Base):
        """One that inherits."""

        d: int = 4

        def __post_init__(self):
            object.__setattr__(self, "b", [*self.b, self.a])

    return Inner


def outcome(function):
    try:
        return function()
    except (TypeError, AttributeError) as error:
        return type(error)


@dataclass(frozen=True, slots=True)
class Pair:
    """With slots, and in a module, so that it can be pickled."""

    first: int
    second: tuple[int, ...] = ()


@pytest.mark.parametrize("options", [{}, {"frozen": True}, {"eq": False}, {"repr": False}])
def test_they_are_as_those_of_the_library(options):
    def set_attribute(one):
        one.a = 7
        return one.a

    cases = [
        lambda kind: dataclasses.asdict(kind(1)),
        lambda kind: dataclasses.asdict(kind(1, [2], 3, c="x")),
        lambda kind: dataclasses.asdict(dataclasses.replace(kind(1), d=5, c="y")),
        lambda kind: [one.name for one in dataclasses.fields(kind)],
        lambda kind: kind(),
        lambda kind: kind(1, a=1),
        lambda kind: kind(1, [], 2, "c"),
        lambda kind: kind(1, e=2),
        lambda kind: kind(1) == kind(1, c="z"),
        lambda kind: kind(1) == kind(2),
        lambda kind: kind(1) == 1,
        lambda kind: outcome(lambda: hash(kind(1))) is TypeError,
        lambda kind: set_attribute(kind(1)),
        lambda kind: "a=1" in repr(kind(1)) and "c=" not in repr(kind(1)),
        lambda kind: kind(1).b is kind(1).b,
    ]
    for case in cases:
        ours, theirs = (declare(one, **options) for one in (dataclass, dataclasses.dataclass))
        assert outcome(partial(case, ours)) == outcome(partial(case, theirs))


def test_slots_are_copied_and_pickled():
    pair = Pair(1, (2, 3))
    assert not hasattr(pair, "__dict__")
    assert pickle.loads(pickle.dumps(pair)) == copy.deepcopy(pair) == pair
    with pytest.raises(dataclasses.FrozenInstanceError):
        pair.first = 2
