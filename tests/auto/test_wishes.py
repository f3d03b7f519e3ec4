"""Wishes for less and for more on whole scans: vertices move less, and farther, always."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from msal_cli import auto as selection
from msal_cli import codecs, methods
from msal_cli.analysis.added_noise import add_plain_noise
from msal_cli.auto import NONE, Wishes
from msal_cli.mesh import prepare_mesh

SAMPLES = Path(__file__).resolve().parents[2] / "sample_meshes"
NAMES = (
    "bear_clean.obj",
    "bracket_clean.ply",
    "coin_noisy.ply",
    "dragon_egg_noisy.ply",
    "knot_noisy.stl",
    "toadstool_clean.ply",
    "vase_noisy.obj",
)


def mean_move(mesh, **wishes):
    """Mean displacement by the choice for these wishes, file units."""
    choice = selection.choose_method(mesh, Wishes(**wishes))
    if choice.method == NONE:
        return 0.0
    moved = methods.find(choice.method).denoise(mesh, choice.parameters).vertices
    return float(np.linalg.norm(moved - mesh.vertices, axis=1).mean())


def check(mesh):
    *less, plain, more, most = (
        mean_move(mesh, strength=strength) for strength in (-2.0, -1.0, 0.0, 1.0, 2.0)
    )
    moves = [*less, plain, more, most]
    if plain > 0.0:
        assert all(a < b for a, b in itertools.pairwise(moves))
    else:
        assert less == [0.0, 0.0] and more < most
    assert mean_move(mesh, keep="texture") <= plain


@pytest.mark.slow
@pytest.mark.parametrize("level", [0.0, 0.2])
@pytest.mark.parametrize("name", NAMES)
def test_sample_meshes(name, level):
    path = SAMPLES / name
    mesh_file = codecs.open_mesh(path.read_bytes(), path.name)
    mesh = prepare_mesh(mesh_file.vertices, mesh_file.faces).mesh
    if level:
        mesh = mesh.with_vertices(add_plain_noise(mesh, "gaussian-normal", level, 1))
    check(mesh)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["clean/igea.ply", "clean/ogre.obj", "scans/angel.obj"])
def test_real_scans(real_data, name):
    path = real_data / name
    if not path.is_file():
        pytest.skip(f"{name} is not among the scans")
    mesh_file = codecs.open_mesh(path.read_bytes(), path.name)
    check(prepare_mesh(mesh_file.vertices, mesh_file.faces).mesh)
