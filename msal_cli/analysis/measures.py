"""Measures of a mesh, and of how its surface changed.

Displacements, distances between surfaces, area, signed and enclosed volume, mean curvature, the
local scale sigma of the paper, angles between face normals, self-intersections, and changes so
large that they are damage rather than denoising.
"""

import math
from dataclasses import replace

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints, Longs
from msal_cli.kernels import geometry
from msal_cli.kernels.connectivity import component_labels
from msal_cli.kernels.quantiles import quantiles
from msal_cli.kernels.welding import first_places
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Defects, Mesh, PreparedMesh

FLAT = 1e-9
"""A volume below this share of area ** 1.5 is a rounding error: the surface encloses nothing."""


@dataclass(frozen=True)
class DistanceStatistics:
    """Mean, root mean square, 95th percentile and maximum of distances; count above 0."""

    mean: float
    rms: float
    p95: float
    max: float
    n_moved: int


def distance_statistics(lengths: Floats) -> DistanceStatistics:
    """Statistics of distances (n,); zeros if n is 0."""
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
    """Distances between corresponding used vertices of two meshes with the same faces."""
    lengths, is_used = geometry.distances(before.vertices, after.vertices), before.topology.has_ring
    return distance_statistics(lengths if is_used.all() else lengths[is_used])


def vertex_error_percent(reference: Mesh, other: Mesh) -> float:
    """Mean distance between corresponding vertices in % of the reference's mean edge length."""
    return 100.0 * displacement(reference, other).mean / reference.mean_edge_length


@dataclass(frozen=True)
class SurfaceChange:
    """Areas before and after, squared file units, signed volumes, cubed ones, and angles between
    corresponding face normals, over the faces that have a normal in both meshes.

    ``mean_angular_error_deg`` is what much of the literature calls MSAE; ``flipped_faces`` is the
    number of faces that turned by more than a right angle.
    """

    areas: tuple[float, float]
    volumes: tuple[float, float]
    mean_angular_error_deg: float
    max_angular_error_deg: float
    flipped_faces: int


def measure_surface_change(before: Mesh, after: Mesh) -> SurfaceChange:
    """The change between two meshes with the same faces."""
    areas, volumes, mean, largest, flipped = geometry.surface_change(
        before.vertices, after.vertices, before.faces
    )
    return SurfaceChange(areas, volumes, math.degrees(mean), math.degrees(largest), flipped)


def mean_curvature(mesh: Mesh) -> Floats:
    """Mean curvature (n,), 1 / file units: 1/r on a sphere of radius r with normals outwards.

    The cotangent Laplacian over the mixed Voronoi area is the mean curvature normal, of length 2 H
    (Meyer et al. 2003, eq. (8)).  H is positive where the surface is convex.  It is not defined at
    boundary vertices and at vertices without area; there the value is 0.
    """
    from msal_cli.kernels.curvature import cotangent_weights, mixed_areas

    x, links = mesh.vertices, mesh.topology
    weights = cotangent_weights(x, mesh.faces, links)
    areas = mixed_areas(x, mesh.faces)
    owner = np.repeat(np.arange(len(x)), np.diff(links.ring_start))
    gradient = np.empty_like(x)
    for axis in range(3):
        steps = weights * (x[owner, axis] - x[links.ring, axis])
        gradient[:, axis] = np.bincount(owner, steps, minlength=len(x))
    length = np.sqrt((gradient * gradient).sum(axis=1))
    side = np.sign((gradient * mesh.vertex_normals()).sum(axis=1))
    is_defined = ~links.boundary & (areas > 0.0)
    curvature: Floats = side * length / (4.0 * np.where(is_defined, areas, np.inf))
    return curvature


def local_scale(mesh: Mesh, normals: Floats) -> Floats:
    """sigma (n,) of eq. (4), file units; 0 where the one-ring is flat.

    It is 2 mean|h - mean h| over the heights h of the one-ring above the tangent plane that the
    vertex's normal defines.  ``normals`` are (n, 3), of unit length or zero.
    """
    from msal_cli.kernels.operators import RingOperator

    free = np.ones(len(mesh.vertices), dtype=bool)
    laplacian = RingOperator(normals, *mesh.topology.one_ring, free, mesh.mean_edge_length)
    sigma = laplacian(mesh.vertices).sigma
    assert sigma is not None
    return sigma


def area_and_volume(mesh: Mesh) -> tuple[float, float]:
    """Area in squared and signed volume in cubed file units (Desbrun et al. 1999).

    The volume is well defined only if the surface is closed, manifold and consistently wound; for
    an open surface it depends on the mesh's local origin.  It is negative if normals point inwards.
    """
    return geometry.area_and_volume(mesh.vertices, mesh.faces)


def is_negative(volume: float, area: float) -> bool:
    """Whether a closed surface with this signed volume and area is inside out."""
    return volume < -_flat_volume(area)


def relative_volume_change(before: float, after: float, area: float) -> float | None:
    """(after - before) / before of the volume of a closed surface.

    ``before`` and ``after`` are signed volumes of the same faces, ``area`` is the area before.
    Negative values mean shrinking, also where the signed volume is negative; below -1 the surface
    was turned inside out.  None if the surface enclosed nothing before.
    """
    if abs(before) <= _flat_volume(area):
        return None
    return (after - before) / before


def _flat_volume(area: float) -> float:
    return FLAT * area * math.sqrt(area)


def apply_umbrella(mesh: Mesh, values: Floats) -> Floats:
    """The umbrella operator (n, 3) of values (n, 3): the mean over the one-ring minus the value."""
    return geometry.apply_umbrella(values, *mesh.topology.one_ring, mesh.topology.has_ring)


def share_over_rings(mesh: Mesh, heights: Floats, rings: int) -> Floats:
    """Heights (n,) averaged ``rings`` times over closed one-rings, then scaled to unit variance.

    They are then correlated: on a regular triangle grid the correlation with a neighbour is 0.57
    after one average and 0.78 after two.  With 0 rings the heights are returned unchanged.
    """
    if not rings:
        return heights
    heights = geometry.average_around(heights, *mesh.topology.one_ring, rings)
    used = heights[mesh.topology.has_ring]
    return heights / math.sqrt(float((used * used).mean()))


def count_self_intersections(mesh: Mesh) -> int:
    """The number of intersecting pairs of faces; see ``kernels.intersections``.

    Degenerate faces do not count: they touch their neighbours along a whole edge.
    """
    return len(_intersection_keys(mesh))


def self_intersection_change(before: Mesh, after: Mesh) -> tuple[int, int, int]:
    """The numbers of intersecting pairs before and after, and of new ones, for the same faces."""
    keys = _intersection_keys(before)
    if np.array_equal(before.vertices, after.vertices):
        return len(keys), len(keys), 0
    later = _intersection_keys(after)
    return len(keys), len(later), len(np.setdiff1d(later, keys, assume_unique=True))


def _intersection_keys(mesh: Mesh) -> Longs:
    """An integer for each intersecting pair of faces (i, j): i * n_faces + j."""
    from msal_cli.kernels.intersections import intersecting_pairs

    has_area = np.flatnonzero(geometry.face_normals(mesh.vertices, mesh.faces).any(axis=1))
    pairs = has_area[intersecting_pairs(mesh.vertices, mesh.faces[has_area])]
    keys: Longs = pairs[:, 0] * len(mesh.faces) + pairs[:, 1]
    return keys


# Distances between meshes whose vertices need not correspond

ROUNDING = 4.0 * float(np.finfo(np.float64).eps)
"""Distances below this share of the largest coordinate are rounding errors, and set to 0."""

MIN_SCALE, MAX_SCALE = 1e-50, 1e50
"""If the largest coordinate is outside, all are divided by it, because sixth powers of coordinates
would underflow or overflow."""

MAX_POINTS, SAMPLED_POINTS = 4_000_000, 1_000_000
"""Up to so many vertices and face centres of a mesh, the distances of all are measured; of more
about the second number: each fifth, sixth and so on, in the order of the file."""


def nearest_on_surface(points: Floats, surface: Mesh) -> tuple[Ints, Floats]:
    """The nearest triangle of ``surface`` to each point (n, 3), and its distance, file units."""
    from msal_cli.kernels.nearest_triangles import find_nearest_triangles

    scale = max(float(np.abs(points).max(initial=0.0)), float(np.abs(surface.vertices).max()))
    vertices, unit = surface.vertices, 1.0
    if scale and not MIN_SCALE < scale < MAX_SCALE:
        points, vertices, unit = points / scale, vertices / scale, scale
    triangles, distances = find_nearest_triangles(points, vertices, surface.faces)
    distances *= unit
    distances[distances < ROUNDING * scale] = 0.0
    return triangles, distances


def at_other_positions(ready: PreparedMesh, vertices: Floats) -> Mesh:
    """The prepared mesh with the positions ``vertices`` (n_file, 3) of another file.

    Where several file vertices are one mesh vertex, the position of the first is used, although
    they may lie apart in the other file; see ``PreparedMesh.seam_gap``.
    """
    if ready.vertex_map is None:
        return ready.mesh.with_vertices(vertices - ready.origin)
    first = first_places(ready.vertex_map, len(ready.mesh.vertices))
    return ready.mesh.with_vertices(vertices[first] - ready.origin)


def used_vertices(mesh: Mesh) -> Floats:
    """Positions (k, 3) of the vertices that faces use."""
    has_ring = mesh.topology.has_ring
    return mesh.vertices if has_ring.all() else mesh.vertices[has_ring]


def sampling_step(mesh: Mesh) -> int:
    """The step k of the sample of ``surface_distances``: each k-th vertex and face centre."""
    count = len(mesh.vertices) + len(mesh.faces)
    return 1 if count <= MAX_POINTS else -(-count // SAMPLED_POINTS)


def surface_distances(
    before: Mesh, after: Mesh
) -> tuple[DistanceStatistics, DistanceStatistics, float]:
    """Distances of ``after``'s vertices to ``before``'s surface, of ``before``'s vertices to
    ``after``'s surface, and the Hausdorff distance, file units; both meshes have the same origin.

    The Hausdorff distance is the maximum over the vertices and face centres of both meshes, so it
    may be a little too small.  Large meshes are sampled, see ``sampling_step``.
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


# The volume that a closed surface encloses
#
# A component that is inside out has a negative signed volume, which reduces the sum of all.  For
# the enclosed volume such a component is flipped.  A component within another one is flipped if the
# outer one is, so that cavities stay cavities.

MAX_PARTS = 1000
"""With more components only the sign of the total volume is considered, because each component is
compared with each other one."""

INSIDE_OUT = "the surface is inside out: its normals point inwards"


@dataclass(frozen=True, eq=False)
class Enclosure:
    """The faces of a closed surface whose normals point inwards."""

    # (m,) whether each face belongs to a component that is inside out; None if no component is
    inward: Flags | None
    # components that are inside out; none where each face is there with both windings
    n_turned: int
    n_parts: int  # all components

    @property
    def is_inside_out(self) -> bool:
        """Whether at least one component is inside out."""
        return self.n_turned > 0

    @property
    def words(self) -> str:
        """A message on the components that are inside out; empty if none is."""
        if not self.is_inside_out:
            return ""
        if self.n_turned == self.n_parts:
            return INSIDE_OUT
        are = "is" if self.n_turned == 1 else "are"
        return (
            f"{self.n_turned:,} of {self.n_parts:,} parts {are} inside out: normals point inwards"
        )

    def volume(self, mesh: Mesh, signed: float) -> float:
        """The volume that a ``mesh`` with these faces and this ``signed`` volume encloses."""
        if self.inward is None:
            return signed
        if self.inward.all():
            return -signed
        faces = np.where(self.inward[:, None], mesh.faces[:, ::-1], mesh.faces)
        return area_and_volume(Mesh(mesh.vertices, faces))[1]

    def change(self, before: Mesh, after: Mesh, change: SurfaceChange) -> SurfaceChange:
        """``change`` with enclosed volumes in place of signed ones."""
        first, last = change.volumes
        return replace(change, volumes=(self.volume(before, first), self.volume(after, last)))

    def outward_signs(self, mesh: Mesh) -> Floats:
        """For each vertex 1 if its normal points outwards, -1 if inwards, (n,)."""
        signs = np.ones(len(mesh.vertices))
        if self.inward is not None:
            signs[mesh.faces[self.inward]] = -1.0
        return signs


def measure_enclosure(ready: PreparedMesh) -> Enclosure:
    """The enclosure of a prepared mesh; without a well-defined volume no face counts as inward."""
    return enclosure_of(ready.mesh, ready.defects, *area_and_volume(ready.mesh))


def enclosure_of(mesh: Mesh, defects: Defects, area: float, volume: float) -> Enclosure:
    """As ``measure_enclosure``, for a mesh whose ``area`` and signed ``volume`` are known."""
    n_parts, inward, n_turned = defects.components, None, 0
    if not defects.volume_objection:
        if 1 < n_parts <= MAX_PARTS:
            inward, n_turned = _inward_parts(mesh)
        elif is_negative(volume, area):
            inward, n_turned = np.ones(len(mesh.faces), dtype=bool), n_parts
    return Enclosure(inward, 0 if defects.is_two_sided else n_turned, n_parts)


def _inward_parts(mesh: Mesh) -> tuple[Flags | None, int]:
    """``Enclosure.inward`` of a mesh of several components, and how many of them are inside out."""
    first = mesh.faces[:, 0]
    labels = component_labels(len(mesh.vertices), mesh.faces)
    numbers, part_of_face = np.unique(labels[first], return_inverse=True)
    n_parts = len(numbers)
    normals, face_areas = geometry.face_normals_and_areas(mesh.vertices, mesh.faces)
    # The tetrahedron of a face and the origin has a third of area times height as its volume.
    heights = np.einsum("ij,ij->i", mesh.vertices[first], normals)
    areas = np.bincount(part_of_face, face_areas, n_parts)
    volumes = np.bincount(part_of_face, face_areas * heights, n_parts) / 3.0
    is_turned = np.array([is_negative(*figures) for figures in zip(volumes, areas, strict=True)])
    if not is_turned.any():
        return None, 0
    used = np.flatnonzero(mesh.topology.has_ring)
    part_of_vertex = np.searchsorted(numbers, labels[used])
    low, high = np.full((n_parts, 3), np.inf), np.full((n_parts, 3), -np.inf)
    np.minimum.at(low, part_of_vertex, mesh.vertices[used])
    np.maximum.at(high, part_of_vertex, mesh.vertices[used])
    # A component follows the largest component whose bounding box contains its own, or itself.
    is_within = (low[:, None] > low[None]).all(axis=2) & (high[:, None] < high[None]).all(axis=2)
    is_within |= np.eye(n_parts, dtype=bool)
    outermost = np.where(is_within, (high - low).prod(axis=1)[None], -1.0).argmax(axis=1)
    is_turned = is_turned[outermost]
    n_turned = int(np.count_nonzero(is_turned))
    return is_turned[part_of_face] if n_turned else None, n_turned


# Damage
#
# Two rules apply at any level of noise: to the volume of a closed surface, and to faces that flip,
# which is to turn by more than a right angle.  Strong tangential noise folds faces over, and
# unfolding flips them.  On six models with Gaussian noise of 0.1 to 0.6 edges in each coordinate,
# restoring the true surface flips 0 to 30 % of the faces, at most 1.2 for each folded face; with
# noise along the normals at most 1.7 % of the faces.  CAD meshes have no folds, and half of the
# faces flip where a filter collapses them.
#
# Three more rules apply if the level of noise is known: it limits the changes of volume and area
# and the displacements.  On seven models with noise of 0.05 to 0.7 edges along the normals and in
# each coordinate, restoring the true surface changes the volume by at most 0.02 times noise x area,
# reduces the area by a share of at most 4 times the noise squared, and moves 95 % of the vertices
# by at most 2.8 times the noise.

FLIPPED_SHARE, FLIPS_PER_FOLD = 0.02, 1.5
"""Share of the faces that may flip on a mesh without folds, and how many more for each face that
was folded before."""

FLIPPED_AREA = 0.02
"""Faces with less than this share of the area may flip however many they are, because small
displacements flip needles.  On four unevenly triangulated shapes filters that bring faces nearer to
the truth, from a noise of 0.1 or 0.3 along the normals, flip 3 to 4 % of them, with 0.4 to 1.2 % of
the area."""

VOLUME_SHARE = 0.5
"""Share of its volume that a closed surface may lose or gain."""

MIN_VOLUME, VOLUME_PER_NOISE = 0.01, 0.1
"""Share of its volume that a closed surface may lose or gain without noise, and the additional
volume with noise, in volumes of a layer on the surface as thick as the level of noise."""

MIN_AREA, AREA_PER_NOISE = 0.02, 6.0
"""Share of its area that a surface may lose or gain without noise, and the additional share that it
may lose, over the square of the level in mean edge lengths."""

AREA_EXPLAINED = 2.0
"""Factor of ``explained_area``, which replaces the additional share of area where it is greater.
On twelve unevenly triangulated shapes with noise of 0.05 to 0.5, restoring the true surface removes
0.6 to 1.75 times ``explained_area``."""

MIN_MOVE, MOVE_PER_NOISE = 0.02, 6.0
"""Mean edge lengths by which one in 20 vertices may move along its normal without noise, and the
additional distance with noise, over its level."""

NAMED_LEEWAY = 3.0
"""Factor of these bounds for a method that the user chose by name."""

MAX_NOISE = 0.7
"""Largest level of noise that bounds allow for, mean edge lengths; no scan has more."""

MAX_SAMPLED = 65_536
"""About how many faces are checked for folds."""

FLIPPED, VOLUME = "W_FLIPPED_FACES", "W_VOLUME_CHANGE"
AREA, MOVES = "W_AREA_CHANGE", "W_LARGE_MOVES"


@dataclass(frozen=True)
class Harm:
    """A harmful change."""

    code: str  # ``FLIPPED``, ``VOLUME``, ``AREA`` or ``MOVES``
    reason: str  # a message with the figures


def harmful_change(
    before: Mesh, after: Mesh, change: SurfaceChange, *, has_volume: bool
) -> Harm | None:
    """The change between two meshes with the same faces if it is harm at any level of noise.

    Parameters
    ----------
    change : ``measure_surface_change(before, after)``, preferably with the enclosed volumes of
        ``Enclosure.change``: signed volumes of components that are inside out reduce the sum.
    has_volume : whether the volume is well defined (``Defects.volume_objection`` is empty).
    """
    share = _volume_share(change, has_volume)
    if share is not None and abs(share) > VOLUME_SHARE:
        return Harm(VOLUME, f"the volume changed by {100.0 * share:+.1f} %")
    n_flipped, n_faces = change.flipped_faces, len(before.faces)
    allowed = FLIPPED_SHARE * n_faces
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
    if not has_volume:
        return None
    return relative_volume_change(*change.volumes, change.areas[0])


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
    """The change if it is more than noise of ``noise_edges`` mean edge lengths explains, else None.

    Parameters
    ----------
    before, after : input and output of the method, with the same faces.
    change : between them, see ``harmful_change``.
    p95_edges : 95th percentile of the displacements, mean edge lengths.
    leeway : factor of all bounds; greater allows more.
    """
    noise = min(noise_edges, MAX_NOISE)
    words = f"noise of {noise:.2g} e explains"
    share = _volume_share(change, has_volume)
    if share is not None:
        layer = noise * before.mean_edge_length * change.areas[0] / abs(change.volumes[0])
        bound = leeway * (MIN_VOLUME + VOLUME_PER_NOISE * layer)
        if abs(share) > bound:
            percent = f"{100.0 * share:+.1f} %, {words} {100.0 * bound:.1f} %"
            return Harm(VOLUME, f"the volume changed by {percent}")
    if change.areas[0] > 0.0:
        share = change.areas[1] / change.areas[0] - 1.0
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
    """Expected share of the area of ``mesh`` that comes from noise of ``noise_edges`` mean edge
    lengths along the normals.

    Such noise of standard deviation s adds s^2 (a^2 + b^2 + c^2) / 4 to the squared area of a face
    with edges a, b, c: relatively much more to needles than to equilateral triangles.
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
    """95th percentile of the displacements along the normals, mean edge lengths; tangential
    displacements hardly change the surface."""
    moves = after.vertices - before.vertices
    across = np.abs(np.einsum("ij,ij->i", moves, before.vertex_normals("uniform", 1)))
    across = across[before.topology.has_ring]
    return float(quantiles(across, (0.95,))[0]) / before.mean_edge_length


def folded_faces(mesh: Mesh) -> int:
    """The number of faces whose normals are opposite to the mollified normals at their corners.

    Large meshes are sampled: each k-th face is tested, and the count is multiplied by k.
    """
    step = max(len(mesh.faces) // MAX_SAMPLED, 1)
    faces = np.ascontiguousarray(mesh.faces[::step])
    # Most methods have computed these normals.
    around = mesh.vertex_normals("uniform", 1)[faces].sum(axis=1)
    cosines = np.einsum("ij,ij->i", geometry.face_normals(mesh.vertices, faces), around)
    return int(np.count_nonzero(cosines < 0.0)) * step
