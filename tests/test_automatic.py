"""What is settled for one mesh under `--auto`, below the command line."""

from __future__ import annotations

import pytest

from msal_cli import automatic, methods, selection
from msal_cli.errors import UsageError
from msal_cli.mesh import Mesh
from msal_cli.noise_estimate import estimated
from msal_cli.tasks import AUTO, Settings, method_bytes_per_face
from tests.shapes import noisy, torus


@pytest.fixture
def mesh():
    vertices, faces = torus()
    return Mesh(noisy(vertices, 0, 0.05), faces)


def settled_as(monkeypatch, mesh, name, given):
    choice = selection.Choice(name, given, "because", "organic", estimated(mesh))
    monkeypatch.setattr("msal_cli.automatic.chosen", lambda *ignored: choice)
    return automatic.settled(mesh, {}, lambda done, total: None)


@pytest.mark.parametrize("name", methods.names())
def test_the_options_told_give_every_method_its_parameters_back(monkeypatch, mesh, name):
    from msal_cli.cli import parameters

    method = methods.find(name)
    # No number of few digits, and another word than the default, wherever a parameter has room.
    given = {
        spec.name: spec.choices[-1] if spec.choices else spec.default / 3
        for spec in method.parameters
        if spec.choices or (spec.kind is float and spec.default / 3 >= spec.low)
    }
    try:
        values = method.settled(given)
    except UsageError:
        values = method.settled({})
    words = settled_as(monkeypatch, mesh, name, values).made.repeat
    assert words[:2] == ("--method", name)
    assert set(words[2::2]) <= {"--set"}
    assert parameters.settled(method, map(parameters.assignment, words[3::2])) == values


def test_values_that_no_user_could_give_are_refused(monkeypatch, mesh):
    with pytest.raises(UsageError, match="K = 7"):
        settled_as(monkeypatch, mesh, "msal", {"K": 7.0})


def test_memory_is_set_aside_for_the_hungriest_method_that_may_be_chosen():
    most = method_bytes_per_face(Settings(AUTO, {}))
    assert most >= max(methods.find(name).bytes_per_face for name in selection.METHODS)
    assert method_bytes_per_face(Settings(AUTO, {}, fields=("sigma",))) > most


@pytest.mark.parametrize("strength", [-2.0, 0.0, 2.0])
def test_what_is_chosen_is_one_of_the_methods_that_memory_is_set_aside_for(mesh, strength):
    choice = selection.chosen(mesh, selection.Wishes(strength=strength))
    assert choice.method in (*selection.METHODS, selection.NONE)
    assert set(selection.METHODS) <= set(methods.names())
    if choice.method == selection.NONE:
        assert choice.parameters == {}
    else:
        assert methods.find(choice.method).settled(choice.parameters) == choice.parameters


def test_the_chooser_tells_how_far_it_is(mesh):
    steps = []
    selection.chosen(mesh, selection.Wishes(), lambda done, total: steps.append((done, total)))
    assert steps
    assert all(0 < done <= total for done, total in steps)
    assert steps == sorted(steps)


def test_choosing_changes_nothing_of_the_mesh(mesh):
    before = mesh.vertices.copy()
    selection.chosen(mesh, selection.Wishes())
    assert (mesh.vertices == before).all()
