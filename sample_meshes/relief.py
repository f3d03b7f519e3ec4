"""A coin as a laser scanner sees it: an open, holed, ragged range image with its camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from shapes import Array, on_grid

ROWS = COLUMNS = 150
EYE = np.array([0.0, 0.0, 120.0])
FOCAL = 120.0
PITCH = 0.262  # mm between pixels at the coin's plane


@dataclass(frozen=True)
class Scan:
    """``vertices`` (n, 3) mm, ``faces`` (m, 3), per-vertex ``confidence`` and ``quality`` (n,)."""

    vertices: Array
    faces: Array
    confidence: Array
    quality: Array


def _hill(x: Array, y: Array, at: tuple[float, float], size: tuple[float, float]) -> Array:
    """Half an ellipsoid of height 1 at ``at`` with half axes ``size``, 0 outside."""
    inside = 1.0 - ((x - at[0]) / size[0]) ** 2 - ((y - at[1]) / size[1]) ** 2
    return np.sqrt(np.maximum(inside, 0.0))


def _bump(x: Array, y: Array, at: tuple[float, float], size: tuple[float, float]) -> Array:
    """A smooth bump of height 1 at ``at``; ``size`` are its standard deviations."""
    return np.exp(-0.5 * (((x - at[0]) / size[0]) ** 2 + ((y - at[1]) / size[1]) ** 2))


def _heights(x: Array, y: Array) -> Array:
    """Height in mm of the coin above its plane: a rim of beads, a wreath and a lion's face."""
    radius = np.sqrt(x * x + y * y)
    angle = np.arctan2(y, x)
    rim = 1.5 / (1.0 + np.exp(-(radius - 17.6) / 0.16))
    beads = 0.9 * np.maximum(0.0, np.cos(33 * angle)) * np.exp(-(((radius - 16.2) / 0.55) ** 2))

    # The mane mirrors left to right; `side` runs from 0 at the top to pi below the chin.
    side = np.arctan2(np.abs(x), y)
    flow = side + 0.035 * (radius - 9.0) * np.sin(2.0 * side)
    locks = np.abs(np.cos(13.0 * flow + 0.35 * np.sin(1.3 * radius)))
    fine = np.cos(39.0 * flow + 0.8 * np.sin(1.3 * radius))
    length = 3.6 + 1.1 * np.abs(np.cos(6.5 * flow))
    mane = (0.5 + 1.5 * locks + 0.12 * fine) * np.exp(-(((radius - 10.2) / length) ** 6))

    head = 3.0 * _hill(x, y, (0.0, 0.3), (8.2, 9.2))
    brow = 0.9 * sum(_bump(x, y, (s * 3.1, 4.1), (2.0, 0.75)) for s in (-1, 1))
    eyes = sum(
        -0.9 * _bump(x, y, (s * 3.2, 2.6), (1.45, 0.85))
        + 0.75 * _hill(x, y, (s * 3.2, 2.6), (1.1, 0.75))
        for s in (-1, 1)
    )
    nose = 1.1 * _bump(x, y, (0.0, 1.8), (1.15, 3.2)) + 1.3 * _hill(x, y, (0.0, -1.5), (1.9, 1.2))
    cheeks = 1.2 * sum(_hill(x, y, (s * 2.1, -4.0), (2.5, 2.0)) for s in (-1, 1))
    whiskers = sum(
        0.16 * np.cos(5.0 * (y + 0.25 * s * x)) * _bump(x, y, (s * 2.4, -4.0), (1.4, 1.0))
        for s in (-1, 1)
    )
    mouth = -0.9 * _bump(x, y + 6.1 - 0.05 * x * x, (0.0, 0.0), (2.4, 0.3))
    chin = 0.8 * _hill(x, y, (0.0, -7.7), (2.3, 1.4))
    philtrum = -0.6 * _bump(x, y, (0.0, -3.6), (0.22, 1.2))
    ears = sum(
        1.5 * _hill(x, y, (s * 6.9, 7.3), (2.2, 2.2))
        - 1.0 * _hill(x, y, (s * 6.7, 7.1), (1.2, 1.2))
        for s in (-1, 1)
    )
    face = head + brow + eyes + nose + cheeks + whiskers + mouth + chin + philtrum + ears
    return rim + beads + np.maximum(mane, face)


def coin() -> Scan:
    """A coin of 38 mm under a perspective camera at (0, 0, 120): 150 x 150 pixels less the misses.

    Pixels are missing outside a ragged outline, in a few blobs (dust, glare) and where the surface
    turns away from the camera.
    """
    source = np.random.RandomState(30)
    row, column = np.meshgrid(np.arange(ROWS), np.arange(COLUMNS), indexing="ij")
    px = (column - (COLUMNS - 1) / 2) * PITCH
    py = ((ROWS - 1) / 2 - row) * PITCH
    depth = np.zeros_like(px)
    for _ in range(12):  # where the pixel's ray meets the surface, by repeated substitution
        shrink = (EYE[2] - depth) / FOCAL
        depth = 0.5 * depth + 0.5 * _heights(px * shrink, py * shrink)
    depth = np.round(depth, 4)
    shrink = (EYE[2] - depth) / FOCAL
    points = np.stack([px * shrink, py * shrink, depth], axis=2)

    slope = np.stack(np.gradient(depth, PITCH), axis=2)
    facing = 1.0 / np.sqrt(1.0 + (slope**2).sum(axis=2))
    angle = np.arctan2(py, px)
    ragged = 18.9 + 0.0 * angle
    for waves in (5, 9, 14, 23, 37):
        ragged += 0.12 * np.sin(waves * angle + source.uniform(0, 2 * np.pi))
    seen = np.sqrt(px * px + py * py) < ragged
    seen &= source.uniform(size=seen.shape) > 0.004
    for x, y, size in ((8.5, -9.5, 1.3), (-12.3, 5.0, 0.9), (12.6, 6.8, 0.8), (-5.6, -12.2, 1.0)):
        blob = np.sqrt((px - x) ** 2 + (py - y) ** 2)
        seen &= blob > size * (1.0 + 0.3 * np.sin(3 * np.arctan2(py - y, px - x) + x))
    seen &= facing > 0.30

    faces = _range_triangles(seen, points)
    used, faces = np.unique(faces, return_inverse=True)
    confidence = np.round(facing, 3).reshape(-1)[used]
    gloss = np.round(200.0 * facing**2 + 30.0 * np.cos(2.0 * px) * np.cos(2.0 * py), 1)
    return Scan(
        on_grid(points.reshape(-1, 3)[used]),
        faces.reshape(-1, 3),
        confidence,
        gloss.reshape(-1)[used],
    )


def _range_triangles(seen: Array, points: Array) -> Array:
    """(m, 3) pixel numbers: two triangles for four neighbours that are seen, one for three."""
    number = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
    corner = [(slice(None, -1), slice(None, -1)), (slice(1, None), slice(None, -1))]
    corner += [(slice(1, None), slice(1, None)), (slice(None, -1), slice(1, None))]
    at = [number[c].reshape(-1) for c in corner]
    ok = [seen[c].reshape(-1) for c in corner]
    flat = points.reshape(-1, 3)
    first = ((flat[at[0]] - flat[at[2]]) ** 2).sum(axis=1)
    second = ((flat[at[1]] - flat[at[3]]) ** 2).sum(axis=1)
    four = ok[0] & ok[1] & ok[2] & ok[3]
    cut = np.round(first, 6) <= np.round(second, 6)
    triangles = []
    for chosen, use in (
        ((0, 1, 2), (four & cut) | (~four & ok[0] & ok[1] & ok[2])),
        ((0, 2, 3), (four & cut) | (~four & ok[0] & ok[2] & ok[3])),
        ((0, 1, 3), (four & ~cut) | (~four & ok[0] & ok[1] & ok[3])),
        ((1, 2, 3), (four & ~cut) | (~four & ok[1] & ok[2] & ok[3])),
    ):
        triangles.append(np.stack([at[k][use] for k in chosen], axis=1))
    return np.concatenate(triangles)
