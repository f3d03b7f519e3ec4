"""Batches in which workers are killed from outside: every file is written all the same.

python -m pytest tests/campaigns/test_worker_kills.py -m slow -s
"""

from __future__ import annotations

import json
import os
import random
import signal
import time

import pytest

from tests.campaigns.runs import (
    IS_LINUX,
    contents,
    ended,
    noted,
    orphans_of,
    session_of,
    started,
    wait_until,
)
from tests.cli.scans import MSAL, closed_scan, folder_of

pytestmark = pytest.mark.skipif(not IS_LINUX, reason="finds processes by /proc")

N_FILES, N_RUNS = 200, 20


@pytest.mark.slow
def test_twenty_runs_with_a_worker_killed_in_each(tmp_path):
    scans = folder_of(tmp_path / "in", **{f"{n:03}": closed_scan(n % 7) for n in range(N_FILES)})
    whole = tmp_path / "whole"
    assert ended([*MSAL, "denoise", str(scans), "-o", str(whole), "-q"])[0] == 0
    choice = random.Random(11)
    ways = [signal.SIGKILL, signal.SIGSEGV, signal.SIGSTOP]
    n_written, n_twice = [], 0
    for n in range(N_RUNS):
        output, report = tmp_path / f"out{n}", tmp_path / f"{n}.json"
        words = [*MSAL, "denoise", str(scans), "-o", str(output), "-j", "2", "-q"]
        # Longer than a file ever takes, also on a busy machine.
        words += ["--report", str(report), "--timeout", "20"]
        after = choice.randint(0, N_FILES - 20)
        with started(words) as process:
            wait_until(lambda out=output, least=after: len(noted(out)) >= least, process)
            victims: list[int] = []
            deadline = time.monotonic() + 10
            while not victims and time.monotonic() < deadline:
                victims = [pid for pid in session_of(process.pid) if pid != process.pid]
            os.kill(choice.choice(victims), ways[n % len(ways)])
            said = process.communicate(timeout=600)[1].decode()
        assert process.returncode == 0, said
        assert orphans_of(process.pid) == []
        records = json.loads(report.read_bytes())["records"]
        n_written.append(sum(record["status"] == "written" for record in records))
        n_twice += sum(bool(record["warnings"]) for record in records)
        assert contents(output) == contents(whole)
    print(f"\n{N_RUNS} runs, written: {n_written}; {n_twice} files needed a second try")
    assert min(n_written) >= N_FILES - 1
    assert n_twice > 0
