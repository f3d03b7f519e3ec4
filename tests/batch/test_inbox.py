"""A watched folder: events of the system, and listing where there are none."""

import builtins
import os
import time

import pytest

from msal_cli.batch import inbox as module
from msal_cli.batch.inbox import Inbox
from msal_cli.errors import ResourceError, UsageError

SETTLE_S = 0.2


@pytest.fixture(params=["events", "polled"])
def is_polled(request, monkeypatch):
    if request.param == "events":
        pytest.importorskip("watchfiles", reason="the extra watch is not installed")
    monkeypatch.setattr(module, "_POLLED_EVERY_S", 0.1)
    return request.param == "polled"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "in").mkdir()
    return tmp_path / "in"


def watch(folder, *patterns, output="out", is_polled=False, settle_s=SETTLE_S):
    return Inbox(
        str(folder), str(folder / output), *patterns, settle_s=settle_s, is_polled=is_polled
    )


def collect(inbox, n, within_s=10.0):
    """The next ``n`` files, and those that come soon after them, by their relative paths."""
    found = []
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        found += [one.relative for one in inbox.pop_complete()]
        if len(found) >= n and end - time.monotonic() > 3 * SETTLE_S:
            end = time.monotonic() + 3 * SETTLE_S
        inbox.wait()
    return found


def test_files_of_all_folders_are_taken_once_and_others_never(folder, is_polled):
    (folder / "early.ply").write_text("x")
    inbox = watch(folder, is_polled=is_polled)
    assert collect(inbox, 1) == ["early.ply"]
    (folder / "a/b").mkdir(parents=True)
    (folder / "a/b/deep.stl").write_text("x")
    for name in (".hidden.ply", "~a.ply", "a.ply.part", "notes.txt", ".msal-lock"):
        (folder / name).write_text("x")
    (folder / "out").mkdir()
    (folder / "out/made.ply").write_text("x")
    (folder / "new.obj").write_text("x")
    assert sorted(collect(inbox, 2)) == ["a/b/deep.stl", "new.obj"]
    assert inbox.is_quiet()


def test_include_and_exclude(folder, is_polled):
    inbox = watch(folder, ["*.ply"], ["old"], is_polled=is_polled)
    (folder / "old").mkdir()
    for name in ("a.ply", "b.obj", "old/c.ply"):
        (folder / name).write_text("x")
    assert collect(inbox, 1) == ["a.ply"]


def test_a_file_written_slowly_is_taken_once_and_whole(folder, is_polled):
    inbox = watch(folder, is_polled=is_polled, settle_s=0.5)
    sizes = []
    with (folder / "slow.ply").open("w", encoding="ascii") as file:
        for _ in range(6):
            file.write("piece")
            file.flush()
            end = time.monotonic() + 0.2
            while time.monotonic() < end:
                sizes += [os.path.getsize(one.path) for one in inbox.pop_complete()]
                inbox.wait()
    end = time.monotonic() + 1.5
    while time.monotonic() < end:
        sizes += [os.path.getsize(one.path) for one in inbox.pop_complete()]
        inbox.wait()
    assert sizes == [30]


def test_a_file_that_gets_its_name_at_the_end_is_taken_at_once(folder):
    pytest.importorskip("watchfiles", reason="the extra watch is not installed")
    inbox = watch(folder, settle_s=3600.0)
    (folder / "scan.ply.part").write_text("x")
    for _ in range(5):
        inbox.wait()
    os.replace(folder / "scan.ply.part", folder / "scan.ply")
    # One that is simply there has to settle.
    (folder / "other.ply").write_text("x")
    assert collect(inbox, 1) == ["scan.ply"]


def test_a_folder_that_goes_away_and_comes_back(folder, monkeypatch, caplog):
    monkeypatch.setattr(module, "_POLLED_EVERY_S", 0.05)
    inbox = watch(folder, is_polled=True)
    folder.rename(folder.with_name("away"))
    for _ in range(4):
        inbox.wait()
    assert sum("msal waits for it" in one for one in caplog.messages) == 1
    folder.with_name("away").rename(folder)
    (folder / "a.ply").write_text("x")
    assert collect(inbox, 1) == ["a.ply"]


def test_a_watch_that_fails_becomes_polling(folder, monkeypatch, caplog):
    watchfiles = pytest.importorskip("watchfiles", reason="the extra watch is not installed")

    def limited(*given, **settings):
        yield set()
        raise OSError("OS file watch limit reached")

    monkeypatch.setattr(watchfiles, "watch", limited)
    monkeypatch.setattr(module, "_POLLED_EVERY_S", 0.05)
    inbox = watch(folder)
    for _ in range(3):
        inbox.wait()
    (folder / "a.ply").write_text("x")
    assert collect(inbox, 1) == ["a.ply"]
    assert "is polled: OS file watch limit reached" in caplog.text


def test_what_cannot_be_watched_is_refused(folder, monkeypatch):
    with pytest.raises(UsageError, match="no file or folder"):
        watch(folder / "none", is_polled=True)
    real = builtins.__import__

    def without(name, *rest, **more):
        if name == "watchfiles":
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ResourceError, match="needs the package watchfiles") as caught:
        watch(folder)
    assert "--poll" in caught.value.hint
    # On a network it is not needed.
    monkeypatch.setattr(module, "is_on_network", lambda path: True)
    watch(folder)
