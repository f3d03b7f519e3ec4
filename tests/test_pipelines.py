"""Jobs in CI services and on many machines: the action, the hooks and the recipes of the docs."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import types
from xml.etree import ElementTree

import pytest

from tests.cli.scans import closed_scan, folder_of, open_scan
from tests.files import ROOT, load_script

yaml = pytest.importorskip("yaml")
refresh = load_script("docs/refresh.py")
make_scans = load_script("docs/example_repository/make_scans.py")

pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(os.name != "posix", reason="the jobs are for POSIX shells"),
    pytest.mark.skipif(not all(map(shutil.which, ("bash", "git", "make"))), reason="lacks a tool"),
]


def load_yaml(path):
    return yaml.safe_load((ROOT / path).read_text("utf-8"))


def load_recipes(page):
    text = (ROOT / page).read_text("utf-8")
    found = re.findall(r"^<!-- \w+: (\S+) -->\n```\w+\n(.*?)^```$", text, re.M | re.DOTALL)
    return text, dict(found)


EXAMPLE = ROOT / "docs/example_repository"
ACTION = load_yaml("action.yml")
HOOKS = {hook["id"]: hook for hook in load_yaml(".pre-commit-hooks.yaml")}
CI_PAGE, CI_RECIPES = load_recipes("docs/ci.md")
MACHINES_PAGE, MACHINE_RECIPES = load_recipes("docs/many_machines.md")
SPIKE = "spike.ply: despiked > 0"


@pytest.fixture
def project(tmp_path):
    """A folder with scans, beside a folder ``bin`` that has a command ``msal``."""
    tools = tmp_path / "bin"
    tools.mkdir()
    (tools / "msal").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m msal_cli "$@"\n')
    (tools / "msal").chmod(0o755)
    folder_of(tmp_path / "project/scans", closed=closed_scan())
    folder_of(tmp_path / "project/scans/below", open=open_scan())
    return tmp_path / "project"


def add_spike(project):
    """A scan with one vertex far out."""
    lines = closed_scan(1).splitlines()
    at = lines.index(b"end_header") + 7
    lines[at] = b" ".join(b"%g" % (30.0 * float(coordinate)) for coordinate in lines[at].split())
    (project / "scans" / "spike.ply").write_bytes(b"\n".join(lines) + b"\n")


def run_shell(project, words, shell="sh", **variables):
    """Run a command in the project; CI services stop at the first that fails."""
    environment = {name: value for name, value in os.environ.items() if "GIT" not in name}
    environment |= {
        "PATH": f"{project.parent / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        **variables,
    }
    command = words if isinstance(words, list) else [shell, "-ec", words]
    return subprocess.run(command, cwd=project, env=environment, capture_output=True, text=True)


# The action


def action_steps(given):
    """The shell steps of the action by their names: script and environment, inputs filled in."""
    assert set(given) <= set(ACTION["inputs"]), "an input that the action does not have"
    values = {
        f"inputs.{name}": given.get(name, spec["default"])
        for name, spec in ACTION["inputs"].items()
    }
    values["github.action_path"] = str(ROOT)

    def fill(text):
        """A value of a workflow with its ``${{ a || b }}`` replaced."""
        return re.sub(
            r"\$\{\{\s*([\w.-]+)(?:\s*\|\|\s*([\w.-]+))?\s*\}\}",
            lambda found: values[found[1]] or (values[found[2]] if found[2] else ""),
            str(text),
        )

    return {
        step["name"]: (
            step["run"],
            {name: fill(value) for name, value in step.get("env", {}).items()},
        )
        for step in ACTION["runs"]["steps"]
        if "run" in step
    }


def run_action(project, given):
    """Run the step of the action that denoises, as a runner does."""
    script, variables = action_steps(given)["Denoise and check"]
    written, summary = project.parent / "github_output", project.parent / "github_summary"
    for path in (written, summary):
        path.write_text("")
    variables |= {"GITHUB_OUTPUT": str(written), "GITHUB_STEP_SUMMARY": str(summary)}
    done = run_shell(project, "set -u\n" + script, "bash", GITHUB_ACTIONS="true", **variables)
    return types.SimpleNamespace(
        status=done.returncode,
        outputs=read_outputs(written.read_text()),
        summary=summary.read_text(),
        stderr=done.stderr,
    )


def read_outputs(text):
    """What a step wrote to ``GITHUB_OUTPUT``: ``name=value`` and ``name<<END``."""
    outputs = {}
    lines = iter(text.splitlines())
    for line in lines:
        if "<<" in line:
            name, _, end = line.partition("<<")
            outputs[name] = "\n".join(iter(lines.__next__, end))
        else:
            name, _, outputs[name] = line.partition("=")
    return outputs


def test_action_reports_and_stops_at_a_gate(project):
    given = {
        "gates": "volume.valid and abs(volume_change) > 50%\nmax_displacement > 1e\n",
        "options": "--method msal\n--timeout 10m",
        "report": "a b.json\nc.html",
    }
    done = run_action(project, given)
    assert done.status == 0, done.stderr
    assert done.outputs == {"report": "a b.json\nc.html", "status": "0"}
    assert "closed.ply" in done.summary
    assert (project / "denoised/below/open.ply").exists()
    assert all((project / name).exists() for name in done.outputs["report"].splitlines())
    add_spike(project)
    done = run_action(project, given)
    assert done.status == 4
    assert done.outputs["status"] == "4" and done.outputs["report"]
    assert "::error" in done.stderr and "spike.ply" in done.summary
    records = json.loads((project / "a b.json").read_bytes())["records"]
    assert [record["status"] for record in records].count("up-to-date") == 2


def test_action_runs_nothing_of_its_inputs(project):
    hostile = '$(touch owned) `touch owned` "; touch owned; "'
    given = dict.fromkeys(("files", "gates", "options", "output", "baseline"), hostile)
    assert run_action(project, given).status not in (0, 4)
    assert not (project / "owned").exists()
    scripts = [script for script, _ in action_steps({}).values()]
    assert not any("${{" in script for script in scripts)


def test_the_example_passes_its_check_and_fails_for_a_worse_and_a_lost_scan(project):
    shutil.rmtree(project)
    shutil.copytree(EXAMPLE, project)
    steps = load_yaml(EXAMPLE / ".github/workflows/meshes.yml")["jobs"]["meshes"]["steps"]
    (given,) = (step["with"] for step in steps if step.get("id") == "msal")
    done = run_action(project, given)
    assert done.status == 0, done.stderr
    assert "ring_with_ribs.ply" in done.summary
    vertices, faces = make_scans.ring(0, 0.0)
    noisier = make_scans.add_noise(make_scans.add_noise(vertices, faces, 1), faces, 7)
    (project / "scans/ring.ply").write_bytes(make_scans.to_ply(noisier, faces))
    done = run_action(project, given)
    assert done.status == 4 and done.outputs["status"] == "4"
    assert "denoised/ring.ply: broken: mean_angular_error_deg > " in done.stderr
    assert "in the baseline, tolerance 5 %" in done.stderr
    assert "plaque.ply: broken" not in done.stderr
    (project / "scans/ring.ply").unlink()
    (project / "scans/plaque.ply").unlink()
    done = run_action(project, given)
    assert done.status == 4 and "ring.ply" in done.stderr


# Hooks and recipes


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
        assert "spike.ply: known(despiked) and despiked > 0" in done.stderr
        assert (project / ".git/msal/closed.ply").exists()
    else:
        assert done.returncode == 0, done.stderr
        assert (project / "denoised/spike.ply").exists()


def assert_junit(path):
    tree = ElementTree.parse(path)
    assert len(tree.findall(".//testcase")) == 3
    assert len(tree.findall(".//failure")) >= 1


def test_recipe_of_a_shell(project):
    install, _, run = CI_RECIPES["shell"].partition("\n")
    assert install == refresh.install_command()
    add_spike(project)
    assert run_shell(project, run).returncode == 4
    assert (project / "meshes.json").exists() and (project / "meshes.html").exists()
    assert_junit(project / "meshes.xml")


def test_recipe_of_make(project):
    (project / "Makefile").write_text(CI_RECIPES["make"])
    done = run_shell(project, ["make"])
    assert done.returncode == 0, done.stderr
    assert (project / "denoised/below/open.ply").exists()
    assert "up to date" in run_shell(project, ["make"]).stdout
    add_spike(project)
    for _ in range(2):
        done = run_shell(project, ["make"])
        assert done.returncode != 0
        assert SPIKE in done.stderr


def component(**given):
    """The jobs of the GitLab component, inputs filled in as GitLab does: as text."""
    head, _, body = (ROOT / "templates/denoise.yml").read_text("utf-8").partition("\n---\n")
    inputs = yaml.safe_load(head)["spec"]["inputs"]
    (include,) = yaml.safe_load(CI_RECIPES["gitlab"])["include"]
    assert set(given) | set(include["inputs"]) <= set(inputs)
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
    assert_junit(project / job["artifacts"]["reports"]["junit"])


# Many machines


@pytest.mark.parametrize("name", ["parallel", "slurm", "aws"])
def test_recipes_of_many_machines(project, name):
    shutil.rmtree(project / "scans")
    folder_of(project / "scans", **{f"s{n}": closed_scan(n) for n in range(3)})
    # In the place of GNU parallel: one after the other, and here.
    parallel = project.parent / "bin/parallel"
    parallel.write_text(
        "#!/bin/sh\nshift 4\nwhile read -r n; do\n"
        'eval "$(printf "%s " "$@" | sed "s/{}/$n/g")" </dev/null || exit\ndone\n'
    )
    parallel.chmod(0o755)
    text = MACHINE_RECIPES[name].replace("/data/", "")
    text = text.replace("seq 8", "seq 2").replace("{}/8", "{}/2")
    variables = {
        "parallel": [{}],
        "slurm": [
            {"SLURM_ARRAY_TASK_ID": task, "SLURM_ARRAY_TASK_COUNT": "2"} for task in ("1", "2")
        ],
        "aws": [
            {"AWS_BATCH_JOB_ARRAY_INDEX": index, "AWS_BATCH_JOB_ARRAY_SIZE": "2"}
            for index in ("0", "1")
        ],
    }[name]
    for given in variables:
        done = run_shell(project, text, **given)
        assert done.returncode == 0, done.stderr
    written = sorted(path.name for path in (project / "denoised").glob("*.ply"))
    assert written == ["s0.ply", "s1.ply", "s2.ply"]
