"""Whole batches of real mesh files through the real pipeline."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.batch import run as running
from msal_cli.batch.events import Finished, Started
from msal_cli.batch.inputs import NothingMatched, found
from msal_cli.batch.manifest import NAME
from msal_cli.batch.plan import built
from msal_cli.batch.run import run
from msal_cli.batch.worker_pool import Crew
from msal_cli.codecs import open_mesh
from msal_cli.errors import UsageError
from msal_cli.job.pipeline import denoise_bytes
from msal_cli.job.settings import Settings
from tests.batch import fakes
from tests.shapes import noisy, torus

posix = pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")


def settings(**given):
    return Settings("msal", methods.find("msal").settled(given))


def obj(seed, around=24, across=12):
    vertices, faces = torus(around, across)
    vertices = noisy(vertices, seed)
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices]
    lines += ["f {} {} {}".format(*face) for face in faces + 1]
    return "\n".join(lines) + "\n"


@pytest.fixture
def scans(tmp_path):
    for n in range(9):
        path = tmp_path / f"scans/{'abc'[n % 3]}/{n}.obj"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(obj(n))
    return tmp_path / "scans"


def plan_of(scans, output="out", **options):
    target = None if options.get("in_place") else str(scans.parent / output)
    return built(found([str(scans)], output=target), target, **options)


def outputs(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not path.name.startswith(".msal-")
    }


def test_any_number_of_jobs_writes_the_bytes_that_one_file_alone_would_get(scans):
    (scans / "bad.obj").write_text("v 1 2\nf 1 2 3\n")
    alone = {}
    for path in scans.rglob("*.obj"):
        data, _ = denoise_bytes(path.read_bytes(), path.name, settings())
        if data is not None:
            alone[path.relative_to(scans).as_posix()] = bytes(data)
    assert len(alone) == 9
    for jobs in (1, 2):
        records = run(plan_of(scans, f"out{jobs}"), settings(), jobs=jobs)
        failed = [record for record in records if record.status == "failed"]
        assert [Path(record.input).name for record in failed] == ["bad.obj"]
        assert outputs(scans.parent / f"out{jobs}") == alone


def test_four_shards_at_once_write_what_one_run_writes(scans):
    """Real processes on one folder, started together; then a whole run finds nothing to do."""
    (scans / "bad.obj").write_text("v 1 2\nf 1 2 3\n")
    run(plan_of(scans, "one"), settings(), jobs=1)
    command = [sys.executable, "-m", "msal_cli", "denoise", str(scans), "-j", "1"]
    command += ["--method", "msal", "-o"]
    shards = [
        subprocess.Popen([*command, str(scans.parent / "out"), "--shard", f"{k}/4", "-q"])
        for k in range(1, 5)
    ]
    # The shard with the bad file ends with 3, or with 1 if that is all it has.
    assert sorted(one.wait() for one in shards) in ([0, 0, 0, 3], [0, 0, 0, 1])
    assert outputs(scans.parent / "out") == outputs(scans.parent / "one") != {}
    names = [path.name for path in (scans.parent / "out").glob(".msal-*")]
    assert sorted(names) == [f".msal-manifest-{k}-of-4.jsonl" for k in range(1, 5)]
    records = run(plan_of(scans), settings())
    assert {record.status for record in records} == {"up-to-date", "failed"}
    assert sum(record.remembered for record in records) == 1


def test_a_rerun_redoes_what_changed_and_its_records_tell_the_same(scans):
    first = run(plan_of(scans), settings())
    assert {record.status for record in first} == {"written"}
    before = outputs(scans.parent / "out")
    (scans / "b/4.obj").write_text(obj(77))
    second = run(plan_of(scans), settings())
    changed = [record.input for record in second if record.status == "written"]
    assert changed == [str(scans / "b/4.obj")]
    for one, two in zip(first, second, strict=True):
        if two.status == "up-to-date":
            assert (one.volume, one.displacement, one.seconds, one.method) == (
                two.volume,
                two.displacement,
                two.seconds,
                two.method,
            )
    after = outputs(scans.parent / "out")
    assert [name for name in before if before[name] != after[name]] == ["b/4.obj"]


def test_a_changed_suffix_is_mirrored(scans):
    plan = plan_of(scans, to="ply")
    records = run(plan, Settings("msal", settings().parameters, to="ply"))
    assert {record.status for record in records} == {"written"}
    data = (scans.parent / "out/a/0.ply").read_bytes()
    assert len(open_mesh(data, "0.ply").vertices) == 24 * 12


def test_in_place_keeps_the_originals_and_never_denoises_twice(scans):
    originals = outputs(scans)
    run(plan_of(scans, in_place=True), settings())
    after = outputs(scans)
    for name, data in originals.items():
        assert after[f"{name}.orig"] == data and after[name] != data
    records = run(plan_of(scans, in_place=True), settings())
    assert {record.status for record in records} == {"up-to-date"}
    assert outputs(scans) == after
    with pytest.raises(UsageError, match="the backup"):
        run(plan_of(scans, in_place=True), settings(iterations=1))
    assert outputs(scans) == after


def test_one_file_does_not_need_a_worker(scans, monkeypatch):
    monkeypatch.setattr(Crew, "__init__", None)
    path = str(scans / "a/0.obj")
    (record,) = run(built(found([path]), str(scans.parent / "one.obj")), settings())
    assert record.status == "written"
    with pytest.raises(NothingMatched):
        found([str(scans)], include=["*.stl"])


@posix
def test_a_worker_killed_in_the_middle_costs_nothing(scans, monkeypatch):
    for n in range(9, 30):
        (scans / f"{n}.obj").write_text(obj(n))
    crews = []

    def watched(*arguments, **options):
        crews.append(Crew(*arguments, **options))
        return crews[0]

    monkeypatch.setattr("msal_cli.batch.worker_pool.Crew", watched)
    count, victims = 0, []

    def on_event(event):
        nonlocal count
        count += isinstance(event, Finished)
        if isinstance(event, Started) and count >= 10 and not victims:
            (worker,) = [one for one in crews[0]._workers if one.in_hand == event.index] or [None]
            if worker is not None:
                os.kill(worker.pid, signal.SIGKILL)
                victims.append(event.index)

    records = run(plan_of(scans), settings(), jobs=2, on_event=on_event)
    assert victims and {record.status for record in records} == {"written"}
    assert [n for n, record in enumerate(records) if record.warnings] in ([], victims)
    assert len(outputs(scans.parent / "out")) == 30


@posix
@pytest.mark.parametrize(
    ("number", "status"),
    [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)],
)
def test_the_command_obeys_a_signal_and_goes_on_from_there(scans, number, status):
    for n in range(3):
        (scans / f"z{n}.obj").write_text(obj(n, 400, 110))
    command = [sys.executable, "-m", "msal_cli", "denoise", str(scans), "-j", "2"]
    command += ["-o", str(scans.parent / "out"), "--set", "iterations=1000"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, start_new_session=True)
    with process:
        manifest = scans.parent / "out" / NAME
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline and process.poll() is None:
            # The small files in folders come first, those that take long at the end.
            if manifest.exists() and manifest.read_bytes().count(b'"kind":"done"') >= 9:
                break
            time.sleep(0.01)
        workers = children_of(process.pid)
        started = time.monotonic()
        os.killpg(process.pid, number)
        assert process.wait(timeout=10) == status
        assert time.monotonic() - started < 2.0
        said = process.stderr.read().decode()
    assert "Traceback" not in said
    assert len(workers) >= 2 and not any(fakes.is_running(pid) for pid in workers)
    assert not [name for name in outputs(scans.parent / "out") if "tmp" in name]
    records = run(plan_of(scans), settings(iterations=1000), dry_run=True)
    assert [record.status for record in records] == ["up-to-date"] * 9 + ["planned"] * 3


def children_of(pid):
    text = subprocess.run(["ps", "-eo", "pid,ppid"], capture_output=True, text=True).stdout
    pairs = [line.split() for line in text.splitlines()[1:]]
    return [int(child) for child, parent in pairs if int(parent) == pid]


@pytest.mark.slow
@posix
def test_two_thousand_files_in_one_worker_do_not_grow_it(scans, monkeypatch):
    for n in range(2000):
        (scans / f"{n:04}.obj").write_text(obj(n % 10))
    shutil.rmtree(scans / "a")
    sizes = []
    real = Crew._finish

    def watched(crew, worker, resident):
        sizes.append(resident)
        real(crew, worker, resident)

    monkeypatch.setattr(Crew, "_finish", watched)
    monkeypatch.setattr(running, "usable_cores", lambda: 1)
    real_init = Crew.__init__
    monkeypatch.setattr(
        Crew, "__init__", lambda crew, *a, **o: real_init(crew, *a, files_per_worker=10**6, **o)
    )
    run(plan_of(scans), settings())
    assert len(sizes) > 2000
    growth = np.mean(sizes[-100:]) / np.mean(sizes[200:300]) - 1.0
    print(f"\n{len(sizes)} files in one worker: {100.0 * growth:+.2f} % after the first 200")
    assert growth < 0.05
