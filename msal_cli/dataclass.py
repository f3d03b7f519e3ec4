"""``dataclass`` as in the standard library, at a tenth of the time.

The standard one writes and compiles up to six functions for every class, which takes 0.4 ms: for
the classes that one command needs, longer than the sweeps over a small mesh.  Here the classes
share a few functions.  Fields and defaults are still found by the standard library, so that its
``field``, ``fields``, ``replace``, ``asdict`` and ``is_dataclass`` work with these classes too.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import Field
from operator import attrgetter
from typing import TYPE_CHECKING, Any

Fields = tuple[Field[Any], ...]


def _dataclass(
    *, frozen: bool = False, eq: bool = True, slots: bool = False
) -> Callable[[type], type]:
    """A decorator for classes with annotations.

    Parameters
    ----------
    frozen : whether objects keep the values that they were made with.
    eq : whether objects with equal fields are equal; if they are frozen too, they have hashes.
    slots : whether objects have places for their fields instead of a dictionary.
    """

    def decorated(cls: type) -> type:
        own = set(cls.__dict__)
        cls = dataclasses.dataclass(init=False, repr=False, eq=False, slots=slots)(cls)
        fields = dataclasses.fields(cls)
        made: dict[str, Any] = {"__init__": _init(cls, fields), "__repr__": _repr}
        if eq:
            made |= _comparisons(fields, is_hashed=frozen)
        if frozen:
            made |= {"__setattr__": _refuse_to_set, "__delattr__": _refuse_to_delete}
        if frozen and slots:
            made |= {"__getstate__": _state, "__setstate__": _set_state}
        for name, function in made.items():
            if name not in own:
                setattr(cls, name, function)
        return cls

    return decorated


if TYPE_CHECKING:
    # Type checkers know what the standard one makes of a class.
    from dataclasses import dataclass as dataclass
else:
    dataclass = _dataclass

_set = object.__setattr__


def _init(cls: type, fields: Fields) -> Callable[..., None]:
    given = [one.name for one in fields if one.init]
    n_plain = len(given) if len(given) == len(fields) else -1
    names = frozenset(one.name for one in fields) if n_plain >= 0 else None
    defaults = {one.name: one.default for one in fields if one.default is not dataclasses.MISSING}
    is_continued = hasattr(cls, "__post_init__")

    def __init__(self: Any, *values: Any, **named: Any) -> None:  # noqa: N807
        if len(values) == n_plain and not named:
            for name, value in zip(given, values, strict=True):
                _set(self, name, value)
        elif not values and (known := defaults | named).keys() == names:
            for name, value in known.items():
                _set(self, name, value)
        else:
            for name, value in _bound(cls.__name__, fields, given, values, named):
                _set(self, name, value)
        if is_continued:
            self.__post_init__()

    return __init__


def _bound(
    kind: str,
    fields: Fields,
    given: list[str],
    values: tuple[Any, ...],
    named: dict[str, Any],
) -> Iterator[tuple[str, Any]]:
    """Names and values of the fields, with defaults for those that were not given."""
    if len(values) > len(given):
        raise TypeError(f"{kind} takes {len(given)} values, not {len(values)}")
    known = dict(zip(given, values, strict=False))
    if twice := known.keys() & named.keys():
        raise TypeError(f"{kind} got two values for {', '.join(sorted(twice))}")
    known |= named
    if unknown := known.keys() - set(given):
        raise TypeError(f"{kind} has no {', '.join(sorted(unknown))}")
    for one in fields:
        if one.name in known:
            yield one.name, known[one.name]
        elif one.default is not dataclasses.MISSING:
            yield one.name, one.default
        elif one.default_factory is not dataclasses.MISSING:
            yield one.name, one.default_factory()
        elif one.init:
            raise TypeError(f"{kind} needs {one.name}")


def _comparisons(fields: Fields, *, is_hashed: bool) -> dict[str, Any]:
    names = [one.name for one in fields if one.compare]
    read: Callable[[Any], Any] = attrgetter(*names) if names else lambda self: ()

    def __eq__(self: Any, other: object) -> bool:  # noqa: N807
        if other.__class__ is not self.__class__:
            return NotImplemented
        # In a tuple, what is the same object is equal, even if it is not a number.
        return (read(self),) == (read(other),)

    def __hash__(self: Any) -> int:  # noqa: N807
        return hash(read(self))

    return {"__eq__": __eq__, "__hash__": __hash__ if is_hashed else None}


def _repr(self: Any) -> str:
    shown = [one.name for one in dataclasses.fields(self) if one.repr]
    said = ", ".join([f"{name}={getattr(self, name)!r}" for name in shown])
    return f"{type(self).__qualname__}({said})"


def _refuse_to_set(self: Any, name: str, value: Any) -> None:
    raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")


def _refuse_to_delete(self: Any, name: str) -> None:
    raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")


# For pickles and copies of objects with slots, which would be filled in by assignment.


def _state(self: Any) -> list[Any]:
    return [getattr(self, one.name) for one in dataclasses.fields(self)]


def _set_state(self: Any, state: list[Any]) -> None:
    for one, value in zip(dataclasses.fields(self), state, strict=True):
        _set(self, one.name, value)
