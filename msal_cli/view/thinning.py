"""Meshes beyond the memory, thinned for pictures: one vertex in each cell of a grid.

A picture has far fewer pixels than such a mesh has faces.  The grid is finer than a picture of
the usual size, and vertices that stay keep their places.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from msal_cli.arrays import Ints
from msal_cli.job.comparison import Surface
from msal_cli.job.room import are_arrays_in_files
from msal_cli.mesh import validate_arrays

MIN_VERTICES = 4_000_000
"""Vertices from which on a mesh whose arrays live in files is thinned."""


def is_to_be_thinned(surface: Surface) -> bool:
    """Whether pictures show a part of the vertices only."""
    return are_arrays_in_files() and len(surface.vertices) >= MIN_VERTICES


def choose_vertices(surface: Surface) -> tuple[Ints, Ints]:
    """The numbers (k,) of the vertices that stay, and the faces (j, 3) between these: faces whose
    corners are in three cells.

    ContentError if the surface is none.
    """
    from msal_cli.kernels import spatial_order
    from msal_cli.kernels.welding import repeated_corners

    vertices, faces, (low, high) = validate_arrays(surface.vertices, surface.faces)
    extent = max(float((high - low).max()), np.finfo(float).tiny)
    vertices, faces, ranks = spatial_order.sort_in_space(vertices, faces, low, extent)
    is_first = spatial_order.begins_cell(vertices, low, extent)
    number = np.cumsum(is_first, dtype=np.int32) - np.int32(1)
    faces = number[faces]
    faces = faces[~repeated_corners(faces)]
    stays = np.flatnonzero(is_first[ranks])
    kept = np.empty(len(stays), dtype=np.int32)
    kept[number[ranks[stays]]] = stays
    return kept, faces


def thin(surface: Surface, kept: Ints, faces: Ints) -> Surface:
    """The surface with the vertices ``kept`` (k,) and ``faces`` (j, 3) between these only."""
    colours = surface.colours
    if colours is not None and colours.vertices is not None:
        colours = replace(colours, vertices=colours.vertices[kept])
    return Surface(surface.vertices[kept], faces, colours=colours)
