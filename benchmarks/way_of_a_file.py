"""How much of the package one denoised file needs.

    python -m benchmarks.way_of_a_file [MESH] [--method NAME] [--list]

Denoises a mesh as the command does and prints how many modules of ``msal_cli`` were imported, and
how many files and functions of it were entered.  Compiled kernels count as one entry each where
Python calls them.  ``--list`` names the functions.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = str(ROOT / "msal_cli")


def count_entries(call: list[str]) -> tuple[list[str], list[str], list[tuple[str, str]]]:
    """Modules imported, files entered and functions entered by ``msal`` with the words ``call``."""
    functions = set()

    def note(frame: FrameType, event: str, argument: Any) -> None:
        code = frame.f_code
        is_function = not code.co_name.startswith("<") and code.co_flags & 0x2
        if event == "call" and is_function and code.co_filename.startswith(PACKAGE):
            functions.add((code.co_filename.removeprefix(PACKAGE), code.co_qualname))

    sys.setprofile(note)
    try:
        from msal_cli.__main__ import main

        sys.argv = ["msal", *call]
        main()
    except SystemExit as ending:
        if ending.code:
            raise
    finally:
        sys.setprofile(None)
    modules = [name for name in sys.modules if name.startswith("msal_cli")]
    return sorted(modules), sorted({file for file, _ in functions}), sorted(functions)


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mesh", nargs="?", default=ROOT / "sample_meshes/bracket_noisy.ply")
    parser.add_argument("--method", default=None)
    parser.add_argument("--list", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        call = ["denoise", str(options.mesh), "-o", str(Path(folder) / "out.ply")]
        if options.method:
            call += ["--method", options.method]
        modules, files, functions = count_entries(call)
    print(f"modules imported  {len(modules)}")
    print(f"files entered     {len(files)}")
    print(f"functions entered {len(functions)}")
    if options.list:
        for file, name in functions:
            print(f"{file} {name}")


if __name__ == "__main__":
    main()
