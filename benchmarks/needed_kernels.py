"""Which kernels a run asks for, by kind of file: the list that ``msal_cli.core.ahead`` works from.

    python -m benchmarks.needed_kernels [--write]

A noisy torus as each kind of file is denoised by the whole command, with the default method, one
thread and an empty cache; and one, as binary PLY, with --auto, of which counts what the default
method does not need.  Printed are the kernels that were asked for and the processor seconds
that each takes to compile, the longest first; ``--write`` puts them into ``core/needed.json``.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Collection, Sequence
from pathlib import Path

import msal_cli
from benchmarks import machine, scans
from msal_cli.core.compiled import AUTO

TARGET = Path(msal_cli.__file__).parent / "core" / "needed.json"

AROUND = 512
"""Around the torus: enough vertices for the kernels that only large meshes need."""

AUTO_AROUND = 256
"""Enough for a mesh of which a part stands for the whole."""

AUTO_WORDS = ("--auto", "--auto-budget", "3")
"""With so small a budget the candidates have the same kernels, those aside that are a last resort
for machined parts: they wait until somebody needs them."""

_PROGRAM = """
import json, sys, time
from msal_cli.cli.main import program
from msal_cli.core.compiled import Kernel
asked, prepared, compiled = {}, Kernel._prepared, Kernel._compiled
def name(kernel, kinds):
    return json.dumps([kernel._key(kinds)[0], kinds])
def note_asked(kernel, kinds):
    asked.setdefault(name(kernel, kinds), 0.0)
    return prepared(kernel, kinds)
def note_compiled(kernel, kinds):
    start = time.process_time()
    code = compiled(kernel, kinds)
    asked[name(kernel, kinds)] = time.process_time() - start
    return code
Kernel._prepared, Kernel._compiled = note_asked, note_compiled
try:
    program.main(sys.argv[1:])
except SystemExit as end:
    assert not end.code, end.code
print(json.dumps([[*json.loads(one), seconds] for one, seconds in asked.items()]))
"""


def asked_for(
    source: Path, scratch: Path, cache: Path | None = None, options: Sequence[str] = ()
) -> dict[str, float]:
    """Kernels that denoising a file asks for, as JSON of name and kinds, and seconds to compile.

    The usual cache is used unless another is given.
    """
    environment = dict(os.environ, MSAL_COMPILE_AHEAD="0", MSAL_THREADS="1")
    if cache is not None:
        environment["MSAL_CACHE_DIR"] = str(cache)
    words = ["denoise", str(source), "-o", str(scratch / f"denoised-{source.name}"), "-q"]
    words += options
    ran = subprocess.run(
        [sys.executable, "-c", _PROGRAM, *words],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    told = json.loads(ran.stdout.splitlines()[-1])
    return {json.dumps([name, kinds]): seconds for name, kinds, seconds in told}


def auto_asked_for(
    folder: Path, default: Collection[str], cache: Path | None = None
) -> dict[str, float]:
    """What --auto asks for beside ``default``, the kernels for a binary PLY, like ``asked_for``."""
    scan = scans.large_torus(AUTO_AROUND)
    source = scans.file_of(folder, "small-torus", "ply", lambda: scan)
    asked = asked_for(source, folder, cache, AUTO_WORDS)
    return {one: seconds for one, seconds in asked.items() if one not in default}


def written(needed: dict[str, dict[str, float]]) -> str:
    """The list as it is kept, a kernel a line, the longest to compile first."""
    routes = []
    for route, kernels in needed.items():
        lines = sorted(kernels, key=lambda one: -kernels[one])
        routes.append(f' "{route}": [\n  ' + ",\n  ".join(lines) + "\n ]")
    return "{\n" + ",\n".join(routes) + "\n}\n"


def _show(title: str, seconds: dict[str, float]) -> None:
    print(f"\n{title}: {sum(seconds.values()):.2f} s\n")
    for one, taken in sorted(seconds.items(), key=lambda pair: -pair[1]):
        print(f"{taken:6.2f}  {json.loads(one)[0]}", flush=True)


def main(words: list[str] | None = None) -> None:
    """Print the tables, and write the list if asked to."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--around", type=int, default=AROUND)
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args(words)
    scan = scans.large_torus(arguments.around)
    print(machine.line())
    needed = {}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for form in scans.FORMS:
            source = scans.file_of(folder, "torus", form, lambda: scan)
            needed[form] = asked_for(source, folder, folder / f"cache-{form}")
            _show(scans.FORMS[form].title, needed[form])
        needed[AUTO] = auto_asked_for(folder, needed["ply"], folder / "cache-auto")
        _show("--auto, beyond binary PLY", needed[AUTO])
    if arguments.write:
        TARGET.write_text(written(needed), encoding="utf-8")


if __name__ == "__main__":
    main()
