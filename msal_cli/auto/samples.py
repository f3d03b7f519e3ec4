"""Samples for trials: the part of a mesh that candidates run on, the kind of its surface, and its
noise as a random field.

A sample of the noise is a field of heights along a direction, with a correlation and a level by
region:

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

from msal_cli.analysis.measures import share_over_rings
from msal_cli.analysis.noise_estimate import NoiseLevel, local_levels
from msal_cli.arrays import Flags, Floats, Ints, Longs
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.faces import dihedral_angles, flaps
from msal_cli.kernels.geometry import face_normals_and_areas
from msal_cli.kernels.quantiles import find_distinct, quantiles
from msal_cli.kernels.spatial_order import order_in_space
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh

PART = 6_000
"""Vertices of the part that candidates of a search run on; on smaller parts the estimates scatter
too much."""

PATCH = 2_000
"""Approximate number of vertices of a patch: smaller ones have too many vertices near the cut."""

SEEDS = 16_384
"""Number of vertices, evenly over the vertex numbers, from which patches of a large mesh may grow:
to sort a million in space takes too long for a short search."""

MARGIN = 3
"""Rings at the cut of a patch that are filtered but not evaluated: neighbours are missing."""


@dataclass(frozen=True, eq=False)
class Part:
    """A sample of a mesh, or the whole."""

    mesh: Mesh  # the patches as one mesh, or the whole
    judged: Flags  # (m,) bool, vertices at which errors are evaluated
    numbers: Ints | EllipsisType = ...  # (m,) vertex numbers in the whole mesh; ``...`` for all


def select_patch(mesh: Mesh, most: int = PART) -> Part:
    """Patches of about ``most`` vertices together; the whole mesh if it has hardly more.

    Fixed vertices and those that no face uses are not evaluated.  The sample has neither
    constraint.
    """
    links, n = mesh.topology, len(mesh.vertices)
    judged = (
        links.has_ring if mesh.fixed_vertices is None else links.has_ring & ~mesh.fixed_vertices
    )
    if n <= most + most // 4:
        is_free = mesh.fixed_vertices is None and mesh.trust is None
        return Part(mesh if is_free else mesh.with_constraints(None, None), judged)
    # Patches begin only at vertices that are evaluated.
    seeds = np.flatnonzero(judged if judged.any() else links.has_ring)
    if len(seeds) > 2 * SEEDS:
        seeds = seeds[:: len(seeds) // SEEDS]
    order = seeds[order_in_space(mesh.vertices[seeds])]
    inside = np.zeros(n, dtype=np.bool_)
    count = max(most // PATCH, 1)
    for patch in range(count):
        _grow(order, (2 * patch + 1) * len(order) // (2 * count), most // count, links, inside)
    # The first vertex is tested alone, which excludes most faces.
    chosen = np.flatnonzero(inside[mesh.faces[:, 0]])
    chosen = chosen[inside[mesh.faces[chosen]].all(axis=1)]
    if not len(chosen):
        # A vertex of a valence beyond the size of a patch may leave no complete face.
        chosen = np.flatnonzero(inside[mesh.faces].any(axis=1))[:most]
    used, corners = np.unique(mesh.faces[chosen], return_inverse=True)
    kept = judged[used] & ~_cut_rings(used, links)[used]
    part = Mesh(mesh.vertices[used], corners.reshape(-1, 3).astype(np.int32))
    return Part(part, kept if kept.any() else judged[used], used)


def _grow(order: Longs, start: int, size: int, links: Connectivity, inside: Flags) -> None:
    """Mark ``size`` more vertices as ``inside`` (n,) by breadth-first search from unmarked ones in
    ``order``, from index ``start`` on."""
    marked, place = 0, 0
    while marked < size:
        while place < len(order) and inside[order[(start + place) % len(order)]]:
            place += 1
        if place == len(order):
            return
        front = order[[(start + place) % len(order)]]
        while len(front):
            inside[front] = True
            marked += len(front)
            reached = find_distinct(links.rings_of(front)[1])
            front = reached[~inside[reached]][: size - marked]


def _cut_rings(used: Ints, links: Connectivity) -> Flags:
    """Whether each vertex (n,) is within ``MARGIN`` rings of one that is not ``used``."""
    near = np.ones(len(links.has_ring), dtype=np.bool_)
    near[used] = False
    rows, ring, _ = links.rings_of(used)
    owner = used[rows]
    for _ in range(MARGIN):
        near[owner[near[ring]]] = True
    return near


# The kind of a surface, by its dihedral angles

MACHINED, TEXTURED, ORGANIC, CLEAN = "machined", "textured", "organic", "clean"

SHARP = 9.0
"""A surface is machined if the 98th percentile of its dihedral angles is more than so many times
the third quartile: sharp edges between smooth parts.  On the models of benchmarks/ground_truth.py,
after a first blend, machined ones have 9.3 and more, others 8.7 and less, mostly 5."""

ROUGH_DEG, EVEN = 10.0, 3.3
"""A surface is textured from this 90th percentile of the angles, in degrees, up to this ratio of
the percentiles above: 2.3 to 2.8 on texture, 3.9 and more where noise is left on smooth parts
between edges."""

AWAY = 0.02
"""Share of the area of a range scan that may face away from the scanner, by noise at grazing
angles.  Scans from one view have 0.015 and less."""


def is_seen_from_one_side(mesh: Mesh) -> bool:
    """Whether the mesh is open and hardly any of its area faces away: a scan from one view."""
    if not mesh.topology.boundary.any():
        return False
    normals, areas = face_normals_and_areas(mesh.vertices, mesh.faces)
    axis = np.einsum("ij,i->j", normals, areas)
    away = areas[np.einsum("ij,j->i", normals, axis) < 0.0]
    return float(away.sum()) <= AWAY * float(areas.sum())


def surface_kind(mesh: Mesh) -> str:
    """``MACHINED``, ``TEXTURED`` or ``ORGANIC``, for a mesh without much noise."""
    angles = dihedral_angles(mesh.vertices, flaps(mesh.faces, mesh.topology))
    if not len(angles):
        return ORGANIC
    usual, rough, sharp = np.degrees(quantiles(angles, (0.75, 0.9, 0.98)))
    if sharp > SHARP * usual and sharp > ROUGH_DEG:
        return MACHINED
    return TEXTURED if rough >= ROUGH_DEG and sharp <= EVEN * usual else ORGANIC


# The noise as a random field

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

    def height(self, judged: Flags, normals: Floats | None = None) -> float:
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
