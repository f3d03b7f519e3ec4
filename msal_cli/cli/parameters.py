"""``--set NAME=VALUE`` and its shortcuts, as the settled parameters of a method."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from msal_cli.methods import Method

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
    canonical = {spec.symbol: spec.name for spec in method.parameters if spec.symbol}
    canonical |= {spec.name: spec.name for spec in method.parameters}
    values: dict[str, str] = {}
    said: dict[str, str] = {}
    for words, word, value in given:
        name = canonical.get(word, word)
        one = method.settled({name: value})
        if name in values and one[name] != method.settled({name: values[name]})[name]:
            raise UsageError(
                f"{said[name]} and {words} give {name} two different values",
                hint="give it once",
            )
        values.setdefault(name, value)
        said.setdefault(name, words)
    return method.settled(values)
