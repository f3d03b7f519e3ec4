"""Whole batches of real mesh files through the real pipeline."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from msal_cli import methods
from msal_cli.batch.inputs import discover_inputs
from msal_cli.batch.plan import build_plan
from msal_cli.batch.run import run
from msal_cli.job.pipeline import denoise_bytes
from msal_cli.job.settings import Settings
from tests.files import tree
from tests.shapes import noisy, torus


def settings(**given):
    return Settings("msal", methods.find("msal").validate(given))


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
    return build_plan(discover_inputs([str(scans)], output=target), target, **options)


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
        assert tree(scans.parent / f"out{jobs}") == alone


@pytest.mark.ci
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
    assert tree(scans.parent / "out") == tree(scans.parent / "one") != {}
    names = [path.name for path in (scans.parent / "out").glob(".msal-*")]
    assert sorted(names) == [f".msal-manifest-{k}-of-4.jsonl" for k in range(1, 5)]
    records = run(plan_of(scans), settings())
    assert {record.status for record in records} == {"up-to-date", "failed"}
    assert sum(record.remembered for record in records) == 1
