"""The surfaces of the sample meshes: pure functions from nothing to vertices and faces.

Every function returns ``vertices`` (n, 3) float64 in millimetres and ``faces``: an (m, 3) integer
array, or a list of index lists where quads and triangles are mixed.  Faces are counter-clockwise
seen from outside.  Only additions, products, square roots and a few sines are used, and positions
are laid on a grid of 1e-5 mm (``on_grid``), so that a last-bit difference between two machines'
sines does not reach the files.
"""

from __future__ import annotations

from typing import Any

import numpy as np

GRID = 1e-5
GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))

Array = np.ndarray[Any, Any]


def on_grid(vertices: Array) -> Array:
    """``vertices`` (n, 3) rounded to multiples of 1e-5 mm; -0 becomes 0."""
    return np.round(vertices / GRID) * GRID + 0.0


def welded(points: Array) -> tuple[Array, Array]:
    """Distinct rows of ``points`` (n, 3) in order of first appearance, and each row's number."""
    keys = np.round(points / GRID).astype(np.int64)
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    return on_grid(points[np.sort(first)]), rank[inverse.reshape(-1)]


def edge_lengths(vertices: Array, faces: Array) -> Array:
    """Length of every distinct edge of the triangles ``faces`` (m, 3), in mm."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges = np.unique(edges, axis=0)
    return np.sqrt(((vertices[edges[:, 0]] - vertices[edges[:, 1]]) ** 2).sum(axis=1))


def triangulated(faces: Array | list[list[int]]) -> Array:
    """(m, 3) triangles; every polygon becomes a fan about its first corner."""
    if isinstance(faces, np.ndarray):
        return faces
    fans = [(f[0], f[k], f[k + 1]) for f in faces for k in range(1, len(f) - 1)]
    return np.array(fans, dtype=np.int64)


def vertex_normals(vertices: Array, faces: Array) -> Array:
    """(n, 3) unit normals: the normalised sum of the unit normals of the triangles around."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    cross /= np.sqrt((cross**2).sum(axis=1))[:, None]
    total = np.zeros_like(vertices)
    for k in range(3):
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, k], cross[:, axis], len(vertices))
    return total / np.sqrt((total**2).sum(axis=1))[:, None]


# ---------------------------------------------------------------------------------------------
# Spheres, and what is made of them


def geodesic_sphere(frequency: int) -> tuple[Array, Array]:
    """Unit sphere from an icosahedron whose edges are cut in ``frequency``: 10 f^2 + 2 vertices."""
    ratio = (1 + np.sqrt(5.0)) / 2
    seeds = np.array([(0.0, s, t * ratio) for s in (-1, 1) for t in (-1, 1)])
    corners = np.concatenate([seeds, seeds[:, [2, 0, 1]], seeds[:, [1, 2, 0]]])
    gap = ((corners[:, None] - corners[None]) ** 2).sum(axis=2)
    near = np.abs(gap - 4.0) < 1e-9
    sides = [
        (i, j, k)
        for i in range(12)
        for j in range(12)
        for k in range(12)
        if i < j
        and i < k
        and near[i, j]
        and near[j, k]
        and near[k, i]
        and np.dot(np.cross(corners[i], corners[j]), corners[k]) > 0
    ]
    f = frequency
    index = {
        (i, j): n for n, (i, j) in enumerate((i, j) for i in range(f + 1) for j in range(f + 1 - i))
    }
    weights = np.array([(f - i - j, i, j) for i, j in index], dtype=float) / f
    cells = []
    for i, j in index:
        if i + j < f:
            cells.append((index[i, j], index[i + 1, j], index[i, j + 1]))
        if i + j < f - 1:
            cells.append((index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]))
    pattern = np.array(cells)
    patches = np.concatenate([weights @ corners[list(s)] for s in sides])
    patches /= np.sqrt((patches**2).sum(axis=1))[:, None]
    points, number = welded(patches)
    faces = np.concatenate([pattern + n * len(weights) for n in range(20)])
    points /= np.sqrt((points**2).sum(axis=1))[:, None]
    return points, number[faces]


def _eased(t: Array) -> Array:
    """Smooth step from 0 (t <= 0) to 1 (t >= 1)."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def dragon_egg() -> tuple[Array, Array]:
    """An egg 80 mm long covered with some 330 keeled, overlapping scales about 7 mm wide."""
    sphere, faces = geodesic_sphere(38)
    count = 330
    step = np.arange(count) + 0.5
    polar = 1.0 - 2.0 * step / count
    ring = np.sqrt(1.0 - polar * polar)
    turn = step * GOLDEN_ANGLE
    centres = np.stack([ring * np.cos(turn), ring * np.sin(turn), polar], axis=1)
    radius = 1.30 * np.sqrt(4.0 / count)

    # Around each scale's centre: `a` towards the egg's tip, `b` across, in scale radii.
    up = np.array([0.0, 0.0, 1.0]) - centres * centres[:, 2:]
    up /= np.sqrt((up**2).sum(axis=1))[:, None]
    side = np.cross(centres, up)
    a = sphere @ up.T / radius
    b = sphere @ side.T / radius
    facing = sphere @ centres.T > 0.5
    inside = 1.0 - np.sqrt(a * a + (1.15 * b) ** 2)
    rise = 0.55 - 0.45 * a - 0.30 * np.abs(b)
    scale = _eased(inside / 0.22) * np.where(facing, rise, 0.0)
    texture = scale.max(axis=1)

    height = sphere[:, 2]
    body = np.stack([27.0 * (1.0 - 0.17 * height)] * 2 + [np.full(len(height), 39.0)], axis=1)
    normal = sphere / body
    normal /= np.sqrt((normal**2).sum(axis=1))[:, None]
    return on_grid(sphere * body + 2.2 * texture[:, None] * normal), faces


def rock() -> tuple[Array, Array]:
    """A river stone of about 60 mm with a fine grain, from folded waves of falling length."""
    sphere, faces = geodesic_sphere(24)
    source = np.random.RandomState(20)
    radius = np.full(len(sphere), 24.0)
    for octave in range(7):
        for _ in range(5):
            axis = source.uniform(-1.0, 1.0, 3)
            axis /= np.sqrt((axis**2).sum())
            wave = np.sin(sphere @ axis * 2.2 * 1.75**octave + source.uniform(0, 2 * np.pi))
            radius += 2.2 * 0.52**octave * (0.6 - np.abs(wave))
    return on_grid(sphere * radius[:, None] * [1.25, 1.0, 0.8]), faces


# ---------------------------------------------------------------------------------------------
# A bear's head: strongly varying triangle size

_HEAD_BALLS = (  # centre, radius, width of the blend with what came before
    ((0.0, 0.0, 0.0), 30.0, 0.0),
    ((0.0, 16.0, -30.0), 27.0, 14.0),
    ((0.0, -24.0, -8.0), 15.0, 10.0),
    ((0.0, -36.0, -3.0), 5.2, 2.5),
    ((-20.0, 2.0, 22.0), 11.0, 8.0),
    ((20.0, 2.0, 22.0), 11.0, 8.0),
    ((-11.0, -25.5, 9.5), 3.6, 1.2),
    ((11.0, -25.5, 9.5), 3.6, 1.2),
)
_HEAD_DENTS = (
    ((-21.5, -7.5, 24.0), 7.0, 3.0),
    ((21.5, -7.5, 24.0), 7.0, 3.0),
    ((-2.6, -41.0, -3.6), 1.5, 0.8),
    ((2.6, -41.0, -3.6), 1.5, 0.8),
)


def _head_distance(points: Array) -> Array:
    """Signed distance (mm, negative inside, approximate) of ``points`` (n, 3) to the head."""
    distance = np.full(len(points), 1e3)
    for centre, radius, blend in _HEAD_BALLS:
        ball = np.sqrt(((points - centre) ** 2).sum(axis=1)) - radius
        if blend:
            t = np.clip(0.5 + 0.5 * (distance - ball) / blend, 0.0, 1.0)
            ball = distance + (ball - distance) * t - blend * t * (1.0 - t)
        distance = ball
    for centre, radius, blend in _HEAD_DENTS:
        hole = radius - np.sqrt(((points - centre) ** 2).sum(axis=1))
        t = np.clip(0.5 - 0.5 * (distance - hole) / blend, 0.0, 1.0)
        distance = distance + (hole - distance) * t + blend * t * (1.0 - t)
    x, y, z = points.T
    # The mouth: a groove below the nose, where the snout faces forward.
    curve = z + 13.0 - 0.025 * x * x
    groove = 0.9 * np.maximum(0.0, 1.0 - (curve / 0.8) ** 2) * _eased((-y - 28.0) / 6.0)
    return distance + groove


def _on_head(points: Array, passes: int) -> Array:
    step = 1e-3
    for _ in range(passes):
        value = _head_distance(points)
        slope = np.stack(
            [(_head_distance(points + step * e) - value) / step for e in np.eye(3)], axis=1
        )
        length = np.maximum((slope**2).sum(axis=1), 0.25)
        points = points - slope * (value / length)[:, None]
    return on_grid(points)


def _head_spacing(points: Array) -> Array:
    """Wanted edge length (mm): fine at the eyes, the nose and the mouth, coarse at the back."""
    reach = np.full(len(points), 1e3)
    spots = (
        (-11, -27, 10),
        (11, -27, 10),
        (0, -40, -3),
        (-5, -36, -12),
        (5, -36, -12),
        (0, -37, -13),
    )
    for spot in spots:
        gap = np.sqrt(((points - np.array(spot, dtype=float)) ** 2).sum(axis=1))
        reach = np.minimum(reach, gap)
    return 0.42 + 0.17 * np.maximum(reach - 3.0, 0.0)


def _split_once(vertices: Array, faces: Array, wanted: Array) -> tuple[Array, Array, bool]:
    """One pass of longest-edge bisection towards edges of length ``wanted`` (n,)."""
    start, stop = faces, np.roll(faces, -1, axis=1)
    low, high = np.minimum(start, stop), np.maximum(start, stop)
    gap = vertices[low] - vertices[high]
    length = np.round((gap[..., 0] ** 2 + gap[..., 1] ** 2) + gap[..., 2] ** 2, 6)
    goal = 0.5 * (wanted[low] + wanted[high])
    key = low * len(vertices) + high
    # Ties are broken by the edge's number, so that two faces never disagree about one edge.
    longest = np.lexsort((key, length), axis=1)[:, -1]
    rows = np.arange(len(faces))
    own = key[rows, longest]
    crowd, count = np.unique(own, return_counts=True)
    needy = (length > (1.35 * goal) ** 2).any(axis=1)
    while True:
        # A face can only be cut when its neighbour agrees; a neighbour that does not is cut first.
        marked = np.unique(own[needy])
        grown = needy | np.isin(key, marked).any(axis=1)
        if (grown == needy).all():
            break
        needy = grown
    cut = crowd[(count == 2) & np.isin(crowd, own[needy])]
    if len(cut) == 0:
        return vertices, faces, False
    middle = _on_head(0.5 * (vertices[cut // len(vertices)] + vertices[cut % len(vertices)]), 3)
    hit = np.isin(own, cut)
    new = len(vertices) + np.searchsorted(cut, own[hit])
    turned = np.take_along_axis(faces[hit], (longest[hit][:, None] + np.arange(3)) % 3, axis=1)
    first = np.stack([turned[:, 0], new, turned[:, 2]], axis=1)
    second = np.stack([new, turned[:, 1], turned[:, 2]], axis=1)
    whole = np.concatenate([faces[~hit], first, second])
    return np.concatenate([vertices, middle]), whole, True


def _relaxed(vertices: Array, faces: Array) -> Array:
    """Every vertex moved half-way to the mean of its neighbours, then back onto the head."""
    total = np.zeros_like(vertices)
    for start, stop in ((0, 1), (1, 2), (2, 0)):
        for axis in range(3):
            total[:, axis] += np.bincount(
                faces[:, start], vertices[faces[:, stop], axis], len(vertices)
            )
    valence = np.bincount(faces.reshape(-1), minlength=len(vertices))
    return _on_head(0.5 * (vertices + total / valence[:, None]), 2)


def bear() -> tuple[Array, Array]:
    """A bear's head, 70 mm: the largest triangle has over 1,000 times the smallest one's area."""
    sphere, faces = geodesic_sphere(5)
    vertices = _on_head(sphere * [34.0, 34.0, 40.0] + [0.0, 2.0, -8.0], 6)
    changed = True
    while changed:
        vertices, faces, changed = _split_once(vertices, faces, _head_spacing(vertices))
        vertices = _relaxed(vertices, faces)
    return vertices, faces


# ---------------------------------------------------------------------------------------------
# Swept and turned surfaces


def knot() -> tuple[Array, Array]:
    """A trefoil knot of rope: three strands twisted about the curve, 240 x 28 vertices."""
    around, along = 28, 240
    t = 2 * np.pi * np.arange(along) / along
    curve = 11.0 * np.stack(
        [np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -1.3 * np.sin(3 * t)], axis=1
    )
    tangent = np.roll(curve, -1, axis=0) - np.roll(curve, 1, axis=0)
    tangent /= np.sqrt((tangent**2).sum(axis=1))[:, None]
    # The knot lies about a torus; "outwards" from that torus's core never meets the tangent.
    flat = np.stack([curve[:, 0], curve[:, 1], np.zeros(along)], axis=1)
    core = 22.0 * flat / np.sqrt((flat**2).sum(axis=1))[:, None]
    out = curve - core
    out -= tangent * (out * tangent).sum(axis=1)[:, None]
    out /= np.sqrt((out**2).sum(axis=1))[:, None]
    side = np.cross(tangent, out)
    p = 2 * np.pi * np.arange(around) / around
    radius = 5.6 + 2.0 * np.abs(np.cos(1.5 * (p[None] + 12 * t[:, None])))
    spoke = out[:, None] * np.cos(p)[None, :, None] + side[:, None] * np.sin(p)[None, :, None]
    vertices = curve[:, None] + radius[:, :, None] * spoke
    i, j = np.meshgrid(range(along), range(around), indexing="ij")

    def at(row: Array, column: Array) -> Array:
        return ((row % along) * around + column % around).reshape(-1)

    faces = np.concatenate(
        [
            np.stack([at(i, j), at(i + 1, j + 1), at(i + 1, j)], axis=1),
            np.stack([at(i, j), at(i, j + 1), at(i + 1, j + 1)], axis=1),
        ]
    )
    return on_grid(vertices.reshape(-1, 3)), faces


def _resampled(outline: Array, steps: int) -> Array:
    """``steps`` + 1 points at equal distances along a polyline (k, 2)."""
    gap = np.sqrt((np.diff(outline, axis=0) ** 2).sum(axis=1))
    walked = np.concatenate([[0.0], np.cumsum(gap)])
    want = np.linspace(0.0, walked[-1], steps + 1)
    return np.stack([np.interp(want, walked, outline[:, k]) for k in range(2)], axis=1)


def _rounded(corners: list[tuple[float, float]]) -> Array:
    """Three rounds of corner cutting: a smooth outline with the first and last corner kept."""
    line = np.array(corners)
    for _ in range(4):
        cut = np.stack([0.75 * line[:-1] + 0.25 * line[1:], 0.25 * line[:-1] + 0.75 * line[1:]])
        line = np.concatenate([line[:1], cut.transpose(1, 0, 2).reshape(-1, 2), line[-1:]])
    return line


def _turned(profile: Array, around: int) -> tuple[Array, list[list[int]]]:
    """Surface of revolution about z of (k, 2) radius and height, from lower pole to upper pole.

    The first and the last point lie on the axis.  Quads, and triangles at the poles.
    """
    p = 2 * np.pi * np.arange(around) / around
    rings = profile[1:-1]
    body = np.stack(
        [
            rings[:, :1] * np.cos(p),
            rings[:, :1] * np.sin(p),
            np.broadcast_to(rings[:, 1:], (len(rings), around)),
        ],
        axis=2,
    ).reshape(-1, 3)
    vertices = np.concatenate([[[0, 0, profile[0, 1]]], body, [[0, 0, profile[-1, 1]]]])
    last = len(vertices) - 1
    top = 1 + (len(rings) - 1) * around
    faces = []
    for j in range(around):
        k = (j + 1) % around
        faces.append([0, 1 + k, 1 + j])
        for r in range(len(rings) - 1):
            low, high = 1 + r * around, 1 + (r + 1) * around
            faces.append([low + j, low + k, high + k, high + j])
        faces.append([last, top + j, top + k])
    return vertices, faces


def toadstool() -> tuple[Array, list[list[int]], Array]:
    """A toadstool of quads and triangles, and (n, 4) uint8 colours: a red cap with white warts."""
    corners = [(0, 0), (9, 0), (10, 4), (6.5, 9), (5.2, 22), (6.5, 31), (16, 30), (25, 29)]
    corners += [(30, 33), (26, 46), (14, 55), (5, 57), (0, 57)]
    profile = _resampled(_rounded([(float(a), float(b)) for a, b in corners]), 84)
    vertices, faces = _turned(profile, 72)
    cap = _eased((vertices[:, 2] - 33.5) / 2.0)
    out = np.stack([vertices[:, 0], vertices[:, 1], vertices[:, 2] - 30.0], axis=1)
    out /= np.sqrt((out**2).sum(axis=1))[:, None]
    source = np.random.RandomState(21)
    wart = np.zeros(len(vertices))
    for step in range(34):
        rise = 1.0 - 0.94 * (step + 0.5) / 34
        turn = step * GOLDEN_ANGLE
        ring = np.sqrt(1.0 - rise * rise)
        spot = np.array([ring * np.cos(turn), ring * np.sin(turn), rise])
        reach = source.uniform(0.09, 0.16)
        gap = np.sqrt(((out - spot) ** 2).sum(axis=1)) / reach
        wart = np.maximum(wart, _eased((1.15 - gap) / 0.55))
    wart *= cap
    vertices = vertices + 1.3 * wart[:, None] * out
    gills = np.sin(24 * np.arctan2(vertices[:, 1], vertices[:, 0]))
    radius = np.sqrt((vertices[:, :2] ** 2).sum(axis=1))
    under = _eased((radius - 8.0) / 4.0) * _eased((31.5 - vertices[:, 2]) / 1.5)
    vertices[:, 2] -= 0.45 * gills * under * _eased((vertices[:, 2] - 24.0) / 2.0)
    stem, red, white = (
        np.array(c, dtype=float) for c in ((226, 211, 176), (178, 24, 20), (245, 240, 228))
    )
    paint = stem + (red - stem) * cap[:, None]
    paint = paint + (white - paint) * np.round(wart, 3)[:, None]
    colours = np.concatenate([np.round(paint), np.full((len(paint), 1), 255.0)], axis=1)
    return on_grid(vertices), faces, colours.astype(np.uint8)


def vase() -> tuple[Array, list[list[int]], Array, list[list[int]], int]:
    """A hollow vase with a relief band: vertices, faces, (t, 2) UVs, UV corners and split row.

    The texture is cut along one meridian and once around the rim, so that vertices there have
    two or more UVs.  Faces from the split row's number on belong to the inside.
    """
    corners = [(0, 0), (15, 0), (17, 1), (13, 5), (20, 16), (29, 32), (30, 50), (20, 68), (11, 77)]
    corners += [(11.5, 85), (17, 91), (16.5, 93), (14, 91), (8.5, 83), (8, 77), (17, 66)]
    corners += [(26.5, 50), (25.5, 33), (17, 17), (9, 7), (0, 6)]
    outline = _rounded([(float(a), float(b)) for a, b in corners])
    around, rows = 80, 104
    profile = _resampled(outline, rows)
    vertices, _ = _turned(profile, around)
    rim = int(np.argmax(profile[:, 1]))
    turn = 2 * np.pi * np.arange(around) / around
    high = vertices[1:-1, 2].reshape(-1, around)
    outside = (np.arange(1, rows) < rim)[:, None]
    band = np.where(outside, _eased((high - 24) / 4) * _eased((60 - high) / 4), 0.0)
    petals = np.abs(np.sin(5 * turn[None] + 0.15 * high) * np.sin(5 * turn[None] - 0.15 * high))
    swell = 1.0 + 0.07 * band * (petals - 0.25)
    body = vertices[1:-1].reshape(rows - 1, around, 3)
    body[:, :, :2] *= swell[:, :, None]
    vertices[1:-1] = body.reshape(-1, 3)

    # One UV grid for the outside (lower 0.7 of the picture) and one for the inside (the rest).
    uv, corner_uv, faces = [], [], []
    number: dict[tuple[int, int, int], int] = {}

    def mapped(row: int, column: int, inside: int) -> int:
        key = (row, column, inside)
        if key not in number:
            number[key] = len(uv)
            along = (row - rim) / (rows - rim) * 0.28 + 0.71 if inside else row / rim * 0.69
            shift = 0.5 if row in (0, rows) else 0.0
            uv.append((round((column + shift) / around, 5), round(along, 5)))
        return number[key]

    def vertex(row: int, column: int) -> int:
        if row == 0:
            return 0
        return len(vertices) - 1 if row == rows else 1 + (row - 1) * around + column % around

    split = 0
    for row in range(rows):
        inside = int(row >= rim)
        split = len(faces) if row == rim else split
        for column in range(around):
            ring = [(row, column), (row, column + 1), (row + 1, column + 1), (row + 1, column)]
            if row == 0:
                ring = [(0, column), (1, column + 1), (1, column)]
                # At the foot the profile starts on the axis: seen from below.
            if row == rows - 1:
                ring = [(row, column), (row, column + 1), (rows, column)]
            faces.append([vertex(*place) for place in ring])
            corner_uv.append([mapped(*place, inside) for place in ring])
    return on_grid(vertices), faces, np.array(uv), corner_uv, split
