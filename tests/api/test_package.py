"""What import msal_cli is, and that its page says all of it and runs."""

import inspect
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import trimesh

import msal_cli as msal
from msal_cli import api, errors, methods
from msal_cli.analysis.added_noise import KINDS
from msal_cli.api.denoise import MethodName, MethodParameters
from msal_cli.job.settings import NoiseKind
from tests.cli.scans import closed_scan, folder_of
from tests.files import run_python
from tests.ply_files import to_ply
from tests.shapes import noisy, torus

PACKAGE = Path(msal.__file__).parent


def test_importing_loads_nothing_else():
    code = (
        "import sys; before = set(sys.modules); import msal_cli; msal_cli.__version__; "
        "dir(msal_cli); print(*sorted(set(sys.modules) - before))"
    )
    assert run_python(code).split() == ["msal_cli", "msal_cli.version"]


def test_the_functions_load_neither_the_command_nor_a_mesh_library():
    code = (
        "import sys, msal_cli as msal; "
        "msal.denoise([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]); "
        "print(*[name for name in ('click', 'tqdm', 'msal_cli.cli', 'trimesh', 'meshio', "
        "'pyvista', 'open3d', 'scipy', 'numba') if name in sys.modules])"
    )
    assert run_python(code).split() == []


def test_every_public_name_is_there_for_programs_and_for_type_checkers():
    assert set(msal.__all__) <= set(dir(msal))
    for name in set(msal.__all__) - {"__version__"}:
        assert getattr(msal, name) is getattr(api, name)
    assert (PACKAGE / "py.typed").is_file()


def test_every_class_of_error_is_public():
    known = {
        name
        for name, value in vars(errors).items()
        if isinstance(value, type) and issubclass(value, errors.MsalError)
    }
    assert known <= set(msal.__all__)
    assert issubclass(msal.NothingMatched, msal.MsalError)


FUNCTIONS = [name for name in msal.__all__ if inspect.isfunction(getattr(msal, name))]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_docstrings_explain_every_parameter_and_the_errors(name):
    function = getattr(msal, name)
    text = inspect.getdoc(function)
    has_parameters = bool(inspect.signature(function).parameters)
    for section in ("Parameters", "Returns", "Raises") if has_parameters else ("Returns",):
        assert f"\n{section}\n---" in text, section
    explained = text.partition("Parameters\n---")[2].partition("\nReturns\n")[0]
    # Names stand alone or with others before a colon; some lists go on in the next line.
    words = {
        word.strip()
        for line in explained.replace(" to ", ", ").splitlines()
        for word in line.partition(" :")[0].split(",")
    }
    missing = set(inspect.signature(function).parameters) - words
    if name == "denoise_folder":
        # It says "method to fail_on : as for denoise_file".
        names = list(inspect.signature(function).parameters)
        missing -= set(names[names.index("method") : names.index("fail_on") + 1])
    assert not missing


def test_the_words_of_the_types_are_those_of_the_program():
    choosing = ("adaptive", "auto")
    assert get_args(MethodName) == (*choosing, *methods.names())
    assert get_args(NoiseKind) == tuple(KINDS)
    assert [one.name for one in msal.list_methods()] == list(methods.names())
    own = {name for one in FUNCTIONS for name in inspect.signature(getattr(msal, one)).parameters}
    specs = [spec for name in methods.names() for spec in methods.find(name).parameters]
    words = {word for spec in specs for word in (spec.name, spec.symbol) if word}
    typed = set(MethodParameters.__annotations__)
    # The rest goes into ``parameters``.
    assert typed <= words
    assert words - typed <= own | {"lambda"}


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


# Type checkers see the API: a user's script passes, mistakes are found


@pytest.mark.ci
def test_a_strict_script_passes_and_mistakes_are_found():
    """To scripts of this folder the package is one of others; the cache is that of the checkout."""
    pytest.importorskip("mypy", reason="mypy is not installed: the types are not checked")
    folder, root = Path(__file__).parent, PACKAGE.parent
    command = [sys.executable, "-m", "mypy", "--strict", "--follow-imports", "silent"]
    command += ["--config-file", os.devnull, "--cache-dir", str(root / ".mypy_cache/api")]
    environment = {**os.environ, "MYPYPATH": str(root)}
    done = subprocess.run(
        [*command, "user_script.py", "user_mistakes.py"],
        capture_output=True, text=True, env=environment, cwd=folder,
    )  # fmt: skip
    lines = (folder / "user_mistakes.py").read_text("utf-8").splitlines()
    expected = {
        at: line.partition("# error: ")[2] for at, line in enumerate(lines, 1) if "# error" in line
    }
    found = dict(re.findall(r"user_mistakes\.py:(\d+): error: (.*)", done.stdout))
    assert {int(at) for at in found} == set(expected), done.stdout + done.stderr
    for at, words in expected.items():
        assert words in found[str(at)]
    others = [
        line for line in done.stdout.splitlines() if ": error:" in line and "mistakes" not in line
    ]
    assert others == []
