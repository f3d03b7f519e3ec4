"""The gallery of docs/examples: every program and every cell runs."""

import json
import re
import runpy
import sys
from pathlib import Path

import pytest

from tests.cli.scans import BAD_SCAN, closed_scan, folder_of

pytestmark = pytest.mark.ci

FOLDER = Path(__file__).parents[1] / "docs/examples"
NOTEBOOK = json.loads((FOLDER / "notebook.ipynb").read_text("utf-8"))


@pytest.fixture
def run_example(tmp_path, monkeypatch, capsys):
    """Run a program of the gallery in a new folder; what it prints."""
    monkeypatch.chdir(tmp_path)

    def run(name, *arguments):
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(FOLDER / name), run_name="__main__")
        return capsys.readouterr().out

    return run


@pytest.mark.parametrize(
    ("name", "made"),
    [("numpy_arrays.py", ""), ("trimesh_colours.py", "toadstool.glb"),
     ("meshio_conversion.py", "toadstool.vtu")],
)  # fmt: skip
def test_a_program_lessens_the_noise(run_example, tmp_path, name, made):
    printed = run_example(name)
    found = [float(number) for number in re.findall(r"([\d.]+) (?:degrees|%)", printed)]
    assert found[1] < 0.7 * found[0] if "trimesh" not in name else "volume" in printed
    assert (tmp_path / made).exists()
    assert "independent at each vertex" in printed or made


def test_a_folder_with_gates(run_example, tmp_path, capsys):
    scans = folder_of(tmp_path / "in", a_noisy=closed_scan(), b_noisy=BAD_SCAN)
    with pytest.raises(SystemExit) as ended:
        run_example("folder_with_gates.py", scans, tmp_path / "out")
    assert ended.value.code == 1
    printed = capsys.readouterr().out
    assert "E_INDEX" in printed and "a_noisy.ply: written" in printed
    (scans / "b_noisy.ply").unlink()
    with pytest.raises(SystemExit) as ended:
        run_example("folder_with_gates.py", scans, tmp_path / "out")
    assert "up-to-date" in capsys.readouterr().out


def test_the_cells_of_the_notebook(monkeypatch, capsys):
    """By nbclient where it is installed, else cell by cell here."""
    monkeypatch.chdir(FOLDER)
    try:
        import nbclient
        import nbformat
    except ImportError:
        names: dict[str, object] = {}
        for cell in NOTEBOOK["cells"]:
            if cell["cell_type"] == "code":
                exec(compile("".join(cell["source"]), "notebook.ipynb", "exec"), names)
        printed = capsys.readouterr().out
    else:
        notebook = nbformat.reads((FOLDER / "notebook.ipynb").read_text("utf-8"), as_version=4)
        nbclient.NotebookClient(notebook, timeout=300).execute()
        printed = "".join(
            output.get("text", "") for cell in notebook.cells for output in cell.get("outputs", [])
        )
    assert "chosen: " in printed
    assert "coin_noisy.ply: written" in printed


def test_the_gallery_lists_every_example():
    listed = set(
        re.findall(r"\]\((\w+\.(?:py|ipynb))\)", (FOLDER / "README.md").read_text("utf-8"))
    )
    assert listed == {path.name for path in FOLDER.iterdir() if path.suffix in (".py", ".ipynb")}
    assert len(listed) >= 5
