"""A file in which nothing moves comes back byte for byte: every sample and real scan."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from msal_cli import codecs
from msal_cli.codecs import detection
from msal_cli.job import pipeline
from msal_cli.job.settings import is_mesh_name
from msal_cli.mesh import prepare_mesh
from msal_cli.storage import gzip_streams
from tests.job.test_pipeline import settings

SAMPLES = Path(__file__).parents[1] / "sample_meshes"


def meshes_in(folder: Path) -> list[Path]:
    paths = (path for path in sorted(folder.rglob("*")) if is_mesh_name(path.name))
    return [path for path in paths if detection.format_of_name(path.name) in detection.OWN_FORMATS]


def require_same(name: str, data: bytes) -> None:
    """Through the whole way of a file, and through each part of it alone."""
    output, record = pipeline.denoise_bytes(data, name, settings(iterations=0))
    assert record.error is None, record.error
    assert record.status == "unchanged"
    assert output is not None and bytes(output) == data
    whole, _ = gzip_streams.expand(data, name)
    file = codecs.open_mesh(whole, name)
    ready = prepare_mesh(file.vertices, file.faces)
    back = ready.to_file_vertices(ready.mesh.vertices.copy(), file.vertices)
    assert np.array_equal(back, file.vertices)
    assert bytes(file.replaced(back)) == bytes(whole)
    file.check(whole, back)
    if len(file.faces) <= 1_000:
        # One vertex there and, from what was written, back again: nothing else may have moved.
        moved = file.vertices.copy()
        moved[0] += 0.5
        there = codecs.open_mesh(bytes(file.replaced(moved)), name, file.format)
        assert np.array_equal(there.vertices[1:], file.vertices[1:])


@pytest.mark.parametrize("path", meshes_in(SAMPLES), ids=lambda path: path.name)
def test_sample_meshes(path):
    require_same(path.name, path.read_bytes())


def test_there_are_many():
    assert len(meshes_in(SAMPLES)) >= 16


REAL = meshes_in(Path(os.environ["MSAL_DATA"])) if os.environ.get("MSAL_DATA") else []


@pytest.mark.parametrize("path", REAL or [None], ids=lambda path: path.name if path else "none")
def test_real_scans(path, real_data):
    require_same(path.name, path.read_bytes())
