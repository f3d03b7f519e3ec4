"""Averages of positions over one-rings: the rule at open edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Ints
from msal_cli.kernels.connectivity import averaging_ring
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._sweeps import ScaleParameters


def ring_of(mesh: Mesh, boundary: str) -> tuple[Ints, Ints]:
    """Rows to average over, (n + 1,) and (...,), for the parameter ``boundary``.

    The rows of fixed vertices are empty: a vertex without neighbours does not move.
    """
    starts, ring = averaging_ring(mesh.faces, mesh.topology, boundary)
    if mesh.fixed_vertices is None:
        return starts, ring
    counts = np.diff(starts)
    kept = ring[np.repeat(~mesh.fixed_vertices, counts)]
    counts[mesh.fixed_vertices] = 0
    starts = np.concatenate([np.zeros(1, counts.dtype), np.cumsum(counts, dtype=counts.dtype)])
    return starts, kept


@dataclass(frozen=True)
class ScheduledRingParameters(ScaleParameters):
    """Parameters of an operator of equation (2) that averages over one-rings."""

    boundary: str = fields.rim()
