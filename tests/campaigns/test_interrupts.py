"""Signals at random moments of whole runs, also while they start, plan, resume and report.

python -m pytest tests/campaigns/test_interrupts.py -m slow -s
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
    contents,
    ended,
    moment,
    orphans_of,
    scans_in,
    started,
    wait_until,
    whole_run,
)

pytestmark = pytest.mark.skipif(not IS_LINUX, reason="finds processes by /proc")

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def is_listening(process):
    """Whether msal has taken its signals; while Python itself starts, Ctrl-C is its own affair."""
    try:
        text = Path(f"/proc/{process.pid}/status").read_text()
    except OSError:
        return False
    caught = int(re.search(r"SigCgt:\s+(\w+)", text)[1], 16)
    return bool(caught >> (signal.SIGTERM - 1) & 1)


def interrupted(words, number, wait, *, twice):
    """Send a signal at a moment: the status as a shell gives it, seconds, and what was said."""
    with started(words) as process:
        wait_until(lambda: is_listening(process), process)
        wait(process)
        process.send_signal(number)
        began = time.monotonic()
        if twice:
            time.sleep(0.01)
            process.send_signal(number)
        said = process.communicate(timeout=60)[1].decode(errors="replace")
        seconds = time.monotonic() - began
    left = orphans_of(process.pid)
    assert not left, left
    status = process.returncode
    return (128 - status if status < 0 else status), seconds, said


def check(status, number, said):
    assert status in (128 + number, STATUS), (status, said)
    assert "Traceback" not in said and "Exception" not in said, said


def test_a_signal_at_the_start_in_the_middle_and_twice(tmp_path):
    scans = scans_in(tmp_path / "in", 4)
    words = [*command(scans, tmp_path / "out", "-j", 1), "--report", tmp_path / "r.json"]
    for number, pause, twice in zip(SIGNALS, (0.0, 0.2, 0.7), (False, False, True), strict=True):
        status, _, said = interrupted(
            words, number, lambda process, pause=pause: time.sleep(pause), twice=twice
        )
        check(status, number, said)
    assert ended(words)[0] == STATUS
    assert sorted(name for name in contents(tmp_path / "out") if "tmp" in name) == []


@pytest.mark.slow
def test_fifty_signals_cost_nothing(tmp_path):
    count = int(os.environ.get("MSAL_INTERRUPTS", "50"))
    scans = scans_in(tmp_path / "in")
    whole = whole_run(scans, tmp_path / "whole", "-j", 2)
    choice = random.Random(3)
    output, report = tmp_path / "out", tmp_path / "reports" / "r.json"
    slowest, met = 0.0, collections.Counter()
    for n in range(count):
        number = SIGNALS[n % 3]
        # Every third run goes on from the one before.
        if n % 3 == 0:
            shutil.rmtree(output, ignore_errors=True)
        words = [*command(scans, output, "-j", 2), "--report", str(report)]
        if n % 5 == 4:
            words = [*command(scans, output, "-j", 2), "--fresh", "--report", str(report)]
        status, seconds, said = interrupted(
            words, number, moment(choice, whole, output), twice=n % 4 == 3
        )
        check(status, number, said)
        met[status] += 1
        slowest = max(slowest, seconds)
        assert whole.faults(output) == [], n
        if n % 3 == 2:
            status, _, said = ended([*command(scans, output), "--report", str(report)])
            assert (status, whole.last_faults(output)) == (STATUS, []), said
            # Only a second signal may leave a temporary file beside the report.
            left = [one for one in report.parent.iterdir() if one != report]
            assert len(left) <= met["twice"], left
        met["twice"] += n % 4 == 3
    print(f"\n{count} signals: {dict(met)}; the slowest end took {slowest:.2f} s")
    assert slowest < 2.0 or os.getloadavg()[0] > 2 * (os.cpu_count() or 1)
