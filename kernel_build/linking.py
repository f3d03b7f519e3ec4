"""The shared library: objects and ``runtime.c`` put together by a C compiler."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from kernel_build.targets import Target

RUNTIME = Path(__file__).with_name("runtime.c")
_ARRAY_FILES = Path(__file__).with_name("array_files.c")

ZIG = (sys.executable, "-m", "ziglang", "cc")


def system_compiler() -> tuple[str, ...]:
    """The C compiler of ``CC`` or of the system; empty where there is none."""
    wanted = os.environ.get("CC", "").split()
    if wanted:
        return tuple(wanted)
    found = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    return (found,) if found else ()


def link(objects: Sequence[Path], target: Target, compiler: Sequence[str], library: Path) -> None:
    """Write the library, unless it is there and was made of the same.

    Raises
    ------
    SystemExit
        with the compiler's words where it fails.
    """
    command = _command(target, compiler)
    note = library.with_name(f"{library.name}.inputs")
    if compiler == ZIG and importlib.util.find_spec("ziglang") is None:
        raise SystemExit("there is no C compiler: install one, or pip install ziglang")
    inputs = _digest(command, objects)
    if library.exists() and note.exists() and note.read_text() == inputs:
        return
    library.parent.mkdir(parents=True, exist_ok=True)
    listing = library.with_name(f"{library.name}.objects")
    # Quoted, and with slashes: a backslash would escape.
    listing.write_text("\n".join(f'"{one.as_posix()}"' for one in objects), encoding="utf-8")
    # In a folder of its own: a library of Windows has its name inside, and files beside it.
    made = library.parent / "linked" / library.name
    made.parent.mkdir(exist_ok=True)
    words = [*command, "-o", str(made), str(RUNTIME), "-lm"]
    if objects:
        words.insert(-1, f"@{listing}")
    ran = subprocess.run(words, capture_output=True, text=True)
    if ran.returncode:
        raise SystemExit(f"{' '.join(words)}\n{ran.stdout}{ran.stderr}")
    made.replace(library)
    note.write_text(inputs)


def _command(target: Target, compiler: Sequence[str]) -> list[str]:
    words = [*compiler, "-O2", "-shared", "-s", "-fvisibility=hidden"]
    words += [f"-DHAS{suffix.upper()}" for suffix in target.processors if suffix]
    if "ziglang" in compiler:
        words += ["-target", target.zig]
    if target.suffix == ".so":
        # No symbol is left for the loader to look for but those of libc and libm.
        words += ["-fPIC", "-Wl,-z,defs", "-Wl,-z,noexecstack", "-Wl,--build-id=none"]
    return words


def _digest(command: Sequence[str], objects: Sequence[Path]) -> str:
    sources = RUNTIME.read_bytes() + _ARRAY_FILES.read_bytes()
    parts = repr(([*command], [one.name for one in objects], sources))
    return hashlib.sha256(parts.encode()).hexdigest()
