"""Numbers as colours: two maps that are even to the eye and safe for the colour-blind.

The control points are in OKLab (Ottosson 2020), where equal steps look equally large, and the
colours between them are found there too.  Lightness never turns back within a map (within each half
of the diverging one), so that order can be read off without telling hues apart, and in print.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

Colours = NDArray[np.uint8]

SHADES = 256
"""Colours in a map."""

UNKNOWN = (128, 128, 128)
"""The colour of what is not a number."""

# Maps for what has a least value and for what has a sign.
# Position, lightness, chroma, hue in degrees.  A low value is pale, so that the shading of a
# surface stays visible where little is going on.
_CONTROL_POINTS = {
    "sequential": (
        (0.00, 0.94, 0.035, 105.0),
        (0.25, 0.83, 0.130, 85.0),
        (0.50, 0.68, 0.165, 50.0),
        (0.75, 0.50, 0.165, 20.0),
        (1.00, 0.30, 0.120, -25.0),
    ),
    "diverging": (
        (0.00, 0.36, 0.130, 262.0),
        (0.25, 0.62, 0.125, 250.0),
        (0.50, 0.94, 0.000, 250.0),
        (0.50, 0.94, 0.000, 50.0),
        (0.75, 0.68, 0.150, 50.0),
        (1.00, 0.40, 0.120, 40.0),
    ),
}

_TO_CONES = np.array(
    [
        [1.0, 0.3963377774, 0.2158037573],
        [1.0, -0.1055613458, -0.0638541728],
        [1.0, -0.0894841775, -1.2914855480],
    ]
)
_TO_LINEAR = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


@functools.cache
def colour_table(map_name: str) -> Colours:
    """The colours of a map, (SHADES, 3) from the lowest to the highest; do not write to it."""
    places, lightness, chroma, hue = np.array(_CONTROL_POINTS[map_name]).T
    turned = np.radians(hue)
    at = np.linspace(0.0, 1.0, SHADES)
    lab = np.stack(
        [
            np.interp(at, places, channel)
            for channel in (lightness, chroma * np.cos(turned), chroma * np.sin(turned))
        ],
        axis=1,
    )
    linear = np.clip((lab @ _TO_CONES.T) ** 3 @ _TO_LINEAR.T, 0.0, 1.0)
    coded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    colours: Colours = np.round(255.0 * coded).astype(np.uint8)
    colours.setflags(write=False)
    return colours


def map_colours(
    values: NDArray[np.float64], low: float, high: float, map_name: str = "sequential"
) -> Colours:
    """Colours (n, 3) of values (n,): ``low`` gets the map's first one, ``high`` its last.

    What lies beyond gets the colour of the nearer end, and what is not a number ``UNKNOWN``.  With
    ``low`` equal to ``high`` every value up to them gets the first colour (of the diverging map,
    the middle one), and those beyond the last.
    """
    colours = colour_table(map_name)
    values = np.asarray(values, dtype=np.float64)
    if high > low:
        with np.errstate(invalid="ignore", over="ignore"):
            share = (values - low) / (high - low)
    else:
        share = np.where(values > high, 1.0, 0.5 if map_name == "diverging" else 0.0)
    is_number = ~np.isnan(values)
    share = np.clip(np.where(is_number, share, 0.0), 0.0, 1.0)
    shades = np.minimum((share * SHADES).astype(np.intp), SHADES - 1)
    result: Colours = colours[shades]
    result[~is_number] = UNKNOWN
    return result
