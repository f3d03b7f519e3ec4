"""The pieces of docs/ci.md: each is taken from the page and run, with a mesh that breaks a gate."""

from __future__ import annotations

import os
import re
import shutil
from xml.etree import ElementTree

import pytest

from tests.pipelines import ROOT, add_spike, make_project, run_shell
from tests.scripts import load_script

refresh = load_script("docs/refresh.py")
PAGE = (ROOT / "docs/ci.md").read_text("utf-8")
RECIPE = re.compile(r"^<!-- recipe: (\S+) -->\n```\w+\n(.*?)^```$", re.MULTILINE | re.DOTALL)
RECIPES = dict(RECIPE.findall(PAGE))

pytestmark = [
    pytest.mark.skipif(os.name != "posix", reason="the recipes are for POSIX shells"),
    pytest.mark.ci,
]


@pytest.fixture
def project(tmp_path):
    return make_project(tmp_path)


def parsed(name):
    return pytest.importorskip("yaml").safe_load(RECIPES[name])


def load_yaml(path):
    return pytest.importorskip("yaml").safe_load((ROOT / path).read_text("utf-8"))


def test_every_recipe_is_known_here():
    assert sorted(RECIPES) == ["github", "gitlab", "hook", "make", "pre-commit", "shell"]
    assert PAGE.count("<!-- recipe:") == 6


def test_inputs_of_the_action_are_documented():
    inputs = load_yaml("action.yml")["inputs"]
    table = re.findall(r"^\| (`.*?) \| (.*?) \|", PAGE, re.MULTILINE)
    documented = {
        name: default for names, default in table for name in re.findall("`([^`]+)`", names)
    }
    assert set(documented) == set(inputs)
    for name in ("files", "output", "python-version", "cache"):
        assert documented[name] == f"`{inputs[name]['default']}`"


@pytest.mark.skipif(shutil.which("git") is None, reason="no git")
def test_hook(project):
    git = "git -c user.name=a -c user.email=a@example.com"
    assert run_shell(project, "git init -q . && git add scans").returncode == 0
    hook = project / ".git/hooks/pre-commit"
    hook.parent.mkdir(exist_ok=True)
    hook.write_text(RECIPES["hook"])
    hook.chmod(0o755)
    done = run_shell(project, f"{git} commit -qm scans")
    assert done.returncode == 0, done.stderr
    assert (project / ".git/denoised/closed.ply").exists()
    (project / "notes.txt").write_text("no mesh\n")
    add_spike(project)
    # The spike is not staged, and a commit without meshes does not wait for them.
    assert run_shell(project, f"git add notes.txt && {git} commit -qm notes").returncode == 0
    done = run_shell(project, f"git add scans && {git} commit -qm spike")
    assert done.returncode != 0
    assert "spike.ply: broken: despiked > 0" in done.stderr


@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
def test_make(project):
    (project / "Makefile").write_text(RECIPES["make"])
    done = run_shell(project, ["make"])
    assert done.returncode == 0, done.stderr
    assert (project / "denoised/below/open.ply").exists()
    assert "up to date" in run_shell(project, ["make"]).stdout
    add_spike(project)
    for _ in range(2):
        done = run_shell(project, ["make"])
        assert done.returncode != 0
        assert "spike.ply: broken: despiked > 0" in done.stderr


def test_gitlab():
    yaml = pytest.importorskip("yaml")
    (include,) = parsed("gitlab")["include"]
    assert include["component"].split("/")[-1] == "denoise@main"
    spec = next(yaml.safe_load_all((ROOT / "templates/denoise.yml").read_text("utf-8")))
    assert set(include["inputs"]) <= set(spec["spec"]["inputs"])


def test_shell(project):
    install, _, run = RECIPES["shell"].partition("\n")
    assert install == refresh.install_command()
    add_spike(project)
    assert run_shell(project, run).returncode == 4
    assert (project / "meshes.json").exists() and (project / "meshes.html").exists()
    tree = ElementTree.parse(project / "meshes.xml")
    assert len(tree.findall(".//testcase")) == 3
    assert len(tree.findall(".//failure")) >= 1
