"""Keyword arguments as the settings of a job: what the options of the command are in Python."""

from __future__ import annotations

import difflib
import inspect
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any, get_args

from msal_cli.api.names import Assumption, Encoding, Keep, MethodParameters, Precision, Preference
from msal_cli.errors import UsageError
from msal_cli.job.settings import (
    ADAPTIVE,
    AUTO,
    NEGLIGIBLE,
    SELF_INTERSECTIONS,
    Settings,
    writable_formats,
)

DEFAULT_METHOD = "msal"

_WORDS = {
    "prefer": get_args(Preference),
    "keep": get_args(Keep),
    "assume": get_args(Assumption),
}
_STRONGEST = 2.0
_LEAST_BUDGET = 1.0


def build_settings(
    method: str | None,
    parameters: Mapping[str, Any],
    *,
    prefer: str | None,
    keep: str | None,
    strength: float | None,
    budget: float | None,
    assume: str | None,
    max_move: str | float | None,
    locks: Sequence[str],
    weights: str | None,
    despike: bool | None,
    min_noise: str | float | None,
    unit: str | None,
    intersections: bool = False,
    to: str | None = None,
    encoding: str = "same",
    precision: str = "same",
    strict: bool = False,
    format: str | None = None,
) -> Settings:
    """The settings; ``to`` and what follows are for files.

    Raises
    ------
    UsageError
        for arguments that do not go together, and values that are not allowed.
    """
    from msal_cli.codecs.detection import readable_suffixes
    from msal_cli.job.constraints import BOUNDARY, parse_lock

    wishes = {
        "prefer": prefer,
        "keep": keep,
        "strength": strength,
        "budget": budget,
        "assume": assume,
    }
    given = {name: value for name, value in wishes.items() if value is not None}
    name, values = _choose_method(method, parameters, given)
    if weights is not None:
        _refuse_without_data_term(name, values)
    return Settings(
        method=name,
        parameters=values,
        max_move=None if max_move is None else length_text(max_move, "max_move", unit),
        lock=tuple(str(parse_lock(one, "lock") or BOUNDARY) for one in locks),
        weights=weights,
        min_noise=min_noise
        if min_noise is None or min_noise == NEGLIGIBLE
        else length_text(min_noise, "min_noise", unit),
        despike=despike,
        checks=(SELF_INTERSECTIONS,) if intersections else (),
        to=_format_word(to, "to", writable_formats),
        encoding=_word("encoding", encoding, get_args(Encoding)),
        precision=_word("precision", precision, get_args(Precision)),
        strict=strict,
        format=_format_word(format, "format", readable_suffixes),
    )


def _word(name: str, word: str, words: Sequence[str]) -> str:
    if word not in words:
        raise _refusal(name, word, " | ".join(words))
    return word


def _format_word(word: str | None, name: str, known: Callable[[], tuple[str, ...]]) -> str | None:
    """A format without dot in lower case; UsageError for one that is not among the known ones."""
    if word is None:
        return None
    words = [one.lstrip(".") for one in known()]
    return _word(name, word.lower().lstrip("."), words)


def merge_parameters(
    parameters: Mapping[str, Any] | None, more: Mapping[str, Any], function: Callable[..., Any]
) -> dict[str, Any]:
    """The parameters of a method; UsageError for one that is given twice, and for a keyword in
    ``more`` that neither ``function`` nor any method has."""
    own = inspect.signature(function).parameters
    known = {name.casefold(): name for name in (*own, *MethodParameters.__annotations__)}
    for name in more:
        if name not in known.values():
            close = difflib.get_close_matches(name.casefold(), known, n=1)
            raise UsageError(
                f"{function.__name__} has no argument {name!r}",
                hint=f"did you mean {known[close[0]]}?"
                if close
                else f"see help(msal_cli.{function.__name__}), and msal_cli.list_methods() for "
                "the parameters of methods",
            )
    twice = sorted((parameters or {}).keys() & more.keys())
    if twice:
        raise UsageError(f"{twice[0]} is given twice", hint="give it once")
    return {**(parameters or {}), **more}


def length_text(value: str | float, name: str, unit: str | None) -> str:
    """A length as settings have it: ``"0.3e"`` in mean edge lengths, a number in file units."""
    from msal_cli.job.constraints import parse_length

    text = value if isinstance(value, str) else repr(to_number(value, name))
    return str(parse_length(text, name, unit))


def to_number(value: Any, name: str) -> float:
    """A number for an argument; UsageError, which names it, for what is none."""
    try:
        return float(value)
    except (TypeError, ValueError):
        raise UsageError(f"{name} is {value!r}, and must be a number") from None


def to_whole_number(value: Any, name: str) -> int:
    """A whole number for an argument; UsageError, which names it, for what is none."""
    try:
        return operator.index(value)
    except TypeError:
        raise UsageError(f"{name} is {value!r}, and must be a whole number") from None


def _choose_method(
    method: str | None, parameters: Mapping[str, Any], wishes: dict[str, Any]
) -> tuple[str, dict[str, Any]]:
    """The method's name and all its parameters; for ``AUTO`` the wishes."""
    if wishes.keys() == {"assume"} and method in (None, ADAPTIVE):
        _refuse_parameters(ADAPTIVE, parameters)
        return ADAPTIVE, _checked_wishes(wishes)
    if method == AUTO or (wishes and method is None):
        _refuse_parameters(AUTO, parameters)
        from msal_cli.auto import Wishes

        return AUTO, asdict(Wishes()) | _checked_wishes(wishes)
    if wishes:
        raise UsageError(
            f"{', '.join(wishes)}: this is for the automatic choice, and the method is {method!r}",
            hint="leave the method out, or give method='auto'; a parameter of a method that has "
            f"this name goes into parameters={{{next(iter(wishes))!r}: ...}}",
        )
    if method == ADAPTIVE or (method is None and not parameters):
        _refuse_parameters(ADAPTIVE, parameters)
        return ADAPTIVE, {}
    from msal_cli import methods

    found = methods.find(method or DEFAULT_METHOD)
    return found.name, found.validate(parameters)


def _refuse_parameters(method: str, parameters: Mapping[str, Any]) -> None:
    if parameters:
        raise UsageError(
            f"{', '.join(parameters)}: {method!r} chooses the parameters itself",
            hint="give a method, such as 'msal', or leave the parameters out",
        )


def _checked_wishes(wishes: dict[str, Any]) -> dict[str, Any]:
    """The wishes; UsageError for what is not allowed."""
    for name, words in _WORDS.items():
        if name in wishes:
            _word(name, wishes[name], words)
    checked = dict(wishes)
    for name, low, high in (
        ("strength", -_STRONGEST, _STRONGEST),
        ("budget", _LEAST_BUDGET, float("inf")),
    ):
        if name in wishes:
            checked[name] = to_number(wishes[name], name)
            if not low <= checked[name] <= high:
                span = f"{low:g} to {high:g}" if name == "strength" else f"{low:g} or more"
                raise _refusal(name, wishes[name], span)
    return checked


def _refusal(name: str, value: object, allowed: str) -> UsageError:
    return UsageError(f"{name} = {value!r} is not allowed", hint=f"allowed: {allowed}")


def _refuse_without_data_term(name: str, values: Mapping[str, Any]) -> None:
    """Refuse weights where nothing pulls a vertex back to where it was scanned; UsageError."""
    from msal_cli import methods

    if name in (AUTO, ADAPTIVE) or methods.find(name).has_data_term(values):
        return
    raise UsageError(
        f"weights need a pull to the scanned positions, and {name} has none with these parameters",
        hint="choose msal, or a schedule other than 'plain'",
    )
