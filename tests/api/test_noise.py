"""compare, estimate_noise and add_noise: the figures and the bits of the commands."""

import json
from dataclasses import asdict, replace

import meshio
import numpy as np
import pytest
import trimesh

import msal_cli as msal
from tests.cli.scans import msal as run_command
from tests.ply_files import to_ply
from tests.shapes import noisy, torus

CLEAN, FACES = torus(40, 20)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_the_estimate_is_that_of_the_command(tmp_path, dtype):
    vertices = noisy(CLEAN, 1, 0.05).astype(dtype)
    (tmp_path / "a.ply").write_bytes(to_ply(vertices, FACES))
    (found,) = json.loads(run_command("info", tmp_path / "a.ply", "--json").stdout)["records"]
    noise = msal.estimate_noise(vertices, FACES)
    assert json.loads(json.dumps(asdict(noise))) == found["noise_estimate"]
    assert noise == msal.estimate_noise(meshio.Mesh(vertices, [("triangle", FACES)]))


@pytest.mark.parametrize(
    ("arguments", "options"),
    [
        ({}, []),
        ({"kind": "gaussian", "level": 0.3, "seed": 7}, ["--level", "0.3", "--seed", "7"]),
        ({"kind": "impulsive", "fraction": 0.2}, ["--fraction", "0.2"]),
        (
            {"kind": "view", "direction": (1, 0, 2), "rings": 1},
            ["--direction", "1,0,2", "--rings", "1"],
        ),
        ({"kind": "quantised", "step": 0.3}, ["--step", "0.3"]),
        ({"kind": "half", "border": 0.2}, ["--border", "0.2"]),
    ],
)
def test_the_bits_are_those_of_the_command(tmp_path, arguments, options):
    vertices = CLEAN.astype(np.float32)
    (tmp_path / "a.ply").write_bytes(to_ply(vertices, FACES))
    kind = ["--kind", arguments["kind"]] if "kind" in arguments else []
    done = run_command("noise", tmp_path / "a.ply", "-o", tmp_path / "b.ply", *kind, *options)
    assert done.exit_code == 0, done.stderr
    assert " noise of " in done.stderr
    noisy_vertices = msal.add_noise(vertices, FACES, **arguments)
    assert noisy_vertices.dtype == np.float32
    # Nothing else of the file has changed.
    assert (tmp_path / "b.ply").read_bytes() == to_ply(noisy_vertices, FACES)


def test_an_object_comes_back_as_one():
    mesh = meshio.Mesh(CLEAN, [("triangle", FACES)])
    result = msal.add_noise(mesh, kind="view")
    expected = msal.add_noise(CLEAN, FACES, "view")
    assert type(result) is meshio.Mesh and np.array_equal(result.points, expected)
    assert np.array_equal(mesh.points, CLEAN)


@pytest.mark.parametrize(
    "arguments",
    [
        {"kind": "pink"},
        {"fraction": 0.1},
        {"level": "much"},
        {"seed": 1.5},
        {"kind": "view", "direction": "z"},
        {"kind": "view", "direction": (1, 0, None)},
    ],
)
def test_settings_that_mean_nothing_are_refused(arguments):
    with pytest.raises(msal.UsageError):
        msal.add_noise(CLEAN, FACES, **arguments)


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
