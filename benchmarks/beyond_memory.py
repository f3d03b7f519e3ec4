"""A giant mesh in less memory than it takes, beside the run in memory: seconds, memory, bytes.

    python -m benchmarks.beyond_memory [--millions 2] [--limit 200M] [--order rows|blocks|shuffled]
        [--to ply|obj|stl] [--folder FOLDER] [--no-whole] [-- OPTION ...]

A mesh of ``benchmarks.giant_mesh`` is denoised with the OPTIONS (``--method msal`` if there are
none) without a limit, and with LIMIT bytes: in a memory cgroup of its own where one can be made
(as root, version 1 or 2), which counts the pages of files, too; else by ``--memory-limit``, which
sets RLIMIT_DATA of a worker.
Printed are seconds from start to end, processor seconds, the most anonymous memory, the most memory
that the cgroup counted, bytes read and written, and whether both outputs have the same bytes.

FOLDER needs some 400 bytes for each vertex, and should be on a disk that nothing else uses.
``--millions 20 --limit 600M``, ``--millions 50 --limit 1500M`` and ``--millions 10 --order shuffled
--limit 400M`` are the figures of docs/scale.md.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import hashlib
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks import giant_mesh, machine
from msal_cli.cli.options import parse_size

_BETWEEN_LOOKS_S = 0.05
_GROUPS = Path("/sys/fs/cgroup")
_MB = 1e6

_COUNTED = (
    ("anonymous_bytes", "status", "RssAnon"),
    ("read_bytes", "io", "read_bytes"),
    ("written_bytes", "io", "write_bytes"),
)
"""Fields of ``Used``, and the files and keys of /proc that they are the most of."""


@dataclass
class Used:
    """What a command used; ``group_bytes`` is None where no cgroup counts."""

    seconds: float = 0.0
    cpu_seconds: float = 0.0
    anonymous_bytes: int = 0
    group_bytes: int | None = None
    read_bytes: int = 0
    written_bytes: int = 0
    digest: str = ""


@contextlib.contextmanager
def limited(n_bytes: int | None) -> Iterator[tuple[str, Callable[[], object], Path | None]]:
    """What limits memory in words, what a child calls to be limited, and what counts its most."""
    if n_bytes is None:
        yield "no limit", lambda: None, None
        return
    for base, limit, peak in (
        (_GROUPS / "memory", "memory.limit_in_bytes", "memory.max_usage_in_bytes"),
        (_GROUPS, "memory.max", "memory.peak"),
    ):
        group = base / f"msal-benchmark-{os.getpid()}"
        try:
            group.mkdir()
            (group / limit).write_text(str(n_bytes))
        except OSError:
            with contextlib.suppress(OSError):
                group.rmdir()
            continue
        enter = functools.partial(_enter, group / "cgroup.procs")
        try:
            yield f"memory cgroup of {n_bytes / _MB:,.0f} MB", enter, group / peak
        finally:
            with contextlib.suppress(OSError):
                group.rmdir()
        return
    yield "no memory cgroup: RLIMIT_DATA by --memory-limit", lambda: None, None


def _enter(members: Path) -> None:
    members.write_text(str(os.getpid()))


def measure(command: list[str], n_bytes: int | None, output: Path) -> Used:
    """Run a command within so many bytes; SystemExit if it fails."""
    used = Used()
    with limited(n_bytes) as (words, enter, peak), tempfile.TemporaryFile() as said:
        if n_bytes is not None and peak is None:
            command = [*command, "--memory-limit", f"{n_bytes / _MB}M"]
        print(f"{words}: {' '.join(command[2:])}", flush=True)
        before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        process = subprocess.Popen(command, stderr=said, preexec_fn=enter)
        while process.poll() is None:
            members = _family(process.pid)
            for field, name, key in _COUNTED:
                total = sum(_number(pid, name, key) for pid in members)
                setattr(used, field, max(getattr(used, field), total))
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_BETWEEN_LOOKS_S)
        used.seconds = time.perf_counter() - began
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        used.cpu_seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        used.group_bytes = None if peak is None else int(peak.read_text())
        if process.returncode:
            said.seek(0)
            raise SystemExit(f"exit status {process.returncode}\n{said.read().decode()}")
    with output.open("rb") as file:
        used.digest = hashlib.file_digest(file, "sha256").hexdigest()
    output.unlink()
    return used


def _family(pid: int) -> list[int]:
    """A process and those that it started: a limit without a cgroup is that of a worker."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        children = []
    return [pid, *(member for child in children for member in _family(int(child)))]


def _number(pid: int, name: str, key: str) -> int:
    try:
        lines = Path(f"/proc/{pid}/{name}").read_text().splitlines()
    except OSError:
        return 0
    for line in lines:
        words = line.split()
        if words[0] == f"{key}:":
            return int(words[1]) * (1024 if words[-1] == "kB" else 1)
    return 0


def _row(used: Used, millions: float) -> str:
    total = "" if used.group_bytes is None else f", {used.group_bytes / _MB:,.0f} MB with files"
    return (
        f"  {used.seconds:.1f} s ({used.seconds / millions:.2f} per million), "
        f"{used.cpu_seconds:.1f} CPU s, {used.anonymous_bytes / _MB:,.0f} MB anonymous{total}, "
        f"{used.read_bytes / _MB:,.0f} MB read, {used.written_bytes / _MB:,.0f} MB written"
    )


def main(words: list[str] | None = None) -> None:
    """Make the mesh, run the command twice, compare."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.beyond_memory")
    parser.add_argument("--millions", type=float, default=2.0)
    parser.add_argument("--limit", type=parse_size, default=200_000_000)
    parser.add_argument("--order", choices=giant_mesh.ORDERS, default="rows")
    parser.add_argument("--to", choices=("ply", "obj", "stl"), default="ply")
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--no-whole", action="store_true")
    parser.add_argument("options", nargs="*")
    arguments = parser.parse_args(words)
    print(machine.line())
    msal = [sys.executable, "-m", "msal_cli"]
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
        source = Path(name) / f"giant{'.stl' if arguments.to == 'stl' else '.ply'}"
        giant = ["--millions", str(arguments.millions), "--order", arguments.order]
        giant_mesh.main([str(source), *giant])
        if arguments.to == "obj":
            text = source.with_suffix(".obj")
            options = ["--method", "taubin", "--set", "iterations=1", "-q"]
            subprocess.run([*msal, "denoise", str(source), "-o", str(text), *options], check=True)
            source = text
        output = source.with_stem("output")
        command = [*msal, "denoise", str(source), "-o", str(output), "-q"]
        command += arguments.options or ["--method", "msal"]
        digests = set()
        for limit in (arguments.limit,) if arguments.no_whole else (None, arguments.limit):
            used = measure(command, limit, output)
            print(_row(used, arguments.millions), flush=True)
            digests.add(used.digest)
        if not arguments.no_whole:
            print("the same bytes" if len(digests) == 1 else "OTHER BYTES")


if __name__ == "__main__":
    main()
