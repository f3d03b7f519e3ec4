"""Spikes: impulses along the normals, and outliers in any direction."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.noise_estimate.quantiles import quantile
from msal_cli.analysis.noise_estimate.survey import Survey
from msal_cli.analysis.noise_estimate.white import WhiteEstimate
from msal_cli.arrays import Floats

if TYPE_CHECKING:
    from msal_cli.mesh import Mesh


FEWEST_OUTLIERS = 0.004
"""Share of the vertices from which they are outliers."""

OUTLYING, TIMES_MOST, MOST = 0.9, 3.5, 0.7
"""How far an outlier is off the middle of its ring at least: in mean edge lengths, and compared
with what this share of the vertices does not exceed."""


def outlying_share(mesh: Mesh, white: WhiteEstimate, survey: Survey) -> tuple[float, float]:
    """Share of the vertices that lie far off their neighbours, and the median of their ways within
    the surface, mean edges; 0 and 0 for too few."""
    fewest = FEWEST_OUTLIERS * len(white.places)
    far = white.places[white.far]
    if len(far) <= fewest:
        return 0.0, 0.0
    lengths = np.sqrt((survey.offsets * survey.offsets).sum(axis=1))
    least = max(OUTLYING, TIMES_MOST * quantile(lengths, MOST))
    offsets = _ring_offsets(mesh, far) / white.edge
    squares = (offsets * offsets).sum(axis=1)
    is_out = squares > least * least
    if is_out.sum() <= fewest:
        return 0.0, 0.0
    along = (offsets * mesh.vertex_normals("uniform", 1)[far]).sum(axis=1)
    within = np.sqrt(np.maximum(squares - along * along, 0.0))
    # Among many outliers some are not detected, but they are as far off.
    share = max(float((lengths > least).mean()), float(is_out.sum()) / len(white.places))
    return share, float(np.median(within[is_out]))


def _ring_offsets(mesh: Mesh, vertices: NDArray[np.int64]) -> Floats:
    """From the middles of the one-rings of vertices (c,) to these, (c, 3), file units."""
    starts, ring = mesh.topology.ring_start, mesh.topology.ring
    return np.array(
        [
            mesh.vertices[vertex] - mesh.vertices[ring[starts[vertex] : starts[vertex + 1]]].mean(0)
            for vertex in vertices
        ]
    ).reshape(-1, 3)
