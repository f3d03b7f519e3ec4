"""The number of usable cores under affinity and quotas."""

from __future__ import annotations

import os

import pytest

from msal_cli import machine
from msal_cli.kernels import parallel


def made(tmp_path, membership, **files):
    (tmp_path / "membership").write_text(membership)
    for name, text in files.items():
        path = tmp_path / "groups" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return machine._quota(tmp_path / "groups", tmp_path / "membership")


def test_a_quota_of_the_second_version(tmp_path):
    files = {"a/b/cpu.max": "150000 100000\n", "a/cpu.max": "max 100000\n"}
    assert made(tmp_path, "0::/a/b\n", **files) == 1500


def test_the_tightest_of_nested_groups_counts(tmp_path):
    files = {"a/b/cpu.max": "400000 100000\n", "a/cpu.max": "200000 100000\n"}
    assert made(tmp_path, "0::/a/b\n", **files) == 2000


def test_a_container_sees_its_own_group_at_the_top(tmp_path):
    assert made(tmp_path, "0::/docker/0123\n", **{"cpu.max": "50000 100000"}) == 500


def test_a_quota_of_the_first_version(tmp_path):
    files = {
        "cpu,cpuacct/x/cpu.cfs_quota_us": "300000\n",
        "cpu,cpuacct/x/cpu.cfs_period_us": "100000\n",
        "memory/x/cpu.max": "1 100000",
    }
    assert made(tmp_path, "4:memory:/x\n3:cpu,cpuacct:/x\n", **files) == 3000


@pytest.mark.parametrize("text", ["max 100000", "", "x y", "-1 100000", "100000 0", "1"])
def test_no_quota(tmp_path, text):
    assert made(tmp_path, "0::/\n", **{"cpu.max": text}) is None


def test_nothing_to_read(tmp_path):
    assert machine._quota(tmp_path, tmp_path / "none") is None
    assert made(tmp_path, "nonsense\n\n::\n") is None


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="needs affinity")
def test_the_smaller_of_affinity_and_quota_counts(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(8)))
    for quota, expected in ((None, 8), (1500, 2), (300, 1), (64_000, 8), (3000, 3)):
        monkeypatch.setattr(machine, "_quota", lambda groups, membership, quota=quota: quota)
        assert machine.usable_cores() == expected


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="needs affinity")
def test_one_file_has_as_many_threads_as_the_container_has_cores(monkeypatch):
    monkeypatch.delenv("MSAL_THREADS", raising=False)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(8)))
    monkeypatch.setattr(machine, "_quota", lambda groups, membership: 1500)
    assert parallel.threads() == 2
