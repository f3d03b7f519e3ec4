"""What is settled for one mesh under --auto: its parameters, clean files and warnings."""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from msal_cli import auto as selection
from msal_cli import methods
from msal_cli.analysis.noise_estimate import estimate_noise
from msal_cli.auto import search
from msal_cli.cli.options import parse_assignment
from msal_cli.errors import UsageError
from msal_cli.job import choice as automatic
from msal_cli.job import pipeline
from msal_cli.job.changes import method_warnings
from msal_cli.job.records import Displacement
from msal_cli.job.room import forecast
from msal_cli.job.settings import AUTO, Settings, Task, resolve_parameters
from msal_cli.mesh import Mesh
from tests.cli.scans import msal, record_of, torus_scan
from tests.report.golden import NOISE
from tests.shapes import noisy, torus


@pytest.fixture
def mesh():
    vertices, faces = torus()
    return Mesh(noisy(vertices, 0, 0.05), faces)


def choose_as(monkeypatch, mesh, name, given):
    choice = selection.Choice(name, given, "because", "organic", estimate_noise(mesh))
    monkeypatch.setattr("msal_cli.auto.search.choose_method", lambda *ignored: choice)
    return automatic.choose(mesh, AUTO, {}, lambda done, total: None)


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
    scan = scan_with(tmp_path / "scan.ply", 0.0)
    task = Task(str(scan), str(tmp_path / "o.ply"), "scan.ply")
    auto = forecast(task, Settings(AUTO, {})).memory_bytes
    # The hungriest that may be chosen.
    blend = Settings("blend", {"members": "0.5*learned+0.5*al"}, despike=True)
    alone = forecast(task, blend).memory_bytes
    assert auto == alone + selection.BYTES


def test_what_is_chosen_is_one_of_the_methods_that_memory_is_set_aside_for(mesh):
    before = mesh.vertices.copy()
    choice = search.choose_method(mesh, selection.Wishes(strength=2.0))
    assert (mesh.vertices == before).all()
    assert choice.method in selection.METHODS and set(selection.METHODS) <= set(methods.names())
    assert methods.find(choice.method).validate(choice.parameters) == choice.parameters


MAX_MEAN_EDGES, MAX_EDGES, MAX_MEAN_DEG = 0.01, 0.1, 0.5


def list_files():
    """Paths below MSAL_DATA, (folder, name)."""
    root = os.environ.get("MSAL_DATA")
    for folder in ("clean", "clean_foreign") if root else ():
        for path in sorted((Path(root) / folder).iterdir()):
            if path.suffix != ".md":
                marks = [pytest.mark.ci] if folder == "clean_foreign" else []
                yield pytest.param(path, id=path.name, marks=marks)


FILES = [*list_files()]


def check(path, out, settings):
    target = out / path.name
    record = pipeline.denoise_file(Task(str(path), str(target), path.name), settings)
    assert record.error is None
    if target.read_bytes() != path.read_bytes():
        assert record.displacement.mean_edges < MAX_MEAN_EDGES
        assert record.displacement.max_edges < MAX_EDGES
        assert record.normal_change.mean_deg < MAX_MEAN_DEG
    assert record.despiked in (None, 0)


@pytest.mark.parametrize("path", FILES)
def test_the_plain_command_leaves_clean_files(path, tmp_path):
    check(path, tmp_path, Settings(method="adaptive", parameters={}))


@pytest.mark.slow
@pytest.mark.parametrize("path", FILES)
def test_auto_leaves_clean_files(path, tmp_path):
    check(path, tmp_path, Settings(method="auto", parameters={}))


def scan_with(path, level, spike=0.0):
    path.write_bytes(torus_scan(level, [100], spike))
    return path


def warnings_of(scan, *words):
    output = scan.with_name("out.ply")
    return record_of(msal("denoise", scan, "-o", output, "--force", "--json", *words))["warnings"]


def test_no_noise_to_speak_of(tmp_path):
    scan = scan_with(tmp_path / "a.ply", 0.0)
    (warning,) = warnings_of(scan, "--method", "taubin")
    assert warning.startswith("no noise to speak of, and taubin moved vertices by 0.")
    assert "--min-noise auto leaves such meshes as they are" in warning
    assert warnings_of(scan, "--method", "msal", "-n", "0") == []
    assert warnings_of(scan) == []


@pytest.mark.parametrize(
    ("words", "is_too_much"),
    [
        (("--method", "al", "--schedule", "multiscale"), True),
        (("--schedule", "robust"), True),
        (("--schedule", "wiener"), False),
        ((), False),
    ],
)
def test_noise_beyond_what_the_method_is_made_for(tmp_path, words, is_too_much):
    scan = scan_with(tmp_path / "a.ply", 0.3)
    warnings = warnings_of(scan, *words)
    assert any("is more than" in warning and "--auto" in warning for warning in warnings) == (
        is_too_much
    )


@pytest.mark.parametrize(("unsure", "count"), [(False, 1), (True, 0)])
def test_no_advice_where_noise_may_be_texture(unsure, count):
    found = methods.find("msal")
    noise = replace(NOISE, mean_edges=0.3, high_edges=0.4, unsure=unsure)
    moved = Displacement(*[0.1] * 8, moved_vertices=100)
    assert len(method_warnings(found, found.validate({}), noise, moved, False)) == count


def test_a_spike_that_rules_lambda(tmp_path):
    spiked = scan_with(tmp_path / "a.ply", 0.1, spike=10.0)
    (warning,) = warnings_of(spiked, "--method", "msal")
    assert "--schedule robust" in warning
    assert warnings_of(spiked, "--method", "msal", "--schedule", "robust") == []
    plain = scan_with(tmp_path / "b.ply", 0.1)
    assert warnings_of(plain, "--method", "msal") == []
