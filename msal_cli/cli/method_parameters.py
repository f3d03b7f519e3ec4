"""``--set NAME=VALUE`` and its shortcuts, as the settled parameters of a method."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from msal_cli.methods import Method, ParameterSpec

Given = tuple[str, str, str]
"""The option as the user wrote it (for messages), the parameter's name or symbol, the value."""


def assignment(text: str) -> Given:
    """The parts of a ``--set``; UsageError if it is no ``NAME=VALUE``."""
    name, sign, value = text.partition("=")
    if not sign or not name.strip() or not value.strip():
        raise UsageError(f"--set {text} is not NAME=VALUE", hint="for example: --set iterations=4")
    return f"--set {text}", name.strip(), value.strip()


def settled(method: Method, given: Iterable[Given]) -> dict[str, Any]:
    """Every parameter of ``method``, with those that the user gave in their place.

    Raises
    ------
    UsageError
        for an unknown name, a value that is not allowed, or one parameter with two values.
    """
    values: dict[str, Any] = {}
    said: dict[str, str] = {}
    for words, word, value in given:
        spec = _spec(method, words, word)
        one = spec.validate(value)
        if values.setdefault(spec.name, one) != one:
            raise UsageError(
                f"{said[spec.name]} and {words} give {spec.name} two different values",
                hint="give it once",
            )
        said.setdefault(spec.name, words)
    return method.validate(values)


def _spec(method: Method, words: str, word: str) -> ParameterSpec:
    """The parameter that ``word`` names; for a shortcut the refusal says which methods have it."""
    try:
        return method.spec(word)
    except UsageError:
        from msal_cli import methods

        others = [
            name
            for name in methods.names()
            if any(word == spec.name for spec in methods.find(name).parameters)
        ]
        if words.startswith("--set") or not others:
            raise
        raise UsageError(
            f"{words} does not go with {method.name}, which has no parameter '{word}'",
            hint=f"methods that have it: {', '.join(others)}",
        ) from None
