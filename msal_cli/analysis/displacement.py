"""How far vertices moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats


@dataclass(frozen=True)
class DisplacementStatistics:
    """Mean, root mean square, 95th percentile and maximum in file units; vertices that moved."""

    mean: float
    rms: float
    p95: float
    max: float
    moved_vertices: int


def displacement_statistics(
    before: Floats, after: Floats, counted: NDArray[np.bool_] | None = None
) -> DisplacementStatistics:
    """Statistics of the distances between (n, 3) positions over the ``counted`` (n,) vertices."""
    from msal_cli.kernels.geometry import distances
    from msal_cli.kernels.quantiles import ranked

    lengths = distances(before, after)
    if counted is not None and not counted.all():
        lengths = lengths[counted]
    if not len(lengths):
        return DisplacementStatistics(0.0, 0.0, 0.0, 0.0, 0)
    rank = min(len(lengths) - 1, int(np.ceil(0.95 * len(lengths))) - 1)
    return DisplacementStatistics(
        mean=float(lengths.mean()),
        rms=float(np.sqrt((lengths * lengths).mean())),
        p95=ranked(lengths, rank)[0],
        max=float(lengths.max()),
        moved_vertices=int(np.count_nonzero(lengths)),
    )
