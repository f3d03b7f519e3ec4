"""Objects: whole in, whole out, their marks, and every failure in words."""

import functools
import http.server
import re
import sys
import threading

import pytest

from msal_cli.codecs import header
from msal_cli.codecs.header import forecast
from msal_cli.errors import InputError, OutputError, TooLargeError, UsageError
from msal_cli.storage import objects as remote
from msal_cli.storage import regular
from msal_cli.storage.objects import list_objects, mark, read_whole, write_whole
from msal_cli.storage.urls import ObjectMark

pytest.importorskip("fsspec", reason="needs the extra: pip install '.[cloud]'")
pytestmark = pytest.mark.usefixtures("empty_store")


class Refusing:
    """In the place of a file system that fails."""

    def __init__(self, failure):
        self.failure = failure

    def __getattr__(self, name):
        def fail(*arguments, **options):
            raise self.failure

        return fail


def test_what_is_written_is_read_back():
    there = write_whole("memory://b/a.ply", [b"one", memoryview(b"two")])
    assert read_whole("memory://b/a.ply") == b"onetwo"
    assert there == mark("memory://b/a.ply") == list_objects("memory://b")["a.ply"]
    assert there.size == 6
    assert there.tag
    write_whole("memory://b/c/y.ply", b"")
    assert mark("memory://b/c") is mark("memory://b/none") is None
    assert mark("memory://b/c/y.ply").size == 0


def test_a_listing_goes_down_and_knows_no_neighbours():
    for name in ("b/x.ply", "b/c/y.ply", "b/c/d/z.ply", "bb/no.ply", "b.ply"):
        write_whole(f"memory://{name}", name.encode())
    assert sorted(list_objects("memory://b")) == ["c/d/z.ply", "c/y.ply", "x.ply"]
    assert sorted(list_objects("memory://b/")) == sorted(list_objects("memory://b"))
    assert sorted(list_objects("memory://b", depth=2)) == ["c/y.ply", "x.ply"]
    assert list_objects("memory://nothing") == {}
    assert list_objects("memory://b/x.ply") == {}


def test_a_beginning_is_told_with_the_size():
    write_whole("memory://b/a.ply", b"0123456789")
    assert remote.read_beginning("memory://b/a.ply", 4) == (b"0123", 10)
    write_whole("memory://b/empty.ply", b"")
    assert remote.read_beginning("memory://b/empty.ply", 4) == (b"", 0)
    write_whole("memory://b/t.ply", b"ply\nformat ascii 1.0\nelement vertex 3\nend_header\n")
    assert forecast("memory://b/t.ply").format == "ply"
    assert forecast("memory://b/none.ply").memory_bytes is None


class NoCredentialsError(Exception):
    """Named like botocore's."""


class EndpointConnectionError(Exception):
    """Named like botocore's."""


@pytest.mark.parametrize(
    ("failure", "words"),
    [
        (PermissionError("Access Denied"), "access is denied"),
        (FileNotFoundError("The specified bucket does not exist"), "no such bucket"),
        (NoCredentialsError("Unable to locate credentials"), "no credentials"),
        (EndpointConnectionError("Could not connect"), "cannot be reached"),
        (TimeoutError(), "cannot be reached"),
        (OSError(5, "it is on fire"), "it is on fire"),
        (UnicodeEncodeError("utf-8", "\udc80", 0, 1, "surrogates not allowed"), "valid Unicode"),
        (NotImplementedError(), "cannot do that"),
        (RuntimeError("sftp://joe:geheim@host is down"), "host is down"),
    ],
)
def test_every_failure_is_an_error_with_a_reason_and_a_hint(monkeypatch, failure, words):
    monkeypatch.setattr(remote, "_open", lambda url: (Refusing(failure), "a.ply"))
    for kind, code, call in (
        (InputError, "E_READ", lambda: read_whole("s3://b/a.ply")),
        (OutputError, "E_WRITE", lambda: write_whole("s3://b/a.ply", b"")),
    ):
        with pytest.raises(kind, match=words) as caught:
            call()
        assert caught.value.code == code
        assert caught.value.hint
        assert caught.value.path == "s3://b/a.ply"
        assert "geheim" not in caught.value.message
    if not isinstance(failure, FileNotFoundError):
        for call in (mark, list_objects):
            with pytest.raises(InputError, match=words):
                call("s3://b/a.ply")


def test_a_put_that_stops_halfway_is_noticed_and_none_is_made_where_it_may(monkeypatch):
    from fsspec.implementations.memory import MemoryFileSystem

    real = MemoryFileSystem.pipe_file
    with monkeypatch.context() as patch:
        patch.setattr(
            MemoryFileSystem, "pipe_file", lambda self, path, data: real(self, path, data[:-1])
        )
        with pytest.raises(OutputError, match="4 of 5 bytes"):
            write_whole("memory://short/a.ply", b"12345")
    monkeypatch.setattr(remote, "_OBJECT_STORES", re.compile("none"))
    with pytest.raises(OutputError, match="object stores only"):
        write_whole("memory://b/c/a.ply", b"new")


def test_without_the_package_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "fsspec", None)
    for call in (read_whole, mark, list_objects, lambda url: write_whole(url, b"")):
        with pytest.raises(UsageError) as caught:
            call("s3://b/a.ply")
        assert "msal-cli[cloud]" in caught.value.hint
        # That would look for msal itself on an index.
        assert "pip install 'msal-cli" not in caught.value.hint


@pytest.mark.parametrize(
    ("info", "tag"),
    [
        ({"size": 1, "ETag": '"abc"', "LastModified": 5}, ObjectMark(1, "abc")),
        ({"size": 1, "etag": 'W/"abc"'}, ObjectMark(1, 'W/"abc"')),
        ({"size": 1, "mtime": 5}, ObjectMark(1, "mtime 5.000000")),
        ({"size": 1, "updated": "2026-01-01"}, ObjectMark(1, "updated 2026-01-01")),
        ({"size": None}, ObjectMark(-1, "")),
    ],
)
def test_marks_are_made_of_what_the_store_tells(info, tag):
    assert remote._mark_of(info) == tag


def test_a_large_object_is_not_asked_for(monkeypatch):
    monkeypatch.setattr(regular, "memory_bytes", lambda: 8 << 20)
    write_whole("memory://b/a.ply", bytes(5 << 20))
    system = type(remote._open("memory://b/a.ply")[0])
    monkeypatch.setattr(system, "cat_file", lambda *words, **more: pytest.fail("it is read"))
    with pytest.raises(TooLargeError):
        read_whole("memory://b/a.ply")
    with pytest.raises(TooLargeError):
        read_whole("memory://b/a.ply", 5 << 20)


def test_a_web_server_is_read(tmp_path):
    pytest.importorskip("aiohttp")
    data = bytes(range(256)) * 8192
    (tmp_path / "a.ply").write_bytes(data)
    answer = functools.partial(http.server.SimpleHTTPRequestHandler, directory=tmp_path)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), answer) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_port}/a.ply"
        assert read_whole(url) == data == header.read_input(url)
        assert remote.read_beginning(url, 100) == (data[:100], len(data))
        assert mark(url + "x") is None
        server.shutdown()
    with pytest.raises(InputError, match="the store cannot be reached"):
        mark(url)
