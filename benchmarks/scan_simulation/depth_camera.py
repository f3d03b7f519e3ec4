"""A depth camera: rays, noise along the view, its own smoothing, depths in steps, and a mesh.

The noise of a depth grows with its square, as that of a disparity does (Khoshelham and Elberink
2012, "Accuracy and resolution of Kinect depth data"), and with the angle at which a surface is seen
(Nguyen, Izadi and Lovell 2012, "Modeling Kinect sensor noise"; ``noise.grazing_growth`` says how).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.scan_simulation.frames import build_frame, turn, turn_back
from benchmarks.scan_simulation.settings import MOST_PIXELS, ScannerSettings
from benchmarks.scan_simulation.surface import Surface
from msal_cli.analysis.added_noise import grazing_growth
from msal_cli.arrays import Floats, Ints
from msal_cli.errors import ContentError, TooLargeError
from msal_cli.mesh import Mesh

DISTANCE = 4.0
"""From the camera to the object's centre, radii of the sphere around the object."""

STEEPEST = 5.0
"""Most depth from pixel to pixel, in pixels, within one surface: 79 degrees."""


@dataclass(frozen=True)
class Camera:
    """A pinhole camera that looks at ``centre`` (3,) from ``distance`` along ``frame[2]``.

    ``pixel`` is the edge of a pixel at the centre, file units; ``columns`` and ``rows`` are the
    places of pixels at the centre's distance, file units.
    """

    frame: Floats
    centre: Floats
    distance: float
    pixel: float
    columns: Floats
    rows: Floats

    def place(self, depths: Floats) -> Floats:
        """Positions (rows, columns, 3) of pixels at depths (rows, columns) from the camera."""
        x, y = np.meshgrid(self.columns, self.rows)
        share = depths / self.distance
        seen = np.stack([x * share, y * share, self.distance - depths], axis=-1)
        return turn_back(seen.reshape(-1, 3), self.frame).reshape(seen.shape) + self.centre

    def project(self, seen: tuple[Floats, Floats, Floats]) -> tuple[Floats, Floats, Floats]:
        """For coordinates about the centre along the frame's axes: columns and rows, as numbers of
        pixels, and depths."""
        x, y, z = seen
        depths = self.distance - z
        growth = self.distance / depths
        column = (x * growth - self.columns[0]) / self.pixel
        return column, (y * growth - self.rows[0]) / self.pixel, depths


@dataclass(frozen=True)
class DepthImage:
    """Depths (rows, columns), infinite where there is nothing, as measured and as they are, and
    how much more than head-on the noise is, by the angle at which each pixel is seen."""

    measured: Floats
    true: Floats
    growth: Floats


def scan_depth(mesh: Mesh, settings: ScannerSettings, pixel: float) -> tuple[Floats, Ints, Floats]:
    """Vertices (n, 3), faces (m, 3) and true vertices (n, 3) of what one camera sees."""
    draw = np.random.Generator(np.random.PCG64(settings.seed))
    camera = place_camera(mesh, build_frame(settings.direction), pixel, draw)
    image = take_image(Surface(mesh), camera, settings, draw)
    jump = max(STEEPEST, 2.0 * settings.value("step")) * pixel
    faces = triangulate(image.measured, jump)
    if not len(faces):
        raise ContentError(
            "the camera sees no surface",
            code="E_NO_FACES",
            hint="choose another direction or a finer resolution",
        )
    used = np.unique(faces)
    number = np.full(image.measured.size, -1, dtype=np.int32)
    number[used] = np.arange(len(used), dtype=np.int32)
    seen = np.isfinite(image.measured)
    measured = camera.place(np.where(seen, image.measured, camera.distance)).reshape(-1, 3)
    true = camera.place(np.where(seen, image.true, camera.distance)).reshape(-1, 3)
    return measured[used], number[faces], true[used]


def place_camera(mesh: Mesh, frame: Floats, pixel: float, draw: np.random.Generator) -> Camera:
    """A camera that sees the whole object, whose place within a pixel is drawn."""
    used = mesh.vertices[mesh.topology.has_ring]
    centre = (used.min(axis=0) + used.max(axis=0)) / 2.0
    radius = float(np.sqrt(((used - centre) ** 2).sum(axis=1).max()))
    distance = DISTANCE * radius
    seen = turn(used - centre, frame)
    images = seen[:, :2] * (distance / (distance - seen[:, 2]))[:, None]
    low, extent = images.min(axis=0), np.ptp(images, axis=0)
    counts = np.ceil(extent / pixel) + 3
    if float(counts.prod()) > MOST_PIXELS:
        raise TooLargeError(
            f"the image would have {counts.prod():,.0f} pixels, more than {MOST_PIXELS:,}",
            hint="choose a coarser resolution",
        )
    first = low - pixel * (0.5 + draw.random(2))
    columns, rows = (
        start + pixel * np.arange(int(n)) for start, n in zip(first, counts, strict=True)
    )
    return Camera(frame, centre, distance, pixel, columns, rows)


def take_image(
    surface: Surface, camera: Camera, settings: ScannerSettings, draw: np.random.Generator
) -> DepthImage:
    """What the camera measures."""
    shape = (len(camera.rows), len(camera.columns))
    ends = camera.place(np.full(shape, camera.distance)).reshape(-1, 3)
    origin = camera.centre + camera.distance * camera.frame[2]
    ways = ends - origin
    lengths = np.sqrt((ways * ways).sum(axis=1))
    ways /= lengths[:, None]
    reach, faces = surface.cast_rays(origin, ways)
    true = (reach * camera.distance / lengths).reshape(shape)
    growth = np.ones(len(ways))
    hit = faces >= 0
    growth[hit] = grazing_growth(surface.face_normals(faces[hit]), ways[hit])
    growth = growth.reshape(shape)
    noise = draw.standard_normal(shape)
    if correlation := settings.value("correlation"):
        noise = _blur(noise, correlation)
        noise /= np.sqrt((noise * noise).mean())
    deviation = settings.value("level") * camera.pixel * growth
    squared = np.where(np.isfinite(true), true, 0.0) ** 2 / camera.distance**2
    measured = true + deviation * squared * noise
    if width := settings.value("smoothing"):
        measured = smooth_depths(measured, true, width, STEEPEST * camera.pixel)
    if step := settings.value("step"):
        measured = quantise_disparities(measured, step * camera.pixel, camera.distance)
    return DepthImage(measured, true, growth)


def _blur(values: Floats, deviation: float) -> Floats:
    """Values (rows, columns) averaged with a Gaussian, whose borders are joined."""
    offsets = range(-int(np.ceil(3.0 * deviation)), int(np.ceil(3.0 * deviation)) + 1)
    for axis in (0, 1):
        weights = [np.exp(-0.5 * (offset / deviation) ** 2) for offset in offsets]
        rolled = (
            w * np.roll(values, offset, axis) for w, offset in zip(weights, offsets, strict=True)
        )
        values = sum(rolled, np.zeros_like(values))
    return values


def smooth_depths(depths: Floats, true: Floats, deviation: float, jump: float) -> Floats:
    """Depths (rows, columns) averaged with a Gaussian of ``deviation`` pixels, but not over
    borders: only with pixels whose ``true`` depth is nearer than ``jump`` a pixel."""
    reach = int(np.ceil(2.0 * deviation))
    padded = np.pad(depths, reach, constant_values=np.inf)
    there = np.pad(true, reach, constant_values=np.inf)
    rows, columns = depths.shape
    sums, weights = np.zeros_like(depths), np.zeros_like(depths)
    seen = np.isfinite(true)
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            part = (slice(reach + dy, reach + dy + rows), slice(reach + dx, reach + dx + columns))
            far = max(1.0, float(np.hypot(dx, dy)))
            with np.errstate(invalid="ignore"):
                joins = seen & (np.abs(there[part] - true) <= jump * far)
            weight = float(np.exp(-0.5 * (dx * dx + dy * dy) / deviation**2))
            sums[joins] += weight * padded[part][joins]
            weights[joins] += weight
    return np.where(seen, sums / np.where(weights > 0.0, weights, 1.0), np.inf)


def quantise_disparities(depths: Floats, step: float, distance: float) -> Floats:
    """Depths whose reciprocals are multiples of one number, ``step`` apart at ``distance``."""
    unit = step / distance**2
    with np.errstate(divide="ignore"):
        whole = np.maximum(np.round(1.0 / (depths * unit)), 1.0)
    return np.where(np.isfinite(depths), 1.0 / (whole * unit), np.inf)


def triangulate(depths: Floats, jump: float) -> Ints:
    """Triangles (m, 3) of neighbouring pixels, cut where a depth is missing or jumps.

    Of the two diagonals of four pixels the one with the lesser difference in depth is taken.
    """
    rows, columns = depths.shape
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b = number[:-1, :-1], number[:-1, 1:]
    c, d = number[1:, 1:], number[1:, :-1]
    flat = depths.reshape(-1)
    with np.errstate(invalid="ignore"):
        first = np.abs(flat[a] - flat[c]) <= np.abs(flat[b] - flat[d])
    # An infinite difference is not less than another; where one corner is missing, the diagonal
    # that leaves it out is taken.
    first = np.where(np.isfinite(flat[a]) & np.isfinite(flat[c]), first, False)
    first |= ~(np.isfinite(flat[b]) & np.isfinite(flat[d]))
    one = np.where(first[..., None], np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    two = np.where(first[..., None], np.stack([a, c, d], -1), np.stack([b, c, d], -1))
    faces = np.stack([one, two], axis=2).reshape(-1, 3)
    corners = flat[faces]
    with np.errstate(invalid="ignore"):
        is_whole = np.isfinite(corners).all(axis=1)
        is_whole[is_whole] = np.ptp(corners[is_whole], axis=1) <= jump
    triangles: Ints = faces[is_whole].astype(np.int32)
    return triangles
