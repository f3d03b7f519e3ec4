"""Helpers compile what a first run will need: the right kernels, once, and never in the way."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time

import pytest

from benchmarks import needed_kernels, scans
from msal_cli.core import ahead, machine_code
from msal_cli.core.compiled import AUTO

pytestmark = pytest.mark.skipif(machine_code.fcntl is None, reason="the system has no such locks")

# One small kernel, so that a helper has little to do.
_SMALL = ("medians._counted", (("<u8", 1, "C", True, True), ("<i8", 1, "C", True, True)))
_HELP = (
    "from msal_cli.core import ahead\n"
    f"ahead.routes = lambda: {{'small': [{_SMALL!r}]}}\n"
    "ahead.help_on(['small'], 0)\n"
)
_HOLD = (
    "import sys\n"
    "from msal_cli.core import machine_code\n"
    "with machine_code.as_helper(0) as is_needed:\n"
    "    print(is_needed, flush=True)\n"
    "    sys.stdin.read()\n"
)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("MSAL_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def started(cache, monkeypatch):
    """Helpers that ``begin`` starts, as route and number; none of them really is."""
    started = []
    monkeypatch.setattr(ahead, "_start", lambda *told: started.append(told))
    monkeypatch.setattr(ahead, "usable_cores", lambda: 3)
    monkeypatch.setattr(ahead, "_free_bytes", lambda: float("inf"))
    monkeypatch.setattr(ahead, "_is_limited", lambda: False)
    monkeypatch.setenv("MSAL_THREADS", "3")
    monkeypatch.delenv("MSAL_COMPILE_AHEAD", raising=False)
    ahead._is_begun.clear()
    yield started
    ahead._is_begun.set()


def process(program):
    return subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def kept(cache):
    return [one.name.partition("-")[0] for one in cache.glob("*.msal-kernel")]


@pytest.fixture(scope="module")
def scan():
    return scans.large_torus(needed_kernels.AROUND)


@pytest.mark.parametrize("form", scans.FORMS)
def test_the_list_is_what_a_run_asks_for(form, scan, tmp_path):
    source = scans.file_of(tmp_path, "torus", form, lambda: scan)
    listed = {json.dumps(one) for one in json.loads(needed_kernels.TARGET.read_text())[form]}
    # If not: python -m benchmarks.needed_kernels --write
    assert listed == set(needed_kernels.asked_for(source, tmp_path))


@pytest.mark.parametrize("form", scans.FORMS)
def test_a_run_begins_helpers_for_its_own_kind_of_file(form, started):
    # The kernels that read a file are asked for first.
    first = {"ply": "connectivity._marked", "ply-ascii": "ply_plain.read_scalars"}
    first |= {"stl": "soup._indexed", "obj": "obj_plain.counted"}
    ahead.begin(*next(one for one in ahead.routes()[form] if one[0] == first[form]))
    assert started == [((form,), 0), ((form,), 1)]


def test_the_list_for_auto_is_what_it_asks_for_beside(tmp_path):
    listed = json.loads(needed_kernels.TARGET.read_text())
    default = [json.dumps(one) for one in listed["ply"]]
    wanted = {json.dumps(one) for one in listed[AUTO]}
    # If not: python -m benchmarks.needed_kernels --write
    assert wanted == set(needed_kernels.auto_asked_for(tmp_path, default))


def test_only_runs_that_expect_it_have_the_kernels_of_auto_compiled(started):
    ahead.begin(*ahead.routes()[AUTO][0])
    assert not started
    ahead._is_begun.clear()
    of_stl = next(one for one in ahead.routes()["stl"] if one[0] == "soup._indexed")
    ahead.begin(*of_stl, (AUTO,))
    assert started == [((AUTO, "stl"), 0), ((AUTO, "stl"), 1)]
    started.clear()
    ahead._is_begun.clear()
    # The default method's are in the cache.
    ahead.begin(*ahead.routes()[AUTO][0], (AUTO,))
    assert started == [((AUTO,), 0), ((AUTO,), 1)]


def test_there_is_a_helper_for_every_other_core_and_once(started, monkeypatch):
    ahead.begin(*ahead.routes()["ply"][0])
    ahead.begin(*ahead.routes()["ply"][1])
    assert started == [(("ply",), 0), (("ply",), 1)]
    monkeypatch.setenv("MSAL_THREADS", "64")
    monkeypatch.setattr(ahead, "usable_cores", lambda: 64)
    started.clear()
    ahead._is_begun.clear()
    ahead.begin(*ahead.routes()["ply"][0])
    assert len(started) == ahead.MOST_HELPERS


@pytest.mark.parametrize(
    "name, value",
    [("MSAL_THREADS", "1"), ("MSAL_COMPILE_AHEAD", "0"), ("MSAL_CACHE_DIR", os.devnull)],
)
def test_nobody_helps_where_it_is_not_wanted(started, monkeypatch, name, value):
    monkeypatch.setenv(name, value)
    ahead.begin(*ahead.routes()["ply"][0])
    assert not started


@pytest.mark.parametrize(
    "name, value", [("_free_bytes", ahead.ROOM_BYTES - 1), ("_is_limited", True)]
)
def test_nobody_helps_where_memory_is_short(started, monkeypatch, name, value):
    monkeypatch.setattr(ahead, name, lambda: value)
    ahead.begin(*ahead.routes()["ply"][0])
    assert not started


def test_an_unknown_kernel_begins_nothing(started):
    ahead.begin("medians._counted", ("int64",))
    assert not started


def test_one_set_helps_for_a_cache(cache, started):
    with process(_HOLD) as other:
        assert other.stdout.readline() == b"True\n"
        ahead.begin(*ahead.routes()["ply"][0])
        second = subprocess.run(
            [sys.executable, "-c", _HELP], stdin=subprocess.PIPE, capture_output=True
        )
        other.stdin.close()
    assert not started
    assert not kept(cache) and not second.stdout + second.stderr


def test_a_helper_keeps_what_is_listed_and_prints_nothing(cache):
    with process(_HELP) as helper:
        assert helper.wait() == 0
        assert helper.stdout.read() + helper.stderr.read() == b""
    assert kept(cache) == [_SMALL[0]]


def test_a_helper_ends_with_whoever_started_it(cache):
    parent = (
        "from msal_cli.core import ahead\n"
        "import os, subprocess, sys\n"
        "popen = subprocess.Popen\n"
        "def noted(*given, **options):\n"
        "    helper = popen(*given, **options)\n"
        "    print(helper.pid, flush=True)\n"
        "    return helper\n"
        "subprocess.Popen = noted\n"
        "ahead._start(('ply',), 0)\n"
        "sys.stdin.read()\n"
        "os._exit(1)\n"
    )
    with process(parent) as one:
        pid = int(one.stdout.readline())
        os.kill(pid, 0)
        one.kill()
    # Whoever outlived its parent would compile for seconds, and keep every kernel in turn.
    for _ in range(200):
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            break
        time.sleep(0.05)
    assert len(kept(cache)) < 3
    assert not list(cache.glob("*.tmp"))


def test_memory_that_a_container_leaves_counts(tmp_path):
    assert ahead._free_bytes(tmp_path) == float("inf")
    (tmp_path / "proc").mkdir()
    (tmp_path / "proc" / "meminfo").write_text("MemTotal: 9 kB\nMemAvailable:   2048 kB\n")
    assert ahead._free_bytes(tmp_path) == 2048 << 10
    group = tmp_path / "sys" / "fs" / "cgroup"
    group.mkdir(parents=True)
    (group / "memory.max").write_text("max\n")
    (group / "memory.current").write_text("5\n")
    assert ahead._free_bytes(tmp_path) == 2048 << 10
    (group / "memory.max").write_text("1000005\n")
    assert ahead._free_bytes(tmp_path) == 1000000
