"""docs/python.md: its code runs, and it names everything that there is."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

import msal_cli as msal
from tests.api.ply_files import to_ply
from tests.cli.scans import closed_scan, folder_of
from tests.shapes import noisy, torus

PAGE = (Path(__file__).parents[2] / "docs/python.md").read_text("utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def names():
    """What the blocks of the page take for granted, and what they have made so far."""
    clean, faces = torus()
    vertices = noisy(clean, 3, 0.05)
    return {
        "msal": msal,
        "clean": clean,
        "vertices": vertices,
        "faces": faces,
        "mesh": trimesh.Trimesh(vertices, faces, process=False),
        "mask": clean[:, 2] < 0.0,
        "trust": np.linspace(0.0, 1.0, len(clean)),
    }


@pytest.fixture(scope="module")
def folder(tmp_path_factory, names):
    folder = tmp_path_factory.mktemp("page")
    folder_of(folder / "scans", a=closed_scan(), bad=b"ply\n")
    (folder / "scan.ply").write_bytes(closed_scan())
    (folder / "truth.ply").write_bytes(to_ply(names["clean"], names["faces"]))
    return folder


@pytest.mark.parametrize("at", range(len(BLOCKS)))
def test_every_block_runs(at, names, folder, monkeypatch, capsys):
    """One after the other, so that a name that one has made is there for the next."""
    monkeypatch.chdir(folder)
    exec(compile(BLOCKS[at], f"block {at + 1} of docs/python.md", "exec"), names)
    if "except msal" in BLOCKS[at]:
        assert "E_INDEX face 0" in capsys.readouterr().out
    if "gate.broken" in BLOCKS[at]:
        assert "E_" in capsys.readouterr().out


def test_the_page_names_all_functions_classes_of_errors_and_arguments():
    code = "\n".join(BLOCKS) + " ".join(re.findall(r"`([^`\n]+)`", PAGE))
    words = set(re.findall(r"\w+", code))
    functions = {name for name in msal.__all__ if inspect.isfunction(getattr(msal, name))}
    errors = {name for name in msal.__all__ if name.endswith("Error")} | {"NothingMatched"}
    assert functions | errors <= words
    assert set(inspect.signature(msal.denoise).parameters) - {"more"} <= words


def test_the_attributes_of_a_result_are_those_of_the_page():
    public = {name for name in vars(msal.DenoiseResult) if not name.startswith("_")}
    public |= set(msal.DenoiseResult.__dataclass_fields__)
    assert public <= set(re.findall(r"^\| `result\.(\w+)`", PAGE, re.MULTILINE))
