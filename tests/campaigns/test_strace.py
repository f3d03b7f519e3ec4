"""The system itself refuses or kills at the k-th call of each kind, for every k (needs strace).

    python -m pytest tests/campaigns/test_strace.py -m slow -s

The calls are those of the process that have to do with the output folder: strace lists them in an
unbroken run first.
"""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest

from msal_cli.batch.temporary_files import is_own
from tests.campaigns.runs import IS_LINUX, Whole, contents, ended
from tests.cli.scans import MSAL, closed_scan, folder_of

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not IS_LINUX or not shutil.which("strace"), reason="no strace"),
]

CALLS = "openat,write,fsync,close,rename,chmod,mkdir,unlink,ftruncate"
ERRORS = ("EIO", "ENOSPC", "EACCES")


def traced(words, log, *options):
    """Run a command under strace; its status and what it said.

    With ``--seccomp-bpf`` that is faster, but signals are not delivered.
    """
    process = subprocess.run(
        ["strace", "-fy", "-o", log, "-e", f"trace={CALLS}", *options, *words],
        capture_output=True,
        check=False,
        timeout=300,
    )
    return process.returncode, process.stderr.decode(errors="replace")


def calls_of(log, folder):
    """Name and number of every call that has to do with ``folder``, of the process that begins."""
    counts, found, main = {}, [], None
    for line in log.read_text(errors="replace").splitlines():
        called = re.match(r"(\d+) +(\w+)\(", line)
        if not called:
            continue
        main = main or called[1]
        if called[1] == main:
            name = called[2]
            counts[name] = counts.get(name, 0) + 1
            if folder in line:
                found.append((name, counts[name]))
    return found


def cases(tmp_path):
    """The command, its output folder, what it writes, and the calls for that."""
    scans = folder_of(tmp_path / "in", a=closed_scan())
    output = tmp_path / "out"
    words = [*MSAL, "denoise", str(scans), "-o", str(output), "-q"]
    assert ended(words)[0] == 0
    whole = Whole(contents(output), 0.0, 1)
    shutil.rmtree(output)
    traced(words, tmp_path / "log")
    return words, output, whole, calls_of(tmp_path / "log", str(output))


def test_every_call_is_refused(tmp_path):
    words, output, whole, calls = cases(tmp_path)
    # Older outputs, from another setting, are in the place of the new ones every second time.
    assert ended([*words, "-n", "1"])[0] == 0
    shutil.copytree(output, tmp_path / "earlier")
    old = contents(output)["a.ply"]
    n_runs, statuses = 0, {}
    for name, at in calls:
        error = ERRORS[n_runs % len(ERRORS)]
        shutil.rmtree(output)
        if n_runs % 2:
            shutil.copytree(tmp_path / "earlier", output)
        inject = f"inject={name}:error={error}:when={at}"
        status, said = traced(words, tmp_path / "log", "--seccomp-bpf", "-e", inject)
        what = (inject, status, said)
        assert status in (0, 1, 2, 3), what
        if "ImportError" in said or "ModuleNotFoundError" in said:
            # Python reads modules between our calls, and not always as many.
            continue
        assert "Traceback" not in said and "nternal error" not in said, what
        present = contents(output) if output.exists() else {}
        assert present.get("a.ply") in (None, old, whole.files["a.ply"]), what
        if n_runs % 2:
            assert present.get("a.ply") is not None, what
        if status == 0:
            assert present["a.ply"] == whole.files["a.ply"], what
        elif status in (1, 3):
            assert "(E_" in said, what
        left = [one for one in present if is_own(one)]
        assert not left or name == "unlink", what
        assert ended(words)[0] == 0, what
        assert whole.last_faults(output) == [], what
        n_runs += 1
        statuses[status] = statuses.get(status, 0) + 1
    print(f"\n{n_runs} calls refused, statuses {statuses}")
    assert n_runs > 25


def test_the_process_is_killed_at_every_call(tmp_path):
    words, output, whole, calls = cases(tmp_path)
    n_runs = n_killed = n_left = 0
    for name, at in calls:
        shutil.rmtree(output, ignore_errors=True)
        status, said = traced(words, tmp_path / "log", "-e", f"inject={name}:signal=KILL:when={at}")
        what = (name, at, status, said)
        assert status in (-9, 137, 0), what
        assert whole.faults(output) == [], what
        present = contents(output) if output.exists() else {}
        n_killed += status != 0
        n_left += any(is_own(one) for one in present)
        assert ended(words)[0] == 0, what
        assert whole.last_faults(output) == [], what
        n_runs += 1
    print(
        f"\n{n_killed} kills at {n_runs} calls; {n_left} left a temporary file, and all were swept"
    )
    assert n_killed > 25 and n_left > 0
