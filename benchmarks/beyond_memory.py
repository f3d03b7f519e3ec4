"""One giant mesh by tiles beside the run in memory: seconds, memory and scratch space.

    python -m benchmarks.beyond_memory [--millions 1 3 10] [--whole 10] [--cores 1 2]
        [--order rows|blocks|shuffled] [--suffix .ply|.stl] [--folder FOLDER] [-- OPTION ...]

Meshes of ``benchmarks.giant_mesh`` are denoised by ``msal denoise --tiled`` with the OPTIONS
(``--method msal`` if there are none), and those of at most WHOLE million vertices without
``--tiled`` too.  Printed are, per million vertices, seconds from start to end and processor time;
the sum of the peaks of resident memory of all processes (a part of it are mapped files, whose pages
the system takes back when it needs memory); the most proportional and the most private memory of
all processes together at one moment; the most bytes in the scratch folder, per vertex; and whether
both outputs have the same bytes.  The last lines compare tiles with memory, large with small, and
two cores with one.

FOLDER needs some 200 bytes per vertex.  100 million vertices: ``--millions 10 100 --whole 10``.
The sizes given by default take five minutes.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks import giant_mesh, machine

_BETWEEN_LOOKS_S = 0.1
_BETWEEN_SCRATCH_LOOKS_S = 1.0
_MIB = 2**20


@dataclass
class Used:
    """What one command used.

    Attributes
    ----------
    seconds, cpu_seconds : from start to end; of the command and its workers.
    resident_bytes : sum over all processes of the most that each held.
    shared_bytes, private_bytes : most of all processes at one moment: proportional set size, in
        which a page counts once however many map it, and anonymous memory.
    scratch_bytes : most that lay in the scratch folder.
    digest : SHA-256 of the output.
    """

    seconds: float = 0.0
    cpu_seconds: float = 0.0
    shared_bytes: int = 0
    private_bytes: int = 0
    scratch_bytes: int = 0
    digest: str = ""
    peaks: dict[int, int] = field(default_factory=dict)

    @property
    def resident_bytes(self) -> int:
        """See above; a worker that replaces another counts instead of it only if both lived."""
        return sum(self.peaks.values())

    def look(self, pid: int) -> None:
        """Add what the process ``pid`` and all below it hold now."""
        shared = private = 0
        for one in _tree(pid):
            status = _fields(one, "status")
            self.peaks[one] = max(self.peaks.get(one, 0), status.get("VmHWM", 0))
            private += status.get("RssAnon", 0)
            shared += _fields(one, "smaps_rollup").get("Pss", 0)
        self.shared_bytes = max(self.shared_bytes, shared)
        self.private_bytes = max(self.private_bytes, private)


def _fields(pid: int, name: str) -> dict[str, int]:
    """Lines ``word: number kB`` of a file in ``/proc``, as bytes."""
    try:
        lines = Path(f"/proc/{pid}/{name}").read_text().splitlines()
    except OSError:
        return {}
    cells = (line.split() for line in lines)
    return {
        one[0].rstrip(":"): 1024 * int(one[1]) for one in cells if len(one) == 3 and one[2] == "kB"
    }


def _tree(pid: int) -> list[int]:
    """A process and all below it."""
    found = [pid]
    for parent in found:
        for listing in Path(f"/proc/{parent}/task").glob("*/children"):
            try:
                found += map(int, listing.read_text().split())
            except OSError:
                continue
    return found


def _folder_bytes(folder: Path) -> int:
    """Bytes that the files of a folder take on the disk."""
    total = 0
    for parent, _, names in os.walk(folder):
        for name in names:
            try:
                total += 512 * os.stat(os.path.join(parent, name)).st_blocks
            except OSError:
                continue
    return total


def _cpu_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measure(command: list[str], cores: int, output: Path, scratch: Path) -> Used:
    """Run a command on so many cores; SystemExit if it fails."""
    used = Used()
    mine = sorted(os.sched_getaffinity(0))[:cores]
    before, began = _cpu_seconds(), time.perf_counter()
    looked = began
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(
            command,
            stderr=said,
            stdout=subprocess.DEVNULL,
            preexec_fn=lambda: os.sched_setaffinity(0, mine),
        )
        while process.poll() is None:
            try:
                process.wait(timeout=_BETWEEN_LOOKS_S)
            except subprocess.TimeoutExpired:
                used.look(process.pid)
                if time.perf_counter() - looked > _BETWEEN_SCRATCH_LOOKS_S:
                    looked = time.perf_counter()
                    used.scratch_bytes = max(used.scratch_bytes, _folder_bytes(scratch))
        used.seconds = time.perf_counter() - began
        used.cpu_seconds = _cpu_seconds() - before
        said.seek(0)
        if process.returncode:
            lines = said.read().decode(errors="replace")
            raise SystemExit(f"{' '.join(command)}: exit status {process.returncode}\n{lines}")
    with output.open("rb") as file:
        used.digest = hashlib.file_digest(file, "sha256").hexdigest()
    output.unlink()
    return used


def _row(n: int, name: str, cores: int, used: Used, whole: Used | None) -> str:
    millions = n / 1e6
    same = "" if whole is None else "same" if whole.digest == used.digest else "DIFFERENT"
    return (
        f"| {n:,} | {name} | {cores} | {used.seconds / millions:.2f} "
        f"| {used.cpu_seconds / millions:.2f} | {used.resident_bytes / _MIB:,.0f} "
        f"| {used.shared_bytes / _MIB:,.0f} | {used.private_bytes / _MIB:,.0f} "
        f"| {used.scratch_bytes / n:.0f} | {same} |"
    )


def _compare(tiles: dict[tuple[int, int], Used], whole: dict[tuple[int, int], Used]) -> list[str]:
    """Sentences about the runs, which are known by vertices and cores."""
    lines = []
    for n, cores in tiles:
        there = [size for size, its_cores in whole if its_cores == cores]
        if there:
            base = whole[max(there), cores].cpu_seconds / max(there)
            ratio = tiles[n, cores].cpu_seconds / n / base
            lines.append(
                f"- {n:,} by tiles, {cores} core(s): {ratio:.2f} times the processor seconds per "
                f"vertex of {max(there):,} in memory"
            )
    for n, cores in tiles:
        if cores > 1 and (n, 1) in tiles:
            ratio = tiles[n, 1].seconds / tiles[n, cores].seconds
            lines.append(f"- {n:,} by tiles: {cores} cores are {ratio:.2f} times as fast as one")
    for cores in sorted({cores for _, cores in tiles}):
        sizes = sorted(n for n, its_cores in tiles if its_cores == cores)
        if len(sizes) > 1:
            first, last = (tiles[n, cores].shared_bytes for n in (sizes[-2], sizes[-1]))
            lines.append(
                f"- memory on {cores} core(s), {sizes[-1]:,} to {sizes[-2]:,}: {last / first:.2f}"
            )
    return lines


def main(words: list[str] | None = None) -> None:
    """Print the table and the ratios."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--millions", type=float, nargs="+", default=[1.0, 3.0, 10.0])
    parser.add_argument("--whole", type=float, default=10.0, help="millions, the most in memory")
    parser.add_argument("--cores", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--order", choices=giant_mesh.ORDERS, default="rows")
    parser.add_argument("--suffix", choices=(".ply", ".stl"), default=".ply")
    parser.add_argument("--folder", type=Path, help="where meshes and scratch files are")
    parser.add_argument("options", nargs="*", help="of msal denoise")
    arguments = parser.parse_args(words)
    options = arguments.options or ["--method", "msal"]
    print(machine.line())
    print(f"\n`msal denoise {' '.join(options)}`, {arguments.order}, {arguments.suffix}\n")
    print(
        "| vertices | run | cores | s per million | processor s per million | resident MiB "
        "| proportional MiB | private MiB | scratch bytes per vertex | output |"
    )
    print("|--:|---|--:|--:|--:|--:|--:|--:|--:|---|", flush=True)
    whole: dict[tuple[int, int], Used] = {}
    tiles: dict[tuple[int, int], Used] = {}
    if arguments.folder is not None:
        arguments.folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
        folder = Path(name)
        source, output = folder / f"giant{arguments.suffix}", folder / f"out{arguments.suffix}"
        scratch = folder / "scratch"
        base = [sys.executable, "-m", "msal_cli", "denoise", str(source), "-o", str(output), "-q"]
        by_tiles = ["--tiled", "--scratch", str(scratch)]
        for millions in arguments.millions:
            mesh = giant_mesh.of_millions(millions, arguments.order)
            mesh.write(source)
            n = mesh.n_vertices
            for cores in arguments.cores:
                jobs = [*options, "--jobs", str(cores)]
                if millions <= arguments.whole:
                    whole[n, cores] = measure([*base, *jobs], cores, output, scratch)
                    print(_row(n, "memory", cores, whole[n, cores], None), flush=True)
                scratch.mkdir()
                tiles[n, cores] = measure([*base, *by_tiles, *jobs], cores, output, scratch)
                shutil.rmtree(scratch)
                other = whole.get((n, cores))
                print(_row(n, "tiles", cores, tiles[n, cores], other), flush=True)
    print()
    for line in _compare(tiles, whole):
        print(line)


if __name__ == "__main__":
    main()
