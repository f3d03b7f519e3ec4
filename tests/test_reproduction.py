"""The page of remade figures: what the script makes has its place there, and is there."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from msal_cli.mesh import prepare_mesh

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE = (DOCS / "reproduction.md").read_text("utf-8")
TABLES = dict(re.findall(r"<!-- made: (\w+) -->\n(.*?)<!-- end -->", PAGE, re.DOTALL))


@pytest.fixture(autouse=True)
def scripts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(DOCS))


def test_every_figure_has_its_place_and_its_table() -> None:
    import paper_figures

    assert set(TABLES) == {*paper_figures.FIGURES, "table1"}
    for name, table in TABLES.items():
        rows = [row.count("|") for row in table.splitlines()]
        assert len(rows) >= 4, name
        assert len(set(rows)) == 1, name


def test_all_pictures_are_shown_and_small() -> None:
    pictures = {path.name: path for path in (DOCS / "images/reproduction").iterdir()}
    assert set(pictures) == set(re.findall(r"\(images/reproduction/([\w.]+)\)", PAGE))
    assert sum(path.stat().st_size for path in pictures.values()) < 3_000_000


def test_a_refined_sphere_is_closed_and_keeps_its_winding() -> None:
    import trimesh
    from paper_models import _refined

    ball = trimesh.creation.icosphere(subdivisions=1)
    points, faces = np.array(ball.vertices), np.array(ball.faces)
    for seed in range(5):
        chosen = np.random.default_rng(seed).random(len(faces)) < 0.3
        finer, made = _refined(points, faces, chosen)
        defects = prepare_mesh(finer, made.astype(np.int32)).defects
        assert defects.boundary_edges == defects.non_manifold_edges == 0
        assert defects.inconsistent_edges == defects.turned_faces == 0
        assert len(made) >= len(faces) + 3 * chosen.sum()
        assert len(finer) - len(made) / 2 == 2  # Euler's formula
