"""Corners of faces that come in pieces, from few blocks of vertices."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.codecs.streamed import open_streamed
from msal_cli.job import streamed_faces
from msal_cli.job.streamed_faces import VertexBlocks, pieces_of, used_flags
from tests.job.large_files import write_ply, write_stl

N_VERTICES = 400_000


@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_corners_in_any_order_from_two_blocks_in_memory(tmp_path, kind, monkeypatch):
    rng = np.random.default_rng(1)
    vertices = rng.random((N_VERTICES, 3)).astype(kind)
    faces = rng.integers(0, N_VERTICES, (3000, 3), dtype=np.int32)
    mesh = open_streamed(write_ply(tmp_path / "a.ply", vertices, faces, kind))
    monkeypatch.setattr(streamed_faces, "PIECE_FACES", 1000)
    block_bytes = 3 * np.dtype(kind).itemsize * streamed_faces.BLOCK_VERTICES
    monkeypatch.setattr(streamed_faces, "CACHE_BYTES", 2 * block_bytes)
    done = []
    pieces = list(pieces_of(mesh, done.append))
    assert done == [1000, 1000, 1000]
    assert [piece.first_triangle for piece in pieces] == [0, 1000, 2000]
    assert np.array_equal(np.concatenate([piece.triangles for piece in pieces]), faces)
    corners = np.concatenate([piece.corners for piece in pieces])
    assert corners.dtype == kind
    assert np.array_equal(corners, vertices[faces].reshape(-1, 9))


def test_faces_near_one_another_read_each_block_once(tmp_path, monkeypatch):
    vertices = np.zeros((N_VERTICES, 3))
    faces = np.arange(N_VERTICES // 3 * 3, dtype=np.int32).reshape(-1, 3)
    mesh = open_streamed(write_ply(tmp_path / "a.ply", vertices, faces))
    n_read = []
    monkeypatch.setattr(
        type(mesh),
        "read_vertices",
        lambda self, start, stop: n_read.append(stop - start) or vertices[start:stop],
    )
    blocks = VertexBlocks(mesh, 1)
    for part in np.array_split(faces.astype(np.uint32), 20):
        blocks.corners(part)
    assert sum(n_read) == N_VERTICES


def test_corners_of_an_stl_are_its_own(tmp_path):
    vertices = np.random.default_rng(2).random((50, 3)).astype(np.float32)
    faces = np.random.default_rng(3).integers(0, 50, (80, 3))
    mesh = open_streamed(write_stl(tmp_path / "a.stl", vertices, faces))
    (piece,) = pieces_of(mesh, lambda _: None)
    assert np.array_equal(piece.corners, vertices[faces].reshape(-1, 9))


def test_marks_of_a_range():
    marks = np.random.default_rng(4).random(77) > 0.5
    bits = np.packbits(marks, bitorder="little")
    for start, stop in ((0, 77), (3, 5), (8, 16), (13, 70), (77, 77)):
        assert np.array_equal(used_flags(bits, start, stop), marks[start:stop])
    assert used_flags(np.empty(0, np.uint8), 5, 9).all()
