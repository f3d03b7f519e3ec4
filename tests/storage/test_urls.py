"""URLs as text: what is one, what lies below it, and what nobody may see of it."""

from __future__ import annotations

import pytest

from msal_cli.errors import UsageError
from msal_cli.storage import urls
from msal_cli.storage.urls import SECRETS, escape_name, identity, join_url, normalize_url, redact


@pytest.fixture(autouse=True)
def no_secrets(monkeypatch):
    monkeypatch.setenv(SECRETS, "")


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
    assert join_url("s3://b/out", "x/y z.ply") == "s3://b/out/x/y z.ply"
    assert join_url("s3://b/out//", "x") == "s3://b/out/x"
    assert join_url("memory://", "x") == "memory://x"
    assert urls.name("s3://b/out/") == "out"
    assert identity("s3a://b/x") == identity("s3://b/x")
    assert identity("memory:///x") == identity("memory://x")


def test_odd_names_stay_below_their_folder_and_apart():
    names = ["../x", "..", "a/../../x", "a//b", "a/b", "/x", "./x", "a/%2F/b", "a\0b", "x"]
    for is_local in (True, False):
        escaped = [escape_name(name, is_local=is_local) for name in names]
        for one in escaped:
            assert not {"", ".", ".."} & set(one.split("/"))
        assert not is_local or all("\0" not in one for one in escaped)
    assert escape_name("../x", is_local=True) == "%2E%2E/x"
    assert escape_name("a b/ü%41#?.ply", is_local=False) == "a b/ü%41#?.ply"


def test_a_password_is_put_away_and_comes_back_only_to_open():
    url = normalize_url("sftp://joe:pa:ss@host/a@b:c.ply")
    assert url == "sftp://joe@host/a@b:c.ply"
    assert urls.restore_secrets(url) == "sftp://joe:pa:ss@host/a@b:c.ply"
    assert urls.restore_secrets("sftp://joe@host/other") == "sftp://joe:pa:ss@host/other"
    assert urls.restore_secrets("sftp://joe@elsewhere/x") == "sftp://joe@elsewhere/x"
    assert normalize_url(url) == url


def test_a_signature_is_put_away_and_comes_back_only_to_open():
    url = normalize_url("https://host/a.ply?X-Amz-Signature=secret")
    assert url == "https://host/a.ply"
    assert urls.restore_secrets(url) == "https://host/a.ply?X-Amz-Signature=secret"
    with pytest.raises(UsageError):
        normalize_url("https://host/a.ply?X-Amz-Signature=other")
    # In a store a question mark is part of the name.
    assert normalize_url("s3://b/a?b.ply") == "s3://b/a?b.ply"


@pytest.mark.parametrize(
    "text",
    [
        "sftp://joe:geheim@host/a.ply",
        "--output=sftp://joe:geheim@host/a",
        "no such file sftp://joe:geheim@host/a.ply, said the server",
        "https://host/a.ply?token=geheim",
    ],
)
def test_nothing_secret_is_told(text):
    assert "geheim" not in redact(text)
    assert "host/a" in redact(text)
    normalize_url("sftp://joe:geheim@host/a.ply")
    assert redact("login as joe with geheim failed") == "login as joe with *** failed"


@pytest.mark.parametrize("text", ["{{{", "[]", '"a"', '{"a": 1}', "\udcff", "[" * 100_000])
def test_secrets_that_are_none_are_ignored(monkeypatch, text):
    monkeypatch.setenv(SECRETS, text)
    assert redact("s3://b") == urls.restore_secrets("s3://b") == "s3://b"
    assert normalize_url("sftp://joe:geheim@host/a") == "sftp://joe@host/a"
    assert urls.restore_secrets("sftp://joe@host/a") == "sftp://joe:geheim@host/a"
