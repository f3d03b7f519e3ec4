"""compare: the record of the command for arrays, objects and files."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
import trimesh

import msal_cli as msal
from tests.api.ply_files import to_ply
from tests.cli.scans import msal as run_command
from tests.shapes import noisy, torus

CLEAN, FACES = torus(40, 20)
NOISY = noisy(CLEAN, 2, 0.05)


@pytest.fixture
def files(tmp_path):
    (tmp_path / "a.ply").write_bytes(to_ply(CLEAN, FACES))
    (tmp_path / "b.ply").write_bytes(to_ply(NOISY, FACES))
    return tmp_path / "a.ply", tmp_path / "b.ply"


def figures(record):
    return asdict(replace(record, before="", after=""))


def test_the_record_is_that_of_the_command(files):
    printed = json.loads(
        run_command("compare", *files, "--json", "--check", "self-intersections").stdout
    )
    record = msal.compare(*files, intersections=True)
    assert json.loads(json.dumps(asdict(record))) == printed
    assert record.correspondence == "vertices" and record.vertex_error_percent > 1.0


def test_files_arrays_and_objects_give_the_same_figures(files):
    expected = figures(msal.compare(*files))
    meshes = [trimesh.Trimesh(vertices, FACES, process=False) for vertices in (CLEAN, NOISY)]
    pairs = [(CLEAN, FACES), (NOISY.tolist(), FACES.tolist())]
    for before in (files[0], meshes[0], pairs[0]):
        for after in (files[1], meshes[1], pairs[1]):
            record = msal.compare(before, after)
            assert figures(record) == expected
    assert (record.before, record.after) == ("arrays", "arrays")


def test_what_cannot_be_read_is_raised_with_its_file(files, tmp_path):
    (tmp_path / "bad.ply").write_bytes(files[0].read_bytes()[:-9])
    for other in (files[1], (NOISY, FACES)):
        with pytest.raises(msal.TruncatedError) as caught:
            msal.compare(tmp_path / "bad.ply", other)
        assert caught.value.path == str(tmp_path / "bad.ply")
        assert "bad.ply" in caught.value.__notes__[0]
        with pytest.raises(msal.InputError):
            msal.compare(other, tmp_path / "missing.ply")
    with pytest.raises(msal.ContentError):
        msal.compare((CLEAN, FACES), (NOISY * np.nan, FACES))
    with pytest.raises(msal.UsageError):
        msal.compare((CLEAN, FACES), CLEAN)
