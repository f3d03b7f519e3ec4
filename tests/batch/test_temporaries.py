"""Left-over temporary files go when their process is gone, and only then."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from msal_cli.batch import temporaries
from msal_cli.batch.processes import ending, is_alive
from msal_cli.batch.temporaries import is_own, sweep, sweep_after, temporary_name


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
    monkeypatch.setattr(temporaries, "_machine", lambda: "00000000")
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
