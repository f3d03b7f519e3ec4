"""A folder of scans, beside the other tools' own loops over it.

    python -m benchmarks.batch [--files 1000] [--peers-python PATH] [--repeats 3]
        [--folder FOLDER] [--peers NAME ...] [--sample 40]

The scans have 5,000 to 50,000 vertices: tori, knots, vases and open reliefs with noise of 0.1 to
0.3 mean edge lengths, a third each as binary PLY, OBJ and binary STL, all by seed.  Measured are,
each with all cores to itself:

- ``msal denoise FOLDER -o OUT``, with as many jobs as it takes by itself, and what it holds in
  memory in the first and in the last quarter of the run;
- every peer's own loop over the folder in one process.  Peers over 2 times slower than the best on
  the first tenth of the files are judged by that tenth;
- every peer with one process per file, one after another, on a sample, scaled to all files.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import contest, machine, measured, peers, scans
from benchmarks.watched import Watched, watched

_FORMS = ("ply", "obj", "stl")
_LEAST, _MOST = 5_000, 50_000
# Vertices along one side of the grid for each along the other, so that edges are of one length.
_SHAPES = {"torus": 2.0, "knot": 8.0, "vase": 1.0, "relief": 2.0}
_PATIENCE = 2.0


def make_scans(folder: Path, count: int, most: int) -> int:
    """Make those of ``count`` files that are missing; the number of vertices of all."""
    random = np.random.default_rng(7)
    n_vertices = 0
    for n in range(count):
        shape = list(_SHAPES)[int(random.integers(len(_SHAPES)))]
        wanted = int(random.integers(min(_LEAST, most // 2), most))
        noise = float(random.uniform(0.1, 0.3))
        across = max(4, round((wanted / _SHAPES[shape]) ** 0.5))
        around = max(4, wanted // across)
        n_vertices += around * across
        scans.file_of(
            folder,
            f"{n:04}-{shape}",
            _FORMS[n % len(_FORMS)],
            lambda given=(shape, around, across, noise, n): scans.scan(*given),
        )
    return n_vertices


def linked(folder: Path, files: list[Path]) -> Path:
    """A new folder with links to some files."""
    folder.mkdir()
    for path in files:
        os.link(path, folder / path.name)
    return folder


def ready(source: Path, target: Path) -> None:
    """Empty the target, bring what others wrote to the disk, and the input into memory."""
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir()
    if hasattr(os, "sync"):
        os.sync()
    for path in source.iterdir():
        path.read_bytes()


def missing(source: Path, target: Path) -> str:
    """How many files a tool did not write; empty if it wrote all."""
    n = len({path.name for path in source.iterdir()} - {path.name for path in target.iterdir()})
    return f"{n} files missing" if n else ""


@dataclass(frozen=True)
class Took:
    """What one way to do a folder took.

    n_files : on how many files it was measured.
    fault : why it was not done; empty if it was.
    """

    title: str
    seconds: float
    cpu_seconds: float
    n_files: int
    peak_bytes: int = 0
    fault: str = ""

    def scaled(self, n_files: int) -> float:
        """Seconds for so many files, by proportion."""
        return self.seconds * n_files / self.n_files


def by_msal(source: Path, target: Path) -> Watched:
    """One run of the command over the folder."""
    ready(source, target)
    command = [sys.executable, "-m", "msal_cli", "denoise", str(source), "-o", str(target)]
    command += ["--method", "msal"]
    run = watched(command)
    fault = run.fault or missing(source, target)
    if fault:
        sys.exit(f"msal: {fault}")
    return run


def looped(peer: peers.Peer, python: str, source: Path, target: Path) -> Took:
    """One run of a peer's own loop over the folder."""
    ready(source, target)
    ran = measured.run(peer.folder_command(python, source, target), is_pinned=False)
    fault = ran.fault or missing(source, target)
    n_files = len(list(source.iterdir()))
    return Took(peer.title, ran.seconds, ran.cpu_seconds, n_files, ran.peak_bytes, fault)


def one_by_one(peer: peers.Peer, python: str, source: Path, target: Path) -> Took:
    """A process of the peer for every file, one after another."""
    ready(source, target)
    seconds, cpu_seconds, peak_bytes, fault = 0.0, 0.0, 0, ""
    files = sorted(source.iterdir())
    for path in files:
        ran = measured.run(peer.command(python, path, target / path.name), is_pinned=False)
        seconds += ran.seconds
        cpu_seconds += ran.cpu_seconds
        peak_bytes = max(peak_bytes, ran.peak_bytes)
        fault = fault or ran.fault
    fault = fault or missing(source, target)
    title = f"{peer.title}, a process per file"
    return Took(title, seconds, cpu_seconds, len(files), peak_bytes, fault)


def table(runs: list[Watched], others: list[Took], n_files: int) -> str:
    """msal and the others, in Markdown."""
    ours = statistics.median(run.seconds for run in runs)
    cpu_ms = 1000 * statistics.median(run.cpu_seconds for run in runs) / n_files
    most = max(sum(run.most(0.0, 1.0)) for run in runs)
    lines = [
        "| way | seconds | times msal | CPU ms a file | peak MB | measured on |",
        "|---|--:|--:|--:|--:|--:|",
        f"| **msal** | {ours:.1f} | 1.0 | {cpu_ms:.0f} | {most / 1e6:.0f} | {n_files} files |",
    ]
    for other in others:
        if other.fault:
            lines.append(f"| {other.title} | | | | | {other.fault} |")
            continue
        seconds = other.scaled(n_files)
        cpu_ms = 1000 * other.cpu_seconds / other.n_files
        lines.append(
            f"| {other.title} | {seconds:.1f} | {seconds / ours:.1f} | {cpu_ms:.0f} | "
            f"{other.peak_bytes / 1e6:.0f} | {other.n_files} files |"
        )
    return "\n".join(lines)


def memory_table(run: Watched) -> str:
    """What the parent and its largest worker held, by quarters of the run."""
    lines = ["| part of the run | parent MB | largest worker MB |", "|---|--:|--:|"]
    for title, begin in (("first quarter", 0.0), ("last quarter", 0.75)):
        parent, worker = run.most(begin, begin + 0.25)
        lines.append(f"| {title} | {parent / 1e6:.0f} | {worker / 1e6:.0f} |")
    return "\n".join(lines)


def main(words: list[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    contest.add_peers_options(parser)
    parser.add_argument("--files", type=int, default=1000)
    parser.add_argument("--most", type=int, default=_MOST, help="vertices of the largest scans")
    parser.add_argument("--repeats", type=int, default=3, help="runs of msal")
    parser.add_argument("--sample", type=int, default=40, help="files of a process each")
    parser.add_argument("--folder", type=Path, help="where scans are kept for the next run")
    arguments = parser.parse_args(words)
    python = arguments.peers_python
    entered, versions = peers.installed(python, arguments.peers)
    if arguments.folder:
        arguments.folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=arguments.folder) as scratch:
        work = Path(scratch)
        source = (arguments.folder or work) / f"scans-{arguments.files}-{arguments.most}"
        n_vertices = make_scans(source, arguments.files, arguments.most)
        files = sorted(source.iterdir())
        size = sum(path.stat().st_size for path in files)
        print(f"{machine.line()}\nPeers: {versions}.")
        print(f"{len(files)} scans, {n_vertices:,} vertices, {size / 1e6:.0f} MB.\n", flush=True)
        target = work / "out"
        tenth = linked(work / "tenth", files[: max(3, len(files) // 10)])
        by_msal(tenth, target)  # compiles what is missing
        runs = [by_msal(source, target) for _ in range(arguments.repeats)]
        short = [looped(peer, python, tenth, target) for peer in entered]
        rivals = [
            took.seconds
            for peer, took in zip(entered, short, strict=True)
            if not (took.fault or peer.is_by_hand)
        ]
        best = min(rivals, default=float("inf"))
        others = [
            took
            if took.fault or took.seconds > _PATIENCE * best
            else looped(peer, python, source, target)
            for peer, took in zip(entered, short, strict=True)
        ]
        sample = linked(work / "sample", files[: arguments.sample])
        others += [one_by_one(peer, python, sample, target) for peer in entered]
        print(table(runs, others, len(files)), end="\n\n")
        print(memory_table(min(runs, key=lambda run: run.seconds)))


if __name__ == "__main__":
    main()
