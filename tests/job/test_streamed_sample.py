"""The part of a mesh on which its noise is estimated, where the mesh is read in pieces."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.job import streamed_sample
from msal_cli.job.streamed_faces import FacePiece
from msal_cli.job.streamed_sample import RepresentativePart, SpreadSample
from tests.shapes import grid


@pytest.mark.parametrize("piece", [7, 100, 10**6])
def test_the_sample_does_not_depend_on_the_pieces(monkeypatch, piece):
    monkeypatch.setattr(streamed_sample, "SAMPLED", 50)
    vertices = np.arange(3000.0).reshape(-1, 3)
    sample = SpreadSample(len(vertices))
    for start in range(0, len(vertices), piece):
        sample.add(start, vertices[start : start + piece])
    numbers = sample.vertices[:, 0] / 3.0
    assert sample.step == 20
    assert np.array_equal(numbers // 20, np.arange(50))
    assert len(np.unique(numbers % 20)) > 10


def test_the_part_is_as_large_as_wanted_and_looks_like_the_whole(monkeypatch):
    monkeypatch.setattr(streamed_sample, "CUBE_VERTICES", 100)
    monkeypatch.setattr(streamed_sample, "WHOLE_VERTICES", 800)
    monkeypatch.setattr(streamed_sample, "SAMPLED", 4000)
    vertices, faces = grid(200, 100)
    sample = SpreadSample(len(vertices))
    sample.add(0, vertices)
    part = RepresentativePart(sample, len(vertices))
    shuffled = np.random.default_rng(0).permutation(faces).astype(np.uint32)
    corners = vertices[shuffled].reshape(-1, 9)
    for start in range(0, len(faces), 5000):
        piece = slice(start, start + 5000)
        part.add(FacePiece(start, shuffled[piece], np.ascontiguousarray(corners[piece])))
    mesh = part.mesh()
    assert 400 < len(mesh.vertices) < 1600
    assert len(mesh.faces) > 1.5 * len(mesh.vertices)


def test_a_small_mesh_is_taken_whole():
    vertices, faces = grid(20, 10)
    part = RepresentativePart(SpreadSample(len(vertices)), len(vertices))
    corners = np.ascontiguousarray(vertices[faces].reshape(-1, 9))
    part.add(FacePiece(0, faces.astype(np.uint32), corners))
    assert len(part.mesh().faces) == len(faces)
