"""From a mesh and a camera to a lit image on nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Floats, Floats32, Ints
from msal_cli.view.camera import Camera


@dataclass(frozen=True, eq=False)
class Lit:
    """A mesh on nothing: what a picture puts before its background.

    Attributes
    ----------
    colours : (h, w, 3) float32, 0 to 255, times ``covered``.
    covered : (h, w) float32, the share of each pixel that shows the mesh.
    depth : (h, w) float32, nearness to the eye in pixels; 0 where nothing is.
    """

    colours: Floats32
    covered: Floats32
    depth: Floats32


def rasterised(
    vertices: Floats,
    faces: Ints,
    camera: Camera,
    size: tuple[int, int],
    *,
    paint: Floats32,
    back: Floats32,
    lights: Floats,
    crease: float,
    side: int,
) -> Lit:
    """Draw the triangles, ``side`` by ``side`` samples in each pixel.

    Parameters
    ----------
    vertices : (n, 3); ``faces`` : (m, 3).
    size : (width, height) in pixels.
    paint, back, lights : see ``kernels.z_buffer.lit``.
    crease : radians; faces that turn by more than this at an edge keep the edge sharp.
    """
    from msal_cli.kernels import z_buffer

    width, height = size
    seen = camera.seen(vertices)
    normals = z_buffer.corner_normals(seen, faces, crease)
    scale = side * camera.pixels_per_unit(width, height)
    points = np.empty_like(seen)
    points[:, 0] = seen[:, 0] * scale + 0.5 * side * width
    points[:, 1] = 0.5 * side * height - seen[:, 1] * scale
    points[:, 2] = seen[:, 2] * scale
    nearness, front = z_buffer.nearest_faces(points, faces, side * height, side * width)
    sums, depth = z_buffer.lit(side, points, faces, nearness, front, normals, paint, back, lights)
    return Lit(sums[..., :3], sums[..., 3], depth / np.float32(side))
