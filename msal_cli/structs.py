"""Data classes that take next to no time to make.

``dataclasses`` writes the methods of each class as source and compiles it, half a millisecond each,
and a run makes more than a hundred: a fifth of the time of a small mesh.  Here all classes share
the same methods, which look the fields up.  The fields are those of ``dataclasses``, whose
``fields``, ``replace`` and ``asdict`` know these classes too.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, TypeVar, dataclass_transform

Class = TypeVar("Class", bound=type)


@dataclass_transform(field_specifiers=(dataclasses.field,))
def dataclass(
    *,
    frozen: bool = False,
    eq: bool = True,
    repr: bool = True,
    slots: bool = False,
    kw_only: bool = False,
) -> Callable[[Class], Class]:
    """As ``dataclasses.dataclass``."""
    methods: dict[str, Any] = {"__init__": _init}
    if repr:
        methods["__repr__"] = _repr
    if eq:
        methods |= {"__eq__": _equals, "__hash__": _hash if frozen else None}
    if frozen:
        methods |= {"__setattr__": _refuse, "__delattr__": _refuse}
    if slots:
        methods |= {"__getstate__": _get_state, "__setstate__": _set_state}

    def make(cls: Class) -> Class:
        made: Any = dataclasses.dataclass(
            init=False, repr=False, eq=False, match_args=False, slots=slots, kw_only=kw_only
        )(cls)
        for name, method in methods.items():
            if name not in made.__dict__:
                setattr(made, name, method)
        return made  # type: ignore[no-any-return]

    return make


def about(description: str) -> dict[str, str]:
    """The metadata of a field: what the JSON Schema says of it."""
    return {"description": description}


def required(description: str) -> Any:
    """A field that has to be given, with its description."""
    return dataclasses.field(metadata=about(description))


def known(description: str, default: Any = None) -> Any:
    """A field with its description; None, or ``default``, if not known."""
    return dataclasses.field(default=default, metadata=about(description))


@functools.cache
def _parameters(cls: Any) -> tuple[list[str], int, dict[str, Any], dict[str, Any]]:
    """The names of the fields, how many of them may be given without a name, the defaults, and what
    makes others."""
    fields = dataclasses.fields(cls)
    names = [field.name for field in sorted(fields, key=lambda field: bool(field.kw_only))]
    given = {field.name: (field.default, field.default_factory) for field in fields}
    missing = dataclasses.MISSING
    return (
        names,
        sum(not field.kw_only for field in fields),
        {name: default for name, (default, _) in given.items() if default is not missing},
        {name: factory for name, (_, factory) in given.items() if factory is not missing},
    )


def _init(self: Any, *values: Any, **named: Any) -> None:
    names, n_positional, defaults, factories = _parameters(type(self))  # type: ignore[arg-type]
    given, n_given = named, len(values) + len(named)
    if values:
        given = dict(zip(names, values, strict=False)) | named
    is_wrong = len(values) > n_positional or len(given) < n_given
    if len(given) < len(names):
        given = defaults | given
        for name in factories.keys() - given.keys():
            given[name] = factories[name]()
    try:
        for name in names:
            _set(self, name, given[name])
    except KeyError:
        is_wrong = True
    if is_wrong or len(given) > len(names):
        raise TypeError(
            f"{type(self).__name__}({', '.join(names)}) got {len(values)} values and "
            f"{', '.join(named) or 'no keywords'}"
        )
    if hasattr(self, "__post_init__"):
        self.__post_init__()


_set = object.__setattr__


def _repr(self: Any) -> str:
    names = [field.name for field in dataclasses.fields(self) if field.repr]
    shown = ", ".join(f"{name}={getattr(self, name)!r}" for name in names)
    return f"{type(self).__qualname__}({shown})"


def _equals(self: Any, other: object) -> bool:
    return type(other) is type(self) and _compared(self) == _compared(other)


def _hash(self: Any) -> int:
    return hash(_compared(self))


def _compared(self: Any) -> tuple[Any, ...]:
    names = _compared_names(type(self))  # type: ignore[arg-type]
    return tuple([getattr(self, name) for name in names])


@functools.cache
def _compared_names(cls: Any) -> list[str]:
    return [field.name for field in dataclasses.fields(cls) if field.compare]


def _refuse(self: Any, name: str, value: object = None) -> None:
    raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")


def _get_state(self: Any) -> list[Any]:
    return [getattr(self, field.name) for field in dataclasses.fields(self)]


def _set_state(self: Any, state: list[Any]) -> None:
    for field, value in zip(dataclasses.fields(self), state, strict=True):
        object.__setattr__(self, field.name, value)
