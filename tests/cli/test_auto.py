"""`msal denoise --auto`: how it is asked for, and what is told of what was chosen.

The choice itself stands in for that of `selection`, except where any choice must keep a promise.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections import Counter
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from msal_cli import auto as selection
from msal_cli import methods
from msal_cli.analysis.noise_estimate import estimate_noise
from tests.cli.scans import (
    closed_scan,
    folder_of,
    msal,
    open_scan,
    ply_text,
    process,
    record_of,
)
from tests.report.schemas import report_schema
from tests.shapes import noisy, torus

REASON = "noise 0.11 e; organic; MSAL, K = 0.7, 3 sweeps"


def fixed(name="msal", given=None, **changes):
    """A chooser that chooses always the same; it keeps the wishes that it was given."""

    def chosen(mesh, wishes, on_step=None, is_allowed=None):
        chosen.wishes.append(wishes)
        if on_step is not None:
            on_step(1, 1)
        parameters = {} if name == "none" else methods.find(name).validate(given or {})
        values = {
            "reason": REASON,
            "surface": "organic",
            "noise": dataclasses.replace(estimate_noise(mesh), mean_edges=0.11),
            "risk": 0.0625,
            "tried": 7,
            "runners_up": (("AL, 3 sweeps", 0.0724),),
        }
        return selection.Choice(name, parameters, **(values | changes))

    chosen.wishes = []
    return chosen


@pytest.fixture
def choose(monkeypatch):
    """Lets a test say what is chosen."""

    def use(chosen):
        monkeypatch.setattr("msal_cli.auto.search.search", chosen)
        # What a test chooses may shrink a small torus.
        monkeypatch.setattr("msal_cli.analysis.harm.excessive_change", lambda *a, **k: None)
        return chosen

    return use


@pytest.fixture
def scan(tmp_path):
    vertices, faces = torus(64, 32)
    data = ply_text(noisy(vertices, 0, 0.02), faces)
    return folder_of(tmp_path / "in", scan=data) / "scan.ply"


def denoised_record(*words):
    made = msal("denoise", *words, "--json", "-q")
    assert made.exit_code == 0, made.stderr
    document = json.loads(made.stdout)
    Draft202012Validator(report_schema()).validate(document)
    (record,) = document["records"]
    return record


# Asking for it


@pytest.mark.parametrize(
    ("words", "wishes"),
    [
        (("--auto",), {}),
        (("--method", "auto"), {}),
        (("--auto", "--method", "auto"), {}),
        (("--keep", "edges"), {"keep": "edges"}),
        (("--strength", "-1.5"), {"strength": -1.5}),
        (("--strength", "0"), {}),
        (("--strength", "-0"), {}),
        (("--prefer", "volume", "--auto"), {"prefer": "volume"}),
        (("--auto-budget", "3"), {"budget": 3.0}),
    ],
)
def test_every_way_to_ask_reaches_the_chooser(scan, tmp_path, choose, words, wishes):
    chooser = choose(fixed())
    record = denoised_record(scan, "-o", tmp_path / "o.ply", *words)
    assert chooser.wishes == [selection.Wishes(**wishes)]
    assert repr(record["choice"]["wishes"]["strength"]) != "-0.0"
    assert selection.Wishes(**record["choice"]["wishes"]) == chooser.wishes[0]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--strength", "2.5"), "'2.5' is not a number from -2 to 2"),
        (("--auto-budget", "0.5"), "'0.5' is not a number from 1"),
        (("--auto-budget", "inf"), "'inf' is not a number from 1"),
        (("--keep", "noise"), "'texture', 'edges', 'shape'"),
        (("--prefer", "speed"), "'positions', 'normals', 'volume'"),
    ],
)
def test_wishes_that_mean_nothing_are_refused(scan, tmp_path, words, said):
    made = msal("denoise", scan, "-o", tmp_path / "o.ply", *words)
    assert made.exit_code == 2
    assert said in made.stderr


def test_other_commands_say_where_auto_is(scan, tmp_path):
    for words in (("sweep", scan, "-o", tmp_path / "o.png", "--method"), ("methods",)):
        made = msal(*words, "auto")
        assert made.exit_code == 2
        assert "hint: `msal denoise --auto` chooses one" in made.stderr


# What is told


def test_the_record_tells_what_was_run_and_why(scan, tmp_path, choose):
    choose(fixed("msal", {"K": 0.7, "iterations": 3}))
    record = denoised_record(scan, "-o", tmp_path / "o.ply", "--keep", "shape")
    settled = methods.find("msal").validate({"K": 0.7, "iterations": 3})
    assert record["method"] == {"name": "msal", "parameters": settled}
    assert record["choice"] == {
        "reason": REASON,
        "surface": "organic",
        "noise_edges": 0.11,
        "risk_edges": 0.0625,
        "tried": 7,
        "runners_up": [{"label": "AL, 3 sweeps", "risk_edges": 0.0724}],
        "wishes": dataclasses.asdict(selection.Wishes(keep="shape")),
        "repeat": ["--method", "msal", "--set", "iterations=3", "--set", "K=0.7"],
        "among": "all",
        "auto_seconds": None,
    }
    # The noise is estimated once.
    assert record["noise_estimate"]["mean_edges"] == 0.11
    assert record["seconds"]["choose"] > 0.0
    stages = {name: spent for name, spent in record["seconds"].items() if name != "total"}
    assert sum(stages.values()) == pytest.approx(record["seconds"]["total"], rel=1e-9)


def test_one_file_is_told_in_one_sentence(scan, tmp_path, choose):
    choose(fixed("msal", {"K": 0.7}))
    short = msal("denoise", scan, "-o", tmp_path / "o.ply", "--auto").stderr
    assert f"  chosen        {REASON}\n" in short
    assert "next best" not in short
    said = msal("denoise", scan, "-o", tmp_path / "o.ply", "--auto", "-v").stderr
    assert f"  chosen        {REASON}\n" in said
    assert "  next best     AL, 3 sweeps (risk 0.072 e)\n" in said
    assert "  by hand       --method msal --set K=0.7\n" in said
    assert ", choose 0." in said


@pytest.fixture(scope="module")
def batch(tmp_path_factory):
    """A run over a clean and two noisy scans: its folder, its records and what it said."""
    folder = tmp_path_factory.mktemp("batch")
    vertices, faces = torus(60, 30)
    scans = {"clean": ply_text(vertices, faces), "b": closed_scan(), "c": closed_scan(1)}
    folder_of(folder / "in", **scans)
    reports = [f"--report={folder / 'report.'}{form}" for form in ("csv", "md", "xml", "html")]
    reports.append("--csv-columns=all")
    words = ("denoise", folder / "in", "-o", folder / "out", "--auto", "-j", "1")
    made = msal(*words, *reports, "--log-file", folder / "log", "--json")
    assert made.exit_code == 0, made.stderr
    return folder, json.loads(made.stdout)["records"], made.stderr


def test_many_files_are_counted_and_each_has_a_line_in_the_log(batch):
    folder, records, said = batch
    counts = Counter(one["method"]["name"] for one in records)
    (line,) = [one for one in said.splitlines() if one.startswith("chosen: ")]
    assert dict(word.split() for word in line.removeprefix("chosen: ").split(", ")) == {
        name: str(count) for name, count in counts.items()
    }
    log = (folder / "log").read_text()
    for record in records:
        assert f"{record['input']}: {record['choice']['reason']}\n" in log
        assert record["choice"]["reason"] not in said


def test_what_is_up_to_date_keeps_its_own_choice(batch):
    folder, records, _ = batch
    made = msal("denoise", folder / "in", "-o", folder / "out", "--auto", "--json")
    again = json.loads(made.stdout)["records"]
    assert [one["status"] for one in again] == ["up-to-date"] * 3
    kept = [(one["method"], one["choice"]) for one in again]
    assert kept == [(one["method"], one["choice"]) for one in records]
    methods_used = [one["method"] for one in records]
    assert any(one != methods_used[0] for one in methods_used), "a case that can fail"


# What is done


def test_none_gives_the_very_bytes_back(scan, tmp_path, choose):
    choose(fixed("none", risk=None))
    output = tmp_path / "o.ply"
    made = msal("denoise", scan, "-o", output, "--auto", "--max-move", "0.1e", "--json")
    assert output.read_bytes() == scan.read_bytes()
    record = record_of(made)
    assert record["status"] == "unchanged"
    assert record["method"] == {"name": "none", "parameters": {}}
    assert record["choice"]["reason"] == REASON
    assert record["displacement"]["max"] == 0.0
    again = tmp_path / "again.ply"
    assert msal("denoise", scan, "-o", again, *record["choice"]["repeat"]).exit_code == 0
    assert again.read_bytes() == scan.read_bytes()


@pytest.mark.parametrize("keep", [("--keep", "edges")])
def test_the_options_told_repeat_a_real_choice(tmp_path, keep):
    one, other = tmp_path / "1.ply", tmp_path / "2.ply"
    scan = "sample_meshes/toadstool_noisy.ply"
    record = denoised_record(scan, "-o", one, "--auto", *keep)
    assert record["method"]["name"] in (*selection.METHODS, selection.NONE)
    assert record["choice"]["reason"].startswith("noise 0.")
    again = denoised_record(scan, "-o", other, *record["choice"]["repeat"])
    if record["method"]["name"] != selection.NONE:
        assert again["method"] == record["method"]
    assert one.read_bytes() == other.read_bytes()


def test_a_failure_before_the_choice_says_what_was_asked(tmp_path):
    scans = folder_of(tmp_path / "in", bad=b"ply\n")
    made = msal("denoise", scans, "-o", tmp_path / "out", "--strength", "1", "--json")
    record = record_of(made, 1)
    assert record["method"]["name"] == "auto"
    assert record["method"]["parameters"]["strength"] == 1.0
    assert record["choice"] is None


def test_the_wishes_are_part_of_what_is_current(scan, tmp_path, choose):
    choose(fixed())
    output = tmp_path / "out"

    def is_current(*words):
        return "is up to date" in msal("denoise", scan.parent, "-o", output, *words).stderr

    assert not is_current("--auto")
    assert is_current("--auto")
    assert is_current("--strength", "-0")
    assert is_current("--method", "auto", "--auto-budget", "60")
    assert not is_current("--strength", "0.5")
    assert not is_current("--strength", "0.5", "--prefer", "normals")
    assert not is_current("--strength", "0.5", "--keep", "texture")
    assert not is_current("--auto", "--auto-budget", "9")
    assert not is_current()
    assert not is_current("--auto")


def test_with_trust_the_method_has_a_data_term(tmp_path, monkeypatch):
    # Methods with a data term shrink a small torus.
    monkeypatch.setattr("msal_cli.analysis.harm.excessive_change", lambda *a, **k: None)
    vertices, faces = torus(64, 32)
    lines = [
        f"{x:.6f} {y:.6f} {z:.6f} 0.{1 + at % 9}"
        for at, (x, y, z) in enumerate(noisy(vertices, 0, 0.05))
    ]
    lines += ["3 " + " ".join(map(str, face)) for face in faces]
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\nproperty float x\n"
        "property float y\nproperty float z\nproperty float quality\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    scan = tmp_path / "scan.ply"
    scan.write_text(head + "\n".join(lines) + "\n")
    for at, wish in enumerate((["--strength", "2"],)):
        words = ("--weights", "quality")
        one, other = tmp_path / f"{at}.ply", tmp_path / f"again-{at}.ply"
        record = denoised_record(scan, "-o", one, "--auto", *wish, *words)
        assert record["method"]["name"] != selection.NONE, record["choice"]["reason"]
        assert (
            msal("denoise", scan, "-o", other, *record["choice"]["repeat"], *words).exit_code == 0
        )
        assert one.read_bytes() == other.read_bytes()


def test_trust_without_effect_is_a_warning(tmp_path, choose):
    choose(fixed("al"))
    vertices, faces = torus()
    head, _, rest = ply_text(vertices, faces).partition(b"\nelement face")
    lines = rest.split(b"\n")
    body = [line + b" 1" if 2 < at < 3 + len(vertices) else line for at, line in enumerate(lines)]
    scan = tmp_path / "scan.ply"
    scan.write_bytes(head + b"\nproperty float q\nelement face" + b"\n".join(body))
    record = denoised_record(scan, "-o", tmp_path / "o.ply", "--auto", "--weights", "q")
    assert record["warnings"][0] == (
        "--weights has no effect: al has no pull to the scanned positions"
    )


@pytest.fixture
def slow_to_choose(tmp_path):
    """An environment for real processes, workers too, in which choosing takes a minute, and a file
    that is there once it has begun."""
    begun = tmp_path / "begun"
    patch = tmp_path / "patch"
    patch.mkdir()
    (patch / "sitecustomize.py").write_text(
        "import time\n"
        "from pathlib import Path\n"
        "from msal_cli.auto import search\n"
        "def slow_search(mesh, wishes, on_step=None, is_allowed=None):\n"
        f"    Path({str(begun)!r}).touch()\n"
        "    for at in range(600):\n"
        "        time.sleep(0.1)\n"
        "search.search = slow_search\n"
    )
    root = str(Path(__file__).resolve().parents[2])
    return {"PYTHONPATH": os.pathsep.join([str(patch), root])}, begun


def test_the_time_limit_holds_while_choosing(tmp_path, slow_to_choose):
    env, begun = slow_to_choose
    scans = folder_of(tmp_path / "in", a=closed_scan(), b=closed_scan(1))
    words = ("--auto", "--timeout", "2s", "--retries", "0", "--json", "-q")
    made = process("denoise", scans, "-o", tmp_path / "out", *words, env=env)
    assert made.returncode == 1, made.stderr
    records = json.loads(made.stdout)["records"]
    assert begun.exists()
    assert [one["error"]["code"] for one in records] == ["E_TIMEOUT"] * 2
    assert not list((tmp_path / "out").glob("*.ply"))


def test_a_chooser_that_fails_is_a_failed_record(scan, tmp_path, choose):
    choose(lambda *given: 1 / 0)
    made = msal("denoise", scan, "-o", tmp_path / "o.ply", "--auto", "--json")
    record = record_of(made, 1)
    assert record["error"]["code"] == "E_INTERNAL"
    assert record["seconds"]["choose"] > 0.0
    assert not (tmp_path / "o.ply").exists()


def test_the_same_bytes_with_any_jobs_and_threads(tmp_path):
    scans = folder_of(tmp_path / "in", a=closed_scan(), b=open_scan(), c=closed_scan(5))
    made = []
    for at, (jobs, threads) in enumerate((("1", "1"), ("2", "2"))):
        output = tmp_path / f"out{at}"
        words = ("denoise", scans, "-o", output, "--auto", "--strength", "0.5", "-j", jobs, "-q")
        env = {"MSAL_THREADS": threads}
        done = process(*words, "--json", env=env)
        assert done.returncode == 0, done.stderr
        records = json.loads(done.stdout)["records"]
        made.append(
            (
                [(output / f"{name}.ply").read_bytes() for name in "abc"],
                [(one["method"], one["choice"]) for one in records],
            )
        )
    assert made[0] == made[1]
