"""Type checkers see the Python API: a user's script passes, mistakes are found."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.ci

pytest.importorskip("mypy", reason="mypy is not installed: the types of the API are not checked")

FOLDER = Path(__file__).parent
ROOT = FOLDER.parents[1]


def run_mypy(*names):
    """What mypy prints for scripts of this folder, to which the package is one of others; the cache
    is that of the checkout."""
    command = [sys.executable, "-m", "mypy", "--strict", "--follow-imports", "silent"]
    command += ["--config-file", os.devnull, "--cache-dir", str(ROOT / ".mypy_cache/api"), *names]
    environment = {**os.environ, "MYPYPATH": str(ROOT)}
    return subprocess.run(command, capture_output=True, text=True, env=environment, cwd=FOLDER)


def test_a_strict_script_passes_and_mistakes_are_found():
    done = run_mypy("user_script.py", "user_mistakes.py")
    lines = (FOLDER / "user_mistakes.py").read_text("utf-8").splitlines()
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
