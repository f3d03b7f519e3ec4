"""estimate_noise and add_noise: the figures and the bits of the command."""

from __future__ import annotations

import json
from dataclasses import asdict

import meshio
import numpy as np
import pytest

import msal_cli as msal
from tests.api.ply_files import positions_of, to_ply
from tests.cli.scans import msal as run_command
from tests.shapes import noisy, torus

CLEAN, FACES = torus(40, 20)
FACTORS = np.linspace(0.0, 2.0, len(CLEAN))


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
        ({"kind": "property", "property": FACTORS}, ["--property", "trust"]),
    ],
)
def test_the_bits_are_those_of_the_command(tmp_path, arguments, options):
    vertices = CLEAN.astype(np.float32)
    (tmp_path / "a.ply").write_bytes(to_ply(vertices, FACES, trust=FACTORS))
    kind = ["--kind", arguments["kind"]] if "kind" in arguments else []
    done = run_command("noise", tmp_path / "a.ply", "-o", tmp_path / "b.ply", *kind, *options)
    assert done.exit_code == 0, done.stderr
    expected = positions_of((tmp_path / "b.ply").read_bytes(), vertices, 1)
    noisy_vertices = msal.add_noise(vertices, FACES, **arguments)
    assert noisy_vertices.dtype == np.float32
    assert noisy_vertices.tobytes() == expected.tobytes()


def test_an_object_comes_back_as_one_with_factors_by_name():
    mesh = meshio.Mesh(CLEAN, [("triangle", FACES)], point_data={"trust": FACTORS})
    result = msal.add_noise(mesh, kind="property", property="trust")
    expected = msal.add_noise(CLEAN, FACES, "property", property=FACTORS)
    assert type(result) is meshio.Mesh and np.array_equal(result.points, expected)
    assert np.array_equal(mesh.points, CLEAN)


@pytest.mark.parametrize(
    "arguments",
    [
        {"kind": "pink"},
        {"level": -1.0},
        {"seed": -1},
        {"fraction": 0.1},
        {"kind": "impulsive", "fraction": 2.0},
        {"kind": "view", "direction": (0, 0, 0)},
        {"kind": "property"},
        {"kind": "property", "property": [1.0]},
        {"property": FACTORS},
        {"level": "much"},
        {"seed": 1.5},
        {"kind": "view", "direction": "z"},
        {"kind": "view", "direction": (1, 0)},
        {"kind": "view", "direction": (1, 0, None)},
    ],
)
def test_settings_that_mean_nothing_are_refused(arguments):
    with pytest.raises(msal.UsageError):
        msal.add_noise(CLEAN, FACES, **arguments)
