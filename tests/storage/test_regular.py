"""Only regular files are opened, and nothing waits for another process."""

import os
import socket

import pytest

from msal_cli.codecs import header
from msal_cli.errors import InputError, TooLargeError
from msal_cli.storage import gzip_streams as streams
from msal_cli.storage import regular
from msal_cli.storage.regular import NotRegularError, open_own, open_regular
from tests.files import time_limit

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pipes, sockets and links of POSIX")


@pytest.fixture(autouse=True)
def promptly():
    """A test that waits fails: nothing here has a reason to take seconds."""
    with time_limit(10.0):
        yield


@pytest.fixture(params=["pipe", "socket", "device", "link to a pipe", "link to a device"])
def special(request, tmp_path, monkeypatch):
    """The path of something that has the name of a mesh and is none."""
    path = tmp_path / "scan.ply"
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    if request.param == "pipe":
        pipe.rename(path)
    elif request.param == "socket":
        # The path of a socket may have some hundred characters only.
        monkeypatch.chdir(tmp_path)
        with socket.socket(socket.AF_UNIX) as one:
            one.bind("scan.ply")
    elif request.param == "device":
        return "/dev/zero"
    else:
        path.symlink_to(pipe if request.param.endswith("pipe") else "/dev/zero")
    return path


def test_every_way_to_read_a_mesh_refuses_a_special_file(special):
    with pytest.raises(NotRegularError, match="not a regular file"):
        open_regular(special)
    with pytest.raises(OSError):
        os.close(open_own(special))
    for read in (streams.read_whole, header.read_input):
        with pytest.raises(InputError, match="not a regular file") as caught:
            read(special)
        assert caught.value.code == "E_READ"
        assert caught.value.hint
    assert header.forecast(str(special)).memory_bytes is None


def test_a_file_that_becomes_a_pipe_in_between_is_not_read(tmp_path, monkeypatch):
    path = tmp_path / "scan.ply"
    os.mkfifo(path)
    status = os.stat(__file__)
    monkeypatch.setattr(os, "stat", lambda path: status)
    with pytest.raises(NotRegularError):
        open_regular(path)


def test_folders_and_what_is_missing_are_told_apart(tmp_path):
    with pytest.raises(IsADirectoryError):
        open_regular(tmp_path)
    with pytest.raises(FileNotFoundError):
        open_regular(tmp_path / "none")


def test_what_grows_without_end_is_not_read_to_the_end(tmp_path, monkeypatch):
    path = tmp_path / "scan.ply"
    path.write_bytes(bytes(3 << 20))
    monkeypatch.setattr(regular, "memory_bytes", lambda: 4 << 20)
    with pytest.raises(TooLargeError, match="memory of this machine"):
        streams.read_whole(path)
    # A file that says it is empty and is not, as one that is written to meanwhile.
    status = os.stat("/dev/null")
    monkeypatch.setattr(os, "fstat", lambda handle: os.stat_result((0o100644, *status[1:])))
    with pytest.raises(TooLargeError):
        streams.read_whole(path)
