"""A release has the version of its tag, and its workflow only the permissions that it needs."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

import msal_cli
from tests.pipelines import ROOT
from tests.scripts import load_script

check_release = load_script("packaging/check_release.py")
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))


def checkout(folder, version, changelog):
    """The two files of a checkout that a release depends on."""
    (folder / "msal_cli").mkdir()
    (folder / "docs").mkdir()
    (folder / "msal_cli/version.py").write_text(f'"""Text."""\n\n__version__ = "{version}"\n')
    (folder / "docs/changelog.md").write_text(changelog)
    return folder


def test_the_version_read_is_that_of_the_package():
    assert check_release.read_version(ROOT) == msal_cli.__version__


@pytest.mark.parametrize(
    ("tag", "changelog", "message"),
    [
        ("v1.2.4", "## 1.2.3\n\n- a\n", "the tag is v1.2.4"),
        ("1.2.3", "## 1.2.3\n\n- a\n", "the tag is 1.2.3"),
        ("v1.2.3", "## Unreleased\n\n- a\n", "no section '## 1.2.3'"),
        ("v1.2.3", "## 1.2.30\n\n- a\n", "no section '## 1.2.3'"),
        ("v1.2.3", "## 1.2.3\n\n## 1.2.2\n\n- a\n", "is empty"),
    ],
)
def test_faults(tmp_path, tag, changelog, message):
    (fault,) = check_release.find_faults(checkout(tmp_path, "1.2.3", changelog), tag)
    assert message in fault


def test_notes_are_the_section_of_the_version(tmp_path):
    text = "# Log\n\n## Unreleased\n\n## 1.2.3 (2030-01-02)\n\n- a\n\n### b\n\n- c\n\n## 1.2.2\n"
    root = checkout(tmp_path, "1.2.3", text)
    words = [sys.executable, str(ROOT / "packaging/check_release.py"), "--root", str(root)]
    done = subprocess.run([*words, "v1.2.3", "-o", str(tmp_path / "notes.md")])
    assert done.returncode == 0
    assert (tmp_path / "notes.md").read_text() == "- a\n\n### b\n\n- c\n"
    assert subprocess.run([*words, "v1.2.4"], capture_output=True).returncode == 1


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_workflows(path):
    workflow = pytest.importorskip("yaml").safe_load(path.read_text("utf-8"))
    assert workflow["permissions"] == {"contents": "read"}
    for job in workflow["jobs"].values():
        needs = job.get("needs", [])
        assert ({needs} if isinstance(needs, str) else set(needs)) <= set(workflow["jobs"])
        if "uses" in job:
            assert (ROOT / job["uses"]).exists()
        for step in job.get("steps", []):
            # Pinned by version; and no text of an event is put into a script.
            assert "uses" not in step or re.fullmatch(r"[\w./-]+@[0-9a-f]{40}", step["uses"])
            assert "${{" not in step.get("run", "")
            for script in re.findall(r"\S+\.(?:py|sh)\b", step.get("run", "")):
                assert (ROOT / script.removeprefix("../").removeprefix("/src/")).exists(), script


def test_release_publishes_after_all_checks_with_few_permissions():
    workflow = pytest.importorskip("yaml").safe_load(
        (ROOT / ".github/workflows/release.yml").read_text("utf-8")
    )
    jobs = workflow["jobs"]
    order, job = [], "page"
    while job:
        order.append(job)
        job = jobs[job].get("needs")
    assert order == ["page", "index", "attest", "bill", "wheels", "check"]
    permissions = {name: job["permissions"] for name, job in jobs.items() if "permissions" in job}
    assert permissions == {
        "attest": {"id-token": "write", "attestations": "write"},
        "index": {"id-token": "write"},
        "page": {"contents": "write"},
    }
    assert jobs["index"]["environment"] == "release"
