"""Learned filter of face normals: small networks that weigh many filtered normals.

Source: P.-S. Wang, Y. Liu and X. Tong, Mesh denoising via cascaded normal regression, ACM
Transactions on Graphics 35 (6), 2016, 232.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

from msal_cli.mesh import Mesh
from msal_cli.methods._cascade import Cascade, load_networks
from msal_cli.methods._contract import OnSweep, Result, parameter
from msal_cli.methods._sliding import settled, sliding_parameter

BYTES_PER_FACE = 900

STAGE_PASSES = 10


@dataclass(frozen=True)
class Parameters:
    """Parameters of the learned filter."""

    iterations: int = parameter(
        3,
        "stages of the cascade, each with its own network; 0 returns the mesh as it is",
        symbol="n",
        low=0,
        high=3,
        more="smoother flat and round parts, sharper edges",
    )
    vertex_iterations: int = parameter(
        20,
        "passes that fit the vertices to the normals after the last stage",
        low=0,
        high=1000,
        more="faces closer to their normals, vertices farther from the scan",
    )
    boundary: str = parameter(
        "free",
        "vertices at open edges: moved like the others by the faces that they have, or fixed",
        choices=("free", "fixed"),
    )
    sliding: str = sliding_parameter()


def denoised(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep | None = None) -> Result:
    """The learned filter on ``mesh``; see the module's description."""
    started = time.perf_counter()
    positions = mesh.vertices.copy()
    stages = parameters.iterations
    if not stages:
        return Result(positions, seconds={"normals": 0.0, "sweeps": 0.0})
    cascade = Cascade(mesh, parameters.boundary)
    normals = None
    ready = time.perf_counter()
    for done, network in enumerate(load_networks()[:stages], start=1):
        normals = cascade.describe(positions, normals).predict(network)
        passes = STAGE_PASSES if done < stages else parameters.vertex_iterations
        positions = cascade.fit(positions, normals, passes)
        if on_sweep is not None:
            on_sweep(done, stages)
    positions = settled(mesh, positions, parameters.sliding, parameters.boundary)
    finished = time.perf_counter()
    return Result(positions, seconds={"normals": ready - started, "sweeps": finished - ready})
