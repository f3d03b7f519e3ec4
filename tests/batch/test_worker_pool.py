"""Real processes that crash, hang, chatter and are killed: each costs the task in hand only."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
import types
from pathlib import Path

import pytest

from msal_cli.batch import workers
from msal_cli.batch.schedule import Failed, Interrupt, Progress, Retried, Started, Work
from msal_cli.batch.workers import WorkerPool
from msal_cli.errors import ResourceError
from tests.batch import fakes
from tests.batch.fakes import heard, lost, pool, results

posix = pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")


@pytest.fixture(autouse=True)
def children():
    """Gives the living child processes of this one that came with the test."""
    # Other tests of this process leave some on purpose, such as trackers.
    strangers = set(fakes.children_of(os.getpid()))
    return lambda: set(fakes.children_of(os.getpid())) - strangers


def test_every_task_is_done_once_and_workers_are_gone_afterwards(children):
    before = threading.active_count()
    messages = heard(pool([("double", n) for n in range(20)]))
    assert results(messages) == {n: 2 * n for n in range(20)}
    assert [one.index for one in messages if isinstance(one, Started)] == list(range(20))
    assert not children()
    assert threading.active_count() == before


def test_no_more_workers_than_tasks_and_each_knows_its_threads():
    assert len(set(results(heard(pool([("pid", 0)], jobs=8))).values())) == 1
    assert results(heard(pool([("threads", 0)] * 2, jobs=2, cores=9))) == {0: "4", 1: "4"}
    assert results(heard(pool([("threads", 0)] * 2, jobs=2, cores=1))) == {0: "1", 1: "1"}


def test_common_and_progress_arrive():
    messages = heard(pool([("common", 0), ("progress", 1000)], common={"a": 1}))
    assert results(messages)[0] == {"a": 1}
    steps = [one for one in messages if isinstance(one, Progress)]
    assert steps[0] == Progress(1, "sweeps", 0, 1000)
    assert steps[-1] == Progress(1, "sweeps", 1000, 1000)
    assert len(steps) < 100, "progress is thinned out"


@pytest.mark.parametrize(
    ("how", "cause", "words"),
    [
        pytest.param("kill", "crash", "SIGKILL", marks=posix),
        pytest.param("segfault", "crash", "SIGSEGV", marks=[posix, pytest.mark.ci]),
        pytest.param("abort", "crash", "SIGABRT", marks=[posix, pytest.mark.ci]),
        ("exit", "crash", "exit status 3"),
        ("memory", "memory", "not enough memory"),
    ],
)
def test_a_task_that_kills_its_workers_is_lost_alone(how, cause, words):
    tasks = [("double", n) for n in range(12)]
    tasks[4] = (how, 0)
    messages = heard(pool(tasks))
    assert results(messages) == {n: 2 * n for n in range(12) if n != 4}
    (one,) = lost(messages).values()
    assert (one.index, one.cause) == (4, cause)
    assert words in one.reason
    assert [type(m) for m in messages if m.index == 4] == [Started, Retried, Started, Failed]
    assert messages[-1] is one, "the second try comes after everything else"


@pytest.mark.parametrize("how", ["error", "sysexit", "unpicklable"])
def test_an_exception_costs_one_task_and_no_worker(how):
    messages = heard(pool([("pid", 0), (how, 0), ("pid", 0)], jobs=1))
    assert lost(messages)[1].cause == "exception"
    assert results(messages)[0] == results(messages)[2]
    assert not [one for one in messages if isinstance(one, Retried)]


@posix
def test_the_second_try_is_alone_in_a_fresh_worker(tmp_path):
    others = [("present", str(tmp_path))] * 6
    messages = heard(pool([("alone", str(tmp_path)), *others], jobs=3))
    assert results(messages)[0] == (1, False)


def test_prints_of_a_library_reach_neither_the_protocol_nor_our_output(capfd, caplog):
    caplog.set_level("DEBUG", logger="msal")
    messages = heard(pool([("chatter", 300_000), ("double", 4)], jobs=1))
    assert results(messages) == {0: "", 1: 8}
    assert capfd.readouterr() == ("", "")
    assert any("zzz" in record.getMessage() for record in caplog.records)
    assert any("yyy" in record.getMessage() for record in caplog.records)


@pytest.mark.parametrize(
    ("retries", "end"), [(0, ""), (1, ", as at the first try"), (2, " (3 tries)")]
)
def test_a_lost_task_is_retried_so_often_and_then_failed(retries, end):
    messages = heard(pool([("exit", 0)], jobs=1, retries=retries))
    assert [one.index for one in messages if isinstance(one, Retried)] == [0] * retries
    assert lost(messages)[0].reason == f"the worker ended with exit status 3{end}"


class TestReplacement:
    def test_after_a_number_of_files(self, monkeypatch):
        monkeypatch.setattr(workers, "_FILES_PER_WORKER", 3)
        pids = results(heard(pool([("pid", 0)] * 7, jobs=1)))
        assert pids[0] == pids[2] != pids[3] == pids[5] != pids[6]

    @pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is not told")
    def test_when_memory_has_grown(self, monkeypatch):
        megabyte = 1 << 20
        tasks = [("grow", 0), *[("grow", 30 * megabyte)] * 3, *[("grow", 0)] * 2]
        monkeypatch.setattr(workers, "_GROWTH_BYTES", 70 * megabyte)
        pids = results(heard(pool(tasks, jobs=1)))
        assert pids[0] == pids[3] != pids[4] == pids[5]


def test_interrupt_ends_all_within_two_seconds_and_keeps_what_was_done(children):
    deaths = []
    tasks = [("double", 1), ("sleep", 60), ("sleep", 60)]
    one = pool(tasks, on_death=lambda pid, index: deaths.append(index))
    messages = []
    started = 0.0
    with pytest.raises(Interrupt):
        for batch in one.batches():
            messages += batch
            if len([m for m in messages if isinstance(m, Started)]) == 3 and not started:
                started = time.monotonic()
                one.interrupt()
    assert time.monotonic() - started < 2.0
    assert results(messages) == {0: 2}
    assert sorted(deaths) == [1, 2]
    assert not children()


@posix
def test_a_worker_that_dies_before_it_starts_is_not_the_files_fault(monkeypatch, children):
    monkeypatch.setattr(workers, "_BOOT", "import sys; print('no way', file=sys.stderr); exit(7)")
    with pytest.raises(ResourceError, match=r"exit status 7; no way"):
        heard(pool([("double", 1)] * 5))
    assert not children()


def test_a_worker_that_cannot_import_the_work_says_so(monkeypatch, children):
    here = types.ModuleType("only_in_the_parent")
    exec("def work(task, common, on_progress): pass", here.__dict__)
    monkeypatch.setitem(sys.modules, "only_in_the_parent", here)
    with pytest.raises(ResourceError, match="No module named 'only_in_the_parent'"):
        heard(WorkerPool(Work({0: 0}, here.work, None)))
    assert not children()


def test_no_worker_at_all_is_a_resource_error(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/no/such/python")
    with pytest.raises(ResourceError, match="no worker can be started: No such file"):
        heard(pool([("double", 1)]))


@posix
def test_workers_end_when_the_parent_is_killed(tmp_path):
    code = (
        "from tests.batch import fakes\n"
        "some = fakes.pool([('sleep', 60)] * 2)\n"
        "for batch in some.batches():\n"
        "    if len([w for w in some._workers if w.current_task is not None]) == 2:\n"
        "        print(*[w.pid for w in some._workers], flush=True)\n"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        cwd=Path(fakes.__file__).parents[2],
        text=True,
    )
    with parent:
        pids = [int(word) for word in parent.stdout.readline().split()]
        assert len(pids) == 2 and all(fakes.is_running(pid) for pid in pids)
        parent.kill()
    assert fakes.are_gone(pids)
