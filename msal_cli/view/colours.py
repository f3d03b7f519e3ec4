"""Colours of vertices in pictures: the file's own, or numbers by a scale.

What cannot be read of a file's colours is a note, never an error: a picture of clay is better than
none.
"""

from __future__ import annotations

import logging
import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.colour_maps import colour_table, map_colours
from msal_cli.arrays import Floats
from msal_cli.codecs.colours import surface_colours
from msal_cli.codecs.mesh_file import MeshFile, Surface, SurfaceColours
from msal_cli.job import comparison
from msal_cli.structs import dataclass
from msal_cli.view.panels import Legend

SHARE_WITHIN = 0.99
"""Share of the numbers within the ends of a scale, so that one stray vertex does not pale all."""

_MIN_END = 1e-290
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
        """The map of ``analysis.colour_maps``."""
        return "diverging" if self.is_signed else "sequential"

    def paint(self, values: Floats) -> NDArray[np.uint8]:
        """(n, 3) colours of ``values`` (n,)."""
        return map_colours(values, self.low, self.high, self.map_name)

    def legend(self, lines: tuple[str, ...], edge: float) -> Legend:
        """The scale with five places in file units above, and in ``edge`` lengths below."""
        ticks = []
        for share in (0.0, 0.25, 0.5, 0.75, 1.0):
            value = self.low + share * (self.high - self.low)
            ticks.append((share, _number_text(value), _number_text(value / edge)))
        return Legend(lines, colour_table(self.map_name), tuple(ticks))


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
    end = max(end, _MIN_END)
    exponent = math.floor(math.log10(end)) - 1
    digits = math.ceil(end / 10.0**exponent - 1e-9)
    end = float(f"{digits}e{exponent}")
    return Scale(-end if is_signed else 0.0, end, is_signed)


def _number_text(value: float) -> str:
    return f"{value:.3g}" if value else "0"


# Colours of the file


log = logging.getLogger("msal")

_MIN_BRIGHTNESS = 16
"""One colour of all vertices that is darker hides the shape; programs write it where none is
meant."""


def open_coloured_surface(path: str, format: str | None = None) -> Surface:
    return coloured_surface_of(comparison.open_mesh_file(path, format), path)


def coloured_surface_of(mesh_file: MeshFile, path: str) -> Surface:
    """The surface in an open file, which is at ``path``, with its colours."""
    return replace(comparison.surface_of(mesh_file), colours=_read_colours(mesh_file, path))


def _read_colours(mesh_file: MeshFile, path: str) -> SurfaceColours:
    try:
        colours = surface_colours(mesh_file)
    except Exception as failure:  # colours are an extra, and files come from strangers
        log.info("%s: no colours", path, exc_info=True)
        return SurfaceColours(None, (f"its colours cannot be read: {str(failure)[:200]}",))
    if colours is None:
        return SurfaceColours()
    if len(colours) != len(mesh_file.vertices):
        return SurfaceColours(None, ("its colours do not fit its vertices",))
    if int(colours.max(initial=0)) < _MIN_BRIGHTNESS:
        return SurfaceColours(None, ("all of its colours are black, and are not shown",))
    return SurfaceColours(colours)
