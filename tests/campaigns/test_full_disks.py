"""Disks that are full: what was whole stays whole, and more room lets the same command go on.

python -m pytest tests/campaigns/test_full_disks.py -m slow -s
"""

from __future__ import annotations

import csv
import io
import json
import os
import subprocess

import pytest

from msal_cli.batch.temporary_files import is_own
from tests.campaigns.runs import (
    IS_LINUX,
    Whole,
    command,
    contents,
    ended,
    noted,
    scans_in,
    started,
)
from tests.cli.scans import closed_scan, folder_of, ply_text
from tests.shapes import noisy, torus

pytestmark = pytest.mark.skipif(not IS_LINUX, reason="limits and mounts of Linux")


def test_a_limit_on_the_size_of_files_is_a_full_disk(tmp_path):
    vertices, faces = torus(60, 30)
    scans = folder_of(tmp_path / "in", big=ply_text(noisy(vertices, 0, 0.01), faces))
    folder_of(scans, **{f"small{n}": closed_scan(n) for n in range(2)})
    words = command(scans, tmp_path / "out", "-j", "1")

    def limit():
        import resource

        # The signal that comes with it must not kill anybody.
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, resource.RLIM_INFINITY))

    made = subprocess.run(words, capture_output=True, preexec_fn=limit, check=False)
    assert made.returncode == 3, made.stderr
    assert b"File too large (E_WRITE)" in made.stderr
    assert sorted(contents(tmp_path / "out")) == ["small0.ply", "small1.ply"]
    assert ended(words)[0] == 0
    assert sorted(contents(tmp_path / "out")) == ["big.ply", "small0.ply", "small1.ply"]


def test_a_manifest_that_is_full_hides_nothing(tmp_path):
    """What was written is counted, although it cannot be noted, and the report is written."""
    scans = folder_of(tmp_path / "in", **{f"s{n:02}": closed_scan(n) for n in range(12)})
    report = tmp_path / "r.csv"
    words = command(scans, tmp_path / "out", "-j", "2", "--report", report)

    def limit():
        import resource

        # Enough for an output and for the report; the manifest of all files is larger.
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))

    told_all = [one for one in words if one != "-q"]
    made = subprocess.run(told_all, capture_output=True, preexec_fn=limit, check=False)
    assert made.returncode == 1, made.stderr
    assert b"manifest" in made.stderr and b"File too large" in made.stderr
    there = sorted(contents(tmp_path / "out"))
    assert 0 < len(there) < 12
    assert f"12 files: {len(there)} written, {12 - len(there)} not done".encode() in made.stderr
    rows = list(csv.DictReader(io.StringIO(report.read_text())))
    reported = {row["output"].rpartition("/")[2] for row in rows if row["status"] == "written"}
    assert sorted(reported) == there
    # The manifest has no torn line, and the same command goes on.
    assert (tmp_path / "out/.msal-manifest.jsonl").read_bytes().endswith(b"}\n")
    assert ended(words)[0] == 0
    assert len(contents(tmp_path / "out")) == 12


@pytest.fixture
def small_disk(tmp_path):
    """A function that makes a disk of so many kilobytes, or changes its size."""
    disk = tmp_path / "disk"
    disk.mkdir()
    is_mounted = False

    def sized(kilobytes):
        nonlocal is_mounted
        options = f"size={kilobytes}k" + (",remount" if is_mounted else "")
        made = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", options, "tmpfs", disk], capture_output=True, check=False
        )
        if made.returncode:
            pytest.skip("no disk can be mounted here")
        is_mounted = True
        return disk

    yield sized
    if is_mounted:
        subprocess.run(["umount", disk], check=True)


by_root = pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root may mount"
)


@by_root
def test_the_report_on_another_disk_is_written(tmp_path, small_disk):
    scans = folder_of(tmp_path / "in", **{f"s{n:02}": closed_scan(n) for n in range(8)})
    disk, report = small_disk(64), tmp_path / "r.json"
    made = subprocess.run(
        command(scans, disk / "out", "-j", "2", "--report", report),
        capture_output=True,
        check=False,
    )
    assert made.returncode in (1, 3), made.stderr
    records = json.loads(report.read_bytes())["records"]
    assert len(records) == 8
    reported = [one["output"].rpartition("/")[2] for one in records if one["status"] == "written"]
    assert sorted(reported) == sorted(contents(disk / "out"))
    assert {one["status"] for one in records} <= {"written", "failed", "planned"}


@pytest.mark.slow
@by_root
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_disk_of_every_size_up_to_enough(tmp_path, small_disk, jobs):
    scans = scans_in(tmp_path / "in", 12)
    assert ended(command(scans, tmp_path / "whole", "-j", jobs))[0] == 3
    whole = Whole(contents(tmp_path / "whole"), 0.0, 0)
    statuses, n_written = [], []
    for kilobytes in (4, 8, 16, 32, 48, 64, 96, 128, 192, 256):
        disk = small_disk(kilobytes)
        # The second time around an old output is in the way of the new one.
        for options in ([], ["--fresh"]):
            words = command(scans, disk / "out", "-j", jobs, *options)
            with started(words) as process:
                said = process.communicate(timeout=300)[1].decode()
            statuses.append(process.returncode)
            assert process.returncode in (1, 3), said
            assert "Traceback" not in said and "nternal" not in said, said
            assert whole.faults(disk / "out") == [], (kilobytes, options, said)
            assert not [one for one in contents(disk / "out") if is_own(one.rpartition("/")[2])]
        n_written.append(len(noted(disk / "out")))
    assert whole.last_faults(disk / "out") == []
    print(f"\nstatuses {statuses}; files noted as the disk grows: {n_written}")
    assert 1 in statuses and 3 in statuses
