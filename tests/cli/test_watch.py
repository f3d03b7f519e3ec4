"""`msal watch`: what arrives is denoised once, as by `msal denoise`, until the watch is ended."""

import json
import os
import signal
import threading
import time

import pytest

from msal_cli.batch.lock import FolderLock
from msal_cli.cli.watch import Inbox
from tests.campaigns import runs
from tests.cli.scans import BAD_SCAN, MSAL, closed_scan, folder_of, msal, open_scan
from tests.files import make_files, posix, tree

QUICK = ("--settle", "0.1s", "-n", "1")


@pytest.fixture
def inbox(tmp_path):
    (tmp_path / "in").mkdir()
    return tmp_path / "in"


def watch(inbox, *options, idle="0.3s"):
    return msal("watch", inbox, "-o", inbox.parent / "out", "--idle-exit", idle, *QUICK, *options)


def done_names(out):
    path = out / ".msal-manifest.jsonl"
    text = path.read_text("utf-8") if path.exists() else ""
    # A line that is being written has no end yet.
    lines = map(json.loads, text.rpartition("\n")[0].splitlines())
    return [one["name"] for one in lines if one["kind"] == "done"]


def when_done(inbox, count, action):
    """Do something while a watch goes on, once ``count`` files are done."""

    def wait():
        while len(done_names(inbox.parent / "out")) < count:
            time.sleep(0.01)
        action()

    threading.Thread(target=wait, daemon=True).start()


def test_outputs_and_records_are_those_of_denoise_and_each_command_knows_the_others(inbox):
    folder_of(inbox, a=closed_scan(), bad=BAD_SCAN)
    folder_of(inbox / "sub", b=open_scan())
    out, other = inbox.parent / "out", inbox.parent / "other"
    made = watch(inbox)
    assert (made.exit_code, made.stdout) == (3, ""), made.stderr
    assert "a.ply -> " in made.stderr and "sub/b.ply -> " in made.stderr
    assert made.stderr.count("E_INDEX") == 1
    assert msal("denoise", inbox, "-o", other, "-n", "1").exit_code == 3
    assert tree(out) == tree(other)
    # Nothing is left to do, for either command: settings and hashes are the same.
    again = msal("denoise", inbox, "-o", out, "-n", "1", "--json")
    states = sorted(one["status"] for one in json.loads(again.stdout)["records"])
    assert states == ["failed", "up-to-date", "up-to-date"]
    restarted = watch(inbox)
    assert (restarted.exit_code, "->" in restarted.stderr) == (3, False)
    assert "2 up to date" in restarted.stderr and len(done_names(out)) == 3


def test_what_arrives_later_is_done_once_and_what_changes_again(inbox):
    folder_of(inbox, a=open_scan())
    out = inbox.parent / "out"

    def change():
        folder_of(inbox / "sub", b=open_scan(), bad=BAD_SCAN)
        (inbox / "a.ply").write_bytes(closed_scan())

    when_done(inbox, 1, change)
    # Its time changes, but not what is in it.
    when_done(inbox, 4, lambda: os.utime(inbox / "sub/bad.ply", (1, 1)))
    made = watch(inbox, idle="1s")
    assert made.exit_code == 3
    assert made.stderr.count("a.ply -> ") == 2
    assert made.stderr.count("b.ply -> ") == 1
    assert sorted(done_names(out)) == ["a.ply", "a.ply", "sub/b.ply", "sub/bad.ply"]
    assert len((out / "a.ply").read_bytes()) > len(open_scan())


@posix
@pytest.mark.parametrize(
    ("number", "status"),
    [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.ci)],
)
def test_a_signal_leaves_whole_files_and_no_lock_and_the_next_watch_does_the_rest(
    inbox, number, status
):
    folder_of(inbox, **{f"s{n}": closed_scan(n) for n in range(5)})
    out = inbox.parent / "out"
    command = [*MSAL, "watch", inbox, "-o", out, *QUICK, "-j", "1"]
    with runs.started([*map(str, command)], text=True) as process:
        lines = [process.stderr.readline() for _ in range(3)]
        process.send_signal(number)
        words = process.stderr.read()
        assert process.wait(20) == status
    # In the order of their arrival, which is that of their times.
    assert [line.split(" ")[0] for line in lines] == ["watching", "s0.ply", "s1.ply"]
    assert "msal: interrupted" in words and "goes on from here" in words
    n_done = len(done_names(out))
    assert n_done >= 2
    assert len(tree(out)) in (n_done, n_done + 1)
    with FolderLock(str(out)):
        pass
    assert watch(inbox).exit_code == 0
    assert len(tree(out)) == 5
    assert len(set(done_names(out))) == 5


def test_an_output_that_is_not_ours_is_a_failure_and_the_watch_goes_on(inbox):
    folder_of(inbox.parent / "out", a=b"foreign")
    folder_of(inbox, a=open_scan(), b=open_scan())
    made = watch(inbox, "-q")
    assert made.exit_code == 3
    assert "--force" in made.stderr
    assert (inbox.parent / "out/a.ply").read_bytes() == b"foreign"
    assert (inbox.parent / "out/b.ply").exists()


def test_fail_fast_ends_the_watch(inbox):
    folder_of(inbox, bad=BAD_SCAN)
    made = watch(inbox, "--fail-fast", idle="60s")
    assert made.exit_code == 1
    assert "stopped after 1 failed" in made.stderr


def test_an_output_of_two_inputs_is_a_failure_of_the_later(inbox):
    folder_of(inbox, a=closed_scan())
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    when_done(inbox, 1, lambda: (inbox / "a.obj").write_text(text))
    for _ in range(2):
        made = watch(inbox, "--to", "ply", idle="1s")
        assert (made.exit_code, "would replace that of" in made.stderr) == (3, True)
    assert done_names(inbox.parent / "out") == ["a.ply", "/a.obj"]
    assert msal("report", inbox.parent / "out", "--check").exit_code == 3


def test_a_file_is_taken_once_it_stands_still_and_again_when_it_changes(inbox, monkeypatch):
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    (inbox / "early.ply.part").write_bytes(b"ply")
    (inbox / ".hidden.ply").write_bytes(b"ply")
    box = Inbox(str(inbox), str(inbox.parent / "out"), settle_s=0.5)
    taken = {}
    for step in range(40):
        # It grows at each of ten steps, stands still, and grows once more.
        if step in (*range(10), 20):
            with (inbox / "slow.ply").open("ab") as file:
                file.write(b"x")
        assert box.is_quiet == (step == 0 or 12 < step <= 20 or step > 22)
        for file in box.take_complete():
            taken[step] = file.relative
        now += 0.3
    assert taken == {12: "slow.ply", 22: "slow.ply"}


@posix
def test_what_is_wrong_with_a_folder_is_said_once_and_delays_no_other(inbox, monkeypatch, caplog):
    make_files(inbox, "a.ply", "locked/b.ply")
    (inbox / "away").symlink_to("..")
    now, real, bad, taken = 0, os.scandir, str(inbox / "locked"), []
    monkeypatch.setattr(time, "monotonic", lambda: now)
    monkeypatch.setattr(os, "scandir", lambda path: real([path, f"{bad}/b.ply"][path == bad]))
    box = Inbox(str(inbox), str(inbox.parent / "out"), settle_s=0.5)
    for now in range(6):
        taken += [(now, file.relative) for file in box.take_complete()]
        if now == 3:
            monkeypatch.setattr(os, "scandir", real)
    assert taken == [(1, "a.ply"), (5, "locked/b.ply")]
    assert [f"{bad!r} cannot be listed: Not a dir" in words for words in caplog.messages] == [0, 1]
