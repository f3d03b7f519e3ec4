"""Glob patterns against relative paths."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.batch.inputs import Patterns
from msal_cli.errors import UsageError


@pytest.mark.parametrize(
    ("pattern", "path", "expected"),
    [
        ("*.ply", "a.ply", True),
        ("*.ply", "left/a.ply", True),
        ("*.ply", "a.obj", False),
        ("*.ply", ".a.ply", False),
        (".*.ply", ".a.ply", True),
        ("left/*.ply", "left/a.ply", True),
        ("left/*.ply", "left/b/a.ply", False),
        ("left/**/*.ply", "left/a.ply", True),
        ("left/**/*.ply", "left/b/c/a.ply", True),
        ("left/**", "left/b/c/a.ply", True),
        ("left/**", "right/a.ply", False),
        ("**/b/*.ply", "b/a.ply", True),
        ("old", "x/old/y/a.ply", True),
        ("old/", "old/a.ply", True),
        ("./old", "old/a.ply", True),
        ("old", "older/a.ply", False),
        ("a?.ply", "ab.ply", True),
        ("a?b", "a/b", False),
        ("a[!b]c", "abc", False),
        ("a[!b]c", "axc", True),
        ("a[!b]c", "a/c", False),
        ("a[]]c", "a]c", True),
        ("a[b-d]e", "ace", True),
        ("a[", "a[", True),
        ("a[\\]b", "a\\b", True),
        ("a.ply", "aXply", False),
        ("*", "line\nbreak.ply", True),
        ("sc*n.ply", "sc\udcff\udcfen.ply", True),
    ],
)
def test_a_pattern_matches_what_a_shell_user_expects(pattern, path, expected):
    assert Patterns([pattern]).matches(path) is expected


def test_whole_patterns_do_not_match_a_name_alone():
    assert not Patterns(["*.ply"], whole=True).matches("left/a.ply")
    assert Patterns(["left"], whole=True).matches("left/a.ply")
    assert not Patterns(["left"], whole=True).is_exact("left/a.ply")


@given(
    st.text(alphabet="ab./*?[]!-^\\&|~\n", max_size=12), st.text(alphabet="ab./-]\n", min_size=1)
)
def test_no_pattern_crashes(pattern, path):
    try:
        Patterns([pattern]).matches(path)
    except UsageError as error:
        assert "pattern" in error.message


@given(st.text(alphabet="ab*?[]!.\\-^ \n\udcff", min_size=1, max_size=12))
def test_a_name_with_every_wildcard_bracketed_matches_itself_only(name):
    quoted = "".join(f"[{c}]" if c in "*?[" else c for c in name)
    if quoted in (".", "./"):
        return
    assert Patterns([quoted]).is_exact(name)
    assert not Patterns([quoted]).is_exact(name + "x")


def test_an_empty_pattern_is_refused():
    with pytest.raises(UsageError):
        Patterns(["./"])
