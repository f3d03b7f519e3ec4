"""The local scale sigma of the paper: how rough the surroundings of each vertex are."""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats
from msal_cli.mesh import Mesh


def local_scale(mesh: Mesh, normals: Floats) -> Floats:
    """sigma (n,) of eq. (4), file units; 0 where the one-ring is flat.

    It is 2 mean|h - mean h| over the heights h of the one-ring above the plane across each normal.

    ``normals`` are (n, 3), of unit length or zero.
    """
    from msal_cli.kernels.operators import AnisotropicLaplacian

    links = mesh.topology
    free = np.ones(len(mesh.vertices), dtype=bool)
    laplacian = AnisotropicLaplacian(
        normals, links.ring_start, links.ring, free, mesh.mean_edge_length
    )
    sigma = laplacian(mesh.vertices).sigma
    assert sigma is not None
    return sigma
