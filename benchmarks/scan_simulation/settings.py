"""What a simulated scanner is: its kind, its resolution and its noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

from msal_cli.errors import UsageError

SCANNERS = {
    "voxels": "binary occupancy on a grid: the staircase of a segmentation",
    "ct": "grey values: partial volume, blur, and noise in the volume",
    "slices": "binary slices several voxels apart: terraces",
    "depth": "one depth camera: noise along the view, smoothed, depths in steps, open borders",
    "fusion": "several depth cameras around the object, fused in a signed distance volume",
}
"""The scanners that ``simulate_scan`` knows, and what their meshes are like."""

OPTIONS = {
    "voxels": (),
    "ct": ("level", "correlation", "smoothing"),
    "slices": ("slices",),
    "depth": ("level", "correlation", "smoothing", "step"),
    "fusion": ("level", "correlation", "smoothing", "step", "views", "misalignment"),
}
"""The settings that each scanner uses besides resolution, direction and seed."""

DEFAULTS: dict[str, dict[str, float]] = {
    "ct": {"level": 0.1, "correlation": 0.0, "smoothing": 0.5},
    "slices": {"slices": 3},
    "depth": {"level": 1.0, "correlation": 0.0, "smoothing": 1.0, "step": 0.3},
    "fusion": {
        "level": 1.0,
        "correlation": 0.0,
        "smoothing": 1.0,
        "step": 0.3,
        "views": 14,
        "misalignment": 0.1,
    },
}
"""A scanner's own values of the settings that are not given."""

MOST_CELLS = 100_000_000
"""Most voxels: a volume of 20 million takes 0.7 GB, and one of 100 million 3 GB."""

MOST_PIXELS = 1 << 24
"""Most pixels of one image, each of which takes a ray: 16,777,216."""


@dataclass(frozen=True)
class ScannerSettings:
    """A simulated scanner.  A cell is a voxel, or a pixel at the distance of the object's centre.

    Attributes
    ----------
    scanner : one of ``SCANNERS``.
    seed : of the noise, and of where the grid lies, from 0.
    cells : cells along the object's longest side: more is finer.
    cell_edges : edge of a cell in mean edge lengths, instead of ``cells``: more is coarser.
    direction : third axis of the grid, from the object to the camera, or across the slices; (3,)
        of any length.  The grid is turned, and not the object.
    level : standard deviation of the noise: greater is noisier.  For ``ct`` as a share of the
        contrast between object and air; for cameras of the depth, seen head-on, in cells.
    correlation : standard deviation, in cells, of the Gaussian that noise is averaged with at the
        same level: 0 is white, greater is shared more widely.
    smoothing : standard deviation, in cells, of what the scanner averages itself: the blur of a
        ``ct``, the window of a camera.  It takes noise, and detail, away.
    step : of the depths that a camera knows, in cells at the object's centre; 0 for none.
    slices : voxels from one slice to the next.
    views : cameras around the object.
    misalignment : standard deviation of each camera's place from the true one, in cells.
    """

    scanner: str
    seed: int = 0
    cells: int = 96
    cell_edges: float | None = None
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    level: float | None = None
    correlation: float | None = None
    smoothing: float | None = None
    step: float | None = None
    slices: int | None = None
    views: int | None = None
    misalignment: float | None = None

    def __post_init__(self) -> None:
        if self.scanner not in SCANNERS:
            raise UsageError(
                f"there is no scanner {self.scanner!r}", hint=f"known are: {', '.join(SCANNERS)}"
            )
        _require("seed", "seed", self.seed, 0, 2**63)
        _require("number of cells", "resolution", self.cells, 4, 4096)
        _require("cell in mean edge lengths", "resolution", self.cell_edges, 1e-3, 1e3)
        _require("level", "level", self.level, 0, 10)
        _require("correlation", "correlation", self.correlation, 0, 50)
        _require("smoothing", "smoothing", self.smoothing, 0, 50)
        _require("step", "step", self.step, 0, 100)
        _require("number of voxels between slices", "slices", self.slices, 1, 1000)
        _require("number of views", "views", self.views, 1, 1000)
        _require("misalignment", "misalignment", self.misalignment, 0, 100)
        if not 0.0 < math.hypot(*self.direction) < math.inf:
            raise UsageError(f"the scanner's direction is {self.direction}, which has no length")

    def value(self, name: str) -> float:
        """A setting, the scanner's own where it is not given."""
        given: float | None = getattr(self, name)
        return given if given is not None else DEFAULTS[self.scanner][name]


def _require(name: str, option: str, value: float | None, least: float, most: float) -> None:
    if value is not None and not least <= value <= most:
        raise UsageError(
            f"the scanner's {name} is {value:g}, and must be from {least:g} to {most:g}",
            hint=f"give another --{option}",
        )
