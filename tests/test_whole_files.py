"""Files through the whole way: unchanged ones byte for byte, malformed and lying ones refused."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.hostile_headers import MOST_BYTES, MOST_SECONDS, lies, refused
from msal_cli import codecs
from msal_cli.codecs import detection
from msal_cli.job import pipeline
from msal_cli.job.settings import is_mesh_name
from msal_cli.mesh import prepare_mesh
from msal_cli.storage import gzip_streams
from tests.job.test_pipeline import settings
from tests.malformed import malformed

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


def real_scans():
    paths = meshes_in(Path(os.environ["MSAL_DATA"])) if os.environ.get("MSAL_DATA") else [Path()]
    for path in paths:
        is_large = path.stat().st_size > 1_500_000
        yield pytest.param(path, id=path.name, marks=[pytest.mark.ci] if is_large else [])


@pytest.mark.parametrize("path", list(real_scans()))
def test_real_scans(path, real_data):
    require_same(path.name, path.read_bytes())


MALFORMED = malformed()


@pytest.mark.parametrize("name", MALFORMED)
def test_the_record_has_the_code_and_the_reason(name):
    data, code, place = MALFORMED[name]
    output, record = pipeline.denoise_bytes(data, name, settings(iterations=0))
    assert output is None
    assert record.status == "failed"
    error = record.error
    assert error is not None
    assert (error.code, place in error.where) == (code, True), error
    assert error.message and len(error.message) < 300 and not error.message.endswith(".")
    assert "Traceback" not in error.message and "\n" not in error.message


reads_proc = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc and writes holes")


@reads_proc
@pytest.mark.ci
def test_every_lie_is_refused(tmp_path):
    all_lies = list(lies())
    assert len(all_lies) >= 50
    assert len({lie.name for lie in all_lies}) == len(all_lies)
    found = refused(all_lies, tmp_path)
    assert [(lie.name, lie.code) for lie in all_lies] == [
        (lie.name, code) for lie, (code, _, _) in zip(all_lies, found, strict=True)
    ]
    # Generous, since the machine may be slow; the table has the figures.
    assert max(seconds for _, seconds, _ in found) < 10 * MOST_SECONDS
    assert sum(grown for _, _, grown in found) < MOST_BYTES
