"""Whole meshes put together from pieces, to compare with the codecs for whole files."""

from __future__ import annotations

import itertools
import pickle

import numpy as np

from msal_cli.codecs import open_mesh
from msal_cli.codecs.streamed import open_streamed


def stored(tmp_path, data: bytes, suffix: str):
    """The opened file of these bytes, as another process would have it."""
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(data)
    open_streamed(path, folder=tmp_path / "folder")
    return pickle.loads(pickle.dumps(open_streamed(path, folder=tmp_path / "folder")))


def read_vertices(mesh, step: int) -> np.ndarray:
    """All vertices, ``step`` at a time."""
    parts = [
        mesh.read_vertices(start, min(start + step, mesh.n_vertices))
        for start in range(0, mesh.n_vertices, step)
    ]
    return np.concatenate(parts)


def read_triangles(mesh, step: int) -> np.ndarray:
    """All triangles, of ``step`` polygons at a time."""
    parts = []
    n_triangles = n_polygons = 0
    for chunk in mesh.face_chunks(step):
        assert chunk.polygons[0] == n_polygons
        assert chunk.first_triangle == n_triangles
        parts.append(mesh.read_triangles(chunk))
        assert parts[-1].dtype == np.uint32
        n_polygons = chunk.polygons[1]
        n_triangles += len(parts[-1])
    assert n_polygons == mesh.n_polygons
    return np.concatenate(parts)


def replace(mesh, vertices, normals=None, step: int = 64) -> bytes:
    """The whole file with new positions (n, 3), and normals of vertices."""
    pieces = mesh.output_pieces(step)
    assert pieces[0][0] == 0 and pieces[-1][1] == mesh.size
    assert all(one[1] == two[0] for one, two in itertools.pairwise(pieces))
    new = None if normals is None else lambda start, stop: normals[start:stop]

    def positions(start, stop):
        return vertices[start:stop]

    survey = mesh.survey(positions, new)
    assert (survey is None) == mesh.keeps_size
    return b"".join(bytes(mesh.replace(piece, positions, new, survey)) for piece in pieces)


def whole(data: bytes, suffix: str):
    """The file as the codec for whole files reads it."""
    return open_mesh(data, f"a.{suffix}")


def new_normals(whole, vertices) -> np.ndarray:
    """Normals (n, 3) of a whole file's vertices at new places; NaN for those that are kept."""
    normals, is_new = whole._new_normals(vertices)[0]
    return np.where(is_new[:, None], normals, np.nan)
