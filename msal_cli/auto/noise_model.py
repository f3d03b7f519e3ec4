"""Noise as a random field over a mesh, to draw from: what the estimate has found out.

One draw is a field of heights along a direction, with a colour and a level by region:

    noise_i = level_i h_i a_i

    h  standard normal numbers, white or averaged over one-rings and scaled back
    a  the vertex normals, or one axis; isotropic noise has three such fields, one per coordinate
    level_i  one level, or that of the region

Simulations need only draws from it.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.measures import share_over_rings
from msal_cli.analysis.noise_estimate import NoiseLevel, local_levels
from msal_cli.arrays import Floats
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh

NORMALS, ISOTROPIC, AXIS = "normals", "isotropic", "axis"
"""Directions of noise."""

DRAWN_KINDS = ("white", "isotropic")
"""Kinds whose noise is drawn: that of scanners is like no draw of the others."""

QUIETEST = 0.05
"""Least level of a place over that of all: moves there are errors, but not beyond measure."""


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Noise to draw from."""

    # standard deviation of a displacement along its direction, file units; per coordinate if it is
    # isotropic
    level: float
    rings: int = 0  # how many averages over one-rings its colour is like; 0 for white noise
    direction: str = NORMALS  # ``NORMALS``, ``ISOTROPIC`` or ``AXIS``
    axis: tuple[float, float, float] | None = None  # unit vector (3,) of the last; None otherwise
    # (n,) level of each vertex over ``level``, for noise that is not the same everywhere; None
    # where it is
    shares: Floats | None = None
    # of depths that are rounded, file units: along the axis or, without one, along the coordinate
    # axis that is nearest to the normal; 0 for none
    step: float = 0.0

    @property
    def is_gaussian(self) -> bool:
        """Whether its heights are Gaussian."""
        return not self.step

    def along_normals(self) -> NoiseModel:
        """The same noise; if it is in all directions, only the part along the normals counts."""
        return dataclasses.replace(self, direction=NORMALS) if self.axis is None else self

    def at_level(self, level: float) -> NoiseModel:
        """The same noise, of another level in file units."""
        return dataclasses.replace(self, level=level)

    def on_part(self, numbers: NDArray[Any] | None) -> NoiseModel:
        """The same noise on some vertices (m,) of the mesh, by their numbers; None for all."""
        if self.shares is None or numbers is None:
            return self
        return dataclasses.replace(self, shares=self.shares[numbers])

    def variance(self, judged: NDArray[np.bool_]) -> float:
        """Mean of the squared displacement over the ``judged`` vertices, file units."""
        coordinates = 3.0 if self.direction == ISOTROPIC else 1.0
        if self.shares is None or not judged.any():
            return coordinates * self.level * self.level
        some = self.shares[judged]
        return coordinates * self.level * self.level * float((some * some).mean())

    def height(self, judged: NDArray[np.bool_], normals: Floats | None = None) -> float:
        """Root mean square of the displacement along the normals, file units, over the vertices
        that are ``judged``; along an axis that is less than the level, by ``normals`` (n, 3)."""
        coordinates = 3.0 if self.direction == ISOTROPIC else 1.0
        height = math.sqrt(self.variance(judged) / coordinates)
        if self.axis is None or normals is None:
            return height
        along = normals[judged] @ np.asarray(self.axis)
        return height * math.sqrt(float((along * along).mean())) if len(along) else height

    @property
    def scale(self) -> Floats:
        """Standard deviation of the displacements of all vertices, (1, 1) or (n, 1), file units."""
        shares = np.ones(1) if self.shares is None else self.shares
        return np.asarray(self.level * shares[:, None])

    def draw(self, mesh: Mesh, normals: Floats, generator: np.random.Generator) -> Floats:
        """One field of displacements (n, 3), file units; ``normals`` (n, 3) are those of the
        surface without the noise."""
        count = 3 if self.direction == ISOTROPIC else 1
        n = len(mesh.vertices)
        fields = [
            share_over_rings(mesh, generator.standard_normal(n), self.rings) for _ in range(count)
        ]
        if self.direction == ISOTROPIC:
            return np.asarray(self.scale * np.stack(fields, axis=1))
        along = normals if self.axis is None else np.asarray(self.axis)[None, :]
        return np.asarray(self.scale * (fields[0][:, None] * along))


def is_like_draws(noise: NoiseLevel) -> bool:
    """Whether draws of a model are like the noise: it is white."""
    return noise.character.kind in DRAWN_KINDS


def build_model(mesh: Mesh, noise: NoiseLevel) -> NoiseModel:
    """The estimated noise of a mesh as a field to draw from."""
    character = noise.character
    level = (noise.rms_edges if noise.is_impulsive else noise.mean_edges) * mesh.mean_edge_length
    shares = None
    # Along an axis, regions differ by their slope.
    if noise.is_uneven and not noise.is_impulsive and character.axis is None and level > 0.0:
        local = np.maximum(local_levels(mesh) * (mesh.mean_edge_length / level), QUIETEST)
        used = local[mesh.topology.has_ring]
        shares = local / math.sqrt(float((used * used).mean()))
    return NoiseModel(
        level,
        character.rings,
        character.direction,
        character.axis,
        shares,
        character.step * mesh.mean_edge_length,
    )
