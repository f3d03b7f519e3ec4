"""One mesh by tiles on several processes that share a folder."""

from __future__ import annotations

import os
import time

import pytest

from msal_cli.batch import tile_claims
from msal_cli.batch.shard import Shard
from msal_cli.batch.tile_claims import claim
from tests.batch import giants
from tests.batch.giants import in_memory, n_finished
from tests.batch.test_tile_run import METHOD, names, output, small_tiles, source, tmp_path

__all__ = ["output", "small_tiles", "source", "tmp_path"]


def owner_of(source, count=2):
    """The shard to which a file belongs."""
    return next(k for k in range(1, count + 1) if Shard(k, count).has(source.name))


def shard(source, output, number, count=2, *words):
    return giants.start_slowly(
        "denoise", source, "-o", output, "--tiled", "-v", "-j1", *METHOD,
        "--shard", f"{number}/{count}", *words,
    )  # fmt: skip


def end(process, seconds=60):
    printed = process.communicate(timeout=seconds)[1]
    return process.returncode, printed


def test_shards_take_tasks_of_one_file(source, output):
    expected = in_memory(source, *METHOD)
    number = owner_of(source)
    leader, helper = shard(source, output, number), shard(source, output, 3 - number)
    for process in (leader, helper):
        status, printed = end(process)
        assert status == 0, printed
    assert "taking tiles" in printed
    assert output.read_bytes() == expected
    assert names(output.parent) == ["b.ply"]


@pytest.mark.slow
def test_a_dead_helper_costs_a_while(source, output):
    expected = in_memory(source, *METHOD)
    number = owner_of(source)
    leader, helper = shard(source, output, number), shard(source, output, 3 - number)
    giants.wait_for(lambda: n_finished(output) >= 5, helper)
    helper.kill()
    helper.communicate()
    status, printed = end(leader)
    assert status == 0, printed
    assert output.read_bytes() == expected
    assert names(output.parent) == ["b.ply"]


@pytest.mark.slow
def test_a_dead_leader_goes_on_where_its_helper_came_to(source, output):
    expected = in_memory(source, *METHOD)
    number = owner_of(source)
    leader, helper = shard(source, output, number), shard(source, output, 3 - number)
    giants.wait_for(lambda: n_finished(output) >= 5, leader)
    leader.kill()
    leader.communicate()
    status, printed = end(helper)
    assert status == 0, printed
    assert not output.exists()
    kept = n_finished(output)
    assert kept > 10
    status, printed = end(shard(source, output, number))
    assert status == 0, printed
    assert output.read_bytes() == expected
    assert names(output.parent) == ["b.ply"]


def test_claims_exclude_and_are_taken_over(tmp_path, monkeypatch):
    with claim(tmp_path, "count", "0") as mine, claim(tmp_path, "count", "0") as other:
        assert mine and not other
        with claim(tmp_path, "count", "1") as another:
            assert another
    assert names(tmp_path / "claims/count") == []
    path = tmp_path / "claims/count/0"
    path.touch()
    with claim(tmp_path, "count", "0") as mine:
        assert not mine
    os.utime(path, (time.time() - 100, time.time() - 100))
    with claim(tmp_path, "count", "0") as mine:
        assert mine
    monkeypatch.setattr(tile_claims, "TOUCHED_EVERY_S", 0.01)
    with claim(tmp_path, "count", "0") as mine:
        os.utime(path, (1, 1))
        time.sleep(0.1)
        assert mine and time.time() - path.stat().st_mtime < 50
    with claim(tmp_path / "gone", "count", "0") as mine:
        assert not mine
    assert not (tmp_path / "gone").exists()
