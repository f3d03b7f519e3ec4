"""``--set NAME=VALUE`` and its shortcuts, as all parameters of a method."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from msal_cli.job.records import MeshRecord
    from msal_cli.methods import Method, ParameterSpec

Given = tuple[str, str, str]
"""The option as the user wrote it (for messages), the parameter's name or symbol, the value."""


def parse_assignment(text: str) -> Given:
    """The parts of a ``--set``; UsageError if it is no ``NAME=VALUE``."""
    name, sign, value = text.partition("=")
    if not sign or not name.strip() or not value.strip():
        raise UsageError(f"--set {text} is not NAME=VALUE", hint="for example: --set iterations=4")
    return f"--set {text}", name.strip(), value.strip()


def resolve(method: Method, given: Iterable[Given]) -> dict[str, Any]:
    """Every parameter of ``method``, with those that the user gave in their place.

    Raises
    ------
    UsageError
        for an unknown name, a value that is not allowed, or one parameter with two values.
    """
    values: dict[str, Any] = {}
    options: dict[str, str] = {}
    for option, name, text in given:
        spec = _find_parameter(method, option, name)
        value = spec.validate(text)
        if values.setdefault(spec.name, value) != value:
            raise UsageError(
                f"{options[spec.name]} and {option} give {spec.name} two different values",
                hint="give it once",
            )
        options.setdefault(spec.name, option)
    return method.validate(values)


def list_defaults(records: Sequence[MeshRecord]) -> dict[str, Any]:
    """The default parameters of the method of a single record; none of a method of another
    version of msal, and none for several records."""
    if len(records) != 1 or records[0].method is None:
        return {}
    from msal_cli import methods

    try:
        return methods.find(records[0].method.name).validate({})
    except UsageError:
        return {}


def _find_parameter(method: Method, option: str, name: str) -> ParameterSpec:
    """The parameter called ``name``; for a shortcut the refusal says which methods have it."""
    try:
        return method.spec(name)
    except UsageError:
        from msal_cli import methods

        others = [
            method_name
            for method_name in methods.names()
            if any(name == spec.name for spec in methods.find(method_name).parameters)
        ]
        if option.startswith("--set") or not others:
            raise
        raise UsageError(
            f"{option} does not go with {method.name}, which has no parameter '{name}'",
            hint=f"methods that have it: {', '.join(others)}",
        ) from None
