"""A part of a mesh that is read in pieces, on which its noise can be estimated.

The part is what lies in a few small cubes around vertices that are spread over the file, each about
as large as the estimate needs, wherever its faces are in the file.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats
from msal_cli.job.streamed_faces import FacePiece
from msal_cli.kernels.corner_gathering import faces_in_boxes
from msal_cli.mesh import Mesh, prepare_mesh

N_CUBES = 8

CUBE_VERTICES = 10_000
"""Vertices in a cube, about: fifty from its middle to its sides, and the estimate looks at six
rings around some of them."""

WHOLE_VERTICES = N_CUBES * CUBE_VERTICES
"""A mesh with no more vertices than that is taken whole."""

MOST_FACES = 8 * WHOLE_VERTICES
"""Faces that are kept, where many more lie in a cube than the vertices let expect."""

SAMPLED = 100_000
"""Vertices of the file that tell how dense it is around the cubes."""


_FACTOR, _BITS = 2_654_435_761, 32


class SpreadSample:
    """One of every k vertices of a mesh that comes in pieces, here and there among them: at even
    steps they might all lie in a few columns of a grid."""

    def __init__(self, n_vertices: int) -> None:
        self.step = -(-n_vertices // SAMPLED)
        self._parts: list[Floats] = []

    def add(self, start: int, vertices: NDArray[np.floating]) -> None:
        """Add the vertices (n, 3) from number ``start`` on."""
        stop = start + len(vertices)
        rows = np.arange(start // self.step, -(-stop // self.step), dtype=np.int64)
        mixed = rows * _FACTOR & (1 << _BITS) - 1
        numbers = rows * self.step + (mixed * self.step >> _BITS)
        numbers = numbers[(numbers >= start) & (numbers < stop)]
        self._parts.append(vertices[numbers - start].astype(np.float64))

    @property
    def vertices(self) -> Floats:
        """What was sampled (k, 3)."""
        return np.concatenate(self._parts)


class RepresentativePart:
    """The faces in small cubes that are spread over a mesh."""

    def __init__(self, sample: SpreadSample, n_vertices: int) -> None:
        self._low = np.full((1, 3), -np.inf)
        self._high = np.full((1, 3), np.inf)
        if n_vertices > WHOLE_VERTICES:
            self._low, self._high = _cubes(sample)
        self._triangles: list[NDArray[np.uint32]] = []
        self._corners: list[Floats] = []
        self._n_faces = 0

    def add(self, piece: FacePiece) -> None:
        """Keep those faces of a piece that lie in a cube."""
        found = faces_in_boxes(piece.corners, self._low, self._high)
        found = found[: MOST_FACES - self._n_faces]
        if len(found):
            self._n_faces += len(found)
            self._triangles.append(piece.triangles[found])
            self._corners.append(piece.corners[found].astype(np.float64))

    def mesh(self) -> Mesh:
        """The part as a mesh; ContentError if it is none."""
        flat = np.concatenate(self._triangles or [np.empty((0, 3), np.uint32)]).reshape(-1)
        corners = np.concatenate(self._corners or [np.empty((0, 9))]).reshape(-1, 3)
        _, first, faces = np.unique(flat, return_index=True, return_inverse=True)
        return prepare_mesh(corners[first], faces.reshape(-1, 3).astype(np.int32)).mesh


def _cubes(sample: SpreadSample) -> tuple[Floats, Floats]:
    """Corners (k, 3) of cubes with about ``CUBE_VERTICES`` vertices each."""
    vertices = sample.vertices
    rank = min(len(vertices), max(4, CUBE_VERTICES // sample.step))
    seeds = vertices[(2 * np.arange(N_CUBES) + 1) * len(vertices) // (2 * N_CUBES)]
    half = np.empty((N_CUBES, 1))
    for at, seed in enumerate(seeds):
        half[at] = np.partition(np.abs(vertices - seed).max(axis=1), rank - 1)[rank - 1]
    return seeds - half, seeds + half
