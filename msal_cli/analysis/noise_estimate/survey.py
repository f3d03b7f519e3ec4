"""What fits over one to six rings leave over at some hundred places of a mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from msal_cli.analysis.noise_estimate.quantiles import quantile
from msal_cli.arrays import Floats, Longs

if TYPE_CHECKING:
    from msal_cli.mesh import Mesh


MOST_PLACES = 640
"""Longs of the survey: more would hardly tell more, and take 15 microseconds each."""

ONE, TWO, THREE, FOUR, SIX = range(5)
"""The fits, by the rings that they are over."""


@dataclass(frozen=True, eq=False)
class Survey:
    """The places, and what fits leave over there; lengths are in mean edge lengths.

    Attributes
    ----------
    at : (c,) which of the places of the ``WhiteEstimate`` these are.
    vertices : (c,) their vertices.
    positions : (c, 3).
    variances : (c, 5) left over by each fit, by the degrees of freedom; NaN where there is none.
    freedoms : (c, 5).
    normals : (c, 3) of the two-ring; unit vectors.
    offsets : (c, 3) from the middle of the ring to the vertex; see ``kernels.patch_fits``.
    """

    at: Longs
    vertices: Longs
    positions: Floats
    variances: Floats
    freedoms: Floats
    normals: Floats
    offsets: Floats

    def quantile(self, fit: int, share: float, scale: Floats | None = None) -> float:
        """Variance that one fit leaves over at a share of the places, or of its ratio to ``scale``
        (c,) where that is above 0; NaN where there is none."""
        values = self.variances[:, fit]
        if scale is not None:
            has = scale > 0.0
            values = values[has] / scale[has]
        values = values[np.isfinite(values)]
        if not len(values):
            return float("nan")
        return quantile(values, share)


def take_survey(mesh: Mesh, places: Longs) -> Survey:
    """Look at some of the places (c,), evenly."""
    from msal_cli.kernels.patch_fits import fit_scales

    at = np.arange(0, len(places), max(-(-len(places) // MOST_PLACES), 1))
    chosen = np.ascontiguousarray(places[at])
    links = mesh.topology
    rests, rows, ranks, frames, offsets = fit_scales(
        chosen,
        mesh.vertices,
        mesh.vertex_normals("uniform", 1),
        links.ring_start,
        links.ring,
    )
    edge = mesh.mean_edge_length
    freedoms = np.maximum(rows - ranks, 0).astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        variances = np.where(freedoms > 0.0, rests / freedoms, np.nan) / (edge * edge)
    has_normal = (frames != 0.0).any(axis=1)
    return Survey(
        at=at[has_normal],
        vertices=chosen[has_normal],
        positions=mesh.vertices[chosen[has_normal]] / edge,
        variances=variances[has_normal],
        freedoms=freedoms[has_normal],
        normals=frames[has_normal],
        offsets=offsets[has_normal] / edge,
    )
