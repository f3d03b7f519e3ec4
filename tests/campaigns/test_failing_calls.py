"""Every call to the system that a run makes while it writes is made to fail, one after another.

python -m pytest tests/campaigns/test_failing_calls.py -m slow -s
"""

import csv
import errno
import io
import json
import os
import re
import shutil
import subprocess

import pytest

from tests.campaigns.runs import IS_LINUX, command, contents, ended
from tests.cli.scans import closed_scan, folder_of, msal, open_scan

CALLS = (
    *("open", "write", "fsync", "close", "replace", "rename", "link", "chmod", "mkdir"),
    *("unlink", "truncate", "scandir"),
)
ERRORS = (errno.EIO, errno.ENOSPC, errno.EACCES)

pytestmark = [pytest.mark.skipif(not IS_LINUX, reason="looks into /proc"), pytest.mark.ci]

REASON = re.compile(r"\(E_(?!INTERNAL)[A-Z]+\)|error: the folder .* cannot be listed")


class Failing:
    """Makes the ``at``-th call among CALLS, and among openings of files, fail with ``number``."""

    def __init__(self, monkeypatch, folder, at, number):
        self.folder, self.at, self.number = str(folder), at, number
        self.calls = []
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


@pytest.mark.parametrize("step", [6, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("way", ["new", "over an old one", "in place"])
def test_whatever_call_fails_the_output_is_whole(tmp_path, monkeypatch, way, step):
    """Make every ``step``-th call fail, one a run, with the errors in turn."""
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
    for at in range(len(way) % step + 1, 1000, step):
        shutil.rmtree(output)
        if way == "in place":
            shutil.copytree(tmp_path / "kept", output)
        elif old:
            shutil.copytree(tmp_path / "earlier", output)
        (tmp_path / "r.json").unlink(missing_ok=True)
        with monkeypatch.context() as patch:
            failing = Failing(patch, tmp_path, at, ERRORS[at % len(ERRORS)])
            made = msal(*words)
        if not failing.has_failed:
            break
        n_calls += 1
        what = f"call {at}, {failing.calls[at - 1]}"
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
    assert n_failed and n_calls > 15 // step


def test_a_manifest_that_is_full_hides_nothing(tmp_path):
    """What was written is counted, although it cannot be noted, and the report is written."""
    scans = folder_of(tmp_path / "in", **{f"s{n:02}": closed_scan(n) for n in range(24)})
    report = tmp_path / "r.csv"
    words = command(scans, tmp_path / "out", "-j", "2", "--report", report)

    def limit():
        import resource

        # Enough for an output and for the report; the manifest of all files is larger.
        resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, resource.RLIM_INFINITY))

    made = subprocess.run(words, capture_output=True, preexec_fn=limit, check=False)
    assert made.returncode == 1, made.stderr
    assert b"manifest" in made.stderr and b"File too large" in made.stderr
    there = sorted(contents(tmp_path / "out"))
    assert 0 < len(there) < 24
    rows = list(csv.DictReader(io.StringIO(report.read_text())))
    reported = {row["output"].rpartition("/")[2] for row in rows if row["status"] == "written"}
    assert sorted(reported) == there
    assert ended(words)[0] == 0
    assert len(contents(tmp_path / "out")) == 24
