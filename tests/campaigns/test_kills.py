"""Runs that are killed or get signals: nothing half-written, nothing lost, and the rest is done.

python -m pytest tests/campaigns/test_kills.py -m slow -s
"""

from __future__ import annotations

import collections
import os
import random
import re
import shutil
import signal
import time
from pathlib import Path

import pytest

from tests.campaigns.runs import (
    IS_LINUX,
    STATUS,
    command,
    ended,
    moment,
    orphans_of,
    scans_in,
    session_of,
    started,
    wait_until,
    whole_run,
)

pytestmark = [pytest.mark.skipif(not IS_LINUX, reason="finds processes by /proc"), pytest.mark.ci]

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    return scans_in(tmp_path_factory.mktemp("kills") / "in")


@pytest.fixture(scope="module")
def whole(scans):
    return whole_run(scans, scans.parent / "whole", "-j", 2)


def kill(process, with_workers):
    """Kill the parent alone, or it and everything that it has started."""
    for pid in sorted(session_of(process.pid)) if with_workers else [process.pid]:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue


@pytest.mark.parametrize("count", [2, pytest.param(1000, marks=pytest.mark.slow)])
def test_kills_cost_nothing(scans, whole, tmp_path, count):
    """In chains: a run is killed, the next goes on from there and is killed too, and after at most
    five kills a run goes on to the end.  A run that ends before its kill does not count."""
    choice, output = random.Random(5), tmp_path / "out"
    met = collections.Counter()
    while met["kills"] < count:
        shutil.rmtree(output, ignore_errors=True)
        words = command(scans, output, "-j", choice.choice([1, 1, 2]))
        for _ in range(choice.randint(1, 5)):
            wait = moment(choice, whole, output)
            with started(words) as process:
                wait(process)
                kill(process, with_workers=bool(met["kills"] % 2))
                process.communicate()
            if process.returncode != -signal.SIGKILL:
                break
            # A worker that is just starting notices late on a busy machine.
            left = orphans_of(process.pid, within_s=20.0)
            assert not left, f"{met}: the workers {left} live on"
            assert whole.faults(output) == [], met
            met["kills"] += 1
            met["a temporary left"] += any(output.rglob(".*.tmp"))
        status, _, said = ended(words)
        assert (status, whole.last_faults(output)) == (STATUS, []), (met, said)
        assert "Traceback" not in said
    print(f"\n{dict(met)}")


def is_listening(process):
    """Whether msal has taken its signals; while Python itself starts, Ctrl-C is its own affair."""
    try:
        text = Path(f"/proc/{process.pid}/status").read_text()
    except OSError:
        return False
    return bool(int(re.search(r"SigCgt:\s+(\w+)", text)[1], 16) >> (signal.SIGTERM - 1) & 1)


@pytest.mark.parametrize("count", [3, pytest.param(50, marks=pytest.mark.slow)])
def test_signals_cost_nothing(scans, whole, tmp_path, count):
    choice = random.Random(3)
    output, report = tmp_path / "out", tmp_path / "reports" / "r.json"
    slowest, met = 0.0, collections.Counter()
    for n in range(count):
        number = SIGNALS[n % 3]
        # Every third run goes on from the one before.
        if n % 3 == 0:
            shutil.rmtree(output, ignore_errors=True)
        words = command(scans, output, "-j", 2, "--report", report)
        wait = moment(choice, whole, output)
        with started(words) as process:
            wait_until(lambda process=process: is_listening(process), process)
            wait(process)
            process.send_signal(number)
            began = time.monotonic()
            if n % 4 == 3:
                time.sleep(0.01)
                process.send_signal(number)
            said = process.communicate(timeout=60)[1].decode(errors="replace")
            slowest = max(slowest, time.monotonic() - began)
        assert orphans_of(process.pid) == []
        status = abs(process.returncode) + 128 * (process.returncode < 0)
        assert status in (128 + number, STATUS), (status, said)
        assert "Traceback" not in said and "Exception" not in said, said
        met[status] += 1
        assert whole.faults(output) == [], n
        if n % 3 == 2:
            status, _, said = ended(words)
            assert (status, whole.last_faults(output)) == (STATUS, []), said
    print(f"\n{count} signals: {dict(met)}; the slowest end took {slowest:.2f} s")
    assert slowest < 2.0 or os.getloadavg()[0] > 2 * (os.cpu_count() or 1)
