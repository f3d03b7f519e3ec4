"""What changed, measured tile by tile, and the figures of a record that come of it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from msal_cli.analysis import harm
from msal_cli.analysis.measures import (
    DisplacementStatistics,
    NormalStatistics,
    SurfaceChange,
    is_negative,
)
from msal_cli.job import changes
from msal_cli.job.records import NormalChange
from msal_cli.mesh import Defects
from msal_cli.tiles.cut import tile_range, weld_numbers
from msal_cli.tiles.plan import read_globals

if TYPE_CHECKING:
    from msal_cli.arrays import Floats
    from msal_cli.mesh import Mesh
    from msal_cli.tiles.part_files import TileMesh
    from msal_cli.tiles.scratch import Scratch

_LENGTHS = "lengths.npy"
_KEY_BITS = np.uint64(42)
"""Bits of a length that do not count when lengths are counted: 10 of its fraction are left, so that
those that count alike differ by 0.1 % at most."""
