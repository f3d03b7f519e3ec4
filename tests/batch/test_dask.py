"""The engine on Dask: a real cluster on this machine, whose workers are killed."""

import os
import signal
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from msal_cli import methods
from msal_cli.batch import dask as dask_engine
from msal_cli.batch.dask import DaskEngine
from msal_cli.batch.inputs import discover_inputs
from msal_cli.batch.plan import build_plan
from msal_cli.batch.run import run
from msal_cli.batch.schedule import Finished, Started
from msal_cli.errors import ResourceError, UsageError
from msal_cli.job.settings import Limits, Settings
from tests.batch import fakes
from tests.batch.test_run import fill, obj, statuses
from tests.campaigns import runs
from tests.cli.scans import msal
from tests.files import ROOT, posix, tree

pytestmark = pytest.mark.ci

distributed = pytest.importorskip("distributed", reason="Dask distributed is not installed")
FAKE = Settings("fake", {"n": 1})


def started_cluster(n_workers):
    import dask

    # One death is enough for Dask to give up a batch, which then is the engine's business; and the
    # workers that come back stay, even if one is just coming back from another death.
    quick = {
        "distributed.scheduler.allowed-failures": 0,
        "distributed.deploy.lost-worker-timeout": "1000 days",
    }
    dask.config.set(quick)
    sys.path.insert(0, str(ROOT))
    try:
        return distributed.LocalCluster(
            n_workers=n_workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address=None,
            scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
            memory_limit=None,
            silence_logs=50,
        )
    finally:
        sys.path.remove(str(ROOT))


def ended(cluster):
    for nanny in cluster.workers.values():
        nanny.auto_restart = False
        # Asked to end, it would finish what it has in hand.
        nanny.process.process._process.kill()
    cluster.close(timeout=5)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Somebody's cluster: two workers that come back when they are killed."""
    cluster = started_cluster(2)
    yield cluster
    ended(cluster)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder for inputs, named ``in`` from here."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in").mkdir()
    return tmp_path


def plan_of(output="out", **options):
    return build_plan(discover_inputs(["in"], output=output), output, **options)


def ran(cluster, settings=FAKE, output="out", **options):
    options = {"denoise": fakes.denoise} | options
    engine = partial(DaskEngine, scheduler=cluster.scheduler_address)
    return run(plan_of(output), settings, engine=engine, **options)


def workers_of(cluster):
    return [nanny.pid for nanny in cluster.workers.values()]


def test_files_and_records_are_those_of_one_process(folder, cluster):
    for n in range(7):
        (folder / f"in/{n}.obj").write_text(obj(n))
    (folder / "in/bad.obj").write_text("v 1 2\nf 1 2 3\n")
    settings = Settings("msal", methods.find("msal").validate({}))
    here = run(plan_of("here"), settings, jobs=1)
    events = []
    engine = partial(DaskEngine, scheduler=cluster.scheduler_address)
    there = run(plan_of("there"), settings, engine=engine, on_event=events.append)
    assert tree(folder / "there") == tree(folder / "here")
    assert len(tree(folder / "there")) == 7

    def timeless(record):
        output = record.output and Path(record.output).name
        return replace(record, output=output, seconds=None, peak_memory_bytes=None)

    assert list(map(timeless, there)) == list(map(timeless, here))
    assert sorted(one.index for one in events if isinstance(one, Started)) == list(range(8))
    assert sorted(one.index for one in events if isinstance(one, Finished)) == list(range(8))


@posix
def test_what_breaks_a_process_costs_its_file_and_no_dask_worker(folder, cluster):
    fill(folder, 12, f03="die segfault", f05="die kill once", f07="die midway", f09="die error")
    before = workers_of(cluster)
    records = ran(cluster)
    codes = {Path(one.input).stem: one.error.code for one in records if one.error}
    assert codes == {"03": "E_CRASH", "07": "E_CRASH", "09": "E_INTERNAL"}
    assert "SIGSEGV" in records[3].error.message
    assert "second try" in records[5].warnings[0]
    assert set(tree(folder / "out")) == {f"{n:02}.ply" for n in range(12) if n not in (3, 7, 9)}
    assert workers_of(cluster) == before


@posix
def test_limits_hold_and_retries_count(folder, cluster):
    fill(folder, 4, f02="hang", f03="die kill once")
    records = ran(cluster, limits=Limits(timeout_s=1.5), retries=0)
    assert [one.error.code for one in records if one.error] == ["E_TIMEOUT", "E_CRASH"]
    assert statuses(ran(cluster)) == ["up-to-date", "up-to-date", "written", "written"]


@posix
def test_a_dask_worker_killed_in_the_middle_costs_nothing(folder, cluster):
    fill(folder, 16, **{f"f{n:02}": "sleep 0.05" for n in range(16)})
    killed = []

    def on_event(event):
        if isinstance(event, Finished) and not killed:
            killed.append(workers_of(cluster)[0])
            os.kill(killed[0], signal.SIGKILL)

    records = ran(cluster, on_event=on_event)
    assert killed and statuses(records) == ["written"] * 16
    assert len(tree(folder / "out")) == 16


@posix
def test_a_file_that_kills_dask_workers_is_found_and_is_one_row(folder, cluster):
    fill(folder, 10, f04="die parent")
    again = []
    records = ran(cluster, on_event=lambda event: again.append(event.index))
    assert [Path(one.input).stem for one in records if one.status != "written"] == ["04"]
    assert records[4].error.code == "E_CRASH"
    assert "died while at work on it" in records[4].error.message
    assert len(tree(folder / "out")) == 9
    assert [path.name for path in folder.joinpath("in").glob("*.died")] == ["04.ply.died"]


@pytest.mark.parametrize("lack", ["version", "scheduler", "worker", "dask"])
def test_refusals_before_any_work(folder, cluster, monkeypatch, lack):
    fill(folder, 2)
    if lack == "version":
        monkeypatch.setattr(dask_engine, "__version__", "99.0")
        with pytest.raises(UsageError, match=r"worker at tcp://127\.0\.0\.1:\d+ has msal .*99\.0"):
            ran(cluster)
        monkeypatch.undo()
        monkeypatch.chdir(folder)
        monkeypatch.setattr(dask_engine, "temporary_name", lambda name: "../in/not there")
        monkeypatch.setattr(Path, "touch", lambda path: None)
        with pytest.raises(UsageError, match=r"does not see .*/out/\.\./in"):
            ran(cluster)
    elif lack == "scheduler":
        monkeypatch.setattr(dask_engine, "_CONNECT_S", 0.2)
        with pytest.raises(UsageError, match=r"no Dask scheduler at tcp://127\.0\.0\.1:9"):
            engine = partial(DaskEngine, scheduler="tcp://127.0.0.1:9")
            run(plan_of(), FAKE, engine=engine, denoise=fakes.denoise)
    elif lack == "worker":
        monkeypatch.setattr(dask_engine, "_PATIENCE_S", 0.3)
        empty = started_cluster(0)
        try:
            with pytest.raises(ResourceError, match="no worker at the Dask scheduler"):
                ran(empty)
        finally:
            empty.close(timeout=5)
    else:
        monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
        words = ("--engine", "dask", "--scheduler", "tcp://host:1")
        result = msal("denoise", "in", "-o", "out", *words)
        assert result.exit_code == 2
        assert "msal-cli[dask]" in result.stderr
        # That would look for msal itself on an index.
        assert "pip install 'msal-cli" not in result.stderr
    assert tree(folder / "out") == {}


@posix
@pytest.mark.parametrize(
    ("number", "status"),
    [
        (signal.SIGINT, 130),
        pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow),
        pytest.param(signal.SIGKILL, -9, marks=pytest.mark.slow),
    ],
)
def test_a_signal_keeps_what_is_done(folder, cluster, number, status):
    for n in range(60):
        (folder / f"in/{n}.obj").write_text(obj(n, 60, 30))
    command = [sys.executable, "-m", "msal_cli", "denoise", "in", "-o", "out", "--engine", "dask"]
    command += ["--scheduler", cluster.scheduler_address, "--set", "iterations=1000"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, env=environment, start_new_session=True
    ) as process:
        runs.wait_until(lambda: len(runs.noted(folder / "out")) >= 4, process, within_s=120.0)
        process.send_signal(number)
        assert process.wait(timeout=20) == status
        said = process.stderr.read().decode()
    assert "Traceback" not in said and "distributed" not in said
    settings = Settings("msal", methods.find("msal").validate({"iterations": 1000}))
    planned = run(plan_of(), settings, dry_run=True)
    assert 4 <= statuses(planned).count("up-to-date") < 60
