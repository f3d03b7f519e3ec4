"""Every call to the system that a run makes while it writes is made to fail, one after another.

python -m pytest tests/campaigns/test_failing_calls.py -m slow -s
"""

from __future__ import annotations

import errno
import io
import json
import os
import re
import shutil
import sys

import pytest

from tests.campaigns.runs import IS_LINUX, contents
from tests.cli.scans import folder_of, msal, open_scan

CALLS = (
    "open",
    "write",
    "fsync",
    "close",
    "replace",
    "rename",
    "link",
    "chmod",
    "mkdir",
    "unlink",
    "truncate",
    "scandir",
)
ERRORS = (errno.EIO, errno.ENOSPC, errno.EACCES)

pytestmark = pytest.mark.skipif(not IS_LINUX, reason="looks into /proc")

REASON = re.compile(r"\(E_(?!INTERNAL)[A-Z]+\)|error: the folder .* cannot be listed")


def called_by():
    """The functions of msal that led here, innermost first."""
    frame, found = sys._getframe(1), []
    while frame is not None:
        if "/msal_cli/" in frame.f_code.co_filename:
            found.append(frame.f_code.co_qualname)
        frame = frame.f_back
    return found[:6]


class Failing:
    """Makes the ``at``-th call among CALLS, and among openings of files, fail with ``number``."""

    def __init__(self, monkeypatch, folder, at, number):
        self.folder, self.at, self.number = str(folder), at, number
        self.calls, self.stack = [], []
        for name in CALLS:
            monkeypatch.setattr(os, name, self.counted(name, getattr(os, name)))
        monkeypatch.setattr(io, "open", self.counted("open", io.open))
        monkeypatch.setattr("builtins.open", self.counted("open", open))

    def counted(self, name, real):
        def call(*given, **options):
            if isinstance(given[0], int):
                # Pipes and descriptors of others do not lead to the disk.
                is_ours = os.readlink(f"/proc/self/fd/{given[0]}").startswith(self.folder)
            else:
                is_ours = os.fspath(given[0]).startswith(self.folder)
            if not is_ours:
                return real(*given, **options)
            self.calls.append((name, given[0]))
            if len(self.calls) != self.at:
                return real(*given, **options)
            self.stack = called_by()
            # What the system has closed is closed, whatever it tells; what is full takes some.
            if name == "close":
                real(*given)
            if name == "write":
                real(given[0], bytes(given[1])[: len(given[1]) // 2])
            raise OSError(self.number, os.strerror(self.number), given[0])

        return call

    @property
    def has_failed(self):
        return len(self.calls) >= self.at


WAYS = pytest.mark.parametrize("way", ["new", "over an old one", "in place"])


@WAYS
def test_whatever_call_fails_the_output_is_whole(tmp_path, monkeypatch, way):
    # A quarter of the calls, other ones each way: the slow campaign takes them all.
    begin = 1 + ["new", "over an old one", "in place"].index(way)
    every_call(tmp_path, monkeypatch, ERRORS, way, range(begin, 1000, 4))


@WAYS
@pytest.mark.slow
@pytest.mark.parametrize("number", ERRORS, ids=errno.errorcode.get)
def test_whatever_call_fails_with_whatever_error(tmp_path, monkeypatch, number, way):
    n_calls, n_failed = every_call(tmp_path, monkeypatch, [number], way, range(1, 1000))
    assert n_calls > 15 and n_failed > 5
    print(f"\n{errno.errorcode[number]}, {way}: {n_calls} calls, {n_failed} runs failed")


def every_call(tmp_path, monkeypatch, numbers, way, calls):
    """Make these calls fail, one a run, with the errors in turn; how many, and failed runs."""
    scans = folder_of(tmp_path / "in", a=open_scan())
    target = ["--in-place"] if way == "in place" else ["-o", tmp_path / "out"]
    words = ["denoise", scans, "--method", "msal", *target, "--report", tmp_path / "r.json"]
    output = tmp_path / ("in" if way == "in place" else "out")
    # What is to be in the folder in the end, and what it holds now.
    shutil.copytree(scans, tmp_path / "kept")
    assert msal(*words).exit_code == 0
    wanted = contents(output)
    old = {}
    if way == "over an old one":
        assert msal(*words, "-n", "1").exit_code == 0
        shutil.copytree(output, tmp_path / "earlier")
        old = contents(output)
    elif way == "in place":
        old = contents(tmp_path / "kept")
    assert old.get("a.ply") != wanted["a.ply"]

    n_calls = n_failed = 0
    for at in calls:
        shutil.rmtree(output)
        if way == "in place":
            shutil.copytree(tmp_path / "kept", output)
        elif old:
            shutil.copytree(tmp_path / "earlier", output)
        (tmp_path / "r.json").unlink(missing_ok=True)
        with monkeypatch.context() as patch:
            failing = Failing(patch, tmp_path, at, numbers[at % len(numbers)])
            made = msal(*words)
        if not failing.has_failed:
            break
        n_calls += 1
        what = f"call {at}, {failing.calls[at - 1]}, {failing.stack}"
        n_failed += made.exit_code != 0
        present = contents(output) if output.exists() else {}
        assert "Traceback" not in made.stderr and "nternal" not in made.stderr, what
        assert made.exit_code in (0, 1) or present == old, (what, made.exit_code, made.stderr)
        left = [name for name in present if name.endswith(".tmp")]
        # Nothing can be done if the one call that would remove it is the one that fails.
        assert not left or failing.calls[at - 1][0] in ("unlink", "scandir"), what
        assert present.get("a.ply") in (wanted["a.ply"], old.get("a.ply")), what
        if way == "in place" and present["a.ply"] != old["a.ply"]:
            assert present["a.ply.orig"] == old["a.ply"], what
        if made.exit_code == 0:
            assert present["a.ply"] == wanted["a.ply"], what
        else:
            assert REASON.search(made.stderr), (what, made.stderr)
        # Whatever it was, the same command now does the rest.
        again = msal(*words)
        assert again.exit_code == 0, (what, again.stderr)
        after = contents(output)
        assert {name: after[name] for name in wanted} == wanted, what
        if (tmp_path / "r.json").exists():
            json.loads((tmp_path / "r.json").read_bytes())
    assert n_failed and n_calls < len(calls)
    return n_calls, n_failed
