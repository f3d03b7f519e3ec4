"""A mesh denoised by tiles has the very bits that it has in memory."""

from __future__ import annotations

import numpy as np
import pytest

from tests.shapes import ball
from tests.tiles.fakes import FakeMesh
from tests.tiles.whole_run import check_same


def noisy_sphere(dtype: type = np.float32) -> FakeMesh:
    vertices, faces = ball(40, 20)
    noise = np.random.default_rng(1).normal(0.0, 0.02, vertices.shape)
    return FakeMesh((vertices + noise).astype(dtype), faces.astype(np.uint32))


@pytest.mark.parametrize("method", ["al", "msal"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_closed_mesh(monkeypatch, tmp_path, method, dtype):
    scratch = check_same(monkeypatch, tmp_path, noisy_sphere(dtype), method, tile_vertices=60)
    assert len(scratch.finished("prepare")) > 8
