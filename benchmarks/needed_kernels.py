"""Which kernels a run asks for, by kind of file: the list that ``msal_cli.core.ahead`` works from.

    python -m benchmarks.needed_kernels [--write]

A noisy torus as each kind of file is denoised by the whole command, with the default method, one
thread and an empty cache.  Printed are the kernels that were asked for and the processor seconds
that each takes to compile, the longest first; ``--write`` puts them into ``core/needed.json``.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import msal_cli
from benchmarks import machine, scans

TARGET = Path(msal_cli.__file__).parent / "core" / "needed.json"

AROUND = 512
"""Around the torus: enough vertices for the kernels that only large meshes need."""

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


def asked_for(source: Path, scratch: Path, cache: Path | None = None) -> dict[str, float]:
    """Kernels that denoising a file asks for, as JSON of name and kinds, and seconds to compile.

    The usual cache is used unless another is given.
    """
    environment = dict(os.environ, MSAL_COMPILE_AHEAD="0", MSAL_THREADS="1")
    if cache is not None:
        environment["MSAL_CACHE_DIR"] = str(cache)
    words = ["denoise", str(source), "-o", str(scratch / f"denoised-{source.name}"), "-q"]
    ran = subprocess.run(
        [sys.executable, "-c", _PROGRAM, *words],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    told = json.loads(ran.stdout.splitlines()[-1])
    return {json.dumps([name, kinds]): seconds for name, kinds, seconds in told}


def written(needed: dict[str, dict[str, float]]) -> str:
    """The list as it is kept, a kernel a line, the longest to compile first."""
    routes = []
    for route, kernels in needed.items():
        lines = sorted(kernels, key=lambda one: -kernels[one])
        routes.append(f' "{route}": [\n  ' + ",\n  ".join(lines) + "\n ]")
    return "{\n" + ",\n".join(routes) + "\n}\n"


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
            print(f"\n{scans.FORMS[form].title}: {sum(needed[form].values()):.2f} s\n", flush=True)
            for one, seconds in sorted(needed[form].items(), key=lambda pair: -pair[1]):
                print(f"{seconds:6.2f}  {json.loads(one)[0]}")
    if arguments.write:
        TARGET.write_text(written(needed), encoding="utf-8")


if __name__ == "__main__":
    main()
