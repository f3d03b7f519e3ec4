"""URLs as text: what is one, what lies below it, and what nobody may see of it."""

import pytest

from msal_cli.errors import UsageError
from msal_cli.storage import urls
from msal_cli.storage.urls import escape_name, folder, identity, normalize_url, redact


def test_a_protocol_makes_a_url_but_for_files():
    for text in ("s3://b/x", "gs://b/x", "memory://x", "HTTPS://h/x", "s3://b/a b#?%.ply"):
        assert urls.is_url(text)
    for text in ("a.ply", "/a/b.ply", "s3:/b", "C://x", "file:///a", "local://a", "-", "", "://x"):
        assert not urls.is_url(text)


def test_files_are_plain_paths():
    assert normalize_url("file:///a/b%20c.ply") == "/a/b%20c.ply"
    assert normalize_url("FILE:///a") == "/a"
    assert normalize_url("a//b/../c.ply") == "a//b/../c.ply"


def test_names_are_joined_as_they_are():
    assert folder("s3://b/out") == folder("s3://b/out//") == "s3://b/out/"
    assert folder("memory://") == "memory://"
    assert urls.name("s3://b/out/") == "out"
    assert identity("s3a://b/x") == identity("s3://b/x")
    assert identity("memory:///x") == identity("memory://x")


def test_odd_names_stay_below_their_folder():
    names = {"../x": "%2E%2E/x", "..": "%2E%2E", "a//b": "a/%2F/b", "/x": "%2F/x", "./x": "%2E/x"}
    for name, there in (names | {"a b/ü%41#?.ply": "a b/ü%41#?.ply"}).items():
        assert escape_name(name, is_local=False) == there
    assert escape_name("a\0b/..", is_local=True) == "a%00b/%2E%2E"


@pytest.mark.parametrize(
    "text",
    [
        "sftp://joe:geheim@host/a.ply",
        "s3://key:geheim@b/a.ply",
        "https://host/a.ply?X-Amz-Signature=geheim",
    ],
)
def test_a_secret_in_a_url_is_refused_and_not_shown(text):
    with pytest.raises(UsageError) as caught:
        normalize_url(text)
    shown = f"{caught.value.message} {redact(f'no such file {text}, said the server')}"
    assert "geheim" not in shown and "/a.ply" in shown


def test_a_question_mark_or_an_at_sign_may_be_in_a_name():
    for url in ("s3://b/a?b.ply", "sftp://joe@host/a@b:c.ply"):
        assert normalize_url(url) == url == redact(url)
