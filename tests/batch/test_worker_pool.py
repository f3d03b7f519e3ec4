"""Real processes that crash, hang, chatter, grow and are killed: each costs its task only."""

import json
import os
import subprocess
import sys
import threading
import time
import types
from pathlib import Path

import pytest

from msal_cli.batch import workers
from msal_cli.batch.run import _warn_of_memory
from msal_cli.batch.schedule import Failed, Interrupt, Progress, Retried, Started, Work
from msal_cli.batch.workers import WorkerPool
from msal_cli.errors import ResourceError
from msal_cli.job.settings import Limits
from tests.batch import fakes, test_run
from tests.batch.fakes import lost, pool, results
from tests.batch.test_run import obj
from tests.cli.scans import msal
from tests.files import posix
from tests.report.made import written

linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs Linux")


def heard(tasks, **options):
    return fakes.heard(pool(tasks, **options))


@pytest.fixture(autouse=True)
def children():
    """Gives the living child processes of this one that came with the test."""
    # Other tests of this process leave some on purpose, such as trackers.
    strangers = set(fakes.children_of(os.getpid()))
    return lambda: set(fakes.children_of(os.getpid())) - strangers


def test_every_task_is_done_once_and_workers_are_gone_afterwards(children):
    before = threading.active_count()
    messages = heard([("double", n) for n in range(20)])
    assert results(messages) == {n: 2 * n for n in range(20)}
    assert [one.index for one in messages if isinstance(one, Started)] == list(range(20))
    assert not children()
    assert threading.active_count() == before


def test_no_more_workers_than_tasks_and_each_knows_its_threads():
    assert len(set(results(heard([("pid", 0)], jobs=8)).values())) == 1
    assert results(heard([("threads", 0)] * 2, jobs=2, cores=9)) == {0: "4", 1: "4"}
    assert results(heard([("threads", 0)] * 2, jobs=2, cores=1)) == {0: "1", 1: "1"}


def test_common_and_progress_arrive():
    messages = heard([("common", 0), ("progress", 1000)], common={"a": 1})
    assert results(messages)[0] == {"a": 1}
    steps = [one for one in messages if isinstance(one, Progress)]
    assert steps[0] == Progress(1, "sweeps", 0, 1000)
    assert steps[-1] == Progress(1, "sweeps", 1000, 1000)
    assert len(steps) < 100, "progress is thinned out"


@posix
def test_tasks_that_kill_their_workers_are_lost_alone():
    deaths = {
        2: ("kill", "E_CRASH", "SIGKILL"),
        5: ("segfault", "E_CRASH", "SIGSEGV"),
        7: ("exit", "E_CRASH", "exit status 3"),
        8: ("memory", "E_MEMORY", "not enough memory"),
    }
    messages = heard([(deaths.get(n, ["double"])[0], n) for n in range(12)])
    assert results(messages) == {n: 2 * n for n in range(12) if n not in deaths}
    for index, one in lost(messages).items():
        _, cause, words = deaths[index]
        assert one.failure.code == cause and words in one.failure.message
        tries = [type(m) for m in messages if m.index == index]
        assert tries == [Started, Retried, Started, Failed]
    assert lost(messages).keys() == deaths.keys()
    # The second tries come after everything else.
    last = max(k for k, m in enumerate(messages) if m.index not in deaths)
    assert not any(isinstance(m, Failed) for m in messages[:last])


def test_an_exception_costs_one_task_and_no_worker():
    hows = ("error", "sysexit", "unpicklable")
    messages = heard([("pid", 0), *((how, 0) for how in hows), ("pid", 0)], jobs=1)
    assert [one.failure.code for one in lost(messages).values()] == ["E_INTERNAL"] * 3
    assert results(messages)[0] == results(messages)[4]
    assert not [one for one in messages if isinstance(one, Retried)]


@posix
def test_the_second_try_is_alone_in_a_fresh_worker(tmp_path):
    others = [("present", str(tmp_path))] * 6
    messages = heard([("alone", str(tmp_path)), *others], jobs=3)
    assert results(messages)[0] == (1, False)


def test_prints_of_a_library_reach_neither_the_protocol_nor_our_output(capfd, caplog):
    caplog.set_level("DEBUG", logger="msal")
    messages = heard([("chatter", 300_000), ("double", 4)], jobs=1)
    assert results(messages) == {0: "", 1: 8}
    assert capfd.readouterr() == ("", "")
    assert any("zzz" in record.getMessage() for record in caplog.records)
    assert any("yyy" in record.getMessage() for record in caplog.records)


@pytest.mark.parametrize(("retries", "end"), [(0, ""), (2, " (3 tries)")])
def test_a_lost_task_is_retried_so_often_and_then_failed(retries, end):
    messages = heard([("exit", 0)], jobs=1, retries=retries)
    assert [one.index for one in messages if isinstance(one, Retried)] == [0] * retries
    assert lost(messages)[0].failure.message == f"the worker ended with exit status 3{end}"


class TestReplacement:
    def test_after_a_number_of_files(self, monkeypatch):
        monkeypatch.setattr(workers, "_FILES_PER_WORKER", 2)
        pids = results(heard([("pid", 0)] * 4, jobs=1))
        assert pids[0] == pids[1] != pids[2] == pids[3]

    @pytest.mark.skipif(
        not Path("/proc/self/statm").exists(), reason="the system reports no memory"
    )
    def test_when_memory_has_grown(self, monkeypatch):
        megabyte = 1 << 20
        tasks = [("grow", 0), *[("grow", 30 * megabyte)] * 3, *[("grow", 0)] * 2]
        monkeypatch.setattr(workers, "_GROWTH_BYTES", 70 * megabyte)
        pids = results(heard(tasks, jobs=1))
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
        heard([("double", 1)] * 5)
    assert not children()


def test_a_worker_that_cannot_import_the_work_says_so(monkeypatch, children):
    here = types.ModuleType("only_in_the_parent")
    exec("def work(task, common, on_progress): pass", here.__dict__)
    monkeypatch.setitem(sys.modules, "only_in_the_parent", here)
    with pytest.raises(ResourceError, match="No module named 'only_in_the_parent'"):
        fakes.heard(WorkerPool(Work({0: 0}, here.work, None)))
    assert not children()


def test_no_worker_at_all_is_a_resource_error(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/no/such/python")
    with pytest.raises(ResourceError, match="no worker can be started: No such file"):
        heard([("double", 1)])


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


# Time, memory and giving up


class TestTime:
    def test_a_task_that_hangs_is_lost_alone_and_the_others_are_done(self):
        deaths = []
        messages = heard(
            [("double", 1), ("sleep", 60), ("double", 3)],
            limits=Limits(timeout_s=0.4),
            on_death=lambda pid, index: deaths.append(index),
        )
        assert results(messages) == {0: 2, 2: 6}
        (one,) = lost(messages).values()
        assert (one.index, one.failure.code) == (1, "E_TIMEOUT")
        assert "0.4 s" in one.failure.message and "--timeout" in one.failure.hint
        assert [type(m) for m in messages if m.index == 1] == [Started, Retried, Started, Failed]
        assert deaths == [1, 1]

    def test_a_worker_that_never_gets_ready_is_given_up(self, monkeypatch):
        monkeypatch.setattr(workers, "_READY_WITHIN_S", 0.2)
        monkeypatch.setattr(workers, "_BOOT", "import time; time.sleep(60)")
        with pytest.raises(workers.ResourceError, match="end before they start"):
            heard([("double", 1)])


def test_an_objection_ends_the_tries():
    messages = heard([("exit", 0)], on_loss=lambda index: f"task {index} is spoilt")
    assert lost(messages)[0].failure.code == "E_CHANGED"
    assert "task 0 is spoilt" in lost(messages)[0].failure.message


class TestMemory:
    @linux
    def test_the_system_refuses_more(self):
        messages = heard(
            [("grow", 10 << 20), ("grow", 600 << 20), ("double", 2)],
            limits=Limits(memory_bytes=300_000_000),
            jobs=1,
            retries=0,
        )
        assert set(results(messages)) == {0, 2}
        one = lost(messages)[1]
        assert one.failure.code == "E_MEMORY" and "300 MB" in one.failure.message
        assert "--memory-limit" in one.failure.hint

    @linux
    def test_where_the_system_cannot_the_worker_looks_itself(self, monkeypatch):
        boot = workers._BOOT.replace(
            "serve; serve()",
            "serve; import msal_cli.batch.workers as w, sys; sys.platform = 'other'; serve()",
        )
        monkeypatch.setattr(workers, "_BOOT", boot)
        limits = Limits(memory_bytes=300_000_000)
        messages = heard([("hold", 400 << 20), ("double", 2)], limits=limits, jobs=1, retries=0)
        assert lost(messages)[0].failure.code == "E_MEMORY"
        assert results(messages) == {1: 4}

    @posix
    def test_a_library_that_aborts_at_the_limit_ran_out_of_memory(self):
        limits = Limits(memory_bytes=300_000_000)
        messages = heard([("bad_alloc", 0), ("abort", 0)], limits=limits, jobs=1, retries=0)
        assert [one.failure.code for one in lost(messages).values()] == ["E_MEMORY", "E_CRASH"]

    def test_one_that_fits_with_no_other_has_all_cores(self):
        tasks = [("threads", 0)] * 3
        messages = heard(tasks, weights={1: 90}, light_bytes=20, budget_bytes=100)
        assert results(messages) == {0: "1", 1: "2", 2: "1"}
        assert next(one.index for one in messages if isinstance(one, Started)) == 1


def ran(folder, texts, *, in_place=False, backup=".orig", **options):
    (folder / "in").mkdir(exist_ok=True)
    test_run.fill(folder, 0, **texts)
    plan = test_run.plan_of(folder, in_place=in_place, backup=backup if in_place else None)
    return test_run.ran(folder, plan=plan, **({"engine": None, "jobs": 1} | options))


class TestRun:
    def test_one_file_with_a_limit_of_time_is_supervised(self, tmp_path):
        (one,) = ran(tmp_path, {"a": "sleep 60"}, limits=Limits(timeout_s=0.4), retries=0)
        assert one.error.code == "E_TIMEOUT"

    @pytest.mark.parametrize("most", [1, 2])
    def test_after_so_many_failures_nothing_more_is_begun(self, tmp_path, most):
        texts = {"a": "x", "b": "fail", "c": "fail", "d": "x", "e": "x"}
        begun = []

        def on_event(event):
            if isinstance(event, Started):
                begun.append("abcde"[event.index])

        # The workers' own way to stop, and that of a run.
        options = {"engine": None if most == 2 else fakes.InProcess, "stop_after_failures": most}
        records = ran(tmp_path, texts, on_event=on_event, **options)
        assert begun == ["a", "b", "c"][: most + 1]
        states = ["written", "failed", "failed", "planned", "planned"]
        assert [one.status for one in records] == [*states[: most + 1], *["planned"] * (4 - most)]
        again = ran(tmp_path, texts, engine=fakes.InProcess)
        assert {one.status for one in again} == {"up-to-date", "failed", "written"}


@posix
def test_without_a_backup_it_is_never_denoised_twice(tmp_path):
    """The worker dies after it has replaced the file: ``replaced`` in it is the order to."""
    records = ran(tmp_path, {"a": "replaced once", "b": "x"}, in_place=True, backup=None)
    assert records[0].error.code == "E_CHANGED"
    assert (tmp_path / "in/a.ply").read_text() == "fake REPLACED ONCE"


# The real command


@pytest.fixture
def scans(tmp_path):
    (tmp_path / "in").mkdir()
    for n in range(3):
        (tmp_path / f"in/{n}.obj").write_text(obj(n))
    return tmp_path


@linux
@pytest.mark.ci
def test_a_small_mesh_fits_into_a_small_limit_and_no_limit_is_exceeded_in_silence(
    scans, monkeypatch
):
    monkeypatch.chdir(scans)
    words = ("denoise", "in", "-o", "out", "--method", "msal", "--json", "--memory-limit")
    made = msal(*words, "60M")
    assert made.exit_code == 0, made.stderr
    for record in json.loads(made.stdout)["records"]:
        assert record["peak_memory_bytes"] <= 60 * 1024**2
    made = msal(*words, "52M", "--fresh")
    assert made.exit_code == 1
    for record in json.loads(made.stdout)["records"]:
        assert record["error"]["code"] == "E_MEMORY"


def test_a_record_beyond_the_limit_gets_a_warning():
    record = written(peak_memory_bytes=70_000_000)
    limit = Limits(memory_bytes=60_000_000)
    (note,) = _warn_of_memory(record, limit).warnings
    assert "70 MB" in note and "--memory-limit 60 MB" in note
    assert _warn_of_memory(record, Limits()) is record


def test_the_command_gives_up(scans, monkeypatch):
    monkeypatch.chdir(scans)
    monkeypatch.setattr("msal_cli.batch.workers.WorkerPool", fakes.InProcess)
    for name in ("a", "b"):
        (scans / f"in/{name}.obj").write_text("v 1 2\nf 1 2 3\n")
    made = msal("denoise", "in", "-o", "out", "-j1", "--include", "[2ab].obj", "--fail-fast")
    assert made.exit_code == 1
    assert "stopped after 1 failure; 1 files were not begun" in made.stderr
    assert "1 not done" in made.stderr
