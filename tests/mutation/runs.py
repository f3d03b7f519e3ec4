"""Running tests against planted faults, each in a process of its own.

One process for each target collects its tests once.  For every fault it forks a child, which gives
the functions of the module their changed code and runs the tests that enter the changed statement,
the fastest first, until one fails.  For a fault in what runs when the module is imported the child
imports everything anew.  Kernels of the module run as Python.
"""

from __future__ import annotations

import functools
import gc
import hashlib
import importlib
import importlib.abc
import importlib.util
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import CodeType, FrameType, FunctionType, ModuleType
from typing import Any

import pytest

from tests.mutation.mutants import Mutant

OPTIONS = ["-q", "-s", "-p", "no:cacheprovider", "-p", "no:xdist", "--tb=no"]
OPTIONS += ["--hypothesis-seed=0", "-W", "ignore::pytest.PytestAssertRewriteWarning"]
LEAST_S = 10.0
"""Tests that take more processor time than this and five times their usual time count as failed;
so do those that take twenty times that in all: they wait for something."""

MOST_MEASURING_S = 300
"""Processor time for running all tests of a target once."""

CACHED = functools._lru_cache_wrapper

MOST_BYTES = 8 << 30
"""Address space of a child: a wrong size is refused, and does not fill the machine."""


@dataclass(frozen=True)
class Target:
    """A module, and the tests that should notice its faults: files and folders below ``root``, and
    options of pytest."""

    root: Path
    file: Path
    tests: Sequence[str]

    @property
    def module(self) -> str:
        """Its dotted name."""
        return ".".join(self.file.relative_to(self.root).with_suffix("").parts)

    def cache(self) -> Path:
        """The temporary file for the coverage, named by the package's and the tests' contents."""
        package = self.root / self.file.relative_to(self.root).parts[0]
        places = [package, *(self.root / test for test in self.tests), Path(__file__)]
        places += (self.root / "tests").glob("*.py")
        files = {file for place in places for file in [place, *place.rglob("*.py")]}
        total = hashlib.sha256(repr([OPTIONS, str(self.file), *self.tests]).encode())
        for file in sorted(files):
            if file.is_file():
                total.update(file.read_bytes())
        return Path(tempfile.gettempdir()) / f"msal_mutation_{total.hexdigest()[:24]}.json"


@dataclass(frozen=True)
class Coverage:
    """The tests that enter each line of a file ("" is the import), and the seconds of processor
    time that each test takes."""

    tests: dict[int, list[str]]
    seconds: dict[str, float]

    def tests_of(self, mutant: Mutant) -> list[str]:
        """The tests that run a mutant's statement, the fastest first."""
        found = self.seconds if self.is_imported(mutant) else self._entered_by(mutant)
        return sorted(found, key=self.seconds.__getitem__)

    def is_imported(self, mutant: Mutant) -> bool:
        """Whether the statement runs when modules are imported."""
        return mutant.lines is None or "" in self._entered_by(mutant)

    def _entered_by(self, mutant: Mutant) -> set[str]:
        first, last = mutant.lines or (0, -1)
        return {test for line in range(first, last + 1) for test in self.tests.get(line, ())}


def run_mutants(
    target: Target, mutants: Sequence[Mutant], jobs: int
) -> Iterator[tuple[Mutant, str]]:
    """Each mutant with ``killed``, ``survived`` or ``not reached``, as they come."""
    receive, send = os.pipe()
    stream = os.fdopen(receive)

    def start() -> int:
        os.chdir(target.root)
        _interpret(target.module)
        campaign = Campaign(target, mutants, jobs, os.fdopen(send, "w"))
        return int(pytest.main([*OPTIONS, *target.tests], plugins=[campaign]))

    child = _fork(start)
    os.close(send)
    left = len(mutants)
    with stream:
        for line in stream:
            number, outcome = json.loads(line)
            left -= 1
            yield mutants[number], outcome
    os.waitpid(child, 0)
    if left:
        raise RuntimeError(f"without any fault, tests of {target.module} fail: {target.tests}")


class Campaign:
    """A plugin of pytest that runs the tests against mutants.  Writes a line for each: its number
    and the outcome."""

    def __init__(self, target: Target, mutants: Sequence[Mutant], jobs: int, results: Any) -> None:
        self.target, self.mutants, self.jobs, self.results = target, mutants, jobs, results
        self.cache = target.cache()
        self.tracer = Tracer(str(target.file))
        if not self.cache.exists():
            self.tracer.start()

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Fork a child for each mutant instead of running the tests here."""
        # It may be imported within functions only.
        importlib.import_module(self.target.module)
        if not self.cache.exists() and not session.testsfailed:
            with tempfile.TemporaryDirectory() as folder:
                os.waitpid(_fork(lambda: self._measure(session), folder), 0)
            self.tracer.stop()
        lines, seconds = json.loads(self.cache.read_text("utf-8"))
        self._run(session, Coverage(dict(lines), seconds))
        return True

    def _measure(self, session: pytest.Session) -> int:
        """Run each test once, and keep in the cache what it enters and how long it takes.  A test
        that fails here ends it."""
        resource.setrlimit(resource.RLIMIT_CPU, (MOST_MEASURING_S, MOST_MEASURING_S))
        seconds = {}
        root = str(self.target.root)
        wrappers = [
            one for one in gc.get_objects() if isinstance(one, CACHED) and _is_below(one, root)
        ]
        for item, following in _in_order(session.items):
            for wrapper in wrappers:
                # Each test is to enter what it needs, as if it were alone.
                wrapper.cache_clear()
            start = time.process_time()
            self.tracer.test = item.nodeid
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            seconds[item.nodeid] = time.process_time() - start
            if session.testsfailed:
                return 1
        self.tracer.stop()
        lines = {line: sorted(tests) for line, tests in self.tracer.tests.items()}
        new = self.cache.with_suffix(f".{os.getpid()}")
        new.write_text(json.dumps([sorted(lines.items()), seconds]), "utf-8")
        new.replace(self.cache)
        return 0

    def _run(self, session: pytest.Session, measured: Coverage) -> None:
        items = {item.nodeid: item for item in session.items}
        source, file = self.target.file.read_text("utf-8"), str(self.target.file)
        functions = [
            function
            for function in gc.get_objects()
            if isinstance(function, FunctionType) and function.__code__.co_filename == file
        ]

        def start(mutant: Mutant, tests: list[str], limit: float) -> int:
            resource.setrlimit(resource.RLIMIT_CPU, (int(limit), int(limit) + 1))
            resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
            code = mutant.compile(source, file)
            if measured.is_imported(mutant):
                return self._run_anew(code, tests)
            _replace_codes(functions, code)
            for item, following in _in_order([items[test] for test in tests]):
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
                if session.testsfailed:
                    return 1
            return 0

        running: dict[int, tuple[int, float, str]] = {}
        waiting = list(enumerate(self.mutants))[::-1]
        while waiting or running:
            while waiting and len(running) < self.jobs:
                number, mutant = waiting.pop()
                if not (tests := measured.tests_of(mutant)):
                    self._write(number, "not reached")
                    continue
                limit = LEAST_S + 5.0 * sum(measured.seconds[test] for test in tests)
                folder = tempfile.mkdtemp(prefix="msal_mutant_")
                child = _fork(lambda call=(mutant, tests, limit): start(*call), folder)
                running[child] = number, time.monotonic() + 20.0 * limit, folder
            time.sleep(0.005)
            for child, (number, end, folder) in list(running.items()):
                done, status = os.waitpid(child, os.WNOHANG)
                if not done and time.monotonic() > end:
                    os.killpg(child, signal.SIGKILL)
                    done, status = os.waitpid(child, 0)
                if done:
                    del running[child]
                    shutil.rmtree(folder, ignore_errors=True)
                    self._write(number, "killed" if status else "survived")

    def _run_anew(self, code: CodeType, tests: list[str]) -> int:
        """Forget all modules below the root, and run ``tests`` with ``code`` for the module."""
        below = str(self.target.root) + os.sep
        for name, module in list(sys.modules.items()):
            if str(getattr(module, "__file__", "")).startswith(below):
                del sys.modules[name]
        sys.meta_path.insert(0, Replacement(self.target.module, code, str(self.target.file)))
        _interpret(self.target.module)
        return int(pytest.main([*OPTIONS, "-x", *self.target.tests], plugins=[Order(tests)]))

    def _write(self, number: int, outcome: str) -> None:
        print(json.dumps([number, outcome]), file=self.results, flush=True)


class Tracer:
    """Notes which lines of one file are entered by which test."""

    def __init__(self, file: str) -> None:
        self.file, self.test = file, ""
        self.tests: dict[int, set[str]] = {}

    def start(self) -> None:
        """Trace this thread, and all that it starts."""
        threading.settrace(self._call)
        sys.settrace(self._call)

    def stop(self) -> None:
        """Trace no more."""
        threading.settrace(None)  # type: ignore[arg-type]
        sys.settrace(None)

    def _call(self, frame: FrameType, event: str, arg: Any) -> Any:
        return self._line if frame.f_code.co_filename == self.file else None

    def _line(self, frame: FrameType, event: str, arg: Any) -> Any:
        if event == "line":
            self.tests.setdefault(frame.f_lineno, set()).add(self.test)
        return self._line


class Order:
    """A plugin of pytest that runs the tests in this order.  Those that it does not know come last:
    a fault can change the name of a test."""

    def __init__(self, tests: Sequence[str]) -> None:
        self.places = {test: place for place, test in enumerate(tests)}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Sort the collected tests."""
        items.sort(key=lambda item: self.places.get(item.nodeid, len(self.places)))


class Replacement(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Gives one module other code; all others come as usual."""

    def __init__(self, module: str, code: CodeType, file: str) -> None:
        self.module, self.code, self.file = module, code, file

    def find_spec(
        self, name: str, path: Any, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The specification of the one module."""
        if name != self.module:
            return None
        places = [os.path.dirname(self.file)] if self.file.endswith("__init__.py") else None
        return importlib.util.spec_from_file_location(
            name, self.file, loader=self, submodule_search_locations=places
        )

    def exec_module(self, module: ModuleType) -> None:
        """Run the other code."""
        exec(self.code, module.__dict__)


def _in_order(items: Sequence[pytest.Item]) -> Iterator[tuple[pytest.Item, pytest.Item | None]]:
    """Each test with the one that follows."""
    return zip(items, [*items[1:], None], strict=True)


def _is_below(wrapper: Any, root: str) -> bool:
    """Whether a function with a cache is defined in a file below ``root``."""
    code = getattr(wrapper.__wrapped__, "__code__", None)
    return code is not None and code.co_filename.startswith(root + os.sep)


def _replace_codes(functions: Sequence[FunctionType], code: CodeType) -> None:
    """Give living functions of a module their code in ``code``, the module's."""
    codes, waiting = {}, [code]
    while waiting:
        inner = [one for one in waiting.pop().co_consts if isinstance(one, CodeType)]
        codes.update({(one.co_qualname, one.co_firstlineno): one for one in inner})
        waiting += inner
    for function in functions:
        old = function.__code__
        new = codes.get((old.co_qualname, old.co_firstlineno))
        if new is not None and new.co_freevars == old.co_freevars and "<" not in new.co_name:
            function.__code__ = new


def _fork(run: Callable[[], int], folder: str = "") -> int:
    """A child that runs ``run`` without standard streams, with temporary files in ``folder``."""
    child = os.fork()
    if child:
        return child
    status = 1
    try:
        os.setpgid(0, 0)
        empty = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(empty, stream)
        if folder:
            os.environ["PYTEST_DEBUG_TEMPROOT"] = folder
        status = run()
    finally:
        os._exit(status)


def _interpret(module: str) -> None:
    """Let the kernels of ``module`` run as Python, and those that the library lacks for it."""
    if not module.startswith("msal_cli.kernels."):
        return
    from msal_cli.errors import InternalError
    from msal_cli.kernels import compiled

    load = compiled.Kernel._load

    def load_or_interpret(self: Any, arg_types: Any) -> Any:
        if self.function.__module__ == module:
            return self.function
        try:
            return load(self, arg_types)
        except (LookupError, TypeError, InternalError):
            return self.function

    compiled.Kernel._load = load_or_interpret  # type: ignore[method-assign]
