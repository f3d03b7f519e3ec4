"""Whole runs over real folders, with fake work and with real meshes: records, rerun, interrupts."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

import msal_cli
from msal_cli import methods
from msal_cli.batch import interrupts
from msal_cli.batch.inputs import discover_inputs
from msal_cli.batch.interrupts import Cancellation
from msal_cli.batch.lock import Shard, parse_shard
from msal_cli.batch.manifest import NAME
from msal_cli.batch.plan import build_plan
from msal_cli.batch.run import run
from msal_cli.batch.schedule import Finished, Progress, Started
from msal_cli.errors import UsageError
from msal_cli.job import room
from msal_cli.job.records import SCHEMA
from msal_cli.job.settings import SELF_INTERSECTIONS, Settings
from tests.batch import fakes
from tests.campaigns import runs
from tests.codecs import plain_obj
from tests.files import denoise_bytes, posix, tree
from tests.shapes import noisy, torus

SETTINGS = Settings("fake", {"n": 1})


@pytest.fixture
def folders(tmp_path):
    (tmp_path / "in").mkdir()
    return tmp_path


def fill(folders, n, **special):
    for index in range(n):
        (folders / f"in/{index:02}.ply").write_text(f"mesh {index}")
    for name, text in special.items():
        (folders / f"in/{name.removeprefix('f')}.ply").write_text(text)


def plan_of(folders, **options):
    some = discover_inputs([str(folders / "in")], output=str(folders / "in/out"))
    output = None if options.get("in_place") else str(folders / "out")
    return build_plan(some, options.pop("output", output), **options)


WORKERS = {"engine": None, "jobs": 2}
"""Options of a run in real worker processes; all else is done here, by and by."""


def ran(folders, settings=SETTINGS, plan=None, **options):
    options = {"denoise": fakes.denoise, "engine": fakes.InProcess} | options
    return run(plan or plan_of(folders), settings, **options)


def statuses(records):
    return [record.status for record in records]


def tried(folders):
    """A list that grows by the names of files that are begun, and the callback that feeds it."""
    names = []

    def on_event(event):
        if isinstance(event, Started):
            names.append(Path(plan_of(folders, force=True).tasks[event.index].input).stem)

    return names, on_event


def test_records_come_in_the_order_of_the_plan_whatever_finishes_first(folders):
    fill(folders, 6, f00="after 03.ply")
    events = []
    records = ran(folders, on_event=events.append, **WORKERS)
    assert [Path(record.input).stem for record in records] == [f"{n:02}" for n in range(6)]
    assert statuses(records) == ["written"] * 6
    finished = [(event.index, event.record) for event in events if isinstance(event, Finished)]
    in_order = sorted(finished, key=lambda pair: pair[0])
    assert in_order == list(enumerate(records)) != finished
    assert {event.index for event in events if isinstance(event, Progress)} == set(range(6))
    assert set(tree(folders / "out")) == {f"{n:02}.ply" for n in range(6)}


def test_a_finished_file_is_noted_before_it_is_told(folders):
    fill(folders, 5)
    names = []

    def on_event(event):
        if isinstance(event, Finished):
            lines = (folders / "out" / NAME).read_text().splitlines()
            done = [one["name"] for one in map(json.loads, lines) if one["kind"] == "done"]
            names.append(Path(event.record.output).name)
            assert set(names) <= set(done)

    ran(folders, on_event=on_event, **WORKERS)
    assert len(names) == 5


def test_one_task_runs_here_and_without_starting_a_process(folders, monkeypatch):
    fill(folders, 1)
    monkeypatch.setattr(subprocess, "Popen", None)
    # Neither the unit nor fewer counts change a byte.
    mm, counted = replace(SETTINGS, unit="mm"), replace(SETTINGS, checks=(SELF_INTERSECTIONS,))
    for settings, is_done in ((SETTINGS, 0), (mm, 1), (counted, 0), (SETTINGS, 1)):
        (status,) = statuses(ran(folders, settings, engine=None))
        assert status == ("up-to-date" if is_done else "written")


class TestFailures:
    @posix
    def test_each_failure_is_one_row_and_the_others_are_done(self, folders):
        fill(folders, 16, f03="fail", f05="die error", f08="die kill once", f12="die midway")
        records = ran(folders, **WORKERS)
        codes = {n: one.error.code for n, one in enumerate(records) if one.error}
        assert codes == {3: "E_FORMAT", 5: "E_INTERNAL", 12: "E_CRASH"}
        assert [n for n, one in enumerate(records) if one.warnings] == [8]
        assert "SIGKILL" in records[8].warnings[0] and "SIGKILL" in records[12].error.message
        failed = records[12]
        assert failed.output is None and failed.schema == SCHEMA
        assert failed.version == msal_cli.__version__ and failed.method.name == "fake"
        assert set(tree(folders / "out")) == {f"{n:02}.ply" for n in range(16) if n not in codes}

    def test_memory_that_runs_out_twice(self, folders):
        fill(folders, 4, f01="memory")
        names, on_event = tried(folders)
        records = ran(folders, on_event=on_event, **WORKERS)
        assert records[1].error.code == "E_MEMORY"
        assert names.count("01") == 2 and names[-1] == "01"


def test_a_dry_run_touches_nothing_and_tells_what_is_current(folders, monkeypatch):
    # These files are no meshes, which a dry run would say.
    monkeypatch.setattr(room, "_check_header", lambda path, format: None)
    fill(folders, 3)
    events = []
    records = ran(folders, dry_run=True, on_event=events.append)
    assert statuses(records) == ["planned"] * 3
    assert records[0].output == str(folders / "out/00.ply")
    assert [event.record for event in events] == records
    assert not (folders / "out").exists()
    ran(folders)
    (folders / "in/01.ply").write_text("changed")
    before = tree(folders)
    assert statuses(ran(folders, dry_run=True)) == ["up-to-date", "planned", "up-to-date"]
    assert tree(folders) == before


@pytest.mark.parametrize("backup", [".orig", None])
def test_a_run_in_place_that_was_killed_after_the_move(folders, backup):
    def in_place(settings=SETTINGS, backup=backup, fresh=False):
        plan = plan_of(folders, in_place=True, backup=backup, fresh=fresh)
        return ran(folders, settings, plan=plan)

    fill(folders, 3)
    in_place()
    expected = tree(folders)
    path = folders / "in" / NAME
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(one for one in lines if not ("done" in one and "01.ply" in one)))
    records = in_place()
    # From its backup a file is taken up; without one it is left alone.
    state = "failed" if backup is None else "written"
    assert statuses(records) == ["up-to-date", state, "up-to-date"]
    assert tree(folders) == expected
    if backup is None:
        assert records[1].error.code == "E_CHANGED" and "--fresh" in records[1].error.hint
        assert statuses(in_place(fresh=True)) == ["written"] * 3
        return
    # The original in a backup is never overwritten.
    with pytest.raises(UsageError, match=r"00\.ply\.orig.*and 2 more"):
        in_place(fresh=True)
    assert tree(folders) == expected
    assert statuses(in_place(Settings("other"), ".2")) == ["written"] * 3
    assert (folders / "in/00.ply.2").read_text() == "fake MESH 0"


@posix
def test_in_place_runs_know_of_those_above_by_any_name(folders):
    fill(folders, 2)
    (folders / "link").symlink_to("in")
    for name in ("", "in", "link", "in/01.ply"):
        found = discover_inputs([str(folders / name)])
        records = ran(folders, plan=build_plan(found, None, in_place=True, backup=None))
        assert set(statuses(records)) == {"up-to-date" if name else "written"}


DRIVER = """
import sys
from msal_cli.batch.inputs import discover_inputs
from msal_cli.batch.plan import build_plan
from msal_cli.batch.run import run
from msal_cli.job.settings import Settings
from tests.batch import fakes

plan = build_plan(discover_inputs([sys.argv[1]]), sys.argv[2])
tell = lambda event: print(type(event).__name__, flush=True)
try:
    run(plan, Settings("fake", {"n": 1}), jobs=2, denoise=fakes.denoise, on_event=tell)
except KeyboardInterrupt as error:
    sys.exit(getattr(error, "exit_status", 130))
"""


@posix
def test_a_run_ends_when_it_is_asked_and_goes_on_later(folders):
    fill(folders, 4)
    cancellation = Cancellation()

    def on_event(event):
        if isinstance(event, Finished) and event.index == 1:
            cancellation.request()

    for _ in range(2):  # The second time it is asked before it begins.
        with pytest.raises(KeyboardInterrupt):
            ran(folders, on_event=on_event, cancellation=cancellation)
        assert set(tree(folders / "out")) == {"00.ply", "01.ply"}
    with pytest.raises(KeyboardInterrupt):
        cancellation.check()
    assert statuses(ran(folders)) == ["up-to-date"] * 2 + ["written"] * 2


class TestInterrupts:
    """Signals to a real process, which then must leave no process and no half file behind."""

    def start(self, folders, **options):
        words = [sys.executable, "-c", DRIVER, str(folders / "in"), str(folders / "out")]
        return runs.started(words, text=True, cwd=Path(fakes.__file__).parents[2], **options)

    def interrupted(self, folders, send, after):
        """Send a signal once ``after`` files are finished; exit status, workers, seconds."""
        with self.start(folders) as process:
            count = 0
            while count < after:
                count += process.stdout.readline().startswith("Finished")
            workers = fakes.children_of(process.pid)
            started = time.monotonic()
            send(process)
            process.stdout.read()
            status = process.wait(timeout=10)
            taken = time.monotonic() - started
        assert workers and fakes.are_gone(workers)
        return status, taken

    @pytest.mark.parametrize(
        ("name", "to_group", "status"),
        [
            ("SIGINT", True, 130),
            pytest.param("SIGTERM", False, 143, marks=pytest.mark.ci),
            pytest.param("SIGHUP", False, 129, marks=pytest.mark.ci),
            pytest.param("SIGKILL", False, -9, marks=pytest.mark.ci),
        ],
    )
    def test_a_signal_ends_all_and_keeps_what_is_finished(self, folders, name, to_group, status):
        fill(folders, 12, f06="hang", f07="hang")
        send = os.killpg if to_group else os.kill
        got, taken = self.interrupted(folders, lambda one: send(one.pid, getattr(signal, name)), 6)
        assert got == status and taken < 2.0
        for source in (folders / "in").glob("*.ply"):
            Path(f"{source}.hung").touch()
        for path, data in tree(folders / "out").items():
            if not path.startswith("."):
                expected = "fake " + (folders / "in" / path).read_text().upper()
                assert data.decode() == expected, path
            else:
                assert name == "SIGKILL", path
        records = ran(folders)
        assert statuses(records).count("up-to-date") >= 6
        assert set(statuses(records)) == {"up-to-date", "written"}
        assert len(tree(folders / "out")) == 12

    def test_a_single_file_here_is_interrupted_too(self, folders):
        fill(folders, 0, f00="hang")
        with self.start(folders) as process:
            assert process.stdout.readline().startswith("Started")
            process.send_signal(signal.SIGTERM)
            assert process.wait(timeout=2) == 143
        assert tree(folders / "out") == {}

    def test_a_run_in_another_locale_goes_on(self, folders):
        fill(folders, 0, **{"f\N{SNOWMAN}": "mesh"})
        plain = os.environ | {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
        for text, event in (("mesh", "Finished"), ("other", "Started")):
            ran(folders)
            fill(folders, 0, **{"f\N{SNOWMAN}": text})
            with self.start(folders, env=plain) as process:
                assert process.stdout.read().startswith(event)
        assert statuses(ran(folders)) == ["up-to-date"]

    def test_a_main_thread_that_does_not_listen_is_ended(self, tmp_path):
        # Neither a kernel nor code that swallows the exception keeps the process; nor is the
        # second signal waited for.
        code = (
            "import hashlib, os, pathlib, signal, sys\n"
            "from msal_cli.batch import interrupts as signals\n"
            "clean = pathlib.Path(sys.argv[1]).touch\n"
            # It is ignored where the tests run under nohup.
            "signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"
            "with signals.catch_signals(print), signals.end_if_late(clean):\n"
            "    os.kill(os.getpid(), signal.SIGTERM)\n"
            "    if sys.argv[2:]: os.kill(os.getpid(), signal.SIGHUP)\n"
            "    hashlib.pbkdf2_hmac('sha256', b'', b'', 10**9)\n"
        )
        for second, status in ((), 143), (("again",), 129):
            began = time.monotonic()
            command = [sys.executable, "-c", code, tmp_path / "cleaned", *second]
            made = subprocess.run(command, capture_output=True, check=False)
            assert (made.returncode, made.stderr) == (status, b"msal: interrupted\n")
            assert time.monotonic() - began < 10
            assert (tmp_path / "cleaned").exists() != bool(second)
            (tmp_path / "cleaned").unlink(missing_ok=True)

    def test_a_signal_that_other_code_handles_ends_nothing(self, monkeypatch):
        monkeypatch.setattr(interrupts, "MAX_DELAY_S", 0.1)
        seen = []
        before = signal.signal(signal.SIGTERM, lambda *_: seen.append(1))
        try:
            with interrupts.end_on_signal():
                os.kill(os.getpid(), signal.SIGTERM)
                time.sleep(0.3)
        finally:
            signal.signal(signal.SIGTERM, before)
        assert seen == [1]

    def test_a_block_that_is_left_in_time_goes_on(self, monkeypatch):
        monkeypatch.setattr(interrupts, "MAX_DELAY_S", 0.2)
        seen, cleaned = [], []
        n_threads = threading.active_count()
        with (
            interrupts.catch_signals(seen.append),
            interrupts.end_if_late(lambda: cleaned.append(1)),
        ):
            os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1.2 * interrupts.MAX_DELAY_S)
        assert (seen, cleaned) == ([signal.SIGTERM], [])
        assert threading.active_count() == n_threads


# Runs after others, or beside them


class TestShards:
    def ran(self, folders, text, settings=SETTINGS, **options):
        return ran(folders, settings, plan_of(folders).select_shard(parse_shard(text)), **options)

    def test_whoever_did_it_it_is_done(self, folders):
        fill(folders, 8, f03="fail E_INDEX")
        names, on_event = tried(folders)
        for k in (1, 2):
            self.ran(folders, f"{k}/2")
        assert statuses(ran(folders, on_event=on_event)).count("up-to-date") == 7
        for k in (1, 2, 3):
            self.ran(folders, f"{k}/3", on_event=on_event)
        assert names == []
        (folders / "in/07.ply").write_text("changed")
        ran(folders, on_event=on_event)
        for k in (1, 2):
            self.ran(folders, f"{k}/2", on_event=on_event)
        assert names == ["07"]
        other = Settings("other")
        self.ran(folders, "1/1", other)
        # The newest lines are those of 1/1 and not what the older manifests say.
        assert statuses(ran(folders, other, on_event=on_event)).count("up-to-date") == 7
        assert names == ["07"]

    def test_an_empty_shard_leaves_word_that_it_ran(self, folders):
        fill(folders, 1)
        k = next(k for k in (1, 2) if not Shard(k, 2).has("00.ply"))
        assert self.ran(folders, f"{k}/2") == []
        path = folders / f"out/.msal-manifest-{k}-of-2.jsonl"
        lines = [json.loads(line)["kind"] for line in path.read_text().splitlines()]
        assert lines == ["run", "end"]


def test_a_run_says_when_it_began_and_ended(folders):
    fill(folders, 2)
    ran(folders, command=("msal", "denoise", "\udcff"))
    lines = list(map(json.loads, (folders / "out" / NAME).read_text().splitlines()))
    (run,), (end,) = ([one for one in lines if one["kind"] == kind] for kind in ("run", "end"))
    assert run["command"] == ["msal", "denoise", "\udcff"] and run["pid"] == os.getpid()
    assert run["files"] == 2 and run["shard"] is None and run["host"]
    assert run["started"] <= end["finished"] and end["interrupted"] is False
    assert 0.0 <= end["seconds"] < 60.0 and run["at"] < end["at"]

    def on_event(event):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ran(folders, Settings("other"), on_event=on_event)
    last = json.loads((folders / "out" / NAME).read_text().splitlines()[-1])
    assert (last["kind"], last["interrupted"]) == ("end", True)


def real_settings(**given):
    return Settings("msal", methods.find("msal").validate(given))


def obj(seed, around=24, across=12):
    vertices, faces = torus(around, across)
    return plain_obj.written(noisy(vertices, seed).round(6), faces).decode()


@pytest.fixture
def scans(tmp_path):
    for n in range(5):
        path = tmp_path / f"scans/{'abc'[n % 3]}/{n}.obj"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(obj(n))
    return tmp_path / "scans"


def plan_of_scans(scans, output="out"):
    target = str(scans.parent / output)
    return build_plan(discover_inputs([str(scans)], output=target), target)


def test_any_number_of_jobs_writes_the_bytes_that_one_file_alone_would_get(scans):
    (scans / "bad.obj").write_text("v 1 2\nf 1 2 3\n")
    alone = {}
    for path in scans.rglob("*.obj"):
        data, _ = denoise_bytes(path.read_bytes(), path.name, real_settings())
        if data is not None:
            alone[path.relative_to(scans).as_posix()] = bytes(data)
    assert len(alone) == 5
    records = run(plan_of_scans(scans), real_settings(), jobs=2)
    failed = [record for record in records if record.status == "failed"]
    assert [Path(record.input).name for record in failed] == ["bad.obj"]
    assert tree(scans.parent / "out") == alone


@pytest.mark.ci
def test_four_shards_at_once_write_what_one_run_writes(scans):
    """Real processes on one folder, started together; then a whole run finds nothing to do."""
    (scans / "bad.obj").write_text("v 1 2\nf 1 2 3\n")
    run(plan_of_scans(scans, "one"), real_settings(), jobs=1)
    command = [sys.executable, "-m", "msal_cli", "denoise", str(scans), "-j", "1"]
    command += ["--method", "msal", "-o"]
    shards = [
        subprocess.Popen([*command, str(scans.parent / "out"), "--shard", f"{k}/4", "-q"])
        for k in range(1, 5)
    ]
    # The shard with the bad file ends with 3, or with 1 if that is all it has.
    assert sorted(one.wait() for one in shards) in ([0, 0, 0, 3], [0, 0, 0, 1])
    assert tree(scans.parent / "out") == tree(scans.parent / "one") != {}
    names = [path.name for path in (scans.parent / "out").glob(".msal-*")]
    assert sorted(names) == [f".msal-manifest-{k}-of-4.jsonl" for k in range(1, 5)]
    records = run(plan_of_scans(scans), real_settings())
    assert {record.status for record in records} == {"up-to-date", "failed"}
    assert sum(record.remembered for record in records) == 1
