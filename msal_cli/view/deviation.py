"""Numbers on a surface as colours, and the scale that says what they mean."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis import colour_maps as colours
from msal_cli.arrays import Floats
from msal_cli.view.panels import Legend

SHARE_WITHIN = 0.99
"""Share of the numbers within the ends of a scale, so that one stray vertex does not pale all."""

_SMALLEST = 1e-290
"""End of a scale, file units: tenths of much smaller ones are no numbers with all digits."""


@dataclass(frozen=True)
class Scale:
    """What the colours of a deviation mean.

    ``low`` and ``high`` in file units; numbers beyond them have the colours of the ends.  With a
    sign, ``low`` is ``-high`` and the map has a pale middle.
    """

    low: float
    high: float
    is_signed: bool

    @property
    def map_name(self) -> str:
        """The map of ``colours``."""
        return "diverging" if self.is_signed else "sequential"

    def paint(self, values: Floats) -> NDArray[np.uint8]:
        """(n, 3) colours of ``values`` (n,)."""
        return colours.map_colours(values, self.low, self.high, self.map_name)

    def legend(self, lines: tuple[str, ...], edge: float) -> Legend:
        """The scale with five places in file units above, and in ``edge`` lengths below."""
        ticks = []
        for share in (0.0, 0.25, 0.5, 0.75, 1.0):
            value = self.low + share * (self.high - self.low)
            ticks.append((share, _said(value), _said(value / edge)))
        return Legend(lines, colours.colour_table(self.map_name), tuple(ticks))


def scale_of(
    values: Floats, *, is_signed: bool, rounding: float = 0.0, if_none: float = 1.0
) -> Scale:
    """The scale for ``values`` (n,) in file units: up to the 99th percentile of their sizes,
    rounded up to two digits.

    Where no size is above ``rounding`` it goes to ``if_none``.
    """
    sizes = np.abs(values[np.isfinite(values)])
    largest = float(sizes.max(initial=0.0))
    end = if_none
    if largest > rounding:
        common = float(np.quantile(sizes, SHARE_WITHIN))
        end = common if common > rounding else largest
    end = _rounded_up(end)
    return Scale(-end if is_signed else 0.0, end, is_signed)


def _rounded_up(value: float) -> float:
    """The next number with two significant digits."""
    value = max(value, _SMALLEST)
    exponent = math.floor(math.log10(value)) - 1
    digits = math.ceil(value / 10.0**exponent - 1e-9)
    return float(f"{digits}e{exponent}")


def _said(value: float) -> str:
    return f"{value:.3g}" if value else "0"
