"""Our quick ``dataclass`` beside the standard library's: the same classes, seen from outside."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from dataclasses import field

import pytest

from msal_cli.dataclass import dataclass as quick

NAN = float("nan")


def made(decorate, **options):
    @decorate(**options)
    class Base:
        """A base."""

        a: int
        b: list = field(default_factory=list)

    @decorate(**options)
    class Point(Base):
        """A point."""

        c: float = 1.5
        d: str = field(default="d", compare=False)
        e: str = field(default="e", repr=False)
        f: int = field(default=7, init=False)

    return Point


@dataclasses.dataclass(frozen=True, slots=True)
class Plain:
    """Standard, to be compared with."""

    a: int
    b: str = "b"


@quick(frozen=True, slots=True)
class Quick:
    """Ours."""

    a: int
    b: str = "b"


@pytest.fixture(
    params=[
        {"frozen": True},
        {"frozen": True, "eq": False},
        {"frozen": True, "slots": True},
        {"eq": False},
        {},
    ],
    ids=str,
)
def options(request):
    return request.param


@pytest.mark.parametrize(
    "tried",
    [
        lambda cls: cls(1),
        lambda cls: cls(1, [2], 3.0, "four", "five"),
        lambda cls: cls(a=1, e="x"),
        lambda cls: cls(1, [NAN], NAN),
        lambda cls: cls(1, d="not compared") == cls(1),
        lambda cls: cls(1) == cls(2),
        lambda cls: cls(1, c=NAN) == cls(1, c=NAN),
        lambda cls: cls(1) == 1,
        lambda cls: cls(1).b is cls(1).b,
        lambda cls: len({cls(1, ()): 1, cls(1, (), d="x"): 2}),
        lambda cls: cls.__hash__ is None,
        lambda cls: [getattr(cls(1), one.name) for one in dataclasses.fields(cls)],
        lambda cls: hasattr(cls(1), "__dict__"),
        lambda cls: cls.__slots__,
        lambda cls: cls.__match_args__,
        lambda cls: dataclasses.replace(cls(1), c=2.0),
        lambda cls: dataclasses.replace(cls(1), f=2),
        lambda cls: dataclasses.asdict(cls(1, [2])),
        lambda cls: [one.name for one in dataclasses.fields(cls)],
        lambda cls: dataclasses.is_dataclass(cls),
        lambda cls: setattr(cls(1), "a", 2),
        lambda cls: delattr(cls(1), "a"),
        lambda cls: copy.copy(cls(1, [2])),
        lambda cls: copy.deepcopy(cls(1, [2])),
        lambda cls: cls(),
        lambda cls: cls(1, [], 1.0, "d", "e", 6),
        lambda cls: cls(1, a=1),
        lambda cls: cls(1, x=1),
        lambda cls: cls(1, f=1),
        lambda cls: sorted([cls(1), cls(2)]),
    ],
)
def test_it_makes_what_the_standard_one_makes(options, tried):
    def outcome(decorate):
        try:
            result = tried(made(decorate, **options))
        except Exception as error:
            return type(error)
        return repr(result)

    assert outcome(quick) == outcome(dataclasses.dataclass)


def test_objects_with_slots_go_through_pickles():
    for one in (Quick(3, "x"), Plain(3, "x")):
        back = pickle.loads(pickle.dumps(one))
        assert back == one and repr(back) == repr(one) and not hasattr(back, "__dict__")
        with pytest.raises(dataclasses.FrozenInstanceError):
            back.a = 4


def test_what_a_class_says_itself_stays():
    @quick(frozen=True)
    class Odd:
        """One with its own words."""

        a: int

        def __repr__(self):
            return "odd"

        def __post_init__(self):
            object.__setattr__(self, "a", self.a + 1)

        def __eq__(self, other):
            return True

    assert repr(Odd(1)) == "odd" and Odd(1).a == 2 and Odd(1) == Odd(5)
