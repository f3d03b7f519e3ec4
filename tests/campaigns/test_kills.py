"""Runs that are killed without warning: nothing half-written, nothing lost, and the rest is done.

python -m pytest tests/campaigns/test_kills.py -m slow -s
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import time

import pytest

from tests.campaigns.runs import (
    IS_LINUX,
    STATUS,
    Whole,
    command,
    contents,
    ended,
    moment,
    noted,
    orphans_of,
    scans_in,
    session_of,
    started,
    whole_run,
)

pytestmark = pytest.mark.skipif(not IS_LINUX, reason="finds processes by /proc")


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    return scans_in(tmp_path_factory.mktemp("kills") / "in")


@pytest.fixture(scope="module")
def whole(scans):
    return whole_run(scans, scans.parent / "whole", "-j", 2)


def kill(process, with_workers):
    """Kill the parent alone, or it and everything that it has started."""
    if not with_workers:
        process.kill()
        return
    for pid in sorted(session_of(process.pid)):
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue


def killed_runs(scans, whole, output, count, seed):
    """``count`` kills, in chains: a run is killed, the next goes on from there and is killed too,
    and after at most five kills one goes on to the end.

    A run that ends before its kill does not count.  Says what the kills met.
    """
    choice = random.Random(seed)
    met = {"kills": 0, "with the folder made": 0, "a temporary left": 0, "runs to the end": 0}
    slowest = 0.0
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
            began = time.monotonic()
            left = orphans_of(process.pid, within_s=20.0)
            assert not left, f"{met}: the workers {left} live on"
            slowest = max(slowest, time.monotonic() - began)
            assert whole.faults(output) == [], met
            met["kills"] += 1
            met["with the folder made"] += output.exists()
            met["a temporary left"] += any(output.rglob(".*.tmp"))
        status, _, said = ended(words)
        assert (status, whole.last_faults(output)) == (STATUS, []), (met, said)
        assert "Traceback" not in said
        met["runs to the end"] += 1
        if met["runs to the end"] % 20 == 0:
            print(met, flush=True)
    return met | {"seconds until the last worker is gone": round(slowest, 2)}


def test_some_kills_cost_nothing(scans, tmp_path):
    words = command(scans, tmp_path / "whole", "-j", 1)
    assert ended(words)[0] == STATUS
    whole = Whole(contents(tmp_path / "whole"), 1.0, len(noted(tmp_path / "whole")))
    killed_runs(scans, whole, tmp_path / "out", 2, seed=5)


@pytest.mark.slow
def test_a_thousand_kills_cost_nothing(scans, whole, tmp_path):
    count = int(os.environ.get("MSAL_KILLS", "1000"))
    began = time.monotonic()
    seed = int(os.environ.get("MSAL_SEED", "1"))
    met = killed_runs(scans, whole, tmp_path / "out", count, seed)
    print(
        f"\n{met} in {time.monotonic() - began:.0f} s; an unbroken run takes {whole.seconds:.2f} s"
    )
