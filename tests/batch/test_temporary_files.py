"""Left-over temporary files go when their process is gone, and only then."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import pytest

from msal_cli.batch import temporary_files as temporaries
from msal_cli.batch.process_status import ending, is_alive, started_at
from msal_cli.batch.temporary_files import is_own, sweep, sweep_after, temporary_name


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


def test_of_another_machine_only_what_is_old_goes(tmp_path, dead, monkeypatch):
    monkeypatch.setattr(temporaries, "machine_tag", lambda: "00000000")
    names = [of(dead, "new"), of(dead, "old")]
    monkeypatch.undo()
    for name in names:
        (tmp_path / name).touch()
    os.utime(tmp_path / names[1], (0, 0))
    assert sweep([tmp_path]) == 1
    assert sweep_after(dead, tmp_path) == 0
    assert [path.name for path in tmp_path.iterdir()] == names[:1]


def test_after_a_worker_only_its_own_go(tmp_path, dead):
    names = [of(dead), of(dead + 1), temporary_name("mine")]
    for name in names:
        (tmp_path / name).touch()
    assert sweep_after(dead, tmp_path) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names[1:])


def test_a_process_number_in_use_again_keeps_nothing(tmp_path):
    mine, earlier = tmp_path / temporary_name("mine"), tmp_path / temporary_name("earlier")
    for path in (mine, earlier):
        path.touch()
    began = started_at(os.getpid()) or time.time()
    os.utime(mine, (began - 5, began - 5))
    os.utime(earlier, (began - 100, began - 100))
    is_told = started_at(os.getpid()) is not None
    assert sweep([tmp_path]) == is_told
    assert mine.exists() and earlier.exists() != is_told


@pytest.mark.skipif(not os.path.exists("/proc/self/stat"), reason="told by /proc")
def test_when_a_process_began():
    before = time.time()
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        began = started_at(process.pid)
        process.communicate(b"\n")
    assert before - 0.5 < began < time.time() + 0.5
    assert started_at(10**30) is None


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


def test_a_folder_of_that_name_does_not_matter(tmp_path, dead):
    (tmp_path / of(dead)).mkdir()
    assert sweep([tmp_path]) == 0


def test_living_and_dead(dead):
    assert is_alive(os.getpid()) and is_alive(os.getppid())
    assert not is_alive(dead) and not is_alive(0) and not is_alive(-1)
    assert is_alive(10**30), "what cannot be told counts as alive"


def test_endings_in_words():
    assert ending(-9) == "was killed by SIGKILL"
    assert ending(-200) == "was killed by signal 200"
    assert ending(3) == "ended with exit status 3"
    assert ending(0xC0000005) == "ended with the exception 0xC0000005"
