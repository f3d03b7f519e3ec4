"""A command with workers, and what it and they hold in memory while it runs.

The system must tell about processes in ``/proc``; elsewhere the memory is 0.
"""

from __future__ import annotations

import os
import resource
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

_BETWEEN_LOOKS_S = 0.2


@dataclass(frozen=True)
class Look:
    """What is held at one moment.

    seconds : since the start of the command.
    parent_bytes : resident memory of the process itself.
    workers_bytes : resident memory of each of its children.
    """

    seconds: float
    parent_bytes: int
    workers_bytes: list[int]


@dataclass(frozen=True)
class Watched:
    """One run.

    seconds : wall-clock time from start to end.
    cpu_seconds : processor time of the command and its workers.
    looks : in the order of time.
    fault : exit status and last line, where the command failed.
    """

    seconds: float
    cpu_seconds: float
    looks: list[Look]
    fault: str

    def most(self, begin: float, end: float) -> tuple[int, int]:
        """The most that the parent held, and that one worker held, between two parts of the run."""
        some = [
            look
            for look in self.looks
            if begin * self.seconds <= look.seconds <= end * self.seconds
        ]
        return (
            max((look.parent_bytes for look in some), default=0),
            max((held for look in some for held in look.workers_bytes), default=0),
        )


def watched(command: list[str]) -> Watched:
    """Run a command on all cores and look at its memory five times a second."""
    looks = []
    before = _cpu_seconds()
    began = time.perf_counter()
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(command, stderr=said, stdout=subprocess.DEVNULL)
        while process.poll() is None:
            try:
                process.wait(timeout=_BETWEEN_LOOKS_S)
            except subprocess.TimeoutExpired:
                workers = [held for held in map(_resident_bytes, _children(process.pid)) if held]
                at = time.perf_counter() - began
                looks.append(Look(at, _resident_bytes(process.pid), workers))
        seconds = time.perf_counter() - began
        said.seek(0)
        lines = said.read().decode(errors="replace").strip().splitlines()
    last = lines[-1][:80] if lines else ""
    fault = f"exit status {process.returncode}: {last}" if process.returncode else ""
    return Watched(seconds, _cpu_seconds() - before, looks, fault)


def _cpu_seconds() -> float:
    """Processor time of all children so far, and of theirs, that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _resident_bytes(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def _children(pid: int) -> list[int]:
    found: list[int] = []
    for listing in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            found += map(int, listing.read_text().split())
        except OSError:
            continue
    return found
