"""Range grids of PLY files, as those of the Stanford archive: raw scans without faces.

The element ``range_grid`` has a list of no vertex or one for each sample of the scanner, row by
row; ``obj_info num_cols`` and ``num_rows`` in the header give its size.  Neighbouring samples are
joined as by Turk and Levoy ("Zippered polygon meshes from range images", 1994): four make two
triangles along the shorter diagonal, three make one, and no triangle has an edge longer than four
times the distance of samples, so that a surface is not joined with what is behind it.  TriMesh2
drops of long triangles only thin ones; MeshLab takes the same diagonal everywhere and drops none.
"""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats, Ints
from msal_cli.codecs.ply_header import Element, Header
from msal_cli.errors import ContentError, FormatError

NAME = "range_grid"

MAX_SPACINGS = 4.0
"""Longest edge that joins two samples, in median edge lengths."""


def grid_shape(header: Header, grid: Element) -> tuple[int, int]:
    """Rows and columns of the grid; FormatError where the header does not give them."""
    found = {name: header.infos.get(name, "") for name in ("num_rows", "num_cols")}
    missing = [f"'obj_info {name}'" for name, word in found.items() if not word]
    if missing:
        raise FormatError(
            f"the header has a range grid but no {' and no '.join(missing)}",
            where="header",
            hint="write 'obj_info num_rows R' and 'obj_info num_cols C' below the format line; "
            f"R times C are {grid.count}",
        )
    if not all(word.isdecimal() and len(word) < 10 for word in found.values()):
        raise FormatError(
            f"the size of the range grid, {' by '.join(found.values())[:60]}, is not two counts",
            where="header",
            hint="correct the lines 'obj_info num_rows' and 'obj_info num_cols'",
        )
    rows, columns = (int(word) for word in found.values())
    if rows * columns != grid.count:
        raise FormatError(
            f"the range grid has {grid.count} samples, but {rows} rows of {columns} columns are "
            f"{rows * columns}",
            where="header",
            hint="correct the lines 'obj_info num_rows' and 'obj_info num_cols'",
        )
    return rows, columns


def triangulate_grid(samples: Ints, vertices: Floats) -> Ints:
    """Triangles (m, 3) between neighbours.

    samples (rows, columns) are vertices, -1 where the scanner saw nothing; vertices (n, 3).
    Raises ContentError (``E_NO_FACES``) where no three samples are neighbours.
    """
    around = (samples[:-1, :-1], samples[:-1, 1:], samples[1:, 1:], samples[1:, :-1])
    corners = np.stack([part.reshape(-1) for part in around], axis=1)
    is_there = corners >= 0
    n_there = is_there.sum(axis=1)
    pairs = np.full((len(corners), 2, 3), -1, dtype=np.int32)
    a, b, c, d = corners[n_there == 4].T
    with np.errstate(over="ignore"):
        is_first = _squared(vertices[c] - vertices[a]) < _squared(vertices[d] - vertices[b])
    along_first = np.stack([a, b, c, a, c, d], axis=1)
    along_second = np.stack([a, b, d, b, c, d], axis=1)
    pairs[n_there == 4] = np.where(is_first[:, None], along_first, along_second).reshape(-1, 2, 3)
    # From the corner behind the missing one on.
    of_three = n_there == 3
    missing = np.argmin(is_there[of_three], axis=1)
    order = (missing[:, None] + np.arange(1, 4)) % 4
    pairs[of_three, 0] = np.take_along_axis(corners[of_three], order, axis=1)
    triangles = pairs.reshape(-1, 3)
    triangles = triangles[triangles[:, 0] >= 0]
    if not len(triangles):
        raise ContentError(
            "no three samples of the range grid are neighbours",
            where=f"element {NAME}",
            hint="the scan has no surface; check num_rows and num_cols",
            code="E_NO_FACES",
        )
    with np.errstate(over="ignore"):
        squares = np.stack(
            [_squared(vertices[triangles[:, k]] - vertices[triangles[:, k - 1]]) for k in range(3)]
        )
        longest = MAX_SPACINGS**2 * np.median(squares)
    return np.ascontiguousarray(triangles[squares.max(axis=0) <= longest])


def _squared(edges: Floats) -> Floats:
    squares: Floats = (edges * edges).sum(axis=1)
    return squares
