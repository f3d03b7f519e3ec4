"""Rasterization: the nearest face in each sample of a picture, and its light.

``points`` (n, 3) float64 are vertices in the coordinates of the picture: to the right and down, in
samples, and nearness to the eye in the same unit.  The sample in row r and column c is at (c + 0.5,
r + 0.5).  ``faces`` (m, 3) int32.  Each pixel of a picture (height, width) has ``side * side``
samples.
"""

import numpy as np

from msal_cli.arrays import Floats, Floats32, Ints
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.library import compiled
from msal_cli.kernels.parallel import over_ranges

NOTHING = -1
"""The face of a sample without a face."""

ROUNDING = 1e-9
"""How far outside a face a sample may be, so that one on an edge is in one of its faces."""

MIN_ROWS = 64
"""Rows per thread: each thread reads all faces."""


@compiled
def _nearest_faces(start, stop, points, faces, nearness, front):
    """Draw all faces into rows ``start`` to ``stop``; the first of equally near faces is kept."""
    width = front.shape[1]
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ay, by, cy = points[a, 1], points[b, 1], points[c, 1]
        # From the first to the last row whose centre is in the height of the triangle.
        top = max(np.float64(start), np.ceil(min(ay, by, cy) - 0.5))
        bottom = min(np.float64(stop - 1), np.floor(max(ay, by, cy) - 0.5))
        if not top <= bottom:
            continue
        ax, bx, cx = points[a, 0], points[b, 0], points[c, 0]
        left = max(0.0, np.ceil(min(ax, bx, cx) - 0.5))
        right = min(np.float64(width - 1), np.floor(max(ax, bx, cx) - 0.5))
        if not left <= right:
            continue
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        nearness_c = points[c, 2]
        nearer_a, nearer_b = points[a, 2] - nearness_c, points[b, 2] - nearness_c
        # Weights of the corners a and b, linear in x; c has the rest.
        slope_a, slope_b = -(cy - by) / area, -(ay - cy) / area
        for row in range(np.int64(top), np.int64(bottom) + 1):
            y = row + 0.5
            start_a = ((cx - bx) * (y - by) + (cy - by) * bx) / area
            start_b = ((ax - cx) * (y - cy) + (ay - cy) * cx) / area
            for column in range(np.int64(left), np.int64(right) + 1):
                x = column + 0.5
                wa = start_a + slope_a * x
                wb = start_b + slope_b * x
                if wa >= -ROUNDING and wb >= -ROUNDING and wa + wb <= 1.0 + ROUNDING:
                    near = np.float32(nearness_c + wa * nearer_a + wb * nearer_b)
                    if near > nearness[row, column]:
                        nearness[row, column] = near
                        front[row, column] = f


def nearest_faces(points: Floats, faces: Ints, height: int, width: int) -> tuple[Floats32, Ints]:
    """The nearness (height, width) of the nearest face in each sample, -inf for none, and the
    face's number, ``NOTHING`` for none."""
    nearness = np.full((height, width), -np.inf, dtype=np.float32)
    front = np.full((height, width), NOTHING, dtype=np.int32)
    over_ranges(_nearest_faces, height, points, faces, nearness, front, smallest=MIN_ROWS)
    return nearness, front


@compiled
def _corner_normals(
    start, stop, faces, face_start, incident, normals, areas, least_cosine, full_cosine, result
):
    """At each corner of faces the mean normal of the vertex's faces that turn little from it."""
    span = full_cosine - least_cosine
    for f in range(start, stop):
        own = vec.load(normals, f)
        for corner in range(3):
            vertex = faces[f, corner]
            total = vec.ORIGIN
            for slot in range(face_start[vertex], face_start[vertex + 1]):
                g = incident[slot]
                cosine = vec.dot(vec.load(normals, g), own)
                if cosine <= least_cosine:
                    continue
                weight = areas[g] * min(1.0, (cosine - least_cosine) / span)
                total = vec.add_scaled(total, weight, vec.load(normals, g))
            length = vec.norm(total)
            vec.store(result[f], corner, vec.divide(total, length) if length > 0.0 else own)


def corner_normals(vertices: Floats, faces: Ints, crease: float) -> Floats32:
    """Normals (m, 3, 3) at the three corners of each face, smooth except for creases.

    A corner's normal is the area-weighted mean of the normals of the faces at its vertex.  Those
    that turn from this face by more than ``crease`` (radians, up to pi) do not count, those that
    turn by less than half of it count in full, and those between in part: a sharp bound would show
    the triangles along rounded edges.  0 gives flat faces.
    """
    from msal_cli.kernels.connectivity import index_rows
    from msal_cli.kernels.geometry import face_normals_and_areas

    normals, areas = face_normals_and_areas(vertices, faces)
    result = np.empty((len(faces), 3, 3), dtype=np.float32)
    if crease <= 0.0:
        result[:] = normals[:, None, :]
        return result
    cosines = float(np.cos(crease)), float(np.cos(0.5 * crease))
    rows = faces, *index_rows(len(vertices), faces)
    over_ranges(_corner_normals, len(faces), *rows, normals, areas, *cosines, result)
    return result


@compiled
def _blend(x, a, b, c, wa, wb, wc):
    """The weighted sum of three vectors of ``x``."""
    total = vec.add_scaled(vec.times(wa, vec.load(x, a)), wb, vec.load(x, b))
    return vec.add_scaled(total, wc, vec.load(x, c))


@compiled
def _light_samples(
    start, stop, side, points, faces, nearness, front, normals, paint, back, lights, sums, depths
):
    """Add up light and coverage of the samples of pixel rows ``start`` to ``stop``."""
    width = sums.shape[1]
    by_vertex = len(paint) > 1
    ambient, rim = lights[0, 0], lights[0, 1]
    gloss, sharpness = lights[0, 2], lights[0, 3]
    share = 1.0 / (side * side)
    for row in range(start, stop):
        for column in range(width):
            colour, covered, depth = vec.ORIGIN, 0.0, 0.0
            for i in range(row * side, row * side + side):
                for j in range(column * side, column * side + side):
                    f = front[i, j]
                    if f < 0:
                        continue
                    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
                    ax, ay = points[a, 0], points[a, 1]
                    bx, by = points[b, 0], points[b, 1]
                    cx, cy = points[c, 0], points[c, 1]
                    x, y = j + 0.5, i + 0.5
                    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
                    wa = ((cx - bx) * (y - by) - (cy - by) * (x - bx)) / area
                    wb = ((ax - cx) * (y - cy) - (ay - cy) * (x - cx)) / area
                    wc = 1.0 - wa - wb
                    normal = _blend(normals[f], 0, 1, 2, wa, wb, wc)
                    length = vec.norm(normal)
                    if length > 0.0:
                        normal = vec.divide(normal, length)
                    # Rows count downwards, so a face turned to the eye has a negative area.
                    is_back = area > 0.0
                    if is_back:
                        normal = vec.times(-1.0, normal)
                    light, shine = ambient, 0.0
                    for k in range(1, len(lights)):
                        wrap = lights[k, 4]
                        cosine = vec.dot(normal, vec.load(lights, k))
                        lambert = (cosine + wrap) / (1.0 + wrap)
                        if lambert > 0.0:
                            light += lights[k, 3] * lambert
                        if k == 1 and cosine > 0.0:
                            # Half way between the light and the eye.
                            middle = np.sqrt(2.0 + 2.0 * lights[k, 2])
                            half = (cosine + normal[2]) / middle
                            if half > 0.0:
                                shine = gloss * half**sharpness
                    edge = 1.0 - abs(normal[2])
                    light += rim * edge * edge * edge
                    if by_vertex:
                        pr, pg, pb = _blend(paint, a, b, c, wa, wb, wc)
                    elif is_back:
                        pr, pg, pb = vec.load(back, 0)
                    else:
                        pr, pg, pb = vec.load(paint, 0)
                    red = min(255.0, pr * light + 255.0 * shine)
                    green = min(255.0, pg * light + 255.0 * shine)
                    blue = min(255.0, pb * light + 255.0 * shine)
                    colour = vec.add(colour, (red, green, blue))
                    covered += 1.0
                    depth += nearness[i, j]
            vec.store(sums[row], column, vec.times(share, colour))
            sums[row, column, 3] = covered * share
            depths[row, column] = depth / covered if covered > 0.0 else 0.0


def light_samples(
    side: int,
    points: Floats,
    faces: Ints,
    nearness: Floats32,
    front: Ints,
    normals: Floats32,
    paint: Floats32,
    back: Floats32,
    lights: Floats,
) -> tuple[Floats32, Floats32]:
    """The samples of ``nearest_faces`` lit and averaged to pixels.

    Parameters
    ----------
    side : samples along one side of a pixel.
    normals : (m, 3, 3) of ``corner_normals``, in directions right, up, towards the eye.
    paint : (n, 3) colours of the vertices, 0 to 255, or (1, 3) for one colour of all.
    back : (3,) colour of faces seen from behind, where there is one colour.
    lights : (1 + k, 5): in row 0 ambient light, light at edges, gloss and its sharpness; then for
        each lamp the unit direction towards it, strength, and how far it reaches round (0 to 1).

    Returns
    -------
    (h, w, 4) float32: red, green, blue in 0 to 255, times the share of the pixel that is covered,
    and that share; (h, w) float32: mean nearness of the covered samples, 0 where there are none.
    """
    height, width = front.shape[0] // side, front.shape[1] // side
    sums = np.empty((height, width, 4), dtype=np.float32)
    depths = np.empty((height, width), dtype=np.float32)
    known = side, points, faces, nearness, front, normals, paint, back, lights
    over_ranges(_light_samples, height, *known, sums, depths, smallest=MIN_ROWS)
    return sums, depths
