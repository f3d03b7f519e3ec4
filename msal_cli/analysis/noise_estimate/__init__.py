"""How much noise there is on a mesh, and of what kind, or whether it has any.

``white`` measures the level of noise that each vertex has of its own, from fits over one- and
two-rings.  ``survey`` looks at fewer places over up to six rings; ``colour``, ``direction``,
``steps``, ``unevenness`` and ``spikes`` measure what each kind of noise would leave there, and
``evidence`` makes numbers of it all.  ``classifier`` says from these how probable every kind is,
and ``character`` puts the estimate together.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from msal_cli.analysis.noise_estimate.character import characterize
from msal_cli.analysis.noise_estimate.level import (
    NOISE,
    SURE,
    TEXTURE,
    NoiseCharacter,
    NoiseLevel,
    Reading,
)
from msal_cli.analysis.noise_estimate.regions import find_nearest
from msal_cli.analysis.noise_estimate.white import estimate_white
from msal_cli.arrays import Floats

if TYPE_CHECKING:
    from msal_cli.mesh import Mesh

__all__ = [
    "NOISE",
    "SURE",
    "TEXTURE",
    "NoiseCharacter",
    "NoiseLevel",
    "Reading",
    "estimate_noise",
    "estimate_regions",
]


def estimate_noise(mesh: Mesh) -> NoiseLevel:
    """The noise of a mesh.

    Noise of 0.05 to 0.7 mean edge lengths is estimated within some per cent where it is white, and
    within about 15 % where neighbours share it.  Detail as fine as the mesh itself may look like
    noise: ``readings`` say how probable both are, and where neither is sure the estimate is
    ``is_unsure``.  The result does not depend on how the mesh is moved or scaled, nor on the number
    of threads.  Its cost hardly depends on the size of the mesh.
    """
    return characterize(mesh, estimate_white(mesh)).level


def estimate_regions(mesh: Mesh) -> Floats:
    """Level of the noise around each vertex (n,), file units: that of the region it lies in.

    Vertices that no face uses have 0.
    """
    result = characterize(mesh, estimate_white(mesh))
    nearest = find_nearest(mesh.vertices, result.middles)
    return np.where(mesh.topology.has_ring, result.regions[nearest], 0.0)
