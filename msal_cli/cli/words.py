"""Values of options: what they may be, and what the shell completes them to without numpy."""

from __future__ import annotations

import difflib
import importlib.util
import pkgutil
from collections.abc import Callable

import click

from msal_cli.errors import UsageError

COMPLETE_VARIABLE = "_MSAL_COMPLETE"
"""The environment variable through which a shell asks for completions."""

_MOST_JOBS = 4096


def method_names() -> tuple[str, ...]:
    """The names of all methods: those of ``methods.names()``, found without importing any."""
    found = importlib.util.find_spec("msal_cli.methods")
    folders = found.submodule_search_locations if found is not None else None
    names = (module.name for module in pkgutil.iter_modules(folders))
    return tuple(sorted(name for name in names if not name.startswith("_")))


def completed_method(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[str]:
    """The methods that begin like this, for the shell."""
    return [name for name in method_names() if name.startswith(incomplete)]


def jobs(context: click.Context, parameter: click.Parameter, value: str) -> int | None:
    """A number of files at the same time; None for ``auto``.

    Raises
    ------
    click.BadParameter
        for anything but ``auto`` or a whole number from 1.
    """
    if value == "auto":
        return None
    if not (value.isascii() and value.isdigit()) or not 1 <= int(value[:9]) <= _MOST_JOBS:
        raise click.BadParameter(
            f"{value!r} is neither auto nor a whole number from 1 to {_MOST_JOBS}"
        )
    return int(value[:9])


def settled_format(
    word: str | None, known: Callable[[], tuple[str, ...]], option: str
) -> str | None:
    """A format in the spelling of what ``known`` gives, a leading dot aside; None for None.

    Raises
    ------
    UsageError
        if it is none of them, with the closest.
    """
    if word is None:
        return None
    names = tuple(name.lstrip(".") for name in known())
    plain = word.lower().lstrip(".")
    if plain in names:
        return plain
    close = difflib.get_close_matches(plain, names, n=2, cutoff=0.5)
    raise UsageError(
        f"{option} {word}: there is no such format",
        hint=f"did you mean {' or '.join(close)}?" if close else f"known are: {', '.join(names)}",
    )
