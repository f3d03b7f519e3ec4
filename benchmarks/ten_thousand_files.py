"""Ten thousand tiny meshes: how long they take to be found, done, and found up to date.

    python benchmarks/ten_thousand_files.py [--files 10000] [--jobs 2] [--folder FOLDER]

The command itself runs, as a user would run it.  Printed are the seconds until a dry run has
listed all files, files a second of the first run, the peak memory of the parent (its workers
aside), the seconds of a second run that has nothing to do, and of a third after 7 files changed.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

N_CHANGED = 7


def tiny_scan(seed: int) -> bytes:
    """A noisy patch of 5 x 4 vertices as ASCII PLY."""
    y, x = np.divmod(np.arange(20), 4)
    z = np.random.default_rng(seed).uniform(-0.1, 0.1, 20)
    corners = [4 * row + column for row in range(4) for column in range(3)]
    faces = [f"3 {at} {at + 1} {at + 5}\n3 {at} {at + 5} {at + 4}" for at in corners]
    lines = [f"{a} {b} {c:.6f}" for a, b, c in zip(x, y, z, strict=True)]
    header = (
        "ply\nformat ascii 1.0\nelement vertex 20\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {2 * len(faces)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    return (header + "\n".join([*lines, *faces]) + "\n").encode()


def make_scans(folder: Path, count: int) -> list[Path]:
    """``count`` files, a hundred in a folder."""
    paths = []
    for n in range(count):
        path = folder / f"{n // 100:04}" / f"{n:06}.ply"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(tiny_scan(n))
        paths.append(path)
    return paths


class Ran:
    """One run of the command: seconds, peak memory of the parent, and files by status."""

    def __init__(self, *words: str) -> None:
        command = [sys.executable, "-m", "msal_cli", "denoise", *words]
        began = time.perf_counter()
        with tempfile.TemporaryFile() as said:
            process = subprocess.Popen(command, stderr=said)
            self.peak_bytes = 0
            while process.poll() is None:
                self.peak_bytes = max(self.peak_bytes, peak_bytes_of(process.pid))
                time.sleep(0.02)
            self.seconds = time.perf_counter() - began
            said.seek(0)
            last = said.read().decode().splitlines()[-1]
        if process.returncode:
            sys.exit(f"exit status {process.returncode}: {last}")
        counts = re.findall(r"([\d,]+) (written|up to date)", last)
        self.files = {word: int(number.replace(",", "")) for number, word in counts}


def peak_bytes_of(pid: int) -> int:
    """The most memory that a process has held so far; 0 where the system does not tell."""
    try:
        text = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0
    found = re.search(r"VmHWM:\s+(\d+) kB", text)
    return 1024 * int(found[1]) if found else 0


def discovery_seconds(folder: Path) -> float:
    """Seconds to find the files, without starting the program."""
    from msal_cli.batch.inputs import discover_inputs

    discover_inputs([str(folder)])
    began = time.perf_counter()
    discover_inputs([str(folder)])
    return time.perf_counter() - began


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--jobs", default="auto")
    parser.add_argument("--folder", type=Path, help="where to work, on the disk to be measured")
    arguments = parser.parse_args()
    work = Path(tempfile.mkdtemp(dir=arguments.folder))
    try:
        paths = make_scans(work / "in", arguments.files)
        words = [str(work / "in"), "-o", str(work / "out"), "-j", arguments.jobs]
        print(f"files                     {len(paths):,}")
        print(f"discovery                 {discovery_seconds(work / 'in'):.2f} s")
        first = Ran(*words)
        rate = len(paths) / first.seconds
        print(f"first run                 {first.seconds:.1f} s, {rate:.0f} files/s, {first.files}")
        second = Ran(*words)
        print(f"second run                {second.seconds:.2f} s, {second.files}")
        peaks = [round(one.peak_bytes / 1e6) for one in (first, second)]
        print(f"parent's peak memory      {peaks[0]} MB, {peaks[1]} MB in the second run")
        for path in paths[:: len(paths) // N_CHANGED][:N_CHANGED]:
            path.write_bytes(path.read_bytes().replace(b" 0.0", b" 0.1", 1))
        third = Ran(*words)
        print(f"after {N_CHANGED} files changed      {third.seconds:.2f} s, {third.files}")
        assert first.files == {"written": len(paths)}
        assert second.files == {"up to date": len(paths)}
        assert third.files == {"up to date": len(paths) - N_CHANGED, "written": N_CHANGED}
    finally:
        shutil.rmtree(work)


if __name__ == "__main__":
    main()
