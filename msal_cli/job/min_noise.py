"""Meshes with too little noise to be touched: ``--min-noise``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msal_cli.job.settings import NEGLIGIBLE

if TYPE_CHECKING:
    from msal_cli.analysis.noise_estimate import NoiseLevel
    from msal_cli.mesh import Mesh


def too_little(noise: NoiseLevel, mesh: Mesh, least: str) -> str:
    """Why a mesh with less noise than ``least`` stays as it is; empty if it has more."""
    level = f"noise {noise.mean_edges:.2g} e"
    if least == NEGLIGIBLE:
        return f"{level}: none to speak of" if noise.is_negligible else ""
    from msal_cli.job import constraints

    bound = constraints.length(least).in_units(mesh.mean_edge_length) / mesh.mean_edge_length
    return f"{level}, below --min-noise {least}" if noise.is_below(bound) else ""
