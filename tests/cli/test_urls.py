"""What is secret in a URL ends up in no report, no log, no manifest and no message."""

from __future__ import annotations

import pytest

from msal_cli.storage import urls
from msal_cli.storage.objects import read_whole, write_whole
from tests.cli.scans import closed_scan, msal, msal_on

pytest.importorskip("fsspec", reason="needs the extra: pip install '.[cloud]'")


@pytest.fixture(autouse=True)
def no_secrets(monkeypatch):
    monkeypatch.setenv(urls.SECRETS, "")


@pytest.mark.parametrize(
    ("place", "is_output"),
    [
        ("memory://joe:geheim@b/x", True),
        ("memory://joe:geheim@b/x.ply", True),
        ("memory://joe:geheim@b/x.ply", False),
        ("http://127.0.0.1:9/x.ply?signature=geheim", False),
        ("nosuch://joe:geheim@b/x.ply", False),
    ],
)
def test_no_secret_is_told(tmp_path, place, is_output):
    (tmp_path / "scans").mkdir()
    (tmp_path / "scans/a.ply").write_bytes(closed_scan())
    pair = (tmp_path / "scans/a.ply", place) if is_output else (place, tmp_path / "out")
    report, log = tmp_path / "r.json", tmp_path / "log"
    told = msal("denoise", pair[0], "-o", pair[1], "-vv", "--report", report, "--log-file", log)
    assert told.exit_code in (1, 2)
    everything = [told.stdout, told.stderr, log.read_text()]
    everything += [path.read_text() for path in tmp_path.rglob("*.json*")]
    assert not any("geheim" in text for text in everything)
    assert "Traceback" not in told.stderr


@pytest.mark.parametrize("words", ["denoise a.ply -o b.ply", "info a.ply", "methods"])
def test_broken_secrets_are_wrong_use(monkeypatch, words):
    monkeypatch.setenv(urls.SECRETS, "{{{")
    told = msal(*words.split())
    assert told.exit_code == 2
    assert urls.SECRETS in told.stderr and "{{{" not in told.stderr


def test_reports_may_go_to_a_store(tmp_path, empty_store):
    (tmp_path / "a.ply").write_bytes(closed_scan())
    report = "memory://reports/r.json"
    told = msal("denoise", tmp_path / "a.ply", "-o", "memory://o/", "--report", report)
    assert told.exit_code == 0
    assert b'"written"' in read_whole(report)


def test_pipes_may_come_from_a_store_and_go_to_one(empty_store):
    write_whole("memory://p/a.ply", closed_scan())
    told = msal("denoise", "memory://p/a.ply", "-o", "-")
    assert told.exit_code == 0
    assert told.stdout_bytes[:3] == b"ply"
    assert msal_on(closed_scan(), "denoise", "-", "-o", "memory://p/b.ply").exit_code == 0
    assert read_whole("memory://p/b.ply") == told.stdout_bytes
