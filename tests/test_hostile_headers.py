"""Files that lie, from `benchmarks/hostile_headers.py`: each refused, at hardly any cost."""

from __future__ import annotations

import sys

import pytest

from benchmarks import hostile_headers
from benchmarks.hostile_headers import MOST_BYTES, MOST_SECONDS, lies, refused

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="reads /proc and writes holes"),
    pytest.mark.ci,
]


def test_every_lie_is_refused(tmp_path):
    all_lies = list(lies())
    assert len(all_lies) >= 50
    assert len({lie.name for lie in all_lies}) == len(all_lies)
    found = refused(all_lies, tmp_path)
    assert [(lie.name, lie.code) for lie in all_lies] == [
        (lie.name, code) for lie, (code, _, _) in zip(all_lies, found, strict=True)
    ]
    # Generous, since the machine may be slow; the table has the figures.
    assert max(seconds for _, seconds, _ in found) < 10 * MOST_SECONDS
    assert sum(grown for _, _, grown in found) < MOST_BYTES


def test_the_measure_notices_what_is_dear(tmp_path):
    text = hostile_headers.GOOD[".ply"].replace(b"0 0 1\n3", b"0 0 1" + b" " * 50_000_000 + b"\n3")
    whole = hostile_headers.lie("whole.ply", "ok", text)
    ((code, _, grown),) = refused([whole], tmp_path)
    assert code == "ok"
    assert grown > 40_000_000
