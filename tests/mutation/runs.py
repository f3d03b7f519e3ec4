"""Running tests against planted faults: each in a process of its own, forked from a warm one.

The warm process has imported numpy and pytest but nothing of the package, so that a child can
import the package with one module replaced.  Kernels of that module run as Python.
"""

from __future__ import annotations

import contextlib
import importlib.abc
import importlib.util
import json
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import coverage
import numpy as np  # noqa: F401  (warm)
import pytest

from tests.mutation.mutants import Mutant

ROOT = Path(__file__).resolve().parents[2]
OPTIONS = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "--tb=no", "--hypothesis-seed=0"]
OPTIONS += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
LEAST_S = 20.0
"""A mutant whose tests take longer than this and five times their usual time does not end."""


@dataclass(frozen=True)
class Coverage:
    """Which tests enter which lines of a file, and the seconds that each test takes."""

    tests: dict[int, list[str]]
    seconds: dict[str, float]

    def tests_of(self, mutant: Mutant) -> list[str]:
        """The tests that run a mutant's statement, the fastest first."""
        first, last = mutant.lines or (min(self.tests, default=0), max(self.tests, default=0))
        found = {test for line in range(first, last + 1) for test in self.tests.get(line, ())}
        return sorted(found, key=lambda test: self.seconds[test])


class Tracer:
    """A plugin of pytest that notes the lines of one file that each test enters."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.coverage = coverage.Coverage(data_file=None, include=[file], config_file=False)
        self.seconds: dict[str, float] = {}

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        start = time.perf_counter()
        self.coverage.switch_context(item.nodeid)
        yield
        self.seconds[item.nodeid] = time.perf_counter() - start

    def tests(self) -> dict[int, list[str]]:
        """The tests that entered each line."""
        lines = self.coverage.get_data().contexts_by_lineno(self.file)
        return {line: [test for test in tests if test] for line, tests in lines.items()}


class Replacement(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Gives one module other code; all others come as usual."""

    def __init__(self, module: str, code: CodeType | None, file: str) -> None:
        self.module, self.code, self.file = module, code, file

    def find_spec(
        self, name: str, path: Any, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name != self.module:
            return None
        return importlib.util.spec_from_file_location(name, self.file, loader=self)

    def exec_module(self, module: ModuleType) -> None:
        code = self.code or compile(Path(self.file).read_text("utf-8"), self.file, "exec")
        exec(code, module.__dict__)


def measure_coverage(file: Path, tests: Sequence[str]) -> Coverage:
    """Run ``tests`` once, in a child, and note what they enter of ``file``."""
    receive, send = os.pipe()
    child = os.fork()
    if not child:
        os.close(receive)
        _be_quiet()
        _interpret(_module_of(file))
        tracer = Tracer(str(file))
        with tracer.coverage.collect():
            pytest.main([*OPTIONS[1:], *tests], plugins=[tracer])
        with os.fdopen(send, "w") as stream:
            json.dump([sorted(tracer.tests().items()), tracer.seconds], stream)
        os._exit(0)
    os.close(send)
    with os.fdopen(receive) as stream:
        text = stream.read()
    os.waitpid(child, 0)
    if not text:
        raise RuntimeError(f"the tests of {file} cannot be run")
    lines, seconds = json.loads(text)
    return Coverage(dict(lines), seconds)


def run_mutants(
    file: Path, mutants: Sequence[Mutant], coverage: Coverage, jobs: int
) -> Iterator[tuple[Mutant, str]]:
    """Each mutant with ``killed``, ``survived`` or ``not reached``, as they come."""
    source = file.read_text("utf-8")
    running: dict[int, tuple[Mutant, float]] = {}
    waiting = list(mutants)[::-1]
    while waiting or running:
        while waiting and len(running) < jobs:
            mutant = waiting.pop()
            tests = coverage.tests_of(mutant)
            if not tests:
                yield mutant, "not reached"
                continue
            usual = sum(coverage.seconds[test] for test in tests)
            child = _start(file, mutant.compile(source, str(file)), tests)
            running[child] = mutant, time.monotonic() + LEAST_S + 5.0 * usual
        time.sleep(0.01)
        for child, (mutant, end) in list(running.items()):
            done, status = os.waitpid(child, os.WNOHANG)
            if done:
                del running[child]
                yield mutant, "survived" if status == 0 else "killed"
            elif time.monotonic() > end:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(child, signal.SIGKILL)
                os.waitpid(child, 0)
                del running[child]
                yield mutant, "killed"


def _start(file: Path, code: CodeType, tests: list[str]) -> int:
    child = os.fork()
    if child:
        return child
    os.setpgid(0, 0)
    _be_quiet()
    module = _module_of(file)
    sys.meta_path.insert(0, Replacement(module, code, str(file)))
    with contextlib.suppress(BaseException):
        _interpret(module)
        os._exit(int(pytest.main([*OPTIONS, *tests])))
    os._exit(1)


def _interpret(module: str) -> None:
    """Let the kernels of ``module`` run as Python, and those that the library lacks for it."""
    if not module.startswith("msal_cli.kernels."):
        return
    from msal_cli.kernels import compiled, library

    load = compiled.Kernel._load

    def load_or_interpret(self: Any, arg_types: Any) -> Any:
        if self.function.__module__ == module:
            return self.function
        try:
            return load(self, arg_types)
        except (LookupError, TypeError, library.InternalError):
            return self.function

    compiled.Kernel._load = load_or_interpret  # type: ignore[method-assign]


def _module_of(file: Path) -> str:
    return ".".join(file.relative_to(ROOT).with_suffix("").parts)


def _be_quiet() -> None:
    empty = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(empty, stream)
