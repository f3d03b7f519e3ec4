"""Surfaces out of volumes by marching cubes (Lewiner et al. 2003), as scikit-image does it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints
from msal_cli.errors import ContentError

Volume = NDArray[np.float32]


def extract_surface(
    volume: Volume, level: float, spacing: Floats, known: NDArray[np.bool_] | None = None
) -> tuple[Floats, Ints]:
    """The surface where a volume has the value ``level``, with greater values inside.

    Parameters
    ----------
    volume : (nx, ny, nz) values.
    level : a value between the least and the greatest.
    spacing : (3,) from one value to the next along x, y and z.
    known : (nx, ny, nz) where there are values; the surface ends where there are none.

    Returns
    -------
    Vertices (n, 3), the value of index (0, 0, 0) at the origin, and faces (m, 3), which look from
    greater values to lesser.

    Raises
    ------
    ContentError
        with code ``E_NO_FACES`` where the volume has no such surface.
    """
    from skimage.measure import marching_cubes

    no_surface = ContentError(
        f"the volume has no surface at the value {level:g}",
        code="E_NO_FACES",
        hint="choose another value",
    )
    if min(volume.shape) < 2 or not float(volume.min()) < level < float(volume.max()):
        raise no_surface
    mask = None if known is None else _last_corners(known)
    try:
        vertices, faces, _, _ = marching_cubes(
            volume, level, gradient_direction="ascent", allow_degenerate=False, mask=mask
        )
    except (RuntimeError, ValueError):
        # All the cells that the surface passes are masked.
        raise no_surface from None
    if not len(faces):
        raise no_surface
    return vertices.astype(np.float64) * spacing, faces.astype(np.int32)


def _last_corners(known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The mask in the library's terms: it takes a cell whose last corner, in all axes, is set."""
    mask = np.zeros(known.shape, dtype=np.bool_)
    cells = mask[1:, 1:, 1:]
    cells[:] = True
    for x in (slice(None, -1), slice(1, None)):
        for y in (slice(None, -1), slice(1, None)):
            for z in (slice(None, -1), slice(1, None)):
                cells &= known[x, y, z]
    return mask
