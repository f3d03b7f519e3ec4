"""The estimated noise as a random field over a mesh, for simulations.

A sample is a field of heights along a direction, with a correlation and a level by region:

    noise_i = level_i h_i a_i

    h  standard normal numbers, white or averaged over one-rings and scaled to unit variance
    a  the vertex normals, or one axis; isotropic noise has three such fields, one per coordinate
    level_i  one level, or that of the region
"""

from __future__ import annotations

import dataclasses
import math
from types import EllipsisType

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.measures import share_over_rings
from msal_cli.analysis.noise_estimate import NoiseLevel, local_levels
from msal_cli.arrays import Floats, Ints
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh

NORMALS, ISOTROPIC, AXIS = "normals", "isotropic", "axis"
"""Directions of noise."""

DRAWN_KINDS = ("white", "isotropic")
"""Kinds of noise that samples of the model resemble; scanner noise of other kinds they do not."""

QUIETEST = 0.05
"""Smallest local level over the overall one, which limits the weight of errors in quiet regions."""


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """A random field of noise."""

    # standard deviation of displacements, or of each coordinate for isotropic noise, file units
    level: float
    rings: int = 0  # averages over one-rings that make its correlation; 0 for white noise
    direction: str = NORMALS  # ``NORMALS``, ``ISOTROPIC`` or ``AXIS``
    axis: tuple[float, float, float] | None = None  # unit vector (3,) of ``AXIS``; else None
    # (n,) level of each vertex over ``level``, for uneven noise; else None
    shares: Floats | None = None

    def along_normals(self) -> NoiseModel:
        """The same noise along the normals if it is isotropic."""
        return dataclasses.replace(self, direction=NORMALS) if self.axis is None else self

    def at_level(self, level: float) -> NoiseModel:
        return dataclasses.replace(self, level=level)

    def on_part(self, numbers: Ints | EllipsisType) -> NoiseModel:
        """The same noise on the vertices ``numbers`` (m,) of the mesh, ``...`` for all."""
        if self.shares is None:
            return self
        return dataclasses.replace(self, shares=self.shares[numbers])

    def height(self, judged: NDArray[np.bool_], normals: Floats | None = None) -> float:
        """Root mean square of the normal displacement over the ``judged`` vertices (n,), file
        units.  For noise along an axis it depends on the ``normals`` (n, 3)."""
        height = self.level
        if self.shares is not None and judged.any():
            some = self.shares[judged]
            height = math.sqrt(self.level * self.level * float((some * some).mean()))
        if self.axis is None or normals is None:
            return height
        along = normals[judged] @ np.asarray(self.axis)
        return height * math.sqrt(float((along * along).mean())) if len(along) else height

    @property
    def scale(self) -> Floats:
        """Standard deviation of the displacements, (1, 1) or of each vertex (n, 1), file units."""
        shares = np.ones(1) if self.shares is None else self.shares
        return np.asarray(self.level * shares[:, None])

    def draw(self, mesh: Mesh, normals: Floats, generator: np.random.Generator) -> Floats:
        """A sample of displacements (n, 3), file units, for ``normals`` (n, 3) without noise."""
        count = 3 if self.direction == ISOTROPIC else 1
        n = len(mesh.vertices)
        fields = [
            share_over_rings(mesh, generator.standard_normal(n), self.rings) for _ in range(count)
        ]
        if self.direction == ISOTROPIC:
            return np.asarray(self.scale * np.stack(fields, axis=1))
        along = normals if self.axis is None else np.asarray(self.axis)[None, :]
        return np.asarray(self.scale * (fields[0][:, None] * along))


def build_model(mesh: Mesh, noise: NoiseLevel) -> NoiseModel:
    """The estimated noise of a mesh as a random field."""
    character = noise.character
    level = (noise.rms_edges if noise.is_impulsive else noise.mean_edges) * mesh.mean_edge_length
    shares = None
    # Along an axis, regions differ in height by their slope, not in level.
    if noise.is_uneven and not noise.is_impulsive and character.axis is None and level > 0.0:
        local = np.maximum(local_levels(mesh) * (mesh.mean_edge_length / level), QUIETEST)
        used = local[mesh.topology.has_ring]
        shares = local / math.sqrt(float((used * used).mean()))
    return NoiseModel(level, character.rings, character.direction, character.axis, shares)
