"""The action, the hooks and the component at the root of the repository, without their services."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
from xml.etree import ElementTree

import pytest

from tests.pipelines import (
    ROOT,
    action_steps,
    add_spike,
    make_project,
    run_action,
    run_shell,
)
from tests.scripts import load_script

yaml = pytest.importorskip("yaml")
refresh = load_script("docs/refresh.py")
ACTION = yaml.safe_load((ROOT / "action.yml").read_text("utf-8"))
HOOKS = {hook["id"]: hook for hook in yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text())}
GATES = "volume.valid and abs(volume_change) > 50%\nmax_displacement > 3e\n"

pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(os.name != "posix", reason="the jobs are for POSIX shells"),
    pytest.mark.skipif(shutil.which("bash") is None, reason="no bash"),
]


@pytest.fixture
def project(tmp_path):
    return make_project(tmp_path)


def test_action_reports_and_stops_at_a_gate(project):
    given = {
        "gates": GATES,
        "options": "--method msal\n--timeout 10m",
        "report": "a b.json\nc.html",
    }
    done = run_action(ACTION, project, given)
    assert done.status == 0, done.stderr
    assert done.outputs == {"report": "a b.json\nc.html", "status": "0"}
    assert "closed.ply" in done.summary
    assert (project / "denoised/below/open.ply").exists()
    assert all((project / name).exists() for name in done.outputs["report"].splitlines())
    add_spike(project)
    done = run_action(ACTION, project, given)
    assert done.status == 4
    assert done.outputs["status"] == "4" and done.outputs["report"]
    assert "::error" in done.stderr and "spike.ply" in done.summary
    records = json.loads((project / "a b.json").read_bytes())["records"]
    assert [record["status"] for record in records].count("up-to-date") == 2


def test_action_runs_nothing_of_its_inputs(project):
    hostile = '$(touch owned) `touch owned` "; touch owned; "'
    given = dict.fromkeys(("files", "gates", "options", "output", "baseline"), hostile)
    assert run_action(ACTION, project, given).status not in (0, 4)
    assert not (project / "owned").exists()
    scripts = [script for script, _ in action_steps(ACTION, {}).values()]
    assert not any("${{" in script for script in scripts)


def test_action_keeps_apart_outputs_from_names_of_reports(project):
    report = "a.json\nEND_OF_REPORTS\nstatus=0\n-n"
    done = run_action(ACTION, project, {"report": report, "options": "--method al"})
    assert done.outputs["report"] == report
    assert done.outputs["status"] == "2" == str(done.status)


def test_action_takes_names_for_names(project):
    (project / "scans").rename(project / "-scans")
    given = {"files": "-scans", "output": "-out", "options": "--method al", "report": ""}
    assert run_action(ACTION, project, given).status == 0
    baseline = run_shell(project, ["msal", "compare", "--json", "--", "-scans", "-out"])
    (project / "base.json").write_text(baseline.stdout)
    done = run_action(ACTION, project, given | {"baseline": "base.json"})
    assert done.status == 0, done.stderr


@pytest.mark.skipif(shutil.which("git") is None, reason="no git")
def test_check_keeps_its_outputs_in_the_folder_of_a_worktree(project):
    git = "git -c user.name=a -c user.email=a@example.com"
    made = run_shell(
        project,
        f"git init -q . && {git} commit -qm a --allow-empty && git worktree add -q ../other",
    )
    assert made.returncode == 0, made.stderr
    shutil.copytree(project / "scans", project.parent / "other/scans")
    hook = HOOKS["msal-check"]
    words = [*shlex.split(hook["entry"]), "scans", "--method=al"]
    done = run_shell(project.parent / "other", words)
    assert done.returncode == 0, done.stderr
    assert (project / ".git/worktrees/other/msal/closed.ply").exists()
    assert run_shell(project.parent / "other", "git status --porcelain").stdout == "?? scans/\n"


def component(**given):
    """The jobs of the GitLab component, inputs filled in as GitLab does: as text."""
    text = (ROOT / "templates/denoise.yml").read_text("utf-8")
    head, _, body = text.partition("\n---\n")
    inputs = yaml.safe_load(head)["spec"]["inputs"]
    assert set(given) <= set(inputs)
    used = set(re.findall(r"\$\[\[ inputs\.(\w+) \]\]", body))
    assert used == set(inputs)
    values = {
        name: given[name] if name in given else spec["default"] for name, spec in inputs.items()
    }
    return yaml.safe_load(re.sub(r"\$\[\[ inputs\.(\w+) \]\]", lambda at: values[at[1]], body))


def test_component(project):
    (job,) = component(options="--include '*.ply'", source="dist/a.whl").values()
    add_spike(project)
    done = run_shell(project, "\n".join(job["script"]), **job["variables"])
    assert done.returncode == 4, done.stderr
    assert all((project / name).exists() for name in job["artifacts"]["paths"])
    tree = ElementTree.parse(project / job["artifacts"]["reports"]["junit"])
    assert len(tree.findall(".//testcase")) == 3
    assert len(tree.findall(".//failure")) >= 1


def test_component_takes_several_gates(project):
    (job,) = component(
        gates="seconds.total < 0; vertices > 10; ", options="-v", source="."
    ).values()
    done = run_shell(project, "\n".join(job["script"]), **job["variables"])
    assert done.returncode == 4, done.stderr
    assert "broken: vertices > 10" in done.stderr
    report = json.loads((project / "meshes.json").read_text())
    assert {len(record["gates"]) for record in report["records"]} == {2}


@pytest.mark.skipif(shutil.which("git") is None, reason="no git")
@pytest.mark.parametrize("name", sorted(HOOKS))
def test_hooks(project, name):
    hook = HOOKS[name]
    assert hook["language"] == "python" and hook["pass_filenames"] is False
    pattern = re.compile(hook["files"])
    assert pattern.search("scans/a.ply") and not pattern.search("scans/a.txt")
    assert run_shell(project, "git init -q .").returncode == 0
    add_spike(project)
    # The default gate of the check needs the choice, which takes longer.
    quick = [] if name == "msal-check" else ["--method=msal"]
    done = run_shell(project, [*shlex.split(hook["entry"]), *hook["args"], *quick])
    if name == "msal-check":
        assert done.returncode == 4
        assert "spike.ply: broken: known(despiked) and despiked > 0" in done.stderr
        assert (project / ".git/msal/closed.ply").exists()
    else:
        assert done.returncode == 0, done.stderr
        assert (project / "denoised/spike.ply").exists()
