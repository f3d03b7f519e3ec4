"""The benchmark of accuracy, its settings and its tables; and the maker of giant meshes.

Tests that compare with ``methods.names()`` fail for a new method; they say what to run.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import accuracy_tables, giant_mesh, ground_truth
from benchmarks.accuracy_grid import Setting, defaults, grid
from benchmarks.accuracy_outcomes import AUTO, NOISY, Outcome
from msal_cli import codecs, methods
from msal_cli.mesh import prepare_mesh


def read(path):
    return codecs.open_mesh(path.read_bytes(), path.name)


@pytest.mark.parametrize("order", giant_mesh.ORDERS)
def test_the_surface_is_the_same_in_every_order(order, tmp_path, monkeypatch):
    monkeypatch.setattr(giant_mesh, "_AT_ONCE", 1000)
    monkeypatch.setattr(giant_mesh, "_BLOCK", 256)
    path = tmp_path / "giant.ply"
    giant_mesh.main([str(path), "--millions", "0.0048", "--order", order])
    rows = giant_mesh.GiantMesh(40)
    mesh = read(path)
    n = rows.n_vertices
    expected = rows.positions(np.arange(n))
    assert len(mesh.vertices) == n == 4800
    ready = prepare_mesh(mesh.vertices, mesh.faces)
    assert ready.defects.boundary_edges == ready.defects.inconsistent_edges == 0
    assert ready.defects.components == 1 and ready.defects.duplicate_faces == 0
    assert (np.unique(mesh.vertices, axis=0) == np.unique(expected, axis=0)).all()
    triangles = mesh.vertices[mesh.faces].reshape(-1, 9)
    same = expected[rows.corners(np.arange(2 * n))].reshape(-1, 9)
    assert (np.unique(triangles, axis=0) == np.unique(same, axis=0)).all()
    if order == "rows":
        assert (mesh.vertices == expected).all()
    else:
        assert not (mesh.vertices == expected).all()


A_NEW_METHOD = (
    "For a new method: add its settings to benchmarks/accuracy_grid.py, run `MSAL_DATA=FOLDER "
    "python -m benchmarks.accuracy --cache accuracy.json` (--quick leaves out large models), "
    "and put the tables that it prints into benchmarks/results/accuracy.txt"
)

PAGE = Path(__file__).resolve().parents[1] / "benchmarks/results/accuracy.txt"

SETTINGS = [Setting("al", {}), Setting("al", {"iterations": 1}), Setting("wiener", {})]


@pytest.mark.parametrize("coarse", [False, True])
def test_the_grid_has_every_default_and_nothing_twice(coarse):
    settings = grid(coarse)
    assert settings[0] == defaults()[0]
    assert {setting.method for setting in settings if setting.is_default} == set(methods.names()), (
        A_NEW_METHOD
    )
    texts = [setting.text for setting in settings]
    assert len(set(texts)) == len(texts) > 50
    distinct = {
        (setting.method, *methods.find(setting.method).validate(setting.given).items())
        for setting in settings
    }
    assert len(distinct) == len(settings)


def rows():
    """Two models; which setting is best differs with the model and the measure."""
    al, short, wiener = (setting.text for setting in SETTINGS)
    return {
        "one": {
            NOISY: Outcome(20.0, 16.0, 0.0),
            al: Outcome(4.0, 10.0, -1.0),
            short: Outcome(8.0, 6.0, 0.0),
            wiener: Outcome(5.0, 5.0, 0.0),
            AUTO: Outcome(5.0, 5.0, 0.5, "noise 0.1 e; because"),
        },
        "two": {
            NOISY: Outcome(20.0, 16.0, 0.0),
            al: Outcome(6.0, 10.0, 0.0),
            short: Outcome(7.0, 8.0, 0.0),
            wiener: Outcome(9.0, 9.0, 0.0),
            AUTO: Outcome(5.0, 7.0, 0.0),
        },
    }


def test_a_summary_by_hand():
    lines = accuracy_tables.summary("organic", rows(), SETTINGS)
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]
    found = {label: values for label, *values in cells}
    assert lines[0].startswith("| organic: 2 models | angle | vertex error |")
    assert found["best published setting, by angle"] == ["5.00", "10.00", "`al`"]
    assert found["best published setting, by vertex error"] == ["7.50", "7.00", "`al` iterations=1"]
    # 7 x 7 is less than 5 x 10 and 7.5 x 7.
    assert found["best setting of this package, by both"] == ["7.00", "7.00", "`wiener`"]
    assert found["tuned for each model, by angle"] == ["5.00", "10.00", ""]
    assert found["tuned for each model, by vertex error"] == ["6.00", "6.50", ""]
    assert found["tuned for each model, by both"] == ["6.00", "6.50", ""]
    assert found["**`--auto`**"] == ["5.00", "6.00", ""]
    assert found["goal"] == ["5.40", "7.80", ""]
    assert found["`--auto` / best published setting"] == ["1.00", "0.86", ""]
    assert found["`--auto` / tuning for both at once"] == ["0.83", "0.92", ""]


def test_the_page_has_every_class_and_every_method():
    page = PAGE.read_text(encoding="utf-8")
    for of in ground_truth.CLASSES:
        part = page.partition(f"\n### {of.capitalize()}\n")[2].partition("\n### ")[0]
        assert "**`--auto`**" in part, of
        for name in methods.names():
            assert f"\n| `{name}` | " in part, f"{of} has no row for {name}. {A_NEW_METHOD}"
