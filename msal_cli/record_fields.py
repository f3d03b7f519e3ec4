"""The fields of records, which the JSON Schema describes, and records as plain data: dicts, lists,
texts, numbers, as in JSON."""

import dataclasses
import functools
import math
import sys
import types
import typing
from collections.abc import Callable, Hashable, Mapping
from typing import Any, Literal

_MAX_SHARED = 24
"""Characters of the longest text that records share: formats and versions repeat in thousands."""

_PLAIN = frozenset({str, int, float, bool, type(None)})
"""What a record is made of in the end, and what needs no copy."""

Reader = Callable[[Any], Any]

_SCREEN_LINES, _SCREEN_WIDTH = 20, 100


def about(description: str) -> dict[str, str]:
    """The metadata of a field: what the JSON Schema says of it."""
    return {"description": description}


def required(description: str) -> Any:
    """A field that has to be given, with its description."""
    return dataclasses.field(metadata=about(description))


def known(description: str, default: Any = None) -> Any:
    """A field with its description; None, or ``default``, if not known."""
    return dataclasses.field(default=default, metadata=about(description))


class ScreenRepr:
    """A record whose ``repr`` fits one screen: what is not known is left out, the rest is cut."""

    __slots__ = ()

    def __repr__(self) -> str:
        facts = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}  # type: ignore[arg-type]
        return screen_repr(type(self).__name__, facts)


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


def as_data(record: Any) -> Any:
    """A record as plain dicts, lists, texts and numbers, ready for JSON.

    As ``dataclasses.asdict``, which also copies every number, in a fifth of the time.
    """
    kind = type(record)
    if kind in _PLAIN:
        return record
    if kind is tuple or kind is list:
        return kind(map(as_data, record))
    if kind is dict:
        return {key: as_data(value) for key, value in record.items()}
    names = _field_names(typing.cast(Hashable, kind))
    return {name: as_data(getattr(record, name)) for name in names} if names else record


@functools.cache
def _field_names(kind: Hashable) -> tuple[str, ...]:
    """Names of a record's fields; none for what is no record."""
    if not dataclasses.is_dataclass(kind):
        return ()
    return tuple(field.name for field in dataclasses.fields(kind))


def value_at(record: Any, path: str) -> Any:
    """The value of a field by its dotted path, such as ``volume.change_percent``; None where a
    part on the way is None."""
    for name in path.split("."):
        if record is None:
            return None
        record = getattr(record, name)
    return record


def from_data(kind: type[Any], data: Any) -> Any:
    """The record that ``as_data`` made ``data`` from; unknown fields are dropped.

    Raises TypeError if a field is missing, or has a value of another type.
    """
    if not isinstance(data, dict):
        raise TypeError(f"{kind.__name__} cannot be {type(data).__name__}")
    values: dict[str, Any] = {}
    for name, read in _field_readers(typing.cast(Hashable, kind)):
        if name in data:
            try:
                values[name] = read(data[name])
            except TypeError as error:
                raise TypeError(f"{name}: {error}") from None
    return kind(**values)


@functools.cache
def _field_readers(kind: Hashable) -> tuple[tuple[str, Reader], ...]:
    # Half a millisecond a call, and a manifest of 10,000 files makes 10,000.
    hints = typing.get_type_hints(kind)
    fields = dataclasses.fields(typing.cast("type[Any]", kind))
    return tuple((field.name, _build_reader(hints[field.name])) for field in fields)


def _build_reader(hint: Any) -> Reader:
    """The function that gives a value of plain data back the type of its field."""
    inner = typing.get_args(hint)
    origin = typing.get_origin(hint)
    if hint is Any:
        return lambda value: value
    if dataclasses.is_dataclass(hint):
        return functools.partial(from_data, typing.cast("type[Any]", hint))
    if origin is Literal:
        return functools.partial(_read_choice, inner)
    if origin in (typing.Union, types.UnionType):
        read = next(_build_reader(type_) for type_ in inner if type_ is not types.NoneType)
        return lambda value: None if value is None else read(value)
    if origin is tuple:
        reads = [_build_reader(type_) for type_ in inner if type_ is not Ellipsis]
        return functools.partial(_read_list, reads, inner[-1] is Ellipsis)
    if origin in (dict, Mapping):
        return functools.partial(_read_mapping, _build_reader(inner[1]))
    return functools.partial(_read_plain, hint)


def _read_plain(kind: type[Any], value: Any) -> Any:
    if kind is float:
        # Strict JSON has null for a number that is not finite.
        if value is None:
            return math.nan
        if type(value) is int:
            return value
    if type(value) is not kind:
        raise TypeError(f"it is {type(value).__name__}, not {kind.__name__}")
    return sys.intern(value) if kind is str and len(value) < _MAX_SHARED else value


def _read_choice(words: tuple[Any, ...], value: Any) -> Any:
    if value not in words:
        raise TypeError(f"it is none of {', '.join(words)}")
    return value


def _read_list(reads: list[Reader], is_any_length: bool, value: Any) -> Any:
    if not isinstance(value, list | tuple):
        raise TypeError(f"it is {type(value).__name__}, not a list")
    if is_any_length:
        return tuple(map(reads[0], value))
    if len(value) != len(reads):
        raise TypeError(f"it is no list of {len(reads)}")
    return tuple(read(item) for read, item in zip(reads, value, strict=True))


def _read_mapping(read: Reader, value: Any) -> Any:
    if not isinstance(value, dict):
        raise TypeError(f"it is {type(value).__name__}, not an object")
    return {sys.intern(str(name)): read(item) for name, item in value.items()}
