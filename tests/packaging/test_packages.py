"""Packages, releases and the image: built where there is a builder, else held to rules."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile

import pytest

import msal_cli
from tests.files import ROOT, load_script

BUILD = ROOT / "packaging/debian/build.sh"


def write_wheel(folder, version):
    """A wheel named as msal's, with a command that prints its arguments."""
    about = f"msal_cli-{version}.dist-info"
    files = {
        "msal_cli/__init__.py": "",
        "msal_cli/__main__.py": "import sys\nprint(sys.argv[1:], sys.flags.safe_path)\n",
        f"msal_cli-{version}.data/data/share/man/man1/msal.1": ".TH MSAL 1\n",
        f"{about}/METADATA": f"Metadata-Version: 2.1\nName: msal-cli\nVersion: {version}\n",
        f"{about}/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    record = "".join(f"{name},,\n" for name in (*files, f"{about}/RECORD"))
    folder.mkdir()
    with zipfile.ZipFile(folder / f"msal_cli-{version}-py3-none-any.whl", "w") as wheel:
        for name, text in {**files, f"{about}/RECORD": record}.items():
            wheel.writestr(name, text)


@pytest.mark.ci
@pytest.mark.skipif(shutil.which("dpkg-deb") is None, reason="no dpkg-deb")
def test_debian_package(tmp_path):
    pytest.importorskip("pip")
    write_wheel(tmp_path / "wheels", "9.8.7rc1")
    words = ["sh", str(BUILD), str(tmp_path / "wheels"), str(tmp_path / "made")]
    variables = os.environ | {"PYTHON": sys.executable}
    done = subprocess.run(words, capture_output=True, text=True, env=variables)
    assert done.returncode == 0, done.stderr
    (package,) = (tmp_path / "made").iterdir()
    assert package.name == "msal-cli_9.8.7~rc1-1_all.deb"
    control = subprocess.run(
        ["dpkg-deb", "--field", str(package)], capture_output=True, text=True, check=True
    ).stdout
    assert "@" not in control.replace("@example.com", "")
    minor = sys.version_info.minor
    assert f"python3 (>= 3.{minor}), python3 (<< 3.{minor + 1})" in control
    root = tmp_path / "root"
    subprocess.run(["dpkg-deb", "--extract", str(package), str(root)], check=True)
    assert (root / "usr/share/doc/msal-cli/copyright").exists()
    assert (root / "usr/share/man/man1/msal.1.gz").exists()
    assert not list(root.rglob("__pycache__"))
    # The command runs the system's Python, which may not be this one.
    asked = ["/usr/bin/python3", "-c", f"import sys; assert sys.version_info[:2] == (3, {minor})"]
    if shutil.which(asked[0]) and subprocess.run(asked, capture_output=True).returncode == 0:
        done = subprocess.run([root / "usr/bin/msal", "a b"], capture_output=True, text=True)
        assert done.stdout == "['a b'] True\n", done.stderr


def test_conda_recipe_needs_what_the_wheel_needs():
    recipe = pytest.importorskip("yaml").safe_load(
        (ROOT / "packaging/conda/recipe.yaml").read_text("utf-8")
    )
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    needed = set(project["dependencies"])
    needed.add(f"python{project['requires-python']}")
    assert {one.replace(" ", "") for one in recipe["requirements"]["run"]} == needed
    assert recipe["package"]["name"] == project["name"]
    assert recipe["about"]["summary"] == project["description"]
    assert re.search(r"pip install .*--no-index", recipe["build"]["script"][0])


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
