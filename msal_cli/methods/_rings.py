"""What the methods share that average positions over one-rings: the rule at open edges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from msal_cli.arrays import Ints
from msal_cli.kernels.connectivity import averaged_ring
from msal_cli.mesh import Mesh
from msal_cli.methods._contract import parameter
from msal_cli.methods._sweeps import ScheduledParameters


def boundary_rule() -> Any:
    """The parameter ``boundary`` of these methods."""
    return parameter(
        "curve",
        "vertices at open edges: averaged along the rim only, as a curve; with all the neighbours "
        "they have, which draws the rim inwards; or fixed",
        choices=("curve", "free", "fixed"),
    )


def ring_of(mesh: Mesh, boundary: str) -> tuple[Ints, Ints]:
    """Rows to average over, (n + 1,) and (...,), for the parameter ``boundary``.

    Those of vertices that are held are empty: who has no neighbours stays.
    """
    starts, ring = averaged_ring(mesh.faces, mesh.links, boundary)
    if mesh.held is None:
        return starts, ring
    counts = np.diff(starts)
    kept = ring[np.repeat(~mesh.held, counts)]
    counts[mesh.held] = 0
    starts = np.concatenate([np.zeros(1, counts.dtype), np.cumsum(counts, dtype=counts.dtype)])
    return starts, kept


@dataclass(frozen=True)
class ScheduledRingParameters(ScheduledParameters):
    """Parameters of an operator of equation (2) that averages over one-rings."""

    mollify: int = parameter(
        1,
        "multiscale schedule: passes that average the normals along which sigma is measured",
        low=0,
        high=100,
        more="a lambda that follows the noise less",
    )
    normals: str = parameter(
        "uniform",
        "multiscale schedule: how face normals count in these normals: alike, or by face area",
        choices=("uniform", "area"),
    )
    boundary: str = boundary_rule()
