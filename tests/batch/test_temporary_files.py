"""Left-over temporary files go when their process is gone, and only then."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time

import pytest

from msal_cli.batch.workers import describe_exit
from msal_cli.machine import is_alive, start_time
from msal_cli.storage.atomic import is_own, sweep, sweep_after, temporary_name


@pytest.fixture(scope="module")
def dead():
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def of(pid, stem="a.ply"):
    return temporary_name(stem).replace(f"-{os.getpid()}-", f"-{pid}-")


def test_names_of_our_own():
    assert is_own(temporary_name("a.ply")) and is_own(temporary_name("new\nline"))
    assert is_own(".msal-manifest.jsonl") and is_own(".msal-lock")
    assert not is_own("a.ply") and not is_own(".a.ply") and not is_own("a.msal-1-2.tmp")
    assert temporary_name("a") != temporary_name("a")


def test_what_the_dead_left_goes(tmp_path, dead):
    names = [of(dead), of(dead, "new\nline"), of(dead, "\udcff"), of(dead, "x" * 100)]
    keep = [temporary_name("mine"), of(os.getppid()), "a.ply", ".hidden", ".a.msal-1.tmp"]
    for name in names + keep:
        (tmp_path / name).touch()
    assert sweep([tmp_path, tmp_path / "missing"]) == 4
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(keep)


def test_of_another_machine_only_what_is_old_goes(tmp_path, dead):
    names = [re.sub(r"-[0-9a-f]{8}", "-00000000", of(dead, name)) for name in ("new", "old")]
    for name in names:
        (tmp_path / name).touch()
    os.utime(tmp_path / names[1], (0, 0))
    assert sweep([tmp_path]) == 1
    assert sweep_after(dead, [tmp_path]) == 0
    assert [path.name for path in tmp_path.iterdir()] == names[:1]


def test_after_a_worker_only_its_own_go(tmp_path, dead):
    names = [of(dead), of(dead + 1), temporary_name("mine")]
    for name in names:
        (tmp_path / name).touch()
    assert sweep_after(dead, [tmp_path]) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names[1:])


def test_a_process_number_in_use_again_keeps_nothing(tmp_path):
    mine, earlier = tmp_path / temporary_name("mine"), tmp_path / temporary_name("earlier")
    for path in (mine, earlier):
        path.touch()
    began = start_time(os.getpid()) or time.time()
    os.utime(mine, (began - 5, began - 5))
    os.utime(earlier, (began - 100, began - 100))
    is_told = start_time(os.getpid()) is not None
    assert sweep([tmp_path]) == is_told
    assert mine.exists() and earlier.exists() != is_told


@pytest.mark.skipif(not os.path.exists("/proc/self/stat"), reason="told by /proc")
def test_a_process_that_nobody_asked_after_is_dead(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", ""], stdout=subprocess.PIPE)
    process.stdout.read()  # until it ends, but without taking its exit status
    deadline = time.monotonic() + 10
    while is_alive(process.pid) and time.monotonic() < deadline:
        time.sleep(0.01)
    name = of(process.pid)
    (tmp_path / name).touch()
    swept = sweep([tmp_path])
    process.stdout.close()
    process.wait()
    assert swept == 1


def test_describe_exits_in_words():
    assert describe_exit(-9) == "was killed by SIGKILL"
    assert describe_exit(-200) == "was killed by signal 200"
    assert describe_exit(3) == "ended with exit status 3"
    assert describe_exit(0xC0000005) == "ended with the exception 0xC0000005"
