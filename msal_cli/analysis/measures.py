"""Measures of a mesh, and of how its surface changed.

Displacements, distances from surface to surface, area, volume, mean curvature, the local scale of
the paper, the angles between face normals, faces that intersect each other, what a closed surface
encloses whichever side its normals point to, and changes so large that they are damage rather than
denoising.
"""

import math
from dataclasses import replace

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints, Longs
from msal_cli.kernels import geometry
from msal_cli.kernels.connectivity import component_labels
from msal_cli.kernels.quantiles import quantiles
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Defects, Mesh, PreparedMesh

FLAT = 1e-9
"""A volume below this share of area ** 1.5 is rounding: the surface encloses nothing."""


@dataclass(frozen=True)
class DistanceStatistics:
    """Mean, root mean square, 95th percentile and maximum of distances, file units, and how many
    are not 0."""

    mean: float
    rms: float
    p95: float
    max: float
    n_moved: int


def distance_statistics(lengths: Floats) -> DistanceStatistics:
    """Statistics of distances (n,), zeros for none."""
    if not len(lengths):
        return DistanceStatistics(0.0, 0.0, 0.0, 0.0, 0)
    rank = min(len(lengths) - 1, int(np.ceil(0.95 * len(lengths))) - 1)
    return DistanceStatistics(
        mean=float(lengths.mean()),
        rms=float(np.sqrt((lengths * lengths).mean())),
        p95=float(np.partition(lengths, rank)[rank]),
        max=float(lengths.max()),
        n_moved=int(np.count_nonzero(lengths)),
    )


def displacement(before: Mesh, after: Mesh) -> DistanceStatistics:
    """How far the vertices that faces use are apart in two meshes with the same faces."""
    lengths, is_used = geometry.distances(before.vertices, after.vertices), before.topology.has_ring
    return distance_statistics(lengths if is_used.all() else lengths[is_used])


def vertex_error_percent(reference: Mesh, other: Mesh) -> float:
    """Mean distance between corresponding vertices in % of the reference's mean edge length."""
    return 100.0 * displacement(reference, other).mean / reference.mean_edge_length


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
    figures = geometry.surface_figures(before.vertices, after.vertices, before.faces)
    angle = figures[geometry.ANGLES] / max(figures[geometry.COMPARED], 1.0)
    return SurfaceChange(
        area_before=float(figures[geometry.DOUBLED_AREA_BEFORE] / 2.0),
        area_after=float(figures[geometry.DOUBLED_AREA_AFTER] / 2.0),
        volume_before=float(figures[geometry.SIXFOLD_VOLUME_BEFORE] / 6.0),
        volume_after=float(figures[geometry.SIXFOLD_VOLUME_AFTER] / 6.0),
        mean_angular_error_deg=float(np.degrees(angle)),
        max_angular_error_deg=float(np.degrees(figures[geometry.LARGEST_ANGLE])),
        flipped_faces=int(figures[geometry.FLIPPED]),
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
    from msal_cli.kernels.operators import RingOperator

    links = mesh.topology
    free = np.ones(len(mesh.vertices), dtype=bool)
    laplacian = RingOperator(normals, links.ring_start, links.ring, free, mesh.mean_edge_length)
    sigma = laplacian(mesh.vertices).sigma
    assert sigma is not None
    return sigma


def area_and_volume(mesh: Mesh) -> tuple[float, float]:
    """Area in squared and signed volume in cubed file units (Desbrun et al. 1999).

    The volume means something only where the surface is closed, manifold and wound one way; that
    of an open surface is the one seen from the mesh's local origin.  It is negative where the
    surface is inside out.
    """
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
    return geometry.apply_umbrella(values, *mesh.topology.one_ring, mesh.topology.has_ring)


def share_over_rings(mesh: Mesh, heights: Floats, rings: int) -> Floats:
    """Heights (n,) averaged ``rings`` times over closed one-rings, with a root mean square of 1.

    Neighbours then share noise: on a regular triangle grid the correlation with a neighbour is
    0.57 after one average and 0.78 after two.  With no rings they are returned as they are.
    """
    if not rings:
        return heights
    counts = np.diff(mesh.topology.ring_start).astype(np.float64)
    for _ in range(rings):
        means = geometry.ring_means(heights, *mesh.topology.one_ring)
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
    from msal_cli.kernels.intersections import intersecting_pairs

    has_area = np.flatnonzero(geometry.face_normals(mesh.vertices, mesh.faces).any(axis=1))
    pairs = has_area[intersecting_pairs(mesh.vertices, mesh.faces[has_area])]
    numbers: Longs = pairs[:, 0] * len(mesh.faces) + pairs[:, 1]
    return numbers


# A mesh against another whose vertices need not correspond

ROUNDING = 4.0 * float(np.finfo(np.float64).eps)
"""Distances below this share of the coordinates are taken for none."""

MIN_SCALE, MAX_SCALE = 1e-50, 1e50
"""Coordinates outside are divided by the greatest: their sixth powers would vanish or overflow."""

MAX_POINTS = 4_000_000
"""Vertices and face centres of a mesh up to which the distances of all are measured."""

SAMPLED_POINTS = 1_000_000
"""How many are measured of more: every fifth, sixth and so on, evenly spread over the file."""


def nearest_on_surface(points: Floats, surface: Mesh) -> tuple[Ints, Floats]:
    """The triangle of ``surface`` nearest to each of the points (n, 3), and its distance in file
    units, both (n,)."""
    from msal_cli.kernels.nearest_triangles import find_nearest_triangles

    scale = max(float(np.abs(points).max(initial=0.0)), float(np.abs(surface.vertices).max()))
    vertices, unit = surface.vertices, 1.0
    if scale and not MIN_SCALE < scale < MAX_SCALE:
        points, vertices, unit = points / scale, vertices / scale, scale
    triangles, distances = find_nearest_triangles(points, vertices, surface.faces)
    distances *= unit
    # What lies on the surface is off by the last digits of its coordinates.
    distances[distances < ROUNDING * scale] = 0.0
    return triangles, distances


def at_other_positions(ready: PreparedMesh, vertices: Floats) -> Mesh:
    """The prepared mesh with its vertices where ``vertices`` (n_file, 3) of another file are.

    Of file vertices that are one in the mesh the first counts; see ``PreparedMesh.seam_gap``.
    """
    if ready.vertex_map is None:
        return ready.mesh.with_vertices(vertices - ready.origin)
    positions = np.array(ready.mesh.vertices)
    # The first comes last, and so prevails.
    there = np.flatnonzero(ready.vertex_map >= 0)[::-1]
    positions[ready.vertex_map[there]] = vertices[there] - ready.origin
    return ready.mesh.with_vertices(positions)


def used_vertices(mesh: Mesh) -> Floats:
    """Positions (k, 3) of the vertices that faces use."""
    has_ring = mesh.topology.has_ring
    return mesh.vertices if has_ring.all() else mesh.vertices[has_ring]


def sampling_step(mesh: Mesh) -> int:
    """Every which vertex and face centre of a mesh ``surface_distances`` looks at."""
    count = len(mesh.vertices) + len(mesh.faces)
    return 1 if count <= MAX_POINTS else -(-count // SAMPLED_POINTS)


def surface_distances(
    before: Mesh, after: Mesh
) -> tuple[DistanceStatistics, DistanceStatistics, float]:
    """Distances of ``after``'s vertices to ``before``'s surface, the other way round, and the
    Hausdorff distance, file units; both meshes are about one origin.

    The Hausdorff distance is taken over the vertices and the centres of the faces of both meshes:
    what lies between them might be a little further away.  Of large meshes they are those of a
    sample, see ``sampling_step``.
    """
    figures, largest = [], 0.0
    for points_of, surface in ((after, before), (before, after)):
        step = sampling_step(points_of)
        vertices = used_vertices(points_of)[::step]
        centres = points_of.vertices[points_of.faces[::step]].mean(axis=1)
        _, lengths = nearest_on_surface(np.concatenate([vertices, centres]), surface)
        figures.append(distance_statistics(lengths[: len(vertices)]))
        largest = max(largest, float(lengths.max()))
    return figures[0], figures[1], largest


# What a closed surface encloses
#
# The signed volume is negative where a surface is inside out, and in a file of several parts one
# that is inside out counts against the others.  Here each part is taken with its normals outwards,
# but for cavities: a part within another one keeps its winding relative to that one.

MAX_PARTS = 1000
"""Parts beyond which only the sum of all is looked at: each is compared with each other."""

INSIDE_OUT = "the surface is inside out: its normals point inwards"


@dataclass(frozen=True, eq=False)
class Enclosure:
    """Which faces of a closed surface have their normals inwards."""

    # (m,) the faces of parts that are inside out; None if there are none
    inward: Flags | None
    n_turned: int  # n_turned, n_parts: how many parts are inside out, and how many there are
    n_parts: int

    @property
    def is_inside_out(self) -> bool:
        """Whether the surface, or a part of it, is inside out."""
        return self.inward is not None

    @property
    def words(self) -> str:
        """Which parts are inside out, in words; empty if none is."""
        if not self.is_inside_out:
            return ""
        if self.n_turned == self.n_parts:
            return INSIDE_OUT
        are = "is" if self.n_turned == 1 else "are"
        return (
            f"{self.n_turned:,} of {self.n_parts:,} parts {are} inside out: normals point inwards"
        )

    def volume(self, mesh: Mesh, signed: float) -> float:
        """The volume that ``mesh``, with these faces and this ``signed`` volume, encloses."""
        if self.inward is None:
            return signed
        if self.inward.all():
            return -signed
        faces = np.where(self.inward[:, None], mesh.faces[:, ::-1], mesh.faces)
        return area_and_volume(Mesh(mesh.vertices, faces))[1]

    def change(self, before: Mesh, after: Mesh, change: SurfaceChange) -> SurfaceChange:
        """``change`` with the volumes that are enclosed in place of the signed ones."""
        return replace(
            change,
            volume_before=self.volume(before, change.volume_before),
            volume_after=self.volume(after, change.volume_after),
        )

    def outward_signs(self, mesh: Mesh) -> Floats:
        """1 where normals point outwards and -1 where they point inwards, for each vertex (n,)."""
        signs = np.ones(len(mesh.vertices))
        if self.inward is not None:
            signs[mesh.faces[self.inward]] = -1.0
        return signs


def measure_enclosure(ready: PreparedMesh) -> Enclosure:
    """What a surface encloses; one that has no volume has no inside."""
    return enclosure_of(ready.mesh, ready.defects, *area_and_volume(ready.mesh))


def enclosure_of(mesh: Mesh, defects: Defects, area: float, volume: float) -> Enclosure:
    """The same for a mesh of which ``area`` and signed ``volume`` are known."""
    n_parts = defects.components
    if defects.volume_objection:
        return Enclosure(None, 0, n_parts)
    if 1 < n_parts <= MAX_PARTS:
        return _enclosure_by_part(mesh)
    if is_negative(volume, area):
        return Enclosure(np.ones(len(mesh.faces), dtype=bool), n_parts, n_parts)
    return Enclosure(None, 0, n_parts)


def _enclosure_by_part(mesh: Mesh) -> Enclosure:
    first = mesh.faces[:, 0]
    labels = component_labels(len(mesh.vertices), mesh.faces)
    numbers, part_of_face = np.unique(labels[first], return_inverse=True)
    n_parts = len(numbers)
    normals, face_areas = geometry.face_normals_and_areas(mesh.vertices, mesh.faces)
    # A face and the origin span a third of area times height.
    heights = np.einsum("ij,ij->i", mesh.vertices[first], normals)
    areas = np.bincount(part_of_face, face_areas, n_parts)
    volumes = np.bincount(part_of_face, face_areas * heights, n_parts) / 3.0
    is_turned = np.array([is_negative(*figures) for figures in zip(volumes, areas, strict=True)])
    if not is_turned.any():
        return Enclosure(None, 0, n_parts)
    used = np.flatnonzero(mesh.topology.has_ring)
    part_of_vertex = np.searchsorted(numbers, labels[used])
    low, high = np.full((n_parts, 3), np.inf), np.full((n_parts, 3), -np.inf)
    np.minimum.at(low, part_of_vertex, mesh.vertices[used])
    np.maximum.at(high, part_of_vertex, mesh.vertices[used])
    # Each part is as the largest one whose box it lies in: itself, if there is none.
    is_within = (low[:, None] > low[None]).all(axis=2) & (high[:, None] < high[None]).all(axis=2)
    is_within |= np.eye(n_parts, dtype=bool)
    outermost = np.where(is_within, (high - low).prod(axis=1)[None], -1.0).argmax(axis=1)
    is_turned = is_turned[outermost]
    n_turned = int(np.count_nonzero(is_turned))
    return Enclosure(is_turned[part_of_face] if n_turned else None, n_turned, n_parts)


# Damage
#
# Two rules hold whatever the noise is.  The volume of a closed surface changed by more than
# half.  Or more faces flipped (turned by more than a right angle) than 2 % of all, and three for
# every two faces that were folded before: strong noise across the normals folds faces over, and
# unfolding them flips them.  On six models with Gaussian noise of 0.1 to 0.6 edges in each
# coordinate the true surface flips 0 to 30 % of the faces, at most 1.2 for each folded one; along
# the normals it flips 1.7 % at most.  CAD meshes have no folds, and where a filter collapses them
# half of the faces flip.
#
# Three more hold where the noise is known: volume, area, and how far vertices moved, by what noise
# of that level explains.  On seven models with noise of 0.05 to 0.7 edges along the normals and in
# each coordinate the true surface has 0.02 times noise x area of the volume more or less at most,
# an area that is less by 4 times the noise squared, and 95 % of the vertices within 2.8 times the
# noise.

FLIPPED_SHARE = 0.02
"""Share of the faces that may flip on a mesh without folds."""

FLIPPED_AREA = 0.01
"""Share of the area whose faces may flip, however many they are: needles flip by tiny moves.  Two
unevenly triangulated shapes with noise of 0.1 along the normals flip 3 and 4 % of their faces, with
0.4 and 0.7 % of the area, when AL removes most of it."""

FLIPS_PER_FOLD = 1.5
"""Faces more that may flip for each face that is folded before."""

VOLUME_SHARE = 0.5
"""Share of its volume that a closed surface may lose or gain."""

MIN_VOLUME, VOLUME_PER_NOISE = 0.01, 0.1
"""Share of its volume that a closed surface may lose or gain without noise, and what it may beyond,
in the volume of a layer over it that is as thick as the noise."""

MIN_AREA, AREA_PER_NOISE = 0.02, 6.0
"""Share of its area that a surface may lose or gain without noise, and what it may lose beyond for
each squared level."""

AREA_EXPLAINED = 2.0
"""Times the share of ``explained_area`` that it may lose, where that is more.  On twelve unevenly
triangulated shapes with noise of 0.05 to 0.5 the true surface has 0.6 to 1.75 times that less."""

MIN_MOVE, MOVE_PER_NOISE = 0.02, 6.0
"""Mean edge lengths that one in 20 vertices may move without noise, and beyond, in its levels, if
it is out of the surface."""

NAMED_LEEWAY = 3.0
"""Times the bounds that a method may use which the user has named."""

MAX_NOISE = 0.7
"""Mean edge lengths of noise that bounds allow for; meshes that read more are no scans."""

MAX_SAMPLED = 65_536
"""Faces that are looked at for folds."""

FLIPPED, VOLUME = "W_FLIPPED_FACES", "W_VOLUME_CHANGE"
AREA, MOVES = "W_AREA_CHANGE", "W_LARGE_MOVES"


@dataclass(frozen=True)
class Harm:
    """A harmful change: its ``code``, ``FLIPPED``, ``VOLUME``, ``AREA`` or ``MOVES``, and the
    figures as ``reason``."""

    code: str
    reason: str


def harmful_change(
    before: Mesh, after: Mesh, change: SurfaceChange, *, has_volume: bool
) -> Harm | None:
    """The harm between two meshes with the same faces, None if there is none.

    Parameters
    ----------
    change : ``measure_surface_change(before, after)``, best with the volumes that are enclosed
        (``Enclosure.change``): those of parts that are inside out would count against the others.
    has_volume : whether the volume means anything (``Defects.volume_objection`` is empty).
    """
    share = _volume_share(change, has_volume)
    if share is not None and abs(share) > VOLUME_SHARE:
        return Harm(VOLUME, f"the volume changed by {100.0 * share:+.1f} %")
    n_flipped, n_faces = change.flipped_faces, len(before.faces)
    allowed = FLIPPED_SHARE * n_faces
    # Folds are counted only where that can matter.
    if (
        n_flipped > allowed
        and n_flipped > allowed + FLIPS_PER_FOLD * folded_faces(before)
        and _flipped_area(before, after) > FLIPPED_AREA
    ):
        percent = 100.0 * n_flipped / n_faces
        return Harm(FLIPPED, f"{n_flipped:,} of {n_faces:,} faces flipped ({percent:.1f} %)")
    return None


def _flipped_area(before: Mesh, after: Mesh) -> float:
    """Share of the area before whose faces turned by more than a right angle."""
    normals, areas = geometry.face_normals_and_areas(before.vertices, before.faces)
    turned = np.einsum("ij,ij->i", normals, geometry.face_normals(after.vertices, after.faces))
    return float(areas[turned < 0.0].sum() / areas.sum())


def _volume_share(change: SurfaceChange, has_volume: bool) -> float | None:
    """Relative change of the volume, None where it means nothing."""
    if not has_volume:
        return None
    return relative_volume_change(change.volume_before, change.volume_after, change.area_before)


def excessive_change(
    before: Mesh,
    after: Mesh,
    change: SurfaceChange,
    noise_edges: float,
    p95_edges: float,
    *,
    has_volume: bool,
    leeway: float = 1.0,
) -> Harm | None:
    """A change that noise of ``noise_edges`` mean edge lengths does not explain, None if it does.

    Parameters
    ----------
    before, after : with the same faces; ``before`` as the method got it.
    change : between them, see ``harmful_change``.
    p95_edges : 95th percentile of the displacements, mean edge lengths.
    leeway : factor of all bounds.
    """
    noise = min(noise_edges, MAX_NOISE)
    words = f"noise of {noise:.2g} e explains"
    share = _volume_share(change, has_volume)
    if share is not None:
        layer = noise * before.mean_edge_length * change.area_before / abs(change.volume_before)
        bound = leeway * (MIN_VOLUME + VOLUME_PER_NOISE * layer)
        if abs(share) > bound:
            percent = f"{100.0 * share:+.1f} %, {words} {100.0 * bound:.1f} %"
            return Harm(VOLUME, f"the volume changed by {percent}")
    if change.area_before > 0.0:
        share = change.area_after / change.area_before - 1.0
        explained = AREA_PER_NOISE * noise * noise
        if -share > leeway * (MIN_AREA + explained):
            explained = max(explained, AREA_EXPLAINED * explained_area(before, noise))
        bound = leeway * (MIN_AREA + explained)
        if share > leeway * MIN_AREA or -share > bound:
            return Harm(AREA, f"the area changed by {100.0 * share:+.1f} %, more than {words}")
    bound = leeway * (MIN_MOVE + MOVE_PER_NOISE * noise)
    if p95_edges > bound and _p95_across(before, after) > bound:
        return Harm(MOVES, f"one in 20 vertices moved by {p95_edges:.2g} e, more than {words}")
    return None


def explained_area(mesh: Mesh, noise_edges: float) -> float:
    """Share of the area of ``mesh`` that noise of ``noise_edges`` mean edge lengths has added.

    Along the normals it adds s^2 (a^2 + b^2 + c^2) / 4 to the squared area of a face, s the noise
    and a, b, c the edges: to a needle much more than to an even triangle.
    """
    noise = noise_edges * mesh.mean_edge_length
    _, areas = geometry.face_normals_and_areas(mesh.vertices, mesh.faces)
    squares = np.zeros(len(areas))
    for corner in range(3):
        edges = mesh.vertices[mesh.faces[:, corner]] - mesh.vertices[mesh.faces[:, corner - 1]]
        squares += np.einsum("ij,ij->i", edges, edges)
    true = np.sqrt(np.maximum(areas * areas - 0.25 * noise * noise * squares, 0.0))
    return 1.0 - float(true.sum() / areas.sum())


def _p95_across(before: Mesh, after: Mesh) -> float:
    """95th percentile of the ways out of the surface, mean edge lengths; ways within it change
    nothing that is seen."""
    ways = after.vertices - before.vertices
    across = np.abs(np.einsum("ij,ij->i", ways, before.vertex_normals("uniform", 1)))
    across = across[before.topology.has_ring]
    return float(quantiles(across, (0.95,))[0]) / before.mean_edge_length


def folded_faces(mesh: Mesh) -> int:
    """How many faces face away from the mollified normals at their corners.

    Of more than ``MAX_SAMPLED`` faces every k-th one is counted, and the count is scaled.
    """
    step = max(len(mesh.faces) // MAX_SAMPLED, 1)
    faces = np.ascontiguousarray(mesh.faces[::step])
    # Most methods have computed these normals.
    around = mesh.vertex_normals("uniform", 1)[faces].sum(axis=1)
    alike = np.einsum("ij,ij->i", geometry.face_normals(mesh.vertices, faces), around)
    return int(np.count_nonzero(alike < 0.0)) * step
