"""Planted faults: which are found in a module, and that a good test kills them."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from tests.mutation.__main__ import ENOUGH, run_target
from tests.mutation.judged import read_judged
from tests.mutation.mutants import find_mutants
from tests.mutation.targets import ROOT, TARGETS


def words_of(source):
    return [mutant.words for mutant in find_mutants(source)]


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("a = b < c", ["Lt becomes LtE", "Lt becomes GtE"]),
        ("a = b is not None", ["IsNot becomes Is"]),
        ("a = b and c", ["and/or swapped"]),
        ("a += b", ["Add becomes Sub"]),
        ("a = 'x' + b", []),
        ("a = f'{b + 1}'", []),
        ("a = 3", ["3 becomes 4"]),
        ("a = 1e-5", ["becomes 99999.99999999999"]),
        ("a = 0.0", ["becomes 1.0"]),
        ("a = True", ["becomes False"]),
        ("a = not b", ["not dropped"]),
        ("if a:\n    pass", ["condition negated"]),
        ("a = max(b)", ["becomes min"]),
        ("f(a)", ["left out"]),
        ("log.warning(a < b)", []),
        ("raise ValueError(a < b)", ["left out"]),
        ("def f():\n    return a", ["returns None"]),
        ("def f(a: T[1]) -> T[2]:\n    'words'", []),
        ("import a\nif TYPE_CHECKING:\n    b = 1", []),
    ],
)
def test_faults_of_a_statement(source, expected):
    found = words_of(source)
    assert len(found) == len(expected)
    assert all(one.endswith(end) for one, end in zip(found, expected, strict=True))


def test_a_fault_is_in_its_place_only():
    source = "def f(a):\n    return (a < 1) + (a < 1)\n"
    results = set()
    for mutant in find_mutants(source):
        if mutant.words.endswith(("Lt becomes LtE", "1 becomes 2")):
            names: dict = {}
            exec(mutant.compile(source, "toy.py"), names)
            assert (mutant.line, mutant.lines, mutant.function) == (2, (2, 2), "f")
            results.add((mutant.node, names["f"](1)))
    assert len(results) == 4
    assert all(total == 1 for _, total in results)


MODULE = """LIMIT = 0.25

def clamp(x):
    if x > LIMIT:
        return LIMIT
    return x

def wait(n):
    while n > 0:
        n -= 1
    return n

def unused():
    return 1
"""
TESTS = """import toy

def test_clamp():
    assert [toy.clamp(x) for x in (0.0, 0.25, 1.0)] == [0.0, 0.25, 0.25]

def test_wait():
    assert toy.wait(3) == 0
"""
SCRIPT = """
import json, pathlib, sys
from tests.mutation import runs
from tests.mutation.mutants import find_mutants
runs.LEAST_S = 2.0
root = pathlib.Path(sys.argv[1])
target = runs.Target(root, root / "toy.py", ["test_toy.py"])
mutants = find_mutants(target.file.read_text())
found = runs.run_mutants(target, mutants, 2)
print(json.dumps({mutant.words: outcome for mutant, outcome in found}))
"""


def outcomes(folder, tests):
    (folder / "toy.py").write_text(MODULE)
    (folder / "test_toy.py").write_text(tests)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(folder)}
    return subprocess.run(
        [sys.executable, "-c", SCRIPT, str(folder)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=100.0,
    )


@pytest.mark.skipif(sys.platform != "linux", reason="it forks and limits the processor time")
def test_faults_of_a_toy_are_killed_or_survive(tmp_path):
    found = json.loads(outcomes(tmp_path, TESTS).stdout)
    survived = {words for words, outcome in found.items() if outcome == "survived"}
    # At the limit both branches return the same.
    assert survived == {"x > LIMIT: Gt becomes GtE"}
    assert {words for words, outcome in found.items() if outcome == "not reached"} == {
        "return 1: returns None",
        "1 becomes 2",
    }
    # A constant of the module, a branch, and a loop that does not end.
    for words in ("0.25 becomes 0.5", "x > LIMIT: Gt becomes LtE", "n -= 1: Sub becomes Add"):
        assert found[words] == "killed"


@pytest.mark.skipif(sys.platform != "linux", reason="it forks and limits the processor time")
def test_tests_that_fail_without_a_fault_are_an_error(tmp_path):
    done = outcomes(tmp_path, TESTS.replace("== 0", "== 1"))
    assert "without any fault, tests of toy fail" in done.stderr


def test_judged_survivors_can_be_planted():
    found = {
        f"{target} {mutant.function}: {mutant.words}"
        for target in TARGETS
        for mutant in find_mutants((ROOT / f"msal_cli/{target}.py").read_text("utf-8"))
    }
    assert read_judged().keys() <= found


@pytest.mark.slow
@pytest.mark.parametrize("target", TARGETS)
def test_the_tests_notice_faults(target):
    killed, counted = run_target(target, sample=20, seed=0, jobs=os.cpu_count() or 1)
    assert killed >= ENOUGH * counted
