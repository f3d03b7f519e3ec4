"""What is settled for one mesh under `--auto`, below the command line."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from msal_cli import auto as selection
from msal_cli import methods
from msal_cli.analysis.noise_estimate import estimate_noise
from msal_cli.cli.options import parse_assignment
from msal_cli.errors import UsageError
from msal_cli.job import choice as automatic
from msal_cli.job.pipeline import denoise_bytes
from msal_cli.job.settings import (
    AUTO,
    Settings,
    Task,
    forecast,
    resolve_parameters,
)
from msal_cli.mesh import Mesh
from tests.shapes import noisy, torus


@pytest.fixture
def mesh():
    vertices, faces = torus()
    return Mesh(noisy(vertices, 0, 0.05), faces)


def choose_as(monkeypatch, mesh, name, given):
    choice = selection.Choice(name, given, "because", "organic", estimate_noise(mesh))
    monkeypatch.setattr("msal_cli.job.choice.choose_method", lambda *ignored: choice)
    return automatic.choose(mesh, {}, lambda done, total: None)


@pytest.mark.parametrize("name", methods.names())
def test_the_options_told_give_every_method_its_parameters_back(monkeypatch, mesh, name):
    method = methods.find(name)
    # No number of few digits, and another word than the default, wherever a parameter has room.
    given = {
        spec.name: spec.choices[-1] if spec.choices else spec.default / 3
        for spec in method.parameters
        if spec.choices or (spec.kind is float and spec.default / 3 >= spec.low)
    }
    try:
        values = method.validate(given)
    except UsageError:
        values = method.validate({})
    words = choose_as(monkeypatch, mesh, name, values).known["choice"].repeat
    assert words[:2] == ("--method", name)
    assert set(words[2::2]) <= {"--set"}
    assert resolve_parameters(method, map(parse_assignment, words[3::2])) == values


def test_values_that_no_user_could_give_are_refused(monkeypatch, mesh):
    with pytest.raises(UsageError, match="K = 7"):
        choose_as(monkeypatch, mesh, "msal", {"K": 7.0})


def test_memory_is_set_aside_for_choosing(tmp_path):
    scan = tmp_path / "scan.obj"
    scan.write_bytes(soup(1))
    task = Task(str(scan), str(tmp_path / "o.obj"), "scan.obj")
    auto = forecast(task, Settings(AUTO, {})).memory_bytes
    # The hungriest that may be chosen.
    blend = Settings("blend", {"members": "0.5*learned+0.5*al"}, despike=True)
    alone = forecast(task, blend).memory_bytes
    assert auto == alone + selection.BYTES
    missing = Task(str(tmp_path / "none.obj"), str(tmp_path / "o.obj"), "none.obj")
    assert forecast(missing, Settings(AUTO, {})).memory_bytes is None


@pytest.mark.parametrize("strength", [-2.0, 0.0, 2.0])
def test_what_is_chosen_is_one_of_the_methods_that_memory_is_set_aside_for(mesh, strength):
    before = mesh.vertices.copy()
    choice = selection.choose_method(mesh, selection.Wishes(strength=strength))
    assert (mesh.vertices == before).all()
    assert choice.method in (*selection.METHODS, selection.NONE)
    assert set(selection.METHODS) <= set(methods.names())
    if choice.method == selection.NONE:
        assert choice.parameters == {}
    else:
        assert methods.find(choice.method).validate(choice.parameters) == choice.parameters


def soup(seed):
    """An OBJ of triangles between any vertices, of any size, some of them flat."""
    draw = np.random.default_rng(seed)
    vertices = draw.normal(size=(draw.integers(3, 30), 3)) * 10.0 ** draw.integers(-12, 12)
    if seed % 4 == 0:
        vertices[:, 2] = 0.0
    faces = draw.integers(0, len(vertices), (draw.integers(1, 60), 3)) + 1
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    return "\n".join(lines + [f"f {i} {j} {k}" for i, j, k in faces]).encode() + b"\n"


@pytest.mark.parametrize("seed", range(8))
def test_no_mesh_is_too_odd_to_choose_for(seed):
    wishes = dataclasses.asdict(selection.Wishes(strength=2.0, keep=(None, "edges")[seed % 2]))
    made, record = denoise_bytes(soup(seed), "soup.obj", Settings(AUTO, wishes))
    again, other = denoise_bytes(soup(seed), "soup.obj", Settings(AUTO, wishes))
    assert record.error is None or record.error.code == "E_NO_FACES"
    assert made == again
    # A risk that is not a number equals nothing, itself included.
    assert repr(record.choice) == repr(other.choice)
