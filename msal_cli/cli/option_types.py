"""Values of options: what they may be, and what the shell completes them to without numpy."""

from __future__ import annotations

import importlib.util
import math
import os
import re
from collections.abc import Callable

import click

from msal_cli.errors import UsageError

COMPLETE_VARIABLE = "_MSAL_COMPLETE"
"""The environment variable through which a shell asks for completions."""

_MOST_JOBS = 4096
_MOST_DIGITS = 15

_NUMBER_AND_UNIT = r"(?ai)(\d{1,15}(?:\.\d{0,9})?|\.\d{1,9})\s*([a-z]*)"
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_SECONDS = {"": 1.0, "s": 1.0, "sec": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
_BYTES = {
    **{f"{letter}{end}": 1000**n for n, letter in enumerate("kmgt", 1) for end in ("", "b")},
    **{f"{letter}ib": 1024**n for n, letter in enumerate("kmgt", 1)},
}


def method_names() -> tuple[str, ...]:
    """The names of all methods: those of ``methods.names()``, found without importing any."""
    import pkgutil

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


def count_from(least: int) -> Callable[[click.Context, click.Parameter, str | None], int | None]:
    """A callback for an option whose value is a whole number from ``least``."""

    def count(context: click.Context, parameter: click.Parameter, value: str | None) -> int | None:
        if value is None:
            return None
        is_number = value.isascii() and value.isdigit()
        if is_number and len(value) > _MOST_DIGITS:
            raise click.BadParameter(f"{value!r} has more than {_MOST_DIGITS} digits")
        if not is_number or int(value) < least:
            raise click.BadParameter(f"{value!r} is not a whole number from {least} up")
        return int(value)

    return count


def listed(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> tuple[str, ...]:
    """Words between commas; none for None."""
    return () if value is None else tuple(word.strip() for word in value.split(","))


def duration(context: click.Context, parameter: click.Parameter, value: str | None) -> float | None:
    """Seconds: ``90``, ``1.5m``, ``2h``; None for ``none``.

    Raises
    ------
    click.BadParameter
        for anything else, and for no time at all.
    """
    if value is None or value == "none":
        return None
    match = re.fullmatch(_NUMBER_AND_UNIT, value.strip())
    unit = _SECONDS.get(match[2].lower()) if match else None
    if match is None or unit is None or not float(match[1]) * unit > 0.0:
        raise click.BadParameter(f"{value!r} is not a time such as 90, 90s, 5m or 1h")
    return float(match[1]) * unit


def size(context: click.Context, parameter: click.Parameter, value: str | None) -> int | None:
    """Bytes: ``500M`` and ``500MB`` are 500 million, ``500MiB`` is 500 * 1024 * 1024; None for
    ``none``.

    Raises
    ------
    click.BadParameter
        for anything else; a number without a unit too, since nobody means bytes by it.
    """
    if value is None or value == "none":
        return None
    match = re.fullmatch(_NUMBER_AND_UNIT, value.strip())
    unit = _BYTES.get(match[2].lower()) if match else None
    if match is None or unit is None or not float(match[1]) * unit >= 1.0:
        raise click.BadParameter(f"{value!r} is not a size such as 500M, 2G or 1.5GiB")
    return int(float(match[1]) * unit)


def direction(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> tuple[float, float, float] | None:
    """Three numbers between commas, or an axis such as ``z`` or ``-z``."""
    if value is None:
        return None
    axis = _AXES.get(value.lower().removeprefix("-").removeprefix("+"))
    if axis is not None:
        sign = -1.0 if value.startswith("-") else 1.0
        # Not -0.0, which would be shown.
        x, y, z = (sign * one + 0.0 for one in axis)
        return x, y, z
    try:
        x, y, z = (float(word) for word in value.split(","))
    except ValueError:
        x = y = z = math.nan
    if math.isnan(x + y + z):
        raise click.BadParameter(
            f"{value!r} is neither an axis such as z or -z nor three numbers such as 0,-1,0.5"
        )
    if not 1e-100 < math.hypot(x, y, z) < 1e100:
        raise click.BadParameter(
            f"{value!r} has no length between 1e-100 and 1e100, so it is no direction"
        )
    return x, y, z


def check_threads_variable() -> None:
    """Refuse a value of ``MSAL_THREADS`` that means nothing; UsageError."""
    value = os.environ.get("MSAL_THREADS", "")
    is_number = value.isascii() and value.isdigit() and len(value) <= _MOST_DIGITS
    if value and not (is_number and int(value) > 0):
        raise UsageError(
            f"MSAL_THREADS is {value!r}, which is not a whole number from 1 up",
            hint="set it to a number of threads, or unset it",
        )


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
    import difflib

    close = difflib.get_close_matches(plain, names, n=2, cutoff=0.5)
    raise UsageError(
        f"{option} {word}: there is no such format",
        hint=f"did you mean {' or '.join(close)}?" if close else f"known are: {', '.join(names)}",
    )
