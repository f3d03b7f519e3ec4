"""A project with scans, and what CI services do with it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from tests.cli.scans import closed_scan, open_scan

ROOT = Path(__file__).parents[1]
INPUT = re.compile(r"\$\{\{\s*([\w.-]+)(?:\s*\|\|\s*([\w.-]+))?\s*\}\}")


def make_project(folder: Path) -> Path:
    """A folder with scans, beside a folder ``bin`` that has a command ``msal``."""
    tools = folder / "bin"
    tools.mkdir()
    (tools / "msal").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m msal_cli "$@"\n')
    (tools / "msal").chmod(0o755)
    scans = folder / "project" / "scans"
    (scans / "below").mkdir(parents=True)
    (scans / "closed.ply").write_bytes(closed_scan())
    (scans / "below" / "open.ply").write_bytes(open_scan())
    return folder / "project"


def add_spike(project: Path) -> None:
    """A scan with one vertex far out."""
    lines = closed_scan(1).splitlines()
    at = lines.index(b"end_header") + 7
    lines[at] = b" ".join(b"%g" % (30.0 * float(coordinate)) for coordinate in lines[at].split())
    (project / "scans" / "spike.ply").write_bytes(b"\n".join(lines) + b"\n")


def run_shell(project: Path, words: str | list[str], shell: str = "sh", **variables: str):
    """Run a command in the project; CI services stop at the first that fails."""
    environment = {name: value for name, value in os.environ.items() if "GIT" not in name}
    environment |= {
        "PATH": f"{project.parent / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        **variables,
    }
    command = words if isinstance(words, list) else [shell, "-ec", words]
    return subprocess.run(command, cwd=project, env=environment, capture_output=True, text=True)


@dataclass(frozen=True)
class ActionRun:
    """What the action of this repository did."""

    status: int
    outputs: dict[str, str]
    summary: str
    stderr: str


def fill(text: str, values: dict[str, str]) -> str:
    """A value of a workflow with its ``${{ a || b }}`` replaced."""
    return INPUT.sub(
        lambda found: values[found[1]] or (values[found[2]] if found[2] else ""), str(text)
    )


def action_steps(action: dict, given: dict[str, str]) -> dict[str, tuple[str, dict[str, str]]]:
    """The shell steps of the action by their names: script and environment, inputs filled in."""
    assert set(given) <= set(action["inputs"]), "an input that the action does not have"
    values = {
        f"inputs.{name}": given.get(name, spec["default"])
        for name, spec in action["inputs"].items()
    }
    values["github.action_path"] = str(ROOT)
    return {
        step["name"]: (
            step["run"],
            {name: fill(value, values) for name, value in step.get("env", {}).items()},
        )
        for step in action["runs"]["steps"]
        if "run" in step
    }


def run_action(
    action: dict, project: Path, given: dict[str, str], without: tuple[str, ...] = ()
) -> ActionRun:
    """Run the step of the action that denoises, as a runner does ``without`` some variables."""
    script, variables = action_steps(action, given)["Denoise and check"]
    written = project.parent / "github_output"
    summary = project.parent / "github_summary"
    written.write_text("")
    summary.write_text("")
    variables |= {
        "GITHUB_ACTIONS": "true",
        "GITHUB_OUTPUT": str(written),
        "GITHUB_STEP_SUMMARY": str(summary),
    }
    variables = {name: value for name, value in variables.items() if name not in without}
    done = run_shell(project, "set -u\n" + script, "bash", **variables)
    return ActionRun(
        done.returncode, read_outputs(written.read_text()), summary.read_text(), done.stderr
    )


def read_outputs(text: str) -> dict[str, str]:
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
