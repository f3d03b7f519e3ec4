"""The pieces of docs/ci.md: each is taken from the page and run, with a mesh that breaks a gate."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.cli.scans import closed_scan, open_scan
from tests.scripts import load_script

refresh = load_script("docs/refresh.py")
ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/ci.md").read_text("utf-8")
RECIPE = re.compile(r"^<!-- recipe: (\S+) -->\n```\w+\n(.*?)^```$", re.MULTILINE | re.DOTALL)
RECIPES = dict(RECIPE.findall(PAGE))

pytestmark = pytest.mark.skipif(os.name != "posix", reason="the recipes are for POSIX shells")


@pytest.fixture
def project(tmp_path):
    """A folder with scans, and a command ``msal`` on the path."""
    tools = tmp_path / "bin"
    tools.mkdir()
    (tools / "msal").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m msal_cli "$@"\n')
    (tools / "msal").chmod(0o755)
    scans = tmp_path / "project" / "scans"
    (scans / "below").mkdir(parents=True)
    (scans / "closed.ply").write_bytes(closed_scan())
    (scans / "below" / "open.ply").write_bytes(open_scan())
    return tmp_path / "project"


def ran(project, words, **variables):
    """A shell command in the project; CI systems stop at the first that fails."""
    environment = {name: value for name, value in os.environ.items() if "GIT" not in name}
    environment |= {
        "PATH": f"{project.parent / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        **variables,
    }
    command = words if isinstance(words, list) else ["sh", "-ec", words]
    return subprocess.run(command, cwd=project, env=environment, capture_output=True, text=True)


def spike(project):
    """A scan with one vertex far out."""
    lines = closed_scan(1).splitlines()
    at = lines.index(b"end_header") + 7
    lines[at] = b" ".join(b"%g" % (30.0 * float(one)) for one in lines[at].split())
    (project / "scans" / "spike.ply").write_bytes(b"\n".join(lines) + b"\n")


def parsed(name):
    return pytest.importorskip("yaml").safe_load(RECIPES[name])


def test_every_recipe_is_run_here():
    assert sorted(RECIPES) == ["github", "gitlab", "hook", "make", "pre-commit"]
    assert PAGE.count("<!-- recipe:") == 5


def test_github(project):
    job = parsed("github")["jobs"]["denoise"]
    steps = {step.get("name"): step for step in job["steps"]}
    assert steps["Install"]["run"] == refresh.install_command()
    summary = project / "summary"
    variables = {"GITHUB_STEP_SUMMARY": str(summary), "GITHUB_ACTIONS": "true"}
    run = steps["Denoise and judge"]["run"]
    done = ran(project, run, **variables)
    assert done.returncode == 0, done.stderr
    assert "closed.ply" in summary.read_text()
    # What is kept is what the run wrote.
    kept = steps["Keep meshes and report"]["with"]["path"].split()
    assert all((project / name).exists() for name in kept)
    assert (project / "denoised/below/open.ply").exists()
    spike(project)
    done = ran(project, run, **variables)
    assert done.returncode == 4, done.stderr
    assert "::error" in done.stderr
    assert "spike.ply" in summary.read_text()
    records = json.loads((project / "meshes.json").read_bytes())["records"]
    assert [one["status"] for one in records].count("up-to-date") == 2


def test_gitlab(project):
    job = parsed("gitlab")["denoise"]
    assert job["before_script"] == [refresh.install_command()]
    run = "\n".join(job["script"])
    done = ran(project, run)
    assert done.returncode == 0, done.stderr
    assert all((project / name).exists() for name in job["artifacts"]["paths"])
    spike(project)
    assert ran(project, run).returncode == 4
    tree = ElementTree.parse(project / job["artifacts"]["reports"]["junit"])
    assert len(tree.findall(".//testcase")) == 3
    assert len(tree.findall(".//failure")) >= 1


def test_pre_commit(project):
    (hook,) = parsed("pre-commit")["repos"][0]["hooks"]
    assert hook["language"] == "system" and hook["pass_filenames"] is False
    names = re.compile(hook["files"])
    assert names.search("scans/a.ply") and not names.search("scans/a.txt")
    (project / ".git").mkdir()
    assert ran(project, shlex.split(hook["entry"])).returncode == 0
    spike(project)
    done = ran(project, shlex.split(hook["entry"]))
    assert done.returncode == 4
    assert "spike.ply: broken: despiked > 0" in done.stderr


@pytest.mark.skipif(shutil.which("git") is None, reason="no git")
def test_hook(project):
    git = "git -c user.name=a -c user.email=a@example.com"
    assert ran(project, "git init -q . && git add scans").returncode == 0
    hook = project / ".git/hooks/pre-commit"
    hook.parent.mkdir(exist_ok=True)
    hook.write_text(RECIPES["hook"])
    hook.chmod(0o755)
    done = ran(project, f"{git} commit -qm scans")
    assert done.returncode == 0, done.stderr
    assert (project / ".git/denoised/closed.ply").exists()
    (project / "notes.txt").write_text("no mesh\n")
    spike(project)
    # The spike is not staged, and a commit without meshes does not wait for them.
    assert ran(project, f"git add notes.txt && {git} commit -qm notes").returncode == 0
    done = ran(project, f"git add scans && {git} commit -qm spike")
    assert done.returncode != 0
    assert "spike.ply: broken: despiked > 0" in done.stderr


@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
def test_make(project):
    (project / "Makefile").write_text(RECIPES["make"])
    done = ran(project, ["make"])
    assert done.returncode == 0, done.stderr
    assert (project / "denoised/below/open.ply").exists()
    assert "up to date" in ran(project, ["make"]).stdout
    spike(project)
    for _ in range(2):
        done = ran(project, ["make"])
        assert done.returncode != 0
        assert "spike.ply: broken: despiked > 0" in done.stderr
