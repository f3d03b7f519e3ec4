"""Open borders: a part of a closed mesh, with a border as ragged as that of a scan."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from training.connectivity import Ints, build_edges, drop_unused
from training.organic import draw_waves
from training.surface import LabelledMesh

Generator = np.random.Generator


def cut_open(mesh: LabelledMesh, g: Generator) -> LabelledMesh:
    """Half to three quarters of the mesh on one side of a wavy sheet, in one piece."""
    direction = g.normal(size=3)
    direction /= np.linalg.norm(direction)
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    height = mesh.vertices @ direction + 0.05 * extent * draw_waves(g, 0.4 * extent)(mesh.vertices)
    level = np.quantile(height, g.uniform(0.25, 0.5))
    kept = (height > level)[mesh.faces].all(axis=1)
    faces, labels = mesh.faces[kept], mesh.labels[kept]
    largest = large_pieces(faces, len(mesh.vertices), len(faces))
    vertices, faces, _ = drop_unused(mesh.vertices, faces[largest])
    return LabelledMesh(vertices, faces, labels[largest])


def large_pieces(faces: Ints, n_vertices: int, least: int) -> Ints:
    """The faces, by number, of parts joined by edges of ``least`` faces, and of the largest one."""
    edges = build_edges(faces, n_vertices)
    pairs = edges.faces[~edges.is_boundary]
    graph = coo_array(
        (np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(faces), len(faces))
    )
    piece = connected_components(graph, directed=False)[1]
    size = np.bincount(piece)
    return np.flatnonzero(size[piece] >= min(least, size.max()))
