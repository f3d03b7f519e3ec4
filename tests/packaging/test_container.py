"""The image: built and run where there is a builder, else held to rules."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tomllib

import pytest

from tests.pipelines import ROOT

DOCKERFILE = ROOT / "Dockerfile"


def instructions():
    """(word, rest) of each instruction, lines joined."""
    text = re.sub(r"^#.*\n", "", DOCKERFILE.read_text("utf-8"), flags=re.MULTILINE)
    lines = re.sub(r"\\\n\s*", "", text).splitlines()
    return [tuple(line.split(" ", 1)) for line in lines if line]


def test_the_final_stage_is_small_and_without_root():
    given = instructions()
    stages = [i for i, (word, _) in enumerate(given) if word == "FROM"]
    assert len(stages) == 2
    final = given[stages[-1] :]
    words = [word for word, _ in final]
    # Nothing is installed in it: no compiler, no pip's cache.
    assert "RUN" not in words and words.count("COPY") == 1
    assert dict(final)["FROM"].endswith("-slim")
    assert dict(final)["USER"].split(":")[0] not in ("root", "0")
    assert dict(final)["ENTRYPOINT"] == '["msal"]'
    assert all(":" in rest and ":latest" not in rest for word, rest in given if word == "FROM")


def test_the_context_has_what_the_build_reads():
    lines = (ROOT / ".dockerignore").read_text("utf-8").splitlines()
    kept = {line[1:] for line in lines if line.startswith("!")}
    assert lines[1] == "*"
    assert kept >= {"pyproject.toml", "hatch_build.py", "kernel_build", "msal_cli", "README.md"}
    assert all((ROOT / one).exists() for one in kept if "*" not in one)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert kept >= {*wheel["packages"], *wheel.get("shared-data", {})}


@pytest.mark.skipif(shutil.which("hadolint") is None, reason="no hadolint")
def test_hadolint():
    done = subprocess.run(["hadolint", str(DOCKERFILE)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def has_builder():
    try:
        return subprocess.run(["docker", "info"], capture_output=True, timeout=10).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


@pytest.mark.slow
def test_the_image_denoises_a_folder_as_any_user(tmp_path):
    if not has_builder():
        pytest.skip("no docker daemon")
    subprocess.run(["docker", "build", "-t", "msal-test", "."], cwd=ROOT, check=True)
    inspect = ["docker", "image", "inspect", "-f", "{{.Size}}", "msal-test"]
    size = int(subprocess.run(inspect, capture_output=True, text=True, check=True).stdout)
    assert size < 250_000_000
    shutil.copy(ROOT / "sample_meshes/coin_noisy.ply", tmp_path / "scan.ply")
    user = ["--user", f"{os.getuid()}:{os.getgid()}"]
    run = ["docker", "run", "--rm", *user, "-v", f"{tmp_path}:/data", "msal-test"]
    subprocess.run([*run, "denoise", "/data/scan.ply", "-o", "/data/out.ply"], check=True)
    assert (tmp_path / "out.ply").stat().st_uid == os.getuid()
