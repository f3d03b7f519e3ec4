"""Noise on meshes: how to add a known amount; ``noise_estimate`` tells how much there is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.errors import UsageError
from msal_cli.mesh import Mesh

Floats = NDArray[np.float64]

KINDS = {
    "gaussian-normal": "Gaussian along the vertex normals",
    "gaussian": "Gaussian in each coordinate",
    "mixed": "Gaussian along the normals, and as much along a random direction across them",
    "impulsive": "Gaussian along the normals, at a fraction of the vertices only",
}
"""The kinds of noise that ``noisy`` adds; ``mixed`` is that of the paper's Fig. 7."""


def noisy(mesh: Mesh, kind: str, level: float, seed: int, fraction: float = 0.1) -> Floats:
    """Positions (n, 3) of the mesh with noise added, the same for the same arguments.

    Parameters
    ----------
    kind : one of ``KINDS``.
    level : standard deviation in mean edge lengths: greater is noisier.
    seed : from 0; another one gives other noise of the same kind.
    fraction : share of the vertices that ``impulsive`` moves, 0 to 1.

    A vertex that no face uses has no normal, and is not moved by what goes along it.
    """
    draw = np.random.Generator(np.random.PCG64(seed))
    n = len(mesh.vertices)
    amount = level * mesh.mean_edge_length
    if kind == "gaussian":
        return mesh.vertices + amount * draw.standard_normal((n, 3))
    normals = mesh.vertex_normals()
    heights = draw.standard_normal(n)
    if kind == "gaussian-normal":
        return mesh.vertices + (amount * heights)[:, None] * normals
    if kind == "impulsive":
        moved = draw.permutation(n)[: round(fraction * n)]
        result = mesh.vertices.copy()
        result[moved] += (amount * heights[moved])[:, None] * normals[moved]
        return result
    if kind != "mixed":
        raise UsageError(f"there is no noise {kind!r}", hint=f"known are: {', '.join(KINDS)}")
    lengths, angles = draw.standard_normal(n), draw.uniform(0.0, 2.0 * np.pi, n)
    first, second = _across(normals)
    across = np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second
    return mesh.vertices + amount * (heights[:, None] * normals + lengths[:, None] * across)


def _across(normals: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors (n, 3) each at right angles to the normals and to each other."""
    # From the axis that the normal leans to least.
    axis = np.zeros_like(normals)
    axis[np.arange(len(normals)), np.abs(normals).argmin(axis=1)] = 1.0
    first = np.cross(normals, axis)
    lengths = np.sqrt((first * first).sum(axis=1))
    first /= np.where(lengths > 0.0, lengths, 1.0)[:, None]
    return first, np.cross(normals, first)
