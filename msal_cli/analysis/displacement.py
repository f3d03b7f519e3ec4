"""How far vertices moved, and statistics of distances."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats


@dataclass(frozen=True)
class DistanceStatistics:
    """Mean, root mean square, 95th percentile and maximum of distances, file units."""

    mean: float
    rms: float
    p95: float
    max: float


@dataclass(frozen=True)
class DisplacementStatistics(DistanceStatistics):
    """Statistics of how far vertices moved, and how many moved at all."""

    moved_vertices: int


def distance_statistics(lengths: Floats) -> DistanceStatistics:
    """Statistics of distances (n,), n >= 1."""
    from msal_cli.kernels.quantiles import ranked

    rank = min(len(lengths) - 1, int(np.ceil(0.95 * len(lengths))) - 1)
    return DistanceStatistics(
        mean=float(lengths.mean()),
        rms=float(np.sqrt((lengths * lengths).mean())),
        p95=ranked(lengths, rank)[0],
        max=float(lengths.max()),
    )


def displacement_statistics(
    before: Floats, after: Floats, counted: NDArray[np.bool_] | None = None
) -> DisplacementStatistics:
    """Statistics of the distances between (n, 3) positions over the ``counted`` (n,) vertices."""
    from msal_cli.kernels.geometry import distances

    lengths = distances(before, after)
    if counted is not None and not counted.all():
        lengths = lengths[counted]
    if not len(lengths):
        return DisplacementStatistics(0.0, 0.0, 0.0, 0.0, 0)
    moved = int(np.count_nonzero(lengths))
    return DisplacementStatistics(**asdict(distance_statistics(lengths)), moved_vertices=moved)
