"""The example repository: its check passes, and fails where a scan becomes worse or is lost."""

from __future__ import annotations

import os
import shutil

import pytest

from tests.pipelines import ROOT, make_project, run_action
from tests.scripts import load_script

yaml = pytest.importorskip("yaml")
EXAMPLE = ROOT / "docs/example_repository"
ACTION = yaml.safe_load((ROOT / "action.yml").read_text("utf-8"))
WORKFLOW = yaml.safe_load((EXAMPLE / ".github/workflows/meshes.yml").read_text("utf-8"))
make_scans = load_script("docs/example_repository/make_scans.py")

pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(os.name != "posix", reason="the action's steps are run by a POSIX shell"),
    pytest.mark.skipif(shutil.which("bash") is None, reason="no bash"),
]


@pytest.fixture
def repository(tmp_path):
    """A copy of the example."""
    project = make_project(tmp_path)
    shutil.rmtree(project)
    shutil.copytree(EXAMPLE, project)
    return project


def check(repository):
    """What the workflow's use of the action does."""
    (step,) = [step for step in WORKFLOW["jobs"]["meshes"]["steps"] if step.get("id") == "msal"]
    return run_action(ACTION, repository, step["with"])


def test_check_passes_and_then_finds_a_scan_that_became_worse(repository):
    pytest.importorskip("fcpw", reason="the Hausdorff distance needs fcpw", exc_type=ImportError)
    done = check(repository)
    assert done.status == 0, done.stderr
    assert "ring_with_ribs.ply" in done.summary
    vertices, faces = make_scans.ring(0, 0.0)
    noisier = make_scans.add_noise(make_scans.add_noise(vertices, faces, 1), faces, 7)
    (repository / "scans/ring.ply").write_bytes(make_scans.to_ply(noisier, faces))
    done = check(repository)
    assert done.status == 4 and done.outputs["status"] == "4"
    assert "denoised/ring.ply: broken: mean_angular_error_deg > " in done.stderr
    assert "in the baseline, tolerance 5 %" in done.stderr
    assert "plaque.ply: broken" not in done.stderr


def test_check_finds_a_lost_scan(repository):
    (repository / "scans/ring.ply").unlink()
    (repository / "scans/plaque.ply").unlink()
    done = check(repository)
    assert done.status == 4
    assert "ring.ply" in done.stderr
