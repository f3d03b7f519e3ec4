"""Values of the options of ``msal scan``: numbers, cells, and three numbers between commas."""

from __future__ import annotations

import math

import click


def parse_number(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> float | None:
    """A finite number."""
    if value is None:
        return None
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise click.BadParameter(f"{value!r} is not a number")
    return number


def parse_resolution(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> tuple[int | None, float | None] | None:
    """``96`` cells along the longest side, or cells of ``0.8e``, mean edge lengths."""
    if value is None:
        return None
    if value.isascii() and value.isdigit() and len(value) < 6:
        return int(value), None
    try:
        edges = float(value.removesuffix("e")) if value.endswith("e") else math.nan
    except ValueError:
        edges = math.nan
    if not math.isfinite(edges):
        raise click.BadParameter(
            f"{value!r} is neither a number of cells such as 96 nor a cell such as 0.8e"
        )
    return None, edges


def parse_lengths(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> tuple[float, ...] | None:
    """Three numbers above 0 between commas."""
    if value is None:
        return None
    try:
        numbers = tuple(float(word) for word in value.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != 3 or not all(0.0 < one < math.inf for one in numbers):
        raise click.BadParameter(f"{value!r} is not three numbers above 0 such as 1,1,3")
    return numbers


def parse_counts(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> tuple[int, ...] | None:
    """Three whole numbers above 0 between commas."""
    if value is None:
        return None
    texts = value.split(",")
    if len(texts) != 3 or not all(
        one.isascii() and one.isdigit() and int(one[:9]) > 0 and len(one) < 10 for one in texts
    ):
        raise click.BadParameter(f"{value!r} is not three whole numbers such as 512,512,100")
    return tuple(map(int, texts))
