"""Lengths with a unit, such as ``0.01mm``, in the unit of a file.

Most mesh files are numbers without a unit, so the user has to say which it is.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from msal_cli.errors import UsageError

METRES: dict[str, tuple[int, int]] = {
    "nm": (1, 10**9),
    "um": (1, 10**6),
    "mm": (1, 1000),
    "cm": (1, 100),
    "dm": (1, 10),
    "m": (1, 1),
    "km": (1000, 1),
    "mil": (254, 10**7),
    "in": (254, 10**4),
    "ft": (3048, 10**4),
    "yd": (9144, 10**4),
}
"""Length units in metres, as numerator and denominator; ``mil`` is a thousandth of an inch."""

# Micro sign and Greek letter.
_MICRO = ("\N{MICRO SIGN}m", "\N{GREEK SMALL LETTER MU}m")

NAMES = (*METRES, *_MICRO)

UNIT_PATTERN = "|".join(sorted(NAMES, key=len, reverse=True))
"""A regular expression for the name of a unit."""

COMPARISONS: dict[str, Callable[[Any, Any], Any]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
"""What a user may write between a quantity and a length or number."""


def in_file_units(number: str, unit: str, file_unit: str | None) -> float:
    """A length in the unit of the file.

    Parameters
    ----------
    number : the length as it was written, so that 0.1 is a tenth and not the double next to it.
    unit : its unit, one of ``NAMES``.
    file_unit : the unit of the file's coordinates, one of ``METRES``.

    Raises
    ------
    UsageError
        if the file's unit is not known, or the length is too long for a double.
    """
    if file_unit is None:
        raise UsageError(
            f"{number}{unit}: mesh files have no unit, so that it is not known how long that is",
            hint="say with --unit what the unit of the files is, such as --unit mm, or write the "
            "length in file units (0.05) or mean edge lengths (0.3e)",
        )
    from fractions import Fraction

    if not float(number):
        # An exponent of a billion would be a fraction of as many digits.
        return 0.0
    own, other = METRES["um" if unit in _MICRO else unit], METRES[file_unit]
    try:
        return float(Fraction(number) * Fraction(*own) / Fraction(*other))
    except OverflowError:
        raise UsageError(f"{number}{unit}: the length is too large") from None
