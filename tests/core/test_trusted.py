"""Machine code is taken only from files that nobody else can have written."""

from __future__ import annotations

import logging
import os
import stat

import numpy as np
import pytest

from msal_cli.core import machine_code, trusted
from msal_cli.core.compiled import Kernel
from tests.core.test_compiled import again, scaled

pytestmark = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="owners of POSIX")

as_root = pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root may give files away"
)


@pytest.fixture(autouse=True)
def fresh_warnings():
    machine_code._warn.cache_clear()


@pytest.fixture
def cache(tmp_path, monkeypatch):
    folder = tmp_path / "above" / "cache"
    folder.mkdir(parents=True)
    monkeypatch.setenv("MSAL_CACHE_DIR", str(folder))
    monkeypatch.setenv("MSAL_COMPILE_AHEAD", "0")
    return folder


@pytest.fixture
def counted(monkeypatch):
    made = []
    real = Kernel._compiled
    monkeypatch.setattr(
        Kernel, "_compiled", lambda self, kinds: made.append(self.__name__) or real(self, kinds)
    )
    return made


def run():
    result = np.empty(2)
    again(scaled)(np.ones(2), result)
    assert (result == 3.0).all()


def kept(folder):
    return sorted(folder.glob("*.msal-kernel"))


@pytest.mark.parametrize("mode", [0o777, 0o775, 0o757])
@pytest.mark.parametrize("which", ["cache", "above"])
def test_a_folder_that_others_may_write_is_not_used(cache, counted, caplog, mode, which):
    run()
    (one,) = kept(cache)
    folder = cache if which == "cache" else cache.parent
    folder.chmod(mode)
    with caplog.at_level(logging.WARNING, "msal.core"):
        run()
        run()
    assert counted == ["scaled"] * 3
    assert kept(cache) == [one]
    (record,) = caplog.records
    assert str(folder) in record.getMessage() and "MSAL_CACHE_DIR" in record.getMessage()
    folder.chmod(0o755)
    run()
    assert len(counted) == 3


@as_root
@pytest.mark.parametrize("which", ["cache", "above", "file"])
def test_what_belongs_to_another_user_is_not_used(cache, counted, which):
    run()
    (one,) = kept(cache)
    os.chown({"cache": cache, "above": cache.parent, "file": one}[which], 12345, 12345)
    run()
    assert counted == ["scaled"] * 2


def test_a_file_that_others_may_write_is_made_again(cache, counted):
    run()
    (one,) = kept(cache)
    one.chmod(0o666)
    run()
    assert counted == ["scaled"] * 2
    assert stat.S_IMODE(one.stat().st_mode) & 0o022 == 0
    run()
    assert counted == ["scaled"] * 2


@pytest.mark.parametrize("kind", ["pipe", "link"])
def test_what_is_no_file_is_not_opened(cache, counted, tmp_path, kind):
    run()
    (one,) = kept(cache)
    one.rename(tmp_path / "moved")
    if kind == "pipe":
        os.mkfifo(one)
    else:
        one.symlink_to(tmp_path / "moved")
    run()
    assert counted == ["scaled"] * 2


def test_an_open_umask_opens_nothing(tmp_path, monkeypatch, counted):
    cache = tmp_path / "new" / "cache"
    monkeypatch.setenv("MSAL_CACHE_DIR", str(cache))
    monkeypatch.setenv("MSAL_COMPILE_AHEAD", "0")
    before = os.umask(0)
    try:
        run()
    finally:
        os.umask(before)
    places = [cache.parent, cache, *cache.iterdir()]
    assert len(places) >= 3
    assert not any(stat.S_IMODE(one.stat().st_mode) & 0o022 for one in places)
    run()
    assert counted == ["scaled"]


def test_a_folder_of_all_is_safe_for_what_lies_in_it(tmp_path):
    (tmp_path / "tmp").mkdir()
    (tmp_path / "tmp").chmod(0o1777)
    refusals = []
    assert trusted.only_trusted([tmp_path / "tmp/mine"], refusals) == [tmp_path / "tmp/mine"]
    assert trusted.only_trusted([tmp_path / "tmp"], refusals) == []
    assert refusals == [f"others may write the folder {str(tmp_path / 'tmp')!r}"]


def test_links_on_the_way_are_resolved_first(tmp_path):
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    (tmp_path / "cache").symlink_to("open/cache")
    refusals = []
    assert trusted.only_trusted([tmp_path / "cache"], refusals) == []
    assert str(tmp_path / "open") in refusals[0]
