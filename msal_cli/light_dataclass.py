"""A ``dataclass`` decorator whose classes share their methods, for a quick start.

``dataclasses.dataclass`` compiles six methods for each frozen class, which takes half a millisecond
for each of a hundred classes.  Here they are loops over the fields, and objects cost some
microseconds more.
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

    def dataclass(*, frozen=False, eq=True, slots=False, kw_only=False):
        """Like ``dataclasses.dataclass``; ``fields``, ``replace`` and ``asdict`` work as usual."""
        given = {"slots": slots, "kw_only": kw_only, "init": False, "repr": False, "eq": False}
        methods = {"__init__": _initialize, "__repr__": _show}
        if eq:
            methods |= {"__eq__": _is_equal, "__hash__": _hash if frozen else None}
        if frozen:
            methods |= {"__setattr__": _refuse, "__delattr__": _refuse, "__setstate__": _restore}

        def build(cls):
            if cls.__doc__ is None:
                cls.__doc__ = cls.__name__  # else the library inspects its signature: slow
            # ``slots`` makes a new class, so the methods are set after this call.
            made = dataclasses.dataclass(cls, **given)
            for name, method in methods.items():
                if name not in vars(cls):
                    setattr(made, name, method)
            return made

        return build


@functools.cache
def _fields_of(kind: Any) -> tuple[dict[str, dataclasses.Field[Any]], list[str]]:
    """The fields by name, and the names of the positional ones."""
    fields = {known.name: known for known in dataclasses.fields(kind)}
    return fields, [name for name, known in fields.items() if known.init and not known.kw_only]


def _initialize(self: Any, /, *values: Any, **given: Any) -> None:
    kind: Any = type(self)
    fields, positional = _fields_of(kind)
    if values:
        by_position = dict(zip(positional, values, strict=False))
        if len(by_position) < len(values) or by_position.keys() & given.keys():
            raise TypeError(f"{kind.__name__}() got too many values, or one of them twice")
        given.update(by_position)
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
    """The usual repr if it fits one line, else ``screen_repr``."""
    kind: Any = type(self)
    values = {name: getattr(self, name) for name, info in _fields_of(kind)[0].items() if info.repr}
    line = f"{kind.__qualname__}({', '.join(f'{key}={value!r}' for key, value in values.items())})"
    is_short = len(line) <= _SCREEN_WIDTH and "\n" not in line
    return line if is_short else screen_repr(kind.__name__, values)


def screen_repr(name: str, values: Mapping[str, Any]) -> str:
    """A repr with one line for each non-empty value, cut to one screen."""
    lines = []
    for key, value in values.items():
        if value is None or (isinstance(value, str | tuple | dict) and not value):
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
    """``__setstate__`` for pickle and copy: the state is a dict, or with slots a pair of dicts."""
    for part in state if isinstance(state, tuple) else (state,):
        for name, value in (part or {}).items():
            object.__setattr__(self, name, value)
