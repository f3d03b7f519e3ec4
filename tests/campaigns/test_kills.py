"""Runs that are killed or get signals: nothing half-written, nothing lost, and the rest is done.

python -m pytest tests/campaigns/test_kills.py -m slow -s
"""

import collections
import os
import random
import shutil
import signal

import pytest

from tests.campaigns import runs

pytestmark = [
    pytest.mark.skipif(not runs.IS_LINUX, reason="finds processes by /proc"),
    pytest.mark.ci,
]


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    return runs.scans_in(tmp_path_factory.mktemp("kills") / "in")


@pytest.fixture(scope="module")
def whole(scans):
    return runs.whole_run(scans, scans.parent / "whole", "-j", 2)


def kill(process, with_workers):
    """Kill the parent alone, or it and everything that it has started."""
    for pid in sorted(runs.session_of(process.pid)) if with_workers else [process.pid]:
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
        words = runs.command(scans, output, "-j", choice.choice([1, 1, 2]))
        for _ in range(choice.randint(1, 5)):
            wait = runs.moment(choice, whole, output)
            with runs.started(words) as process:
                wait(process)
                kill(process, with_workers=bool(met["kills"] % 2))
                process.communicate()
            if process.returncode != -signal.SIGKILL:
                break
            # A worker that is just starting notices late on a busy machine.
            left = runs.orphans_of(process.pid, within_s=20.0)
            assert not left, f"{met}: the workers {left} live on"
            assert whole.faults(output) == [], met
            met["kills"] += 1
            met["a temporary left"] += any(output.rglob(".*.tmp"))
        status, _, said = runs.ended(words)
        assert (status, whole.last_faults(output)) == (runs.STATUS, []), (met, said)
        assert "Traceback" not in said
    print(f"\n{dict(met)}")
