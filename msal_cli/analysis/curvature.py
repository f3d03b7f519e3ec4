"""Mean curvature at the vertices of a mesh."""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats
from msal_cli.mesh import Mesh


def mean_curvature(mesh: Mesh) -> Floats:
    """Mean curvature (n,), one over file units: 1/r on a sphere of radius r wound outward.

    Half the length of the cotangent Laplacian over the mixed Voronoi area (Meyer et al. 2003),
    positive where it points against the vertex normal: on what bulges outward.  At open edges, and
    at vertices without area, it is 0, for it means nothing there.
    """
    from msal_cli.kernels.cotangent import cotangent_weights, mixed_areas

    x, links = mesh.vertices, mesh.topology
    weights = cotangent_weights(x, mesh.faces, links)
    areas = mixed_areas(x, mesh.faces, links)
    owner = np.repeat(np.arange(len(x)), np.diff(links.ring_start))
    gradient = np.empty_like(x)
    for axis in range(3):
        steps = weights * (x[owner, axis] - x[links.ring, axis])
        gradient[:, axis] = np.bincount(owner, steps, minlength=len(x))
    length = np.sqrt((gradient * gradient).sum(axis=1))
    side = np.sign((gradient * mesh.vertex_normals()).sum(axis=1))
    means_something = ~links.boundary & (areas > 0.0)
    curvature: Floats = side * length / (4.0 * np.where(means_something, areas, np.inf))
    return curvature
