"""Measures of a mesh, and of how far and how its surface changed.

Displacements, distances, mean curvature, the local scale of the paper, area, volume, the angles
between face normals, and faces that intersect each other.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from msal_cli.arrays import Flags, Floats, Longs
from msal_cli.mesh import Mesh

FLAT = 1e-9
"""A volume below this share of area ** 1.5 is rounding: the surface encloses nothing."""


@dataclass(frozen=True)
class DistanceStatistics:
    """Mean, root mean square, 95th percentile and maximum of distances, file units."""

    mean: float
    rms: float
    p95: float
    max: float


@dataclass(frozen=True)
class DisplacementStatistics(DistanceStatistics):
    """Statistics of how far vertices moved, and how many moved at all."""

    moved_vertices: int


def distance_statistics(lengths: Floats) -> DistanceStatistics:
    """Statistics of distances (n,), n >= 1."""
    from msal_cli.kernels.quantiles import select_ranks

    rank = min(len(lengths) - 1, int(np.ceil(0.95 * len(lengths))) - 1)
    return DistanceStatistics(
        mean=float(lengths.mean()),
        rms=float(np.sqrt((lengths * lengths).mean())),
        p95=select_ranks(lengths, rank)[0],
        max=float(lengths.max()),
    )


def displacement_statistics(
    before: Floats, after: Floats, counted: Flags | None = None
) -> DisplacementStatistics:
    """Statistics of the distances between (n, 3) positions over the ``counted`` (n,) vertices."""
    from msal_cli.kernels.geometry import distances

    lengths = distances(before, after)
    if counted is not None and not counted.all():
        lengths = lengths[counted]
    if not len(lengths):
        return DisplacementStatistics(0.0, 0.0, 0.0, 0.0, 0)
    moved = int(np.count_nonzero(lengths))
    return DisplacementStatistics(**asdict(distance_statistics(lengths)), moved_vertices=moved)


@dataclass(frozen=True)
class SurfaceChange:
    """Areas in squared and signed volumes in cubed file units, and the angles between corresponding
    face normals, over the faces that have one in both meshes.

    ``mean_angular_error_deg`` is what much of the literature prints as MSAE;
    ``flipped_faces`` turned by more than a right angle.
    """

    area_before: float
    area_after: float
    volume_before: float
    volume_after: float
    mean_angular_error_deg: float
    max_angular_error_deg: float
    flipped_faces: int


def measure_surface_change(before: Mesh, after: Mesh) -> SurfaceChange:
    """The change between two meshes with the same faces."""
    from msal_cli.kernels import geometry as core

    figures = core.surface_figures(before.vertices, after.vertices, before.faces)
    return SurfaceChange(
        area_before=float(figures[core.DOUBLED_AREA_BEFORE] / 2.0),
        area_after=float(figures[core.DOUBLED_AREA_AFTER] / 2.0),
        volume_before=float(figures[core.SIXFOLD_VOLUME_BEFORE] / 6.0),
        volume_after=float(figures[core.SIXFOLD_VOLUME_AFTER] / 6.0),
        mean_angular_error_deg=float(
            np.degrees(figures[core.ANGLES] / max(figures[core.COMPARED], 1.0))
        ),
        max_angular_error_deg=float(np.degrees(figures[core.LARGEST_ANGLE])),
        flipped_faces=int(figures[core.FLIPPED]),
    )


def mean_curvature(mesh: Mesh) -> Floats:
    """Mean curvature (n,), one over file units: 1/r on a sphere of radius r wound outward.

    Half the length of the cotangent Laplacian over the mixed Voronoi area (Meyer et al. 2003),
    positive where it points against the vertex normal: on what bulges outward.  At open edges, and
    at vertices without area, it is 0, for it means nothing there.
    """
    from msal_cli.kernels.curvature import cotangent_weights, mixed_areas

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


def area_and_volume(mesh: Mesh) -> tuple[float, float]:
    """Area in squared and signed volume in cubed file units (Desbrun et al. 1999).

    The volume means something only where the surface is closed, manifold and wound one way; that
    of an open surface is the one seen from the mesh's local origin.  It is negative where the
    surface is inside out.
    """
    from msal_cli.kernels import geometry

    return geometry.area_and_volume(mesh.vertices, mesh.faces)


def is_negative(volume: float, area: float) -> bool:
    """Whether a closed surface with this signed volume and area is inside out."""
    return volume < -_flat_volume(area)


def relative_volume_change(before: float, after: float, area: float) -> float | None:
    """Change of the volume that a closed surface encloses, over what it enclosed before.

    ``before`` and ``after`` are volumes of the same faces with one sign, ``area`` is the area
    before.  Less is shrinking, also of negative volumes; below -1 the surface passed through
    itself.  None where it encloses nothing before.
    """
    if abs(before) <= _flat_volume(area):
        return None
    return (after - before) / before


def _flat_volume(area: float) -> float:
    return FLAT * area * math.sqrt(area)


def apply_umbrella(mesh: Mesh, values: Floats) -> Floats:
    """The umbrella (n, 3) of values (n, 3): the mean over the one-ring less the own value."""
    from msal_cli.kernels.geometry import ring_means

    moves = np.empty_like(values)
    for axis in range(3):
        column = np.ascontiguousarray(values[:, axis])
        moves[:, axis] = ring_means(column, *mesh.topology.one_ring) - column
    return moves


def share_over_rings(mesh: Mesh, heights: Floats, rings: int) -> Floats:
    """Heights (n,) averaged ``rings`` times over closed one-rings, with a root mean square of 1.

    Neighbours then share noise: on a regular triangle grid the correlation with a neighbour is
    0.57 after one average and 0.78 after two.  With no rings they are returned as they are.
    """
    from msal_cli.kernels.geometry import ring_means

    if not rings:
        return heights
    counts = np.diff(mesh.topology.ring_start).astype(np.float64)
    for _ in range(rings):
        means = ring_means(heights, *mesh.topology.one_ring)
        heights = (counts * means + heights) / (counts + 1.0)
    used = heights[mesh.topology.has_ring]
    return heights / math.sqrt(float((used * used).mean()))


def count_self_intersections(mesh: Mesh) -> int:
    """How many pairs of faces intersect; see ``kernels.intersections``.

    Faces without area are left out: they touch their neighbours all along an edge.
    """
    return len(_pairs(mesh))


def self_intersection_change(before: Mesh, after: Mesh) -> tuple[int, int, int]:
    """The counts for a mesh and the same faces at other positions, and how many pairs intersect
    after that did not before."""
    pairs = _pairs(before)
    if np.array_equal(before.vertices, after.vertices):
        return len(pairs), len(pairs), 0
    later = _pairs(after)
    return len(pairs), len(later), len(np.setdiff1d(later, pairs, assume_unique=True))


def _pairs(mesh: Mesh) -> Longs:
    """A number for each pair of faces that intersect, the same for the same faces."""
    from msal_cli.kernels.geometry import face_normals
    from msal_cli.kernels.intersections import intersecting_pairs

    has_area = np.flatnonzero(face_normals(mesh.vertices, mesh.faces).any(axis=1))
    pairs = has_area[intersecting_pairs(mesh.vertices, mesh.faces[has_area])]
    numbers: Longs = pairs[:, 0] * len(mesh.faces) + pairs[:, 1]
    return numbers
