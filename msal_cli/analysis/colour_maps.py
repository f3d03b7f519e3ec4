"""Numbers as colours: two maps that are even to the eye and safe for the colour-blind.

The points, in sRGB, are evenly spaced between a few in OKLab (Ottosson 2020), where equal steps
look equally large.  Lightness never turns back within a map (within each half of the diverging
one), so that order can be read off without telling hues apart, and in print.
"""

import functools

import numpy as np
from numpy.typing import NDArray

Colours = NDArray[np.uint8]

SHADES = 256
"""Colours in a map."""

UNKNOWN = (128, 128, 128)
"""The colour of what is not a number."""

# Maps for what has a least value and for what has a sign.  A low value is pale, so that the shading
# of a surface stays visible where little is going on.
_POINTS = {
    "sequential": "eeedd2 efe2b7 efd79b eecc7d eec05b edae4e ec9b41 e98834 e67425"
    " d8632e ca5234 bc4038 ad2c3a 942540 7c1e43 651545 4f0a45",
    "diverging": "123780 1d4c93 2a60a6 3775ba 458ace 71a3d7 9abbdf c2d3e5 ebebeb"
    " ebcfc0 e9b396 e6976a e07937 c6642b ac501f 933d13 7a2a06",
}


@functools.cache
def colour_table(map_name: str) -> Colours:
    """The colours of a map, (SHADES, 3) from the lowest to the highest; do not write to it."""
    points = np.array([list(bytes.fromhex(point)) for point in _POINTS[map_name].split()])
    at = np.linspace(0.0, len(points) - 1.0, SHADES)
    channels = [np.interp(at, np.arange(len(points)), channel) for channel in points.T]
    colours: Colours = np.round(np.stack(channels, axis=1)).astype(np.uint8)
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
