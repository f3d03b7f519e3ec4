"""Finding the input files of a command on real folders."""

import os
import socket
from pathlib import Path

import pytest

from msal_cli.batch.inputs import NothingMatched, discover_inputs, is_matched, parse_patterns
from msal_cli.errors import UsageError
from msal_cli.storage.atomic import temporary_name
from tests.files import make_files, posix


def relatives(*inputs, **options):
    return [one.relative for one in discover_inputs([str(one) for one in inputs], **options)]


def test_a_file_is_taken_whatever_its_name(tmp_path):
    make_files(tmp_path, "scan.xyz", ".hidden")
    (one, other) = discover_inputs([str(tmp_path / "scan.xyz"), str(tmp_path / ".hidden")])
    assert (one.path, one.relative, one.root) == (str(tmp_path / "scan.xyz"), "scan.xyz", "")
    assert other.relative == ".hidden"


def test_a_folder_is_searched_in_the_order_of_names(tmp_path):
    make_files(tmp_path, "b.ply", "a/z.obj", "a/y/x.ply", "c.txt", "a.ply", "B.ply")
    some = discover_inputs([str(tmp_path)])
    assert [one.relative for one in some] == ["B.ply", "a/y/x.ply", "a/z.obj", "a.ply", "b.ply"]
    assert all(Path(one.path) == tmp_path / one.relative for one in some)
    assert {one.root for one in some} == {str(tmp_path)}


def test_a_folder_named_by_dots_is_known_by_its_real_name(tmp_path, monkeypatch):
    make_files(tmp_path, "one/a.ply", "two/a.ply")
    monkeypatch.chdir(tmp_path / "one")
    assert relatives(".", "../two") == ["one/a.ply", "two/a.ply"]
    assert discover_inputs(["."])[0].path == "a.ply"


def test_a_missing_input_is_named():
    names = {"not here.ply": "no file or folder.*not here", "a" * 5000: "too long"}
    for name, words in (names | {"": "empty string", "a\0b": "null"}).items():
        with pytest.raises(UsageError, match=words) as caught:
            relatives(name)
        assert caught.value.code == "E_USAGE"


def test_nothing_matched_is_a_signal_of_its_own(tmp_path):
    make_files(tmp_path, "a.txt")
    for inputs in ([tmp_path], [f"{tmp_path}/*.ply"], [f"{tmp_path}/no/*.ply"]):
        with pytest.raises(NothingMatched) as caught:
            relatives(*inputs)
        assert not isinstance(caught.value, UsageError)
    with pytest.raises(NothingMatched):
        relatives(tmp_path / "a.txt", include=["*.ply"])


def test_an_input_without_files_is_a_warning_beside_others(tmp_path, caplog):
    make_files(tmp_path, "full/a.ply", "empty/b.txt")
    relatives(tmp_path / "full", tmp_path / "empty")
    assert [one.getMessage() for one in caplog.records] == [
        f"no mesh file is selected by the input {str(tmp_path / 'empty')!r}"
    ]


@posix
class TestLinks:
    def test_folders_are_found_where_they_are_and_not_through_links(self, tmp_path):
        make_files(tmp_path, "in/real/a.ply", "in/real/b/x.ply", "out/b.ply")
        (tmp_path / "in/alias").symlink_to("real")
        (tmp_path / "in/away").symlink_to(tmp_path / "out")
        (tmp_path / "in/self").symlink_to("self")
        (tmp_path / "in/real/b/up").symlink_to("..")
        assert relatives(tmp_path / "in") == ["real/a.ply", "real/b/x.ply"]
        assert relatives(tmp_path / "in/alias") == ["a.ply", "b/x.ply"]

    def test_a_link_that_leads_out_is_named(self, tmp_path, caplog):
        make_files(tmp_path, "in/a.ply", "out/b.ply")
        (tmp_path / "in/round").symlink_to(".")
        (tmp_path / "in/again").symlink_to("round")
        relatives(tmp_path / "in")
        assert caplog.messages == []
        for name in "vwxyz":
            (tmp_path / "in" / name).symlink_to("../out")
        assert relatives(tmp_path / "in") == ["a.ply"]
        assert len(caplog.messages) == 4
        assert f"{str(tmp_path / 'in/v')!r} leads out of the input folder" in caplog.messages[0]
        assert caplog.messages[3] == "2 more links lead out of it"
        caplog.clear()
        discover_inputs([str(tmp_path / "in")], exclude=["[v-z]"])
        assert caplog.messages == []

    def test_a_linked_file_is_an_input_and_a_broken_one_is_not_lost(self, tmp_path):
        make_files(tmp_path, "store/a.ply")
        (tmp_path / "in").mkdir()
        (tmp_path / "in/a.ply").symlink_to(tmp_path / "store/a.ply")
        (tmp_path / "in/gone.ply").symlink_to("nowhere")
        (tmp_path / "in/round.ply").symlink_to("round.ply")
        assert relatives(tmp_path / "in") == ["a.ply", "gone.ply", "round.ply"]
        for name in ("gone.ply", "round.ply"):
            assert relatives(tmp_path / "in" / name) == [name]


@posix
class TestOddTrees:
    def test_special_files_are_passed_over(self, tmp_path):
        make_files(tmp_path, "a.ply")
        os.mkfifo(tmp_path / "fifo.ply")
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(str(tmp_path / "s.ply"))
            (tmp_path / "null.ply").symlink_to("/dev/null")
            assert relatives(tmp_path) == ["a.ply"]
        with pytest.raises(UsageError, match="neither a file nor a folder"):
            relatives(tmp_path / "fifo.ply")

    def test_a_folder_that_the_system_refuses_to_list_is_not_skipped(self, tmp_path, monkeypatch):
        make_files(tmp_path, "a.ply", "locked/b.ply")
        real, bad = os.scandir, str(tmp_path / "locked")
        monkeypatch.setattr(os, "scandir", lambda path: real([path, f"{bad}/b.ply"][path == bad]))
        with pytest.raises(UsageError, match=r"locked' cannot be listed: Not a directory"):
            relatives(tmp_path)
        assert relatives(tmp_path, exclude=["locked"]) == ["a.ply"]
        failures = []
        assert relatives(tmp_path, failures=failures) == ["a.ply"]
        assert [(error.code, error.path) for error in failures] == [("E_READ", bad)]
        with pytest.raises(UsageError, match="cannot be listed"):
            relatives(bad, failures=[])


GLOBS = "s/one/a.ply s/two/b.ply s/c.ply s/one/d.txt"
TREE = "a.ply left/b.ply left/old/c.ply right/d.obj"
OWN = ".b.ply .git/c.ply .msal-manifest.jsonl"
IN_OUT = "a.ply out/.msal-manifest.jsonl out/a.ply out/sub/b.ply outer/c.ply"


@pytest.mark.parametrize(
    ("files", "pattern", "options", "expected"),
    [
        (f"a.ply {OWN}", "", {}, "a.ply"),
        (f"a.ply {OWN}", ".*", {}, ".b.ply .git/c.ply"),
        (TREE, "", {"include": ["left/**"]}, "left/b.ply left/old/c.ply"),
        (TREE, "", {"include": ["*.obj", "a.*"]}, "a.ply right/d.obj"),
        (TREE, "", {"exclude": ["old"]}, "a.ply left/b.ply right/d.obj"),
        (TREE, "", {"include": ["left"], "exclude": ["**/old/*"]}, "left/b.ply"),
        # A pattern is relative to its fixed part, and a folder that matches is searched.
        (GLOBS, "s/*.ply", {}, "c.ply"),
        (GLOBS, "s/*/*.ply", {}, "one/a.ply two/b.ply"),
        (GLOBS, "s/**/*.ply", {}, "c.ply one/a.ply two/b.ply"),
        (GLOBS, "*/one/a.ply", {}, "s/one/a.ply"),
        ("s/one/deep/a.ply s/two/b.ply s/two/b.txt", "s/*", {}, "one/deep/a.ply two/b.ply"),
        ("b.x left.x/a.x left.x/b.ply right/c.x", "*.x", {}, "b.x left.x/b.ply"),
        ("a[1].ply a1.ply", "a[1].ply", {}, "a[1].ply"),
        ("a1.ply", "a[1].ply", {}, "a1.ply"),
        # An output folder in the input is not searched.
        (IN_OUT, "", {"output": "out"}, "a.ply outer/c.ply"),
        (IN_OUT, "**/*.ply", {"output": "./out/"}, "a.ply outer/c.ply"),
        (IN_OUT, "", {"output": "outer"}, "a.ply out/a.ply out/sub/b.ply"),
        pytest.param(IN_OUT, "", {"output": "alias"}, "a.ply outer/c.ply", marks=posix),
    ],
)
def test_what_is_found(tmp_path, caplog, files, pattern, options, expected):
    make_files(tmp_path, *files.split(), temporary_name("d.ply"))
    if output := options.get("output"):
        options = {"output": f"{tmp_path}/{output}"}
        if output == "alias":
            (tmp_path / "alias").symlink_to("out")
    assert relatives(f"{tmp_path}/{pattern}".rstrip("/"), **options) == expected.split()
    # Results of an earlier run are inputs, but not unnoticed.
    assert ("earlier run" in caplog.text) == (output == "outer")


MATCHED = (
    "*.ply left/a.ply, .*.ply .a.ply, left/*.ply left/a.ply, left/**/*.ply left/a.ply, "
    "left/**/*.ply left/b/c/a.ply, left/** left/b/c/a.ply, **/b/*.ply b/a.ply, **/**/a.ply a.ply, "
    "old/ x/old/y/a.ply, ./old old/a.ply, a[!b]c axc, a[1].ply a[1].ply, * line\nbreak.ply, "
    "sc*n.ply sc\udcff\udcfen.ply"
)
OTHERS = (
    "*.ply a.obj, *.ply .a.ply, left/*.ply left/b/a.ply, left/** right/a.ply, old older/a.ply, "
    "a?b a/b, a[!b]c a/c, a.ply aXply"
)


@pytest.mark.parametrize(("pairs", "expected"), [(MATCHED, True), (OTHERS, False)])
def test_a_pattern_matches_what_a_shell_user_expects(pairs, expected):
    for pattern, path in (pair.split(" ") for pair in pairs.split(", ")):
        assert is_matched(parse_patterns([pattern]), path) is expected, pattern
