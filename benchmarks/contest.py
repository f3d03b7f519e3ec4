"""msal and its peers on one file, in turn, and the tables that tell how it went."""

from __future__ import annotations

import argparse
import math
import os
import statistics
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks import machine, measured, peers
from benchmarks.scans import FORMS, Scan

# A contestant this many times slower than the best peer after two runs is not run again.
_PATIENCE = 3.0


@dataclass
class Contestant:
    """Someone who can denoise a file; ``command`` gets the source and the target."""

    title: str
    command: Callable[[Path, Path], list[str]]
    is_peer: bool = True
    is_binary_only: bool = False
    is_by_hand: bool = False


@dataclass
class Row:
    """How a contestant did on one file.

    fault : why it did not do it; empty if it did.
    output : how its output compares with the input, in words.
    """

    contestant: Contestant
    runs: list[measured.Ran] = field(default_factory=list)
    fault: str = ""
    output: str = ""

    @property
    def seconds(self) -> float:
        """The median."""
        return statistics.median(run.seconds for run in self.runs)

    @property
    def cpu_seconds(self) -> float:
        """The median of processor time, which tells more where the machine has other work."""
        return statistics.median(run.cpu_seconds for run in self.runs)

    @property
    def peak_bytes(self) -> int:
        """The greatest of all runs."""
        return max(run.peak_bytes for run in self.runs)


def msal() -> Contestant:
    """The command with the paper's MSAL, under the Python that runs the benchmark."""

    def command(source: Path, target: Path) -> list[str]:
        words = ["denoise", str(source), "-o", str(target), "--method", "msal"]
        return [sys.executable, "-m", "msal_cli", *words]

    return Contestant("**msal**", command, is_peer=False)


def contestants(python: str, only: list[str] | None) -> tuple[list[Contestant], str]:
    """msal and the peers that ``python`` has, and a line on the peers' versions."""
    found, versions = peers.installed(python, only)

    def contestant(peer: peers.Peer) -> Contestant:
        return Contestant(
            peer.title,
            lambda source, target: peer.command(python, source, target),
            is_binary_only=peer.is_binary_only,
            is_by_hand=peer.is_by_hand,
        )

    return [msal(), *(contestant(peer) for peer in found)], versions


def contest(
    entered: list[Contestant], source: Path, target: Path, repeats: int, is_pinned: bool
) -> list[Row]:
    """Everyone on ``source`` in turn, ``repeats`` times, after one run that does not count.

    The input is in the page cache.  Before each run what others wrote is brought to the disk, so
    that nobody waits for another's bytes.
    """
    rows = [Row(one) for one in entered]
    for turn in range(-1, repeats):
        for row in rows:
            if row.fault or (turn > 1 and _is_hopeless(row, rows)):
                continue
            target.unlink(missing_ok=True)
            source.read_bytes()
            if hasattr(os, "sync"):
                os.sync()
            ran = measured.run(row.contestant.command(source, target), is_pinned)
            row.fault = ran.fault
            if not ran.fault and not target.exists():
                row.fault = "no output"
            if row.fault:
                continue
            if turn < 0:
                row.output = compared(source, target)
                if row.contestant.is_binary_only and is_ascii_ply(source):
                    row.output += ", as binary"
                continue
            row.runs.append(ran)
    target.unlink(missing_ok=True)
    return rows


def _is_hopeless(row: Row, rows: list[Row]) -> bool:
    best = best_peer([one for one in rows if one.runs])
    return row.contestant.is_peer and best is not None and row.seconds > _PATIENCE * best.seconds


def best_peer(rows: list[Row]) -> Row | None:
    """The fastest peer that did the job; one that is no tool only if there is no other."""
    done = [row for row in rows if row.contestant.is_peer and not row.fault]
    tools = [row for row in done if not row.contestant.is_by_hand]
    return min(tools or done, key=lambda row: row.seconds, default=None)


def compared(source: Path, target: Path) -> str:
    """How an output compares with its input: counts that differ, and how far vertices moved."""
    from msal_cli import codecs
    from msal_cli.errors import MsalError

    before = codecs.open_mesh(source.read_bytes(), source.name)
    try:
        after = codecs.open_mesh(target.read_bytes(), target.name)
    except MsalError as error:
        return f"not a mesh: {error}"
    if len(after.faces) != len(before.faces):
        return f"{len(after.faces):,} faces"
    if len(after.vertices) != len(before.vertices):
        return f"{len(after.vertices):,} vertices"
    some = before.faces[:: max(1, len(before.faces) // 100_000)]
    edge = np.linalg.norm(before.vertices[some[:, 1]] - before.vertices[some[:, 0]], axis=1).mean()
    moves = np.linalg.norm(after.vertices - before.vertices, axis=1).mean() / edge
    return f"moved {moves:.3f}" if moves < 2.0 else "in another order"


def three_digits(seconds: float) -> str:
    """Seconds as a table shows them."""
    return f"{seconds:.{max(0, 2 - math.floor(math.log10(seconds)))}f}"


def is_ascii_ply(path: Path) -> bool:
    """Whether a file is a PLY of text."""
    with path.open("rb") as stream:
        return stream.read(16) == b"ply\nformat ascii"


def table(rows: list[Row], scan: Scan) -> str:
    """The table of one file, in Markdown; times are of whole processes."""
    best = best_peer(rows)
    lines = [
        "| tool | seconds | least | CPU | peak MB | to best peer | peak / arrays | output | runs |",
        "|---|--:|--:|--:|--:|--:|--:|---|--:|",
    ]
    for row in rows:
        title = row.contestant.title
        if row.fault:
            lines.append(f"| {title} | | | | | | | {row.fault} | |")
            continue
        least = three_digits(min(run.seconds for run in row.runs))
        cpu = three_digits(row.cpu_seconds)
        ratio = f"{row.seconds / best.seconds:.2f}" if best else ""
        arrays = f"{row.peak_bytes / scan.array_bytes:.1f}"
        lines.append(
            f"| {title} | {three_digits(row.seconds)} | {least} | {cpu} | "
            f"{row.peak_bytes / 1e6:.0f} | {ratio} | {arrays} | {row.output} | {len(row.runs)} |"
        )
    return "\n".join(lines)


def summary(results: list[tuple[str, str, list[Row], Scan]]) -> str:
    """One line per file and cores: msal beside the best peer."""
    lines = [
        "| file | cores | msal s | best peer s | ratio | CPU ratio | msal MB | peer MB "
        "| msal MB / arrays |",
        "|---|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for title, cores, rows, scan in results:
        ours = next(row for row in rows if not row.contestant.is_peer)
        best = best_peer(rows)
        if ours.fault or best is None:
            lines.append(
                f"| {title} | {cores} | {ours.fault or three_digits(ours.seconds)} | | | | | | |"
            )
            continue
        lines.append(
            f"| {title} | {cores} | {three_digits(ours.seconds)} | "
            f"{three_digits(best.seconds)} ({best.contestant.title}) | "
            f"**{ours.seconds / best.seconds:.2f}** | {ours.cpu_seconds / best.cpu_seconds:.2f} | "
            f"{ours.peak_bytes / 1e6:.0f} | "
            f"{best.peak_bytes / 1e6:.0f} | {ours.peak_bytes / scan.array_bytes:.1f} |"
        )
    return "\n".join(lines)


def add_peers_options(parser: argparse.ArgumentParser) -> None:
    """Who takes part."""
    parser.add_argument(
        "--peers-python",
        default=peers.default_python(),
        help="Python that has the peers [default: MSAL_PEERS_PYTHON in the environment, or this]",
    )
    parser.add_argument(
        "--peers", nargs="*", choices=[peer.script for peer in peers.PEERS], help="only these peers"
    )


def add_options(parser: argparse.ArgumentParser, repeats: int, forms: tuple[str, ...]) -> None:
    """The options that contests share."""
    add_peers_options(parser)
    parser.add_argument("--repeats", type=int, default=repeats)
    parser.add_argument("--forms", nargs="*", choices=list(FORMS), default=list(forms))
    parser.add_argument("--cores", choices=["one", "all", "both"], default="both")
    parser.add_argument("--folder", type=Path, help="where meshes are kept for the next run")


def hold(arguments: argparse.Namespace, folder: Path, sources: dict[str, Path], scan: Scan) -> None:
    """All contests on the files of one mesh, one table each, and their summary."""
    entered, versions = contestants(arguments.peers_python, arguments.peers)
    print(f"{machine.line()}\nPeers: {versions}.\n")
    cores = {"both": [True, False]}.get(arguments.cores, [arguments.cores == "one"])
    results = []
    for form, source in sources.items():
        for is_pinned in cores:
            word = "one" if is_pinned else f"all {machine.n_cores()}"
            title = FORMS[form].title
            target = folder / f"out{source.suffix}"
            rows = contest(entered, source, target, arguments.repeats, is_pinned)
            size = source.stat().st_size
            print(
                f"{title}, {size / 1e6:.1f} MB, cores: {word}\n\n{table(rows, scan)}\n", flush=True
            )
            results.append((title, word, rows, scan))
    print(summary(results))
