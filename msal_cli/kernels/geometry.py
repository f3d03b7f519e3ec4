"""Normals, areas and volumes of triangle meshes.

Throughout: ``vertices`` (n, 3) float64 and ``faces`` (m, 3) int32, counter-clockwise from outside.
A face whose doubled area is at most 1e-12 of its longest edge squared is *degenerate*: it has no
normal, which is represented by a zero vector.
"""

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.library import compiled
from msal_cli.kernels.parallel import MIN_RANGE, fill_array, over_ranges, threads
from msal_cli.kernels.vectors import arctangents
from msal_cli.kernels.welding import first_alike, number_groups, used_vertices

POWERS = 2048
"""Number of values of the exponent bits of a float64."""

DEGENERATE = 1e-12
"""Doubled area over longest edge squared, at and below which a face has no usable normal."""

VANISHED = 1e-10
"""A sum of k unit vectors shorter than this times k has no direction."""

BLOCK_FACES = 512
"""Faces in a block, whose data stay in the first-level cache."""


@compiled
def doubled_area_normal(vertices, a, b, c):
    """Unit normal (zeros if degenerate) and doubled area of one triangle."""
    u, w, normal = vec.edges_and_normal(vertices, a, b, c)
    doubled = vec.norm(normal)
    if doubled <= DEGENERATE * vec.longest_square(u, w):
        return vec.ORIGIN, doubled
    return vec.divide(normal, doubled), doubled


@compiled
def _face_normals(start, stop, vertices, faces, normals, doubled_areas):
    for f in range(start, stop):
        a, b, c = vec.load(faces, f)
        normal, doubled = doubled_area_normal(vertices, a, b, c)
        vec.store(normals, f, normal)
        doubled_areas[f] = doubled


def face_normals_and_areas(vertices: Floats, faces: Ints) -> tuple[Floats, Floats]:
    """Unit face normals (m, 3), zeros for degenerate faces, and areas (m,) in squared units."""
    normals = np.empty((len(faces), 3))
    doubled_areas = np.empty(len(faces))
    over_ranges(_face_normals, len(faces), vertices, faces, normals, doubled_areas)
    doubled_areas *= 0.5
    return normals, doubled_areas


def usable_areas(normals: Floats, areas: Floats) -> Floats:
    """Areas (m,), zero for faces whose normal, of ``normals`` (m, 3), is zero."""
    usable: Floats = np.where((normals != 0.0).any(axis=1), areas, 0.0)
    return usable


def face_normals(vertices: Floats, faces: Ints) -> Floats:
    """Unit face normals (m, 3), zeros for degenerate faces."""
    return face_normals_and_areas(vertices, faces)[0]


@compiled
def _normal_sums(vertices, faces, by_area, sums, weights):
    """Add each face's normal and weight to its corners; returns the number of faces without a
    normal.

    Faces are processed in blocks, so that roots and quotients become vector code.
    """
    x, y, z = np.empty(BLOCK_FACES), np.empty(BLOCK_FACES), np.empty(BLOCK_FACES)
    longest, weight = np.empty(BLOCK_FACES), np.empty(BLOCK_FACES)
    without = 0
    for first in range(0, len(faces), BLOCK_FACES):
        count = min(BLOCK_FACES, len(faces) - first)
        for at in range(count):
            a, b, c = vec.load_corners(faces, first + at)
            u, w, (x[at], y[at], z[at]) = vec.edges_and_normal(vertices, a, b, c)
            longest[at] = vec.longest_square(u, w)
        for at in range(count):
            length = np.sqrt(x[at] * x[at] + y[at] * y[at] + z[at] * z[at])
            has_normal = length > DEGENERATE * longest[at]
            scale = 1.0 if by_area else length
            scale = scale if has_normal else np.inf
            x[at] /= scale
            y[at] /= scale
            z[at] /= scale
            weight[at] = (length if by_area else 1.0) if has_normal else 0.0
        for at in range(count):
            for i in vec.load_corners(faces, first + at):
                vec.store(sums, i, vec.add(vec.load(sums, i), (x[at], y[at], z[at])))
                weights[i] += weight[at]
            without += weight[at] == 0.0
    return without


@compiled
def _unit_sums(start, stop, sums, weights):
    """Normalize sums; one that vanishes becomes zero, and its weight negative."""
    for i in range(start, stop):
        total = vec.load(sums, i)
        length = vec.norm(total)
        if length > VANISHED * weights[i]:
            vec.store(sums, i, vec.divide(total, length))
        else:
            vec.store(sums, i, vec.ORIGIN)
            weights[i] = -weights[i]


def normals_and_flat_faces(vertices: Floats, faces: Ints, weighting: str) -> tuple[Floats, int]:
    """Unit vertex normals (n, 3), see ``vertex_normals``, and the number of degenerate faces."""
    n = len(vertices)
    sums, weights = np.zeros((n, 3)), np.zeros(n)
    by_area = weighting == "area"
    without = _normal_sums(vertices, faces, by_area, sums, weights)
    over_ranges(_unit_sums, n, sums, weights)
    if not by_area:
        vanished = weights < 0.0
        if vanished.any():
            sums[vanished] = vertex_normals(vertices, faces, "area")[vanished]
    return sums, int(without)


def vertex_normals(vertices: Floats, faces: Ints, weighting: str) -> Floats:
    """Unit vertex normals (n, 3): the normalised sum of the adjacent face normals.

    ``weighting`` is ``"uniform"`` (equal weights, section 2.3 of Huang and Ascher) or ``"area"``.
    Degenerate faces are left out.  If the sum vanishes (opposed normals) the area-weighted sum is
    used; if that vanishes too, or there is no face, the normal is zero, and a filter that moves
    along normals does not move the vertex.
    """
    return normals_and_flat_faces(vertices, faces, weighting)[0]


@compiled
def _mollify(start, stop, normals, ring_start, ring, result):
    for i in range(start, stop):
        least = VANISHED * (ring_start[i + 1] - ring_start[i])
        vec.write_unit(vec.sum_row(normals, ring_start, ring, i), least, normals, i, result)


def mollify(normals: Floats, ring_start: Ints, ring: Ints, passes: int) -> Floats:
    """Vertex normals (n, 3) after ``passes`` passes of averaging over one-rings.

    Each pass replaces a normal by the normalised sum of the normals of its one-ring, without its
    own (section 2.3 of Huang and Ascher); if that sum vanishes the normal is kept.
    """
    for _ in range(passes):
        result = np.empty_like(normals)
        over_ranges(_mollify, len(normals), normals, ring_start, ring, result)
        normals = result
    return normals


@compiled
def _area_and_volume(vertices, faces):
    doubled_area = 0.0
    sixfold_volume = 0.0
    for f in range(len(faces)):
        a, b, c = vec.load(faces, f)
        _, _, normal = vec.edges_and_normal(vertices, a, b, c)
        doubled_area += vec.norm(normal)
        sixfold_volume += vec.dot(vec.load(vertices, a), normal)
    return doubled_area / 2.0, sixfold_volume / 6.0


def area_and_volume(vertices: Floats, faces: Ints) -> tuple[float, float]:
    """Surface area and signed volume, the sum of x1 . (x2 x x3) / 6 over the faces.

    Desbrun, Meyer, Schroeder and Barr 1999, the paper's Table 1.  The volume of an open surface
    depends on the origin.
    """
    area, volume = _area_and_volume(vertices, faces)
    return float(area), float(volume)


@compiled
def _distances(start, stop, before, after, lengths):
    for i in range(start, stop):
        lengths[i] = vec.norm(vec.subtract(vec.load(after, i), vec.load(before, i)))


def distances(before: Floats, after: Floats) -> Floats:
    """Distances (n,) between positions (n, 3)."""
    return fill_array(_distances, len(before), before, after)


@compiled
def _add_edge_lengths(start, stop, vertices, ring_start, ring, bins, counts):
    """Add lengths of edges from a share of the vertices to ones of higher number, for each row.

    ``bins`` (rows, 2 * POWERS) sum the upper halves of the 53-bit mantissas by power of two, then
    the lower halves, so that 2^36 numbers cannot overflow.
    """
    n = len(vertices)
    for row in range(start, stop):
        count = 0
        for i in range(n * row // len(counts), n * (row + 1) // len(counts)):
            for at in range(ring_start[i], ring_start[i + 1]):
                k = ring[at]
                if k > i:
                    length = vec.norm(vec.offset(vertices, k, i))
                    bits = np.float64(length).view(np.uint64)
                    power = bits >> np.uint64(52)
                    digits = bits & np.uint64(0xFFFFFFFFFFFFF)
                    # A number of power 0 has no hidden bit, and the exponent of power 1.
                    digits = (digits | np.uint64(1 << 52)) if power else digits << np.uint64(1)
                    bins[row, power] += np.int64(digits >> np.uint64(26))
                    bins[row, power + np.uint64(POWERS)] += np.int64(digits & np.uint64(0x3FFFFFF))
                    count += 1
        counts[row] = count


def mean_edge_length(vertices: Floats, ring_start: Ints, ring: Ints) -> float:
    """Mean length of the unique edges, in file units; zero without edges.  For centroids of faces
    and rows of their neighbours it is their mean distance.

    The sum of the float64 lengths is exact, as an integer multiple of 2^-1075, and rounded once, so
    the result does not depend on the order of edges and the number of threads.
    """
    rows = max(1, min(len(vertices) // MIN_RANGE, threads()))
    bins, counts = np.zeros((rows, 2 * POWERS), dtype=np.int64), np.zeros(rows, dtype=np.int64)
    over_ranges(_add_edge_lengths, rows, vertices, ring_start, ring, bins, counts, smallest=1)
    total, sums = 0, bins.sum(axis=0).reshape(2, POWERS)
    for power in np.flatnonzero(sums.any(axis=0)).tolist():
        total += ((int(sums[0, power]) << 26) + int(sums[1, power])) << power
    # Python rounds a quotient of integers once, however large they are.
    return total / (int(counts.sum()) << 1075) if counts.any() else 0.0


@compiled
def count_parallel(some, columns, least, counts):
    """For each of ``some`` (m, 3) the number of unit vectors, the ``columns`` of (3, k), with an
    absolute cosine above ``least``."""
    for i in range(len(some)):
        x, y, z = vec.load(some, i)
        count = 0
        for k in range(columns.shape[1]):
            count += abs(x * columns[0, k] + y * columns[1, k] + z * columns[2, k]) > least
        counts[i] = count


@compiled
def _row_sums(start, stop, values, row_start, row, sums):
    for i in range(start, stop):
        total = 0.0
        for at in range(row_start[i], row_start[i + 1]):
            total += values[row[at]]
        sums[i] = total


def ring_means(values: Floats, ring_start: Ints, ring: Ints) -> Floats:
    """Mean of vertex values (n,) over each one-ring; the vertex's own value if it is empty."""
    sums = fill_array(_row_sums, len(values), values, ring_start, ring)
    count = np.diff(ring_start)
    return np.divide(sums, count, out=values.copy(), where=count > 0)


@compiled
def _apply_umbrella(start, stop, x, ring_start, ring, inner, moves):
    for i in range(start, stop):
        m = ring_start[i + 1] - ring_start[i] if inner[i] else 0
        total = vec.sum_row(x, ring_start, ring, i)
        vec.store(moves, i, vec.subtract(vec.divide(total, m), vec.load(x, i)) if m else vec.ORIGIN)


def apply_umbrella(
    values: Floats, ring_start: Ints, ring: Ints, inner: Flags, moves: Floats | None = None
) -> Floats:
    """The umbrella operator (n, 3) of values (n, 3): the mean over the one-ring minus the value.

    Zero for vertices that are not ``inner`` (n,) or have no neighbours.  ``moves`` can hold the
    result.
    """
    moves = np.empty_like(values) if moves is None else moves
    over_ranges(_apply_umbrella, len(values), values, ring_start, ring, inner, moves)
    return moves


@compiled
def _average_around(start, stop, values, ring_start, ring, averages):
    columns = values.shape[1]
    for i in range(start, stop):
        m = np.float64(ring_start[i + 1] - ring_start[i])
        for column in range(columns):
            own, total = values[i, column], 0.0
            for at in range(ring_start[i], ring_start[i + 1]):
                total += values[np.uint64(ring[at]), column]
            around = total / m if m else own
            averages[i, column] = (around * m + own) / (m + 1.0)


def average_around(values: Floats, ring_start: Ints, ring: Ints, passes: int) -> Floats:
    """Vertex values, (n,) or (n, k), averaged ``passes`` times over closed one-rings."""
    before = np.array(values, order="C").reshape(len(values), -1)
    after = np.empty_like(before)
    for _ in range(passes):
        over_ranges(_average_around, len(before), before, ring_start, ring, after)
        before, after = after, before
    return before.reshape(values.shape)


@compiled
def _entry_sums(old, new, faces, moved, group, old_sums, new_sums, touched):
    for f in range(len(faces)):
        a, b, c = vec.load(faces, f)
        face_moved = moved[a] or moved[b] or moved[c]
        old_normal, _ = doubled_area_normal(old, a, b, c)
        new_normal, _ = doubled_area_normal(new, a, b, c)
        for corner in range(3):
            g = group[f, corner]
            if face_moved:
                touched[g] = True
            vec.store(old_sums, g, vec.add(vec.load(old_sums, g), old_normal))
            vec.store(new_sums, g, vec.add(vec.load(new_sums, g), new_normal))


def regroup_normals(
    old_vertices: Floats,
    new_vertices: Floats,
    faces: Ints,
    corner_entry: NDArray[np.integer],
    old_normals: Floats,
) -> tuple[Floats, NDArray[np.bool_]]:
    """Recompute a file's stored normals for moved vertices.

    Parameters
    ----------
    old_vertices, new_vertices : (n, 3), before and after.
    faces : (m, 3), the triangles.
    corner_entry : (m, 3), which normal entry each face corner uses; negative for none.
    old_normals : (g, 3), the entries as the file stores them, of any length.

    Returns
    -------
    normals : (g, 3).  An entry becomes the normalised sum of the unit normals of the face corners
        that use it; corners at coincident vertices whose stored normals are equal share one sum,
        so that a UV seam does not become a crease.  The sense of the old normal relative to the
        old faces is kept.  A zero or non-finite entry, one without faces, and one whose sum
        vanishes are returned as they were.
    changed : (g,) bool, False where no face of the entry moved: keep the bytes of those.
    """
    n_entries = len(old_normals)
    old_vertices, new_vertices = map(np.ascontiguousarray, (old_vertices, new_vertices))
    result = np.array(old_normals, order="C")
    changed = np.zeros(n_entries, dtype=bool)
    moved = (old_vertices != new_vertices).any(axis=1)
    if not n_entries or not moved.any():
        return result, changed
    entries = np.ascontiguousarray(corner_entry, dtype=np.int32).reshape(-1)
    usable = np.isfinite(result).all(axis=1) & (result != 0.0).any(axis=1)
    place, _ = first_alike(old_vertices, used_vertices(len(old_vertices), faces))
    if np.array_equal(entries, faces.reshape(-1)) and (place == np.arange(len(place))).all():
        # One normal per vertex and no seam: the entry is the group.
        group, n_groups = entries, n_entries
        pair_entry = pair_group = None
    else:
        like, _ = first_alike(np.where(usable[:, None], old_normals, 0.0), usable)
        alike = np.where(entries < 0, -1, like[entries]).astype(np.int32)
        group, first_corner = number_groups(place[faces.reshape(-1)], alike)
        n_groups = len(first_corner)
        # One entry may be used at many positions (a flat region that shares one normal): its groups
        # are summed, each once however many corners use it.
        _, first_corner = number_groups(entries, group)
        first_corner = first_corner[entries[first_corner] >= 0]
        pair_entry, pair_group = entries[first_corner], group[first_corner]
    old_sums, new_sums = np.zeros((2, n_groups, 3))
    touched = np.zeros(n_groups, dtype=bool)
    surfaces = old_vertices, new_vertices, faces, moved
    _entry_sums(*surfaces, group.reshape(-1, 3), old_sums, new_sums, touched)
    if pair_entry is None:
        old_total, new_total, changed = old_sums, new_sums, touched
    else:
        old_total, new_total = np.zeros((2, n_entries, 3))
        np.add.at(old_total, pair_entry, old_sums[pair_group])
        np.add.at(new_total, pair_entry, new_sums[pair_group])
        np.logical_or.at(changed, pair_entry, touched[pair_group])
    length = np.sqrt((new_total * new_total).sum(axis=1))
    changed &= usable & (length > VANISHED)
    # Stored normals may be so long that products overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        opposed = (old_total * np.where(usable[:, None], old_normals, 0.0)).sum(axis=1) < 0.0
    sense = np.where(opposed, -1.0, 1.0) / np.where(length > 0.0, length, 1.0)
    result[changed] = new_total[changed] * sense[changed, None]
    return result, changed


@compiled
def _volume_moment(vertices, faces, moment):
    """The integral of the position over the volume, and the volume, times 24."""
    volume = 0.0
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        normal = vec.cross(vec.load(vertices, b), vec.load(vertices, c))
        part = vec.dot(vec.load(vertices, a), normal)
        volume += part
        for axis in range(3):
            moment[axis] += part * (vertices[a, axis] + vertices[b, axis] + vertices[c, axis])
    return 4.0 * volume


def restore_volume(original: Floats, vertices: Floats, faces: Ints) -> Floats:
    """``vertices`` (n, 3) scaled so that the closed surface has the volume of ``original`` (n, 3).

    The factor is the cube root of the ratio of the volumes (Desbrun et al. 1999), the fixed point
    the centre of mass of the solid, so that the surface does not drift.  Vertices without faces (m,
    3) are not changed, and none is if a volume is zero or changed its sign.
    """
    wanted = area_and_volume(original, faces)[1]
    moment = np.zeros(3)
    volume = float(_volume_moment(vertices, faces, moment)) / 24.0
    if wanted == 0.0 or volume == 0.0 or (wanted > 0.0) != (volume > 0.0):
        return vertices
    centre = moment / (24.0 * volume)
    scaled = centre + (wanted / volume) ** (1.0 / 3.0) * (vertices - centre)
    result: Floats = np.where(used_vertices(len(vertices), faces)[:, None], scaled, vertices)
    return result


@compiled
def _changes(start, stop, before, after, faces, figures):
    """Doubled areas, sixfold volumes, the sum and the largest of the angles, and the numbers of
    faces that flipped and that have both normals, of each block of faces."""
    # Gathering cannot become vector code; the later loops can.
    px, py, pz = np.empty(BLOCK_FACES), np.empty(BLOCK_FACES), np.empty(BLOCK_FACES)
    qx, qy, qz = np.empty(BLOCK_FACES), np.empty(BLOCK_FACES), np.empty(BLOCK_FACES)
    p_longest, q_longest = np.empty(BLOCK_FACES), np.empty(BLOCK_FACES)
    compares = np.empty(BLOCK_FACES)  # 1 if both normals exist, else 0
    apart = np.empty(BLOCK_FACES)  # sine of half the angle between them, times a factor
    along = np.empty(BLOCK_FACES)  # its cosine times the same factor
    for block in range(start, stop):
        first = block * BLOCK_FACES
        count = min(BLOCK_FACES, len(faces) - first)
        volume_before = volume_after = 0.0
        for at in range(count):
            f = first + at
            a, b, c = vec.load_corners(faces, f)
            u, w, p = vec.edges_and_normal(before, a, b, c)
            px[at], py[at], pz[at] = p
            p_longest[at] = vec.longest_square(u, w)
            volume_before += vec.dot(vec.load(before, a), p)
            u, w, q = vec.edges_and_normal(after, a, b, c)
            qx[at], qy[at], qz[at] = q
            q_longest[at] = vec.longest_square(u, w)
            volume_after += vec.dot(vec.load(after, a), q)
        for at in range(count):
            p, q = (px[at], py[at], pz[at]), (qx[at], qy[at], qz[at])
            p_size, q_size = vec.norm(p), vec.norm(q)
            has_both = (p_size > DEGENERATE * p_longest[at]) & (q_size > DEGENERATE * q_longest[at])
            scale = 1.0 / p_size / q_size if has_both else 0.0
            # Sine and cosine of the angle; the arccosine of the latter would lose tiny angles.
            sine = vec.norm(vec.times(scale, vec.cross(p, q)))
            cosine = vec.dot(p, q) * scale
            # tan(a / 2) is sin a / (1 + cos a) or (1 - cos a) / sin a: the one without
            # cancellation.
            apart[at] = sine if cosine >= 0.0 else 1.0 - cosine
            along[at] = 1.0 + cosine if cosine >= 0.0 else sine
            compares[at] = 1.0 if has_both else 0.0
            p_longest[at], q_longest[at] = p_size, q_size
        area_before = area_after = compared = flipped = 0.0
        for at in range(count):
            area_before += p_longest[at]
            area_after += q_longest[at]
            compared += compares[at]
            flipped += 1.0 if apart[at] > along[at] else 0.0
        arctangents(apart, along, count)
        total = largest = 0.0
        for at in range(count):
            total += apart[at]
            largest = max(largest, apart[at])
        figures[block, 0], figures[block, 1] = area_before, area_after
        figures[block, 2], figures[block, 3] = volume_before, volume_after
        figures[block, 4], figures[block, 5] = 2.0 * total, 2.0 * largest
        figures[block, 6], figures[block, 7] = flipped, compared


def surface_change(
    before: Floats, after: Floats, faces: Ints
) -> tuple[tuple[float, float], tuple[float, float], float, float, int]:
    """Areas and signed volumes of ``faces`` (m, 3) with two sets of vertices (n, 3); the mean and
    the largest angle between their normals, radians, and the number of faces that turned by more
    than a right angle, both over the faces that have a normal before and after."""
    n_blocks = -(-len(faces) // BLOCK_FACES)
    figures = np.empty((n_blocks, 8))
    over_ranges(_changes, n_blocks, before, after, faces, figures, smallest=64)
    a, b, v, w, angles, _, flipped, compared = figures.sum(axis=0).tolist()
    largest = float(figures[:, 5].max(initial=0.0))
    areas, volumes = (a / 2.0, b / 2.0), (v / 6.0, w / 6.0)
    return areas, volumes, angles / max(compared, 1.0), largest, int(flipped)


def ring_areas(vertices: Floats, faces: Ints, links: Connectivity) -> Floats:
    """Area of the faces around each vertex, (n,), squared file units; thrice the area in all."""
    areas = face_normals_and_areas(vertices, faces)[1]
    return fill_array(_row_sums, len(vertices), areas, *links.incidence)
