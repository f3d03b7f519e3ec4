"""What Windows and macOS do differently, simulated here: a module gets another ``os``."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from msal_cli.batch import interrupts
from msal_cli.errors import OutputError
from msal_cli.storage import atomic, urls

ROOT = Path(__file__).parent.parent


class OtherOs:
    """``os`` of another system: of another name, or without some of its functions."""

    def __init__(self, *missing, **changed):
        self._missing = missing
        self.__dict__.update(changed)

    def __getattr__(self, name):
        if name in self._missing:
            raise AttributeError(name)
        return getattr(os, name)


@pytest.fixture
def windows(monkeypatch):
    """Have a module take the system for Windows."""

    def change(module, *missing, **changed):
        monkeypatch.setattr(module, "os", OtherOs(*missing, name="nt", **changed))

    return change


# Files that another program looks at


@pytest.mark.parametrize(("refusals", "is_written"), [(0, True), (3, True), (4, False)])
def test_a_file_that_is_open_elsewhere_is_replaced_a_little_later(
    tmp_path, windows, monkeypatch, refusals, is_written
):
    windows(atomic)
    waits, left = [], [refusals]
    monkeypatch.setattr(atomic.time, "sleep", waits.append)
    replace = Path.replace

    def refuse(self, target):
        if left[0]:
            left[0] -= 1
            raise PermissionError(13, "Access is denied")
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", refuse)
    path = tmp_path / "a.ply"
    path.write_bytes(b"old")
    if is_written:
        atomic.write_whole(path, b"new")
    else:
        with pytest.raises(OutputError, match="Access is denied") as caught:
            atomic.write_whole(path, b"new")
        assert "permissions" in caught.value.hint
    assert path.read_bytes() == (b"new" if is_written else b"old")
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]
    assert len(waits) == min(refusals, 3)


def test_a_new_file_is_renamed_where_that_does_not_replace(tmp_path, windows, monkeypatch):
    windows(atomic, "link")
    rename = Path.rename

    def rename_as_on_windows(self, target):
        if target.exists():
            raise FileExistsError(17, "Cannot create a file when that file already exists")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", rename_as_on_windows)
    assert atomic.write_new(tmp_path / "a.ply", b"one")
    assert not atomic.write_new(tmp_path / "a.ply", b"two")
    assert (tmp_path / "a.ply").read_bytes() == b"one"
    assert len(os.listdir(tmp_path)) == 1


# Names


@pytest.mark.parametrize(
    ("name", "there"),
    [
        ("CON.ply", "%43ON.ply"),
        ("con", "%63on"),
        ("scans/aux.scan.ply", "scans/%61ux.scan.ply"),
        ("com1.ply", "%63om1.ply"),
        ("com1 .ply", "%63om1 .ply"),
        ("concert.ply", "concert.ply"),
        ("com10.ply", "com10.ply"),
        ("a./b.ply", "a%2E/b.ply"),
        ("a /b.ply ", "a%20/b.ply%20"),
        ("..\\x/c:y", "..%5Cx/c%3Ay"),
        ("a\nb?.ply", "a%0Ab%3F.ply"),
    ],
)
def test_an_object_of_any_name_becomes_a_file_of_windows(name, there, windows):
    assert urls.escape_name(name, is_local=True) == name
    windows(urls)
    assert urls.escape_name(name, is_local=True) == there
    assert urls.escape_name(name, is_local=False) == name


def test_a_drive_is_no_protocol(windows):
    assert not urls.is_url("C:\\scans\\a.ply")
    assert not urls.is_url("C:/scans/a.ply")
    windows(urls)
    assert urls.normalize_url("file:///C:/scans/a.ply") == "C:/scans/a.ply"


# Signals and processes


@pytest.mark.skipif(os.name != "posix", reason="it is what Windows does")
def test_a_run_in_this_process_ends_late_without_set_blocking(windows):
    def pipe():
        listening, telling = os.pipe()
        # Linux, unlike Windows, wants it so.
        os.set_blocking(telling, False)
        return listening, telling

    windows(interrupts, "set_blocking", pipe=pipe)
    received = []
    with interrupts.catch_signals(received.append), interrupts.end_if_late(lambda: None):
        signal.raise_signal(signal.SIGTERM)
    assert received == [signal.SIGTERM]


def test_the_program_starts_without_modules_of_posix():
    code = (
        "import sys\n"
        "sys.modules.update(dict.fromkeys(('fcntl', 'resource', 'pwd', 'grp', 'termios')))\n"
        "import msal_cli.cli.denoise, msal_cli.cli.watch, msal_cli.batch.run\n"
        "import msal_cli.batch.lock, msal_cli.batch.workers, msal_cli.job.pipeline"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


# The workflow


def test_ctrl_break_ends_a_run_like_other_signals(monkeypatch):
    # SIGBREAK is 21 on Windows; here another number plays its part.
    number = int(getattr(signal, "SIGUSR1", signal.SIGTERM))
    monkeypatch.setattr(signal, "SIGBREAK", number, raising=False)
    received = []
    with interrupts.catch_signals(received.append):
        signal.raise_signal(number)
    assert received == [number]
    with pytest.raises(interrupts.Terminated) as caught:
        interrupts.raise_for(number)
    assert caught.value.exit_status == 128 + number
