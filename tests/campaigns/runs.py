"""Whole runs of the real command over a small folder, accidents to them, and what must hold after.

The folder holds small meshes, one of them damaged, so that a run over it takes about a
second and ends with exit status 3.
"""

import gzip
import hashlib
import json
import random
import signal
import subprocess
import sys
import time
from dataclasses import dataclass

from msal_cli.batch.lock import NAME as LOCK
from msal_cli.batch.manifest import NAME as MANIFEST
from msal_cli.storage.atomic import is_own
from tests.batch.fakes import living_processes
from tests.cli.scans import BAD_SCAN, MSAL, ply_text
from tests.files import tree
from tests.shapes import noisy, torus

STATUS = 3
"""The exit status of an unbroken run over the folder."""


def scans_in(folder, count=24):
    """Fill ``folder`` with ``count`` small meshes, some of them packed, and a damaged one."""
    folder.mkdir(parents=True)
    for n in range(count):
        vertices, faces = torus(8 + n % 5, 6)
        data = ply_text(noisy(vertices, n, 0.05), faces)
        home = folder / ("", "a", "a/b")[n % 3]
        home.mkdir(parents=True, exist_ok=True)
        if n % 3 == 2:
            (home / f"{n}.ply.gz").write_bytes(gzip.compress(data, mtime=0))
        else:
            (home / f"{n}.ply").write_bytes(data)
    (folder / "a" / "damaged.ply").write_bytes(BAD_SCAN)
    return folder


def command(folder, output, *options):
    """The words of the command that denoises ``folder``."""
    return [*MSAL, "denoise", str(folder), "-o", str(output), "-q", *map(str, options)]


def started(words, **options):
    """The command in a session of its own, by which its workers are found."""
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options
    # Tests that run in the background have SIGINT ignored, and so would the child.
    return subprocess.Popen(
        words,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        **options,
    )


def ended(words, **options):
    """Run a command to its end: its status, and what it said to both streams."""
    with started(words, **options) as process:
        printed, said = process.communicate(timeout=300)
    return process.returncode, printed, said.decode(errors="replace")


def session_of(pid):
    """The living processes of the session that process ``pid`` began, itself included."""
    return [child for child, _, session in living_processes() if session == pid]


def orphans_of(pid, within_s=2.0):
    """What is still alive of a session after ``within_s`` seconds."""
    deadline = time.monotonic() + within_s
    while left := session_of(pid):
        if time.monotonic() > deadline:
            break
        time.sleep(0.01)
    return left


def contents(folder):
    """The files of an output folder by relative name, the manifest and the lock aside."""
    own = (MANIFEST, LOCK)
    every = tree(folder, has_own=True)
    return {name: data for name, data in every.items() if name.rpartition("/")[2] not in own}


def noted(folder):
    """The ``done`` entries of the manifest by name; torn lines are passed over."""
    found = {}
    try:
        lines = (folder / MANIFEST).read_bytes().split(b"\n")
    except FileNotFoundError:
        return found
    for line in lines:
        try:
            entry = json.loads(line)
        except ValueError:
            continue
        if entry.get("kind") == "done":
            found[entry["name"]] = entry
    return found


@dataclass(frozen=True)
class Whole:
    """What an unbroken run writes, and how long it takes."""

    files: dict[str, bytes]
    seconds: float
    n_done: int

    def faults(self, folder):
        """What is wrong with an output folder in the middle of a run that was broken."""
        present = contents(folder)
        found = [
            f"{name} is not whole"
            for name, data in present.items()
            if not is_own(name.rpartition("/")[2]) and data != self.files.get(name)
        ]
        for name, entry in noted(folder).items():
            digest = hashlib.sha256(present.get(name, b"")).hexdigest()
            if entry["status"] != "failed" and digest != entry["output"]["sha256"]:
                found.append(f"{name} is noted as done and is lost")
        return found

    def last_faults(self, folder):
        """What is wrong with the folder after a run that came to its end."""
        present = contents(folder)
        names = self.files.keys() | present.keys()
        found = [f"{name} differs" for name in names if present.get(name) != self.files.get(name)]
        return [*found, *(["the lock is left"] if (folder / LOCK).exists() else [])]


def whole_run(folder, output, *options):
    """Run the command unbroken."""
    words = command(folder, output, *options)
    began = time.monotonic()
    assert ended(words)[0] == STATUS
    return Whole(contents(output), time.monotonic() - began, len(noted(output)))


def wait_until(is_so, process, within_s=60.0):
    """Wait for ``is_so()`` or the end of the process."""
    deadline = time.monotonic() + within_s
    while not is_so() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.001)


def moment(choice: random.Random, whole, output):
    """A function that waits, given the process, for a random moment of its run: any, or shortly
    after a file was noted as done."""
    pause, count = choice.uniform(0.0, whole.seconds), 0
    if choice.random() < 0.5:
        pause, count = choice.uniform(0.0, 0.01), choice.randint(1, whole.n_done - 2)

    def wait(process):
        wait_until(lambda: len(noted(output)) >= count, process)
        deadline = time.monotonic() + pause
        wait_until(lambda: time.monotonic() > deadline, process)

    return wait


IS_LINUX = sys.platform.startswith("linux")
