"""Two runs on one folder: the second is refused; the dead hold nothing."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys

import pytest

from msal_cli.batch import lock
from msal_cli.batch.lock import NAME, FolderLock
from msal_cli.errors import OutputError, UsageError

HOLD = (
    "import sys; from msal_cli.batch.lock import FolderLock; one = FolderLock(sys.argv[1]); "
    "print('held', flush=True); sys.stdin.read()"
)


@pytest.fixture
def holder(tmp_path):
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_the_second_is_told_who_is_first(tmp_path, holder):
    with pytest.raises(UsageError) as caught:
        FolderLock(str(tmp_path))
    assert caught.value.code == "E_LOCKED"
    assert f"process {holder.pid} " in caught.value.message
    assert str(tmp_path) in caught.value.message


def test_also_within_one_process(tmp_path):
    with FolderLock(str(tmp_path)), pytest.raises(UsageError, match=f"process {os.getpid()} "):
        FolderLock(str(tmp_path))
    with FolderLock(str(tmp_path)):
        pass
    assert list(tmp_path.iterdir()) == []


def test_the_dead_hold_nothing(tmp_path, holder):
    holder.send_signal(getattr(signal, "SIGKILL", signal.SIGTERM))
    holder.wait()
    assert (tmp_path / NAME).exists()
    one = FolderLock(str(tmp_path))
    assert (tmp_path / NAME).read_text().split() == [str(os.getpid()), socket.gethostname()]
    one.release()
    one.release()


def test_a_lock_file_removed_while_we_waited_is_not_the_lock(tmp_path, monkeypatch):
    real = lock._is_locked_by_us
    calls = []

    def slow(handle, **how):
        calls.append(handle)
        if len(calls) == 1:
            # The last holder lets go between our opening the file and our locking it.
            (tmp_path / NAME).unlink()
        return real(handle, **how)

    monkeypatch.setattr(lock, "_is_locked_by_us", slow)
    with FolderLock(str(tmp_path)):
        assert len(calls) == 2
        with pytest.raises(UsageError):
            FolderLock(str(tmp_path))


class TestWithoutLocks:
    """Some network file systems know no locks: then the word of a living process counts."""

    @pytest.fixture(autouse=True)
    def no_locks(self, monkeypatch):
        def unsupported(handle, **how):
            raise OSError(38, "Function not implemented")

        monkeypatch.setattr(lock, "_is_locked_by_us", unsupported)

    def test_a_living_holder_counts(self, tmp_path, caplog):
        with FolderLock(str(tmp_path)):
            with pytest.raises(UsageError, match=str(os.getpid())):
                FolderLock(str(tmp_path))
            assert "cannot be locked" in caplog.text

    @pytest.mark.parametrize("text", ["", "x", "2147480000 HOST", "-1 HOST", "1 other-machine"])
    def test_others_do_not(self, tmp_path, text):
        (tmp_path / NAME).write_text(text.replace("HOST", socket.gethostname()))
        FolderLock(str(tmp_path)).release()


def test_a_folder_that_cannot_be_written_is_an_output_error(tmp_path):
    with pytest.raises(OutputError):
        FolderLock(str(tmp_path / "missing"))


@pytest.mark.skipif(not hasattr(os, "O_NOFOLLOW"), reason="needs O_NOFOLLOW")
def test_a_link_in_the_place_of_the_lock_does_not_harm_its_target(tmp_path):
    (tmp_path / "precious").write_text("keep")
    (tmp_path / NAME).symlink_to("precious")
    with pytest.raises(OutputError):
        FolderLock(str(tmp_path))
    assert (tmp_path / "precious").read_text() == "keep"
