"""What the machine and its control groups leave, from made-up files of both versions."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from msal_cli import machine


def laid_out(tmp_path, membership="", meminfo="", vmstat="", **files):
    proc, groups = tmp_path / "proc", tmp_path / "groups"
    (proc / "self").mkdir(parents=True)
    groups.mkdir()
    (proc / "self/cgroup").write_text(membership)
    (proc / "meminfo").write_text(meminfo)
    (proc / "vmstat").write_text(vmstat)
    for name, text in files.items():
        (groups / name).parent.mkdir(parents=True, exist_ok=True)
        (groups / name).write_text(text)
    return proc, groups


MEMINFO = "MemTotal: 100 kB\nMemFree: 10 kB\nMemAvailable:    50 kB\n"


def test_the_machine_alone(tmp_path):
    assert machine.available_bytes(*laid_out(tmp_path, meminfo=MEMINFO)) == 50 * 1024


def test_nobody_tells(tmp_path):
    assert machine.available_bytes(tmp_path / "none", tmp_path / "none") is None
    assert machine.oom_kills(tmp_path / "none", tmp_path / "none") == 0


def test_a_group_leaves_its_limit_less_what_is_used_and_not_cached(tmp_path):
    files = {
        "a/memory.max": "30000\n",
        "a/memory.current": "25000\n",
        "a/memory.stat": "anon 1\ninactive_file 4000\nactive_file 700\n",
    }
    laid = laid_out(tmp_path, "0::/a\n", MEMINFO, **files)
    assert machine.available_bytes(*laid) == 9000


def test_the_tightest_of_nested_groups_counts(tmp_path):
    files = {
        "a/b/memory.max": "max\n",
        "a/b/memory.current": "5\n",
        "a/memory.max": "2000\n",
        "a/memory.current": "500\n",
    }
    laid = laid_out(tmp_path, "0::/a/b\n", MEMINFO, **files)
    assert machine.available_bytes(*laid) == 1500


def test_groups_of_the_first_version(tmp_path):
    files = {
        "memory/x/memory.limit_in_bytes": "9000\n",
        "memory/x/memory.usage_in_bytes": "8000\n",
        "memory/x/memory.stat": "inactive_file 1\ntotal_inactive_file 500\n",
        "memory/memory.limit_in_bytes": "9223372036854771712\n",
        "memory/memory.usage_in_bytes": "8000\n",
        "memory/x/memory.oom_control": "oom_kill_disable 0\nunder_oom 0\noom_kill 3\n",
        "cpu/x/memory.max": "1\n",
    }
    laid = laid_out(tmp_path, "4:memory:/x\n3:cpu:/x\n", MEMINFO, **files)
    assert machine.available_bytes(*laid) == 1500
    assert machine.oom_kills(*laid) == 3


@pytest.mark.parametrize("used", ["40000", "0"])
def test_never_less_than_nothing_nor_more_than_the_limit(tmp_path, used):
    files = {
        "memory.max": "30000",
        "memory.current": used,
        "memory.stat": "inactive_file 5000\n",
    }
    laid = laid_out(tmp_path, "0::/\n", **files)
    assert machine.available_bytes(*laid) == (0 if used == "40000" else 30000)


def test_kills_are_counted_by_the_group_and_else_by_the_machine(tmp_path):
    events = "low 0\nhigh 0\nmax 9\noom 8\noom_kill 7\noom_group_kill 0\n"
    laid = laid_out(tmp_path, "0::/a\n", vmstat="oom_kill 99\n", **{"a/memory.events": events})
    assert machine.oom_kills(*laid) == 7
    (tmp_path / "groups/a/memory.events").unlink()
    assert machine.oom_kills(*laid) == 99


@pytest.mark.parametrize("text", ["", "x", "MemAvailable:", "MemAvailable: x kB", "\udcff"])
def test_nonsense_is_nothing(tmp_path, text):
    proc, groups = laid_out(tmp_path, "0::/a\n\n:\n")
    (proc / "meminfo").write_text(text, errors="surrogateescape")
    assert machine.available_bytes(proc, groups) is None


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_this_machine_tells():
    told = machine.available_bytes()
    assert told is not None and 0 < told < 1 << 50
    assert machine.oom_kills() >= 0
    assert Path("/proc/self/cgroup").exists()
