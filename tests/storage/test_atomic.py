"""Files that appear whole or not at all."""

import errno
import os
import stat
import sys

import pytest

from msal_cli.errors import OutputError
from msal_cli.storage import atomic as writing
from msal_cli.storage.atomic import write_new, write_whole
from tests.files import posix, umask
from tests.report.made import HOSTILE_NAMES


def names(folder):
    return sorted(os.listdir(folder))


def mode_of(path):
    return stat.S_IMODE(path.stat().st_mode)


def make_file(path, mode):
    path.write_bytes(b"1")
    path.chmod(mode)
    return path


@posix
def test_permissions_are_those_of_the_umask_or_of_the_replaced_file(tmp_path):
    with umask(0o027):
        write_whole(tmp_path / "a", b"x")
    assert mode_of(tmp_path / "a") == 0o640
    old = make_file(tmp_path / "old", 0o6606)
    write_whole(old, b"new")
    assert mode_of(old) == 0o606


@posix
@pytest.mark.parametrize(
    ("write", "replaced"),
    [(write_whole, None), (write_whole, 0o666), (write_whole, 0o600), (write_new, None)],
)
def test_no_output_is_open_to_more_users_than_its_sources(tmp_path, write, replaced):
    first, second = make_file(tmp_path / "a", 0o644), make_file(tmp_path / "b", 0o640)
    output = tmp_path / "out"
    for sources, expected in [
        ((first, second), 0o640),
        ((str(first), "s3://bucket/a.ply", "memory://b.ply"), 0o644),
        ((tmp_path / "gone",), 0o600),
    ]:
        if replaced is not None:
            make_file(output, replaced)
        write(output, b"new", sources=sources)
        assert mode_of(output) == expected & (0o666 if replaced is None else replaced), sources
        output.unlink()


@posix
def test_the_temporary_file_is_private_from_its_beginning(tmp_path):
    private = make_file(tmp_path / "a", 0o600)
    out = make_file(tmp_path / "out", 0o666)

    def look():
        (temporary,) = set(tmp_path.iterdir()) - {private, out}
        modes.append(mode_of(temporary))
        yield b"new"

    modes = []
    write_whole(out, look(), sources=[private])
    assert modes == [0o600]


@posix
def test_an_open_source_counts_and_a_pipe_does_not(tmp_path):
    private = make_file(tmp_path / "a", 0o600)
    with private.open() as file:
        write_whole(tmp_path / "out", b"new", sources=[file.fileno()])
    assert mode_of(tmp_path / "out") == 0o600
    ends = os.pipe()
    with umask(0o022):
        write_whole(tmp_path / "piped", b"new", sources=[ends[0]])
    for end in ends:
        os.close(end)
    assert mode_of(tmp_path / "piped") == 0o644


@posix
def test_another_group_gets_what_all_others_may(tmp_path, monkeypatch):
    source = make_file(tmp_path / "a", 0o664)
    private = make_file(tmp_path / "b", 0o660)
    monkeypatch.setattr(writing, "_group_of_new_file", lambda folder: source.stat().st_gid + 1)
    with umask(0):
        write_whole(tmp_path / "out", b"new", sources=[source])
        write_whole(tmp_path / "private", b"new", sources=[private])
    assert mode_of(tmp_path / "out") == 0o644
    assert mode_of(tmp_path / "private") == 0o600


@posix
def test_a_link_to_a_file_of_all_users_does_not_widen_the_output(tmp_path):
    (tmp_path / "link").symlink_to(make_file(tmp_path / "theirs", 0o666))
    with umask(0o077):
        write_whole(tmp_path / "link", b"new")
    assert mode_of(tmp_path / "link") == 0o600


@posix
def test_a_link_is_replaced_and_its_target_kept(tmp_path):
    (tmp_path / "input").write_bytes(b"precious")
    (tmp_path / "link").symlink_to("input")
    write_whole(tmp_path / "link", b"new")
    assert (tmp_path / "input").read_bytes() == b"precious"
    assert not (tmp_path / "link").is_symlink()
    (tmp_path / "dangling").symlink_to("nowhere")
    write_whole(tmp_path / "dangling", b"new")
    assert (tmp_path / "dangling").read_bytes() == b"new"


@pytest.mark.skipif(sys.platform != "linux", reason="other systems restrict names further")
@pytest.mark.parametrize(
    "name",
    [b"\xff\xfe.ply", b"-o.ply", b"a\nb", "ü".encode() * 127, b" "]
    + [b"n" * (length - 4) + b".ply" for length in (100, 143, 200, 251, 255)]
    + list(map(os.fsencode, HOSTILE_NAMES)),
)
def test_names_of_any_bytes(tmp_path, name):
    path = os.fsencode(tmp_path) + b"/" + name
    write_whole(os.fsdecode(path), b"x")
    assert os.listdir(os.fsencode(tmp_path)) == [name]


@posix
def test_what_cannot_be_a_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for path in (
        *(tmp_path / "pipe", tmp_path / "folder", "/dev/null"),
        *(f"{tmp_path}/a\0b", tmp_path / ("n" * 256)),
    ):
        with pytest.raises(OutputError):
            write_whole(path, b"x")
    with pytest.raises(OutputError) as caught:
        write_whole(tmp_path / "no" / "a.ply", b"x")
    assert caught.value.code == "E_WRITE"
    assert "does not exist" in caught.value.hint
    assert caught.value.path.endswith("a.ply")
    assert names(tmp_path) == ["folder", "pipe"]
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)


@pytest.mark.parametrize("call", ["open", "write", "fsync"])
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EACCES, errno.EROFS, errno.EIO])
def test_a_failing_system_leaves_the_old_file_and_no_temporary(tmp_path, monkeypatch, call, number):
    path = tmp_path / "a.ply"
    path.write_bytes(b"old")

    def fail(*_args, **_keywords):
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patch:
        patch.setattr(writing.os, call, fail)
        with pytest.raises(OutputError) as caught:
            write_whole(path, b"new")
    assert os.strerror(number) in str(caught.value)
    if number == errno.ENOSPC:
        assert "full" in caught.value.hint
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["a.ply"]


def test_short_writes_are_continued_and_lost_bytes_noticed(tmp_path, monkeypatch):
    real = os.write
    monkeypatch.setattr(writing.os, "write", lambda handle, view: real(handle, view[:7]))
    write_whole(tmp_path / "a", [bytes(range(100)), bytes(range(100, 200))])
    assert (tmp_path / "a").read_bytes() == bytes(range(200))
    monkeypatch.setattr(writing.os, "write", lambda handle, view: len(view))
    with pytest.raises(OutputError, match="0 of 3 bytes"):
        write_whole(tmp_path / "b", b"abc")
    assert names(tmp_path) == ["a"]


@pytest.mark.parametrize("has_links", [True, False])
def test_write_new_never_replaces(tmp_path, monkeypatch, has_links):
    def fail(*_args, **_keywords):
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    if not has_links:
        monkeypatch.setattr(writing.os, "link", fail)
    path = tmp_path / "tex.png"
    assert write_new(path, b"first")
    assert not write_new(path, b"second")
    assert path.read_bytes() == b"first"
    assert names(tmp_path) == ["tex.png"]
