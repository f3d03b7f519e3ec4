"""``dataclass`` of the standard library, for classes that share their methods.

The library compiles six methods for each frozen class, which takes half a millisecond, a hundred
times at each start.  Here they are loops over the fields: some microseconds for each object.
"""

import dataclasses
import functools
from collections.abc import Mapping
from dataclasses import field as field
from typing import TYPE_CHECKING, Any

_SCREEN_LINES, _SCREEN_WIDTH = 20, 100

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(cls=None, /, *, frozen=False, eq=True, repr=True, slots=False, kw_only=False):
        """As ``dataclasses.dataclass``, and with the other functions of that module."""
        if cls is None:
            given = {"frozen": frozen, "eq": eq, "repr": repr, "slots": slots, "kw_only": kw_only}
            return functools.partial(dataclass, **given)
        if cls.__doc__ is None:
            cls.__doc__ = cls.__name__  # the library would look for its signature
        plain = {"init": False, "repr": False, "eq": False}
        # With slots it is a class of its own, so the methods come after them.
        made = dataclasses.dataclass(cls, slots=slots, kw_only=kw_only, **plain)
        methods = {"__init__": _initialize}
        if repr:
            methods["__repr__"] = _show
        if eq:
            methods |= {"__eq__": _is_equal, "__hash__": _hash if frozen else None}
        if frozen:
            methods |= {"__setattr__": _refuse, "__delattr__": _refuse, "__setstate__": _restore}
        for name, method in methods.items():
            if name not in vars(cls):
                setattr(made, name, method)
        return made


@functools.cache
def _fields_of(kind: Any) -> tuple[dict[str, dataclasses.Field[Any]], list[str]]:
    """The fields by name, and the names of those that may be given by place."""
    fields = {known.name: known for known in dataclasses.fields(kind)}
    return fields, [name for name, known in fields.items() if known.init and not known.kw_only]


def _initialize(self: Any, /, *values: Any, **given: Any) -> None:
    kind: Any = type(self)
    fields, by_place = _fields_of(kind)
    if values:
        placed = dict(zip(by_place, values, strict=False))
        if len(placed) < len(values) or placed.keys() & given.keys():
            raise TypeError(f"{kind.__name__}() got too many values, or one of them twice")
        given.update(placed)
    n_unknown = len(given)
    for name, known in fields.items():
        if known.init and name in given:
            value = given[name]
            n_unknown -= 1
        elif known.default is not dataclasses.MISSING:
            value = known.default
        elif known.default_factory is not dataclasses.MISSING:
            value = known.default_factory()
        else:
            raise TypeError(f"{kind.__name__}() needs {name!r}")
        object.__setattr__(self, name, value)
    if n_unknown:
        raise TypeError(f"{kind.__name__}() has not all of {', '.join(given)}")
    if hasattr(kind, "__post_init__"):
        self.__post_init__()


def _compared(self: Any) -> list[Any]:
    kind: Any = type(self)
    return [getattr(self, name) for name, known in _fields_of(kind)[0].items() if known.compare]


def _is_equal(self: Any, other: Any) -> Any:
    return _compared(self) == _compared(other) if type(other) is type(self) else NotImplemented


def _hash(self: Any) -> int:
    return hash(tuple(_compared(self)))


def _show(self: Any) -> str:
    """As the library has it; what is longer than a line fits one screen."""
    kind: Any = type(self)
    facts = {name: getattr(self, name) for name, known in _fields_of(kind)[0].items() if known.repr}
    line = f"{kind.__qualname__}({', '.join(f'{name}={fact!r}' for name, fact in facts.items())})"
    is_short = len(line) <= _SCREEN_WIDTH and "\n" not in line
    return line if is_short else screen_repr(kind.__name__, facts)


def screen_repr(name: str, facts: Mapping[str, Any]) -> str:
    """A line for each fact that is known, as many as fit one screen."""
    lines = []
    for key, value in facts.items():
        if value is None or value in ("", (), {}):
            continue
        line = f"    {key}={value}" if isinstance(value, str) else f"    {key}={value!r}"
        line = " ".join(line.split("\n"))
        lines.append(line if len(line) <= _SCREEN_WIDTH else f"{line[: _SCREEN_WIDTH - 3]}...")
    if len(lines) > _SCREEN_LINES:
        lines[_SCREEN_LINES:] = [f"    ... and {len(lines) - _SCREEN_LINES} more"]
    return "\n".join([f"{name}(", *lines, ")"])


def _refuse(self: Any, name: str, *_: Any) -> None:
    raise dataclasses.FrozenInstanceError(f"{type(self).__name__}.{name} cannot change")


def _restore(self: Any, state: Any) -> None:
    """What pickle and copy give back: a dict, or with slots a pair of such."""
    for part in state if isinstance(state, tuple) else (state,):
        for name, value in (part or {}).items():
            object.__setattr__(self, name, value)
