"""The recipes of docs/many_machines.md do what they say, as far as they run without a cluster."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from msal_cli.batch.shard import COUNT_VARIABLE, parse_shard
from tests.cli.scans import closed_scan, folder_of

pytestmark = pytest.mark.ci

PAGE = (Path(__file__).parents[1] / "docs/many_machines.md").read_text("utf-8")
posix = pytest.mark.skipif(os.name != "posix", reason="the recipes are for a POSIX shell")


def recipe(name):
    found = re.search(rf"<!-- run: {name} -->\n```\w+\n(.*?)^```$", PAGE, re.M | re.DOTALL)
    assert found is not None, name
    return found[1]


@pytest.fixture
def shell(tmp_path):
    """Runs lines in a shell where ``msal`` is this one, in a folder with scans."""
    folder_of(tmp_path / "scans", **{f"s{n}": closed_scan(n) for n in range(3)})
    (tmp_path / "bin").mkdir()
    program = tmp_path / "bin/msal"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m msal_cli "$@"\n')
    # In the place of GNU parallel: one after the other, and here.
    parallel = tmp_path / "bin/parallel"
    parallel.write_text(
        "#!/bin/sh\nshift 4\nwhile read -r n; do\n"
        'eval "$(printf "%s " "$@" | sed "s/{}/$n/g")" </dev/null || exit\ndone\n'
    )
    program.chmod(0o755)
    parallel.chmod(0o755)

    def run(text, **variables):
        path = f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}"
        environment = {**os.environ, "PATH": path, **variables}
        done = subprocess.run(
            ["sh", "-c", text], cwd=tmp_path, env=environment, capture_output=True, check=False
        )
        assert done.returncode == 0, done.stderr.decode()
        return sorted(path.name for path in (tmp_path / "denoised").glob("*.ply"))

    return run


@posix
def test_parallel(shell):
    text = recipe("parallel")
    assert "--sshlogin :,node1,node2 --workdir ." in text
    assert shell(text.replace("seq 8", "seq 2").replace("{}/8", "{}/2")) == [
        "s0.ply",
        "s1.ply",
        "s2.ply",
    ]


@posix
def test_slurm(shell):
    text = recipe("slurm")
    first, last = map(int, re.findall(r"--array=(\d+)-(\d+)", text)[0])
    assert last - first + 1 == 16 and "/16'" in PAGE
    for task in (0, 1):
        done = shell(
            text,
            SLURM_PROCID="0",
            SLURM_NTASKS="1",
            SLURM_ARRAY_TASK_ID=str(task),
            SLURM_ARRAY_TASK_MIN="0",
            SLURM_ARRAY_TASK_STEP="1",
            SLURM_ARRAY_TASK_COUNT="2",
        )
    assert done == ["s0.ply", "s1.ply", "s2.ply"]


@posix
def test_aws(shell):
    text = recipe("aws").replace("/data/", "")
    for index in ("0", "1"):
        done = shell(text, AWS_BATCH_JOB_ARRAY_INDEX=index, AWS_BATCH_JOB_ARRAY_SIZE="2")
    assert done == ["s0.ply", "s1.ply", "s2.ply"]
    job = json.loads(re.search(r"```json\n(.*?)```", PAGE, re.DOTALL)[1])
    assert job["containerOverrides"]["command"] == recipe("aws").split()
    assert 2 <= job["arrayProperties"]["size"] <= 10_000


def test_kubernetes():
    text = recipe("kubernetes")
    completions = int(re.search(r"^  completions: (\d+)$", text, re.M)[1])
    name, value = re.search(r'- name: (MSAL_\w+)\n +value: "(\d+)"', text).groups()
    assert (name, int(value)) == (COUNT_VARIABLE, completions)
    assert "completionMode: Indexed" in text and "\t" not in text
    command = re.search(r"command: \[(.*)\]", text)[1].split(", ")
    assert command == recipe("aws").split()
    for index in (0, completions - 1):
        shard = parse_shard("auto", {"JOB_COMPLETION_INDEX": str(index), name: value})
        assert str(shard) == f"{index + 1}/{completions}"
    try:
        import yaml
    except ImportError:
        return
    job = yaml.safe_load(text)
    assert job["spec"]["template"]["spec"]["containers"][0]["env"] == [
        {"name": name, "value": value}
    ]
