"""Undo the shrinkage of a closed surface by scaling it about its centre of mass."""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.geometry import area_and_volume


@compiled
def _volume_moment(vertices, faces, moment):
    """Integral of the position over the volume, and the volume, times 24."""
    volume = 0.0
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        px = vertices[b, 1] * vertices[c, 2] - vertices[b, 2] * vertices[c, 1]
        py = vertices[b, 2] * vertices[c, 0] - vertices[b, 0] * vertices[c, 2]
        pz = vertices[b, 0] * vertices[c, 1] - vertices[b, 1] * vertices[c, 0]
        part = vertices[a, 0] * px + vertices[a, 1] * py + vertices[a, 2] * pz
        volume += part
        for axis in range(3):
            moment[axis] += part * (vertices[a, axis] + vertices[b, axis] + vertices[c, axis])
    return 4.0 * volume


def with_volume_of(original: Floats, vertices: Floats, faces: Ints) -> Floats:
    """``vertices`` (n, 3) scaled so that the closed surface has the volume of ``original`` (n, 3).

    The factor is the cube root of the ratio of the volumes (Desbrun et al. 1999), the fixed point
    the centre of mass of the solid, so that the surface does not wander off.  Vertices that no
    face (m, 3) has are left alone, and so are all where a volume is zero or changed its sign.
    """
    wanted = area_and_volume(original, faces)[1]
    moment = np.zeros(3)
    volume = float(_volume_moment(vertices, faces, moment)) / 24.0
    if wanted == 0.0 or volume == 0.0 or (wanted > 0.0) != (volume > 0.0):
        return vertices
    centre = moment / (24.0 * volume)
    used = np.zeros(len(vertices), dtype=bool)
    used[faces.reshape(-1)] = True
    scaled = centre + (wanted / volume) ** (1.0 / 3.0) * (vertices - centre)
    result: Floats = np.where(used[:, None], scaled, vertices)
    return result
