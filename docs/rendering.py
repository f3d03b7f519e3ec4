"""A small flat-shading renderer for the pictures in these pages: numpy and zlib, nothing else."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]

CLAY = (214, 203, 188)
LIGHTS = (  # direction towards the light in view coordinates (right, up, towards the eye), strength
    ((-0.55, 0.62, 0.56), 0.80),
    ((0.85, 0.15, 0.35), 0.30),
)
AMBIENT = 0.24
SAMPLES = 3


def turned(turn_deg: float, tilt_deg: float) -> Array:
    """(3, 3) rotation from z-up model coordinates to right, up, towards the eye.

    ``turn_deg`` turns the model about z, ``tilt_deg`` raises the eye above the horizon.
    """
    t, p = np.radians([turn_deg, tilt_deg])
    right = np.array([np.cos(t), np.sin(t), 0.0])
    out = np.array([np.sin(t) * np.cos(p), -np.cos(t) * np.cos(p), np.sin(p)])
    return np.stack([right, np.cross(out, right), out])


def picture(
    vertices: Array,
    faces: Array,
    view: Array,
    size: tuple[int, int],
    *,
    window: tuple[float, float, float] | None = None,
    colours: Array | None = None,
) -> Array:
    """(height, width, 3) uint8: the triangles under parallel projection, lit, on white.

    Parameters
    ----------
    vertices : (n, 3) float64; ``faces`` : (m, 3) int.
    view : (3, 3) rotation of ``turned``.
    size : (width, height) in pixels.
    window : centre right, centre up and half height of what is shown, in units of the vertices
        after the rotation; None frames the whole mesh.
    colours : (m, 3) in 0..255, or None for clay.
    """
    width, height = size[0] * SAMPLES, size[1] * SAMPLES
    seen = vertices @ view.T
    if window is None:
        low, high = seen[faces.reshape(-1)].min(axis=0), seen[faces.reshape(-1)].max(axis=0)
        centre = 0.5 * (low + high)
        half = 0.53 * max(high[1] - low[1], (high[0] - low[0]) * height / width)
    else:
        centre, half = np.array([window[0], window[1], 0.0]), window[2]
    scale = height / (2.0 * half)
    across = (seen[:, 0] - centre[0]) * scale + width / 2
    down = height / 2 - (seen[:, 1] - centre[1]) * scale
    corner = np.stack([across, down, seen[:, 2]], axis=1)[faces]

    front = _front_faces(corner, width, height)
    normal = np.cross(seen[faces[:, 1]] - seen[faces[:, 0]], seen[faces[:, 2]] - seen[faces[:, 0]])
    normal /= np.maximum(np.sqrt((normal**2).sum(axis=1)), 1e-30)[:, None]
    normal[normal[:, 2] < 0] *= -1.0
    light = np.full(len(faces), AMBIENT)
    for direction, strength in LIGHTS:
        towards = np.array(direction) / np.linalg.norm(direction)
        light += strength * np.maximum(normal @ towards, 0.0)
    paint = np.broadcast_to(np.array(CLAY, dtype=float), (len(faces), 3))
    paint = paint if colours is None else colours
    shade = np.concatenate([np.minimum(paint * light[:, None], 255.0), [[255.0] * 3]])
    image = shade[front].reshape(size[1], SAMPLES, size[0], SAMPLES, 3).mean(axis=(1, 3))
    return np.round(image).astype(np.uint8)


def _front_faces(corner: Array, width: int, height: int) -> Array:
    """(height, width) number of the nearest triangle in each sample, -1 where there is none.

    ``corner`` is (m, 3, 3): across, down (both in samples) and nearness.
    """
    low = np.floor(corner[:, :, :2].min(axis=1)).astype(int)
    high = np.ceil(corner[:, :, :2].max(axis=1)).astype(int)
    extent = (high - low).max(axis=1) + 1
    inside = (high >= 0).all(axis=1) & (low[:, 0] < width) & (low[:, 1] < height)
    nearest = np.full(height * width, -np.inf)
    front = np.full(height * width, -1)
    reach = 1
    while inside.any() and reach < 2 * extent[inside].max():
        # Triangles of like size share one square of samples.
        some = np.flatnonzero(inside & (extent <= reach) & (extent > reach // 2))
        offsets = np.stack(np.meshgrid(range(reach), range(reach)), axis=2).reshape(-1, 2)
        for part in np.array_split(some, max(1, len(some) * reach * reach // 2_000_000 + 1)):
            _draw(corner, part, low, offsets, nearest, front, width, height)
        reach *= 2
    return front.reshape(height, width)


def _draw(
    corner: Array, part: Array, low: Array, offsets: Array, nearest: Array, front: Array,
    width: int, height: int,
) -> None:  # fmt: skip
    a, b, c = (corner[part, k] for k in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    good = np.abs(area) > 1e-9
    part, a, b, c, area = part[good], a[good], b[good], c[good], area[good]
    spot = low[part][:, None, :] + offsets[None]
    x, y = spot[..., 0] + 0.5, spot[..., 1] + 0.5

    def weight(p: Array, q: Array) -> Array:
        turn = (q[:, 0] - p[:, 0])[:, None] * (y - p[:, 1:2])
        turn = turn - (q[:, 1] - p[:, 1])[:, None] * (x - p[:, :1])
        return turn / area[:, None]

    wa, wb, wc = weight(b, c), weight(c, a), weight(a, b)
    hit = (wa >= 0) & (wb >= 0) & (wc >= 0)
    hit &= (spot >= 0).all(axis=2) & (spot[..., 0] < width) & (spot[..., 1] < height)
    depth = wa * a[:, 2:] + wb * b[:, 2:] + wc * c[:, 2:]
    who, which = np.nonzero(hit)
    place = spot[who, which, 1] * width + spot[who, which, 0]
    depth, owner = depth[who, which], part[who]
    # Nearest last, so that it is the one which an assignment with repeated places keeps.
    order = np.argsort(depth, kind="stable")
    place, depth, owner = place[order], depth[order], owner[order]
    last = np.full(len(nearest), -1)
    last[place] = np.arange(len(place))
    keep = last[last >= 0]
    better = depth[keep] > nearest[place[keep]]
    keep = keep[better]
    nearest[place[keep]] = depth[keep]
    front[place[keep]] = owner[keep]


def write_png(path: Path, image: Array) -> None:
    """Write (height, width, 3) uint8 ``image`` with a palette of its 256 most frequent colours."""
    palette, index = _indexed(image)
    height, width = index.shape
    rows = np.concatenate([np.zeros((height, 1), np.uint8), index], axis=1)

    def chunk(kind: bytes, body: bytes) -> bytes:
        check = zlib.crc32(kind + body)
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", check)

    header = struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"PLTE", palette.tobytes())
        + chunk(b"IDAT", zlib.compress(rows.tobytes(), 9))
        + chunk(b"IEND", b"")
    )


def _indexed(image: Array) -> tuple[Array, Array]:
    """Palette (k, 3) uint8, k <= 256, and the number of the nearest colour for each pixel."""
    coarse = np.minimum(np.round(image / 5.0) * 5.0, 255.0)
    colours, which, count = np.unique(
        coarse.reshape(-1, 3), axis=0, return_inverse=True, return_counts=True
    )
    kept = colours[np.argsort(-count, kind="stable")[:256]]
    gaps = ((colours[:, None, :] - kept[None]) ** 2).sum(axis=2)
    index = gaps.argmin(axis=1)[which.reshape(-1)].reshape(image.shape[:2])
    return kept.astype(np.uint8), index.astype(np.uint8)
