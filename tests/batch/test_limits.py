"""Time, memory, retries and giving up: with fakes that hang, and with the real command."""

from __future__ import annotations

import json
import os
import sys

import pytest

from msal_cli.batch import workers
from msal_cli.batch.run import _warn_of_memory
from msal_cli.batch.schedule import Failed, Retried, Started
from msal_cli.codecs.header import BASE_BYTES
from msal_cli.errors import UsageError
from msal_cli.job.settings import Limits
from tests.batch import fakes, test_run
from tests.batch.fakes import lost, results
from tests.batch.test_whole import obj
from tests.cli.scans import msal
from tests.report.made import written

posix = pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs Linux")


def heard(tasks, **options):
    return fakes.heard(fakes.pool(tasks, **options))


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
        assert (one.index, one.cause) == (1, "timeout")
        assert "0.4 s" in one.reason and "--timeout" in one.hint
        assert [type(m) for m in messages if m.index == 1] == [Started, Retried, Started, Failed]
        assert deaths == [1, 1]

    def test_a_worker_that_never_gets_ready_is_given_up(self, monkeypatch):
        monkeypatch.setattr(workers, "_READY_WITHIN_S", 0.2)
        monkeypatch.setattr(workers, "_BOOT", "import time; time.sleep(60)")
        with pytest.raises(workers.ResourceError, match="end before they start"):
            heard([("double", 1)])


def test_an_objection_ends_the_tries():
    messages = heard([("exit", 0)], on_loss=lambda index: f"task {index} is spoilt")
    assert lost(messages)[0].cause == "changed"
    assert "task 0 is spoilt" in lost(messages)[0].reason


@posix
def test_a_kill_by_the_system_for_want_of_memory_is_told_apart(monkeypatch):
    counts = iter([4, 4, 4, 5])
    monkeypatch.setattr(workers, "oom_kills", lambda: next(counts))
    messages = heard([("kill", 0)])
    assert [one.reason for one in messages if isinstance(one, Retried)] == [
        "the worker was killed by SIGKILL"
    ]
    assert lost(messages)[0].cause == "memory"


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
        assert one.cause == "memory" and "300 MB" in one.reason
        assert "--memory-limit" in one.hint

    @linux
    def test_where_the_system_cannot_the_worker_looks_itself(self, monkeypatch):
        boot = workers._BOOT.replace(
            "serve; serve()",
            "serve; import msal_cli.batch.workers as w, sys; sys.platform = 'other'; serve()",
        )
        monkeypatch.setattr(workers, "_BOOT", boot)
        limits = Limits(memory_bytes=300_000_000)
        messages = heard([("hold", 400 << 20), ("double", 2)], limits=limits, jobs=1, retries=0)
        assert lost(messages)[0].cause == "memory"
        assert results(messages) == {1: 4}

    @posix
    def test_a_library_that_aborts_at_the_limit_ran_out_of_memory(self):
        limits = Limits(memory_bytes=300_000_000)
        messages = heard([("bad_alloc", 0), ("abort", 0)], limits=limits, jobs=1, retries=0)
        assert [one.cause for one in lost(messages).values()] == ["memory", "crash"]

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

        records = ran(tmp_path, texts, stop_after_failures=most, on_event=on_event)
        assert begun == ["a", "b", "c"][: most + 1]
        states = ["written", "failed", "failed", "planned", "planned"]
        assert [one.status for one in records] == [*states[: most + 1], *["planned"] * (4 - most)]
        assert {one.status for one in ran(tmp_path, texts)} == {"up-to-date", "failed", "written"}

    @pytest.mark.parametrize(
        "options",
        [
            {"limits": Limits(timeout_s=0.0)},
            {"limits": Limits(memory_bytes=BASE_BYTES - 1)},
            {"limits": Limits(max_faces=0)},
            {"retries": -1},
            {"jobs": 0},
            {"stop_after_failures": 0},
        ],
    )
    def test_wrong_limits_are_refused_before_any_work(self, tmp_path, options):
        with pytest.raises(UsageError):
            ran(tmp_path, {"a": "x", "b": "y"}, **options)
        assert not (tmp_path / "out").exists()


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
    for name in ("a", "b"):
        (scans / f"in/{name}.obj").write_text("v 1 2\nf 1 2 3\n")
    made = msal("denoise", "in", "-o", "out", "-j1", "--include", "[2ab].obj", "--fail-fast")
    assert made.exit_code == 1
    assert "stopped after 1 failure; 1 files were not begun" in made.stderr
    assert "1 not done" in made.stderr
