"""``msal.toml``: which file counts, what the command line overrules, and what is refused."""

import json
import re
from pathlib import Path

import pytest

from tests.cli.scans import closed_scan, folder_of, msal, msal_on

WORDS = ("denoise", "in/a.ply", "-o", "o.ply")


@pytest.fixture
def project(tmp_path, monkeypatch):
    folder_of(tmp_path / "in", a=closed_scan())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(folder, text, name="msal.toml"):
    (folder / name).write_text(text)


def settings(*words):
    made = msal(*words, "--json")
    assert made.exit_code == 0, made.stderr
    return json.loads(made.stdout)["settings"]


def refusal(*words):
    made = msal(*words)
    assert (made.exit_code, made.stdout) == (2, "")
    assert "Traceback" not in made.stderr
    return made.stderr


def test_options_come_from_the_current_folder(project):
    write(
        project, '[denoise]\nmethod = "msal"\niterations = 2\nK = 0.3\n[denoise.set]\nmollify = 2'
    )
    used = settings(*WORDS)
    assert used["method"] == "msal"
    assert used["parameters"]["K"] == 0.3
    assert used["parameters"]["mollify"] == 2
    assert settings(*WORDS, "--no-config")["method"] == "adaptive"


def test_the_command_line_wins(project):
    write(project, '[denoise]\nmethod = "msal"\niterations = 2\nfail-on = ["faces > 1"]')
    assert settings(*WORDS, "-n", "5", "--fail-on", "faces < 1")["parameters"]["iterations"] == 5
    assert msal(*WORDS).exit_code == 4


@pytest.mark.parametrize(
    ("text", "words", "key", "value"),
    [
        ('method = "msal"\nK = 0.3', ("--auto",), "method", "auto"),
        ("auto = true", ("-n", "2"), "method", "msal"),
        ('method = "adaptive"', ("-K", "0.3"), "method", "msal"),
        ('backup = ".raw"\ncsv-columns = "all"', (), "method", "adaptive"),
        ('to = "obj"', (), "to", None),
    ],
)
def test_what_contradicts_the_command_line_is_left_out(project, text, words, key, value):
    write(project, f"[denoise]\n{text}")
    assert settings(*WORDS, *words)[key] == value


def test_options_for_files_are_left_out_for_a_stream(project):
    write(project, "[denoise]\nretries = 2\nfail-fast = true\nquiet = true")
    assert msal(*WORDS).exit_code == 0
    made = msal_on((project / "in/a.ply").read_bytes(), "denoise", "-")
    assert (made.exit_code, made.stderr) == (0, "")
    assert "time" in msal("denoise", "in/a.ply", "-o", "b.ply", "-v").stderr


def test_paths_are_relative_to_the_file(project, monkeypatch):
    (project / ".git").mkdir()
    write(project, '[denoise]\nreport = "in/r.csv"')
    monkeypatch.chdir(project / "in")
    assert msal("denoise", "a.ply", "-o", "o.ply").exit_code == 0
    assert (project / "in/r.csv").exists()


def test_a_parent_counts_within_a_repository_only(project, monkeypatch):
    write(project, '[denoise]\nmethod = "al"')
    below = project / "in"
    monkeypatch.chdir(below)
    words = ("denoise", "a.ply", "-o", "o.ply")
    assert settings(*words)["method"] == "adaptive"
    (project / ".git").mkdir()
    assert settings(*words)["method"] == "al"
    write(below, '[denoise]\nmethod = "umbrella"')
    assert settings(*words)["method"] == "umbrella"
    (below / "msal.toml").unlink()
    (below / ".git").mkdir()
    assert settings(*words)["method"] == "adaptive"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[denoise]\nmax-mov = 3", ("msal.toml: [denoise] max-mov", "did you mean 'max-move'?")),
        ("[denoise]\nmax_move = 3", ("[denoise] max_move", "did you mean 'max-move'?")),
        ("[denois]\nK = 3", ("msal.toml", "[denois]", "did you mean 'denoise'?")),
        ("K = 3", ("msal.toml: K is not a table", "below [denoise]")),
        ("denoise = 3", ("denoise is not a table",)),
        ("[denoise]\nhelp = true", ("there is no such option",)),
        ("[denoise]\nconfig = 'x'", ("there is no such option",)),
        ("[denoise]\nauto = 'yes'", ("[denoise] auto is 'yes'", "true or false")),
        ("[denoise]\njobs = 0", ("msal.toml: [denoise] jobs", "neither auto nor")),
        ("[denoise]\njobs = 1\nmethod = 'foo'", ("no method 'foo' (msal.toml gives method)",)),
        ("[denoise]\nfields = 'noise,nope'", ("no field 'nope' (msal.toml gives fields)",)),
        ("[denoise]\nencoding = 'hex'", ("msal.toml: [denoise] encoding", "'hex'")),
        ("[denoise]\nverbose = 'x'", ("write true",)),
        ("[denoise]\nmethod = 1979-05-27", ("[denoise] method",)),
        ("[denoise]\nfail-on = [[1]]", ("[denoise] fail-on",)),
        ("[denoise\n", ("msal.toml: this is not TOML", "line 1")),
        ("[denoise]\nin-place = true", ("in-place", "--config")),
        ("[denoise]\nscheduler = 'tcp://evil:1'", ("scheduler", "--config")),
        ("[denoise]\nscratch = '.'", ("scratch", "--config")),
        ("[denoise]\nreport = '../x.csv'", ("leads out of the folder",)),
        ("[denoise]\noutput = '/elsewhere/x'", ("leads out of the folder",)),
        ('[denoise]\nreport = "a\\u0000.csv"', ("[denoise] report", "u0000")),
        ("[denoise]\nreport = 's3://evil/r.csv'", ("leads out of the folder",)),
    ],
)
def test_mistakes_are_refused_and_named(project, text, words):
    write(project, text)
    said = refusal(*WORDS)
    assert all(word in said for word in words), said
    assert not (project / "o.ply").exists()
    # Help is there to mend it.
    assert msal("denoise", "--help").exit_code == 0


def test_a_named_file_may_do_all_that_the_command_line_may(project):
    (project / "away").mkdir()
    write(project / "away", "[denoise]\nin-place = true\nreport = '../x.csv'", "my.toml")
    assert msal("denoise", "in", "--config", "away/my.toml").exit_code == 0
    assert (project / "x.csv").exists()
    assert (project / "in/a.ply.orig").exists()


def test_a_named_file_must_be_there(project):
    assert "none.toml: the file cannot be read" in refusal(*WORDS, "--config", "none.toml")
    (project / "latin.toml").write_bytes(b"[denoise]\nmethod = '\xe9'")
    assert "not UTF-8" in refusal(*WORDS, "--config", "latin.toml")
    assert "contradict" in refusal(*WORDS, "--config", "latin.toml", "--no-config")
    (project / "bom.toml").write_bytes("\ufeff[denoise]\r\nmethod = 'al'\r\n".encode())
    assert settings(*WORDS, "--config", "bom.toml")["method"] == "al"


def test_other_commands_have_tables_too(project):
    write(
        project, '[info]\nexclude = ["*"]\n[noise]\nlevel = 0.0\n[view]\nsize = 64\nverbose = true'
    )
    assert msal("info", "in").exit_code == 5
    assert msal("noise", "in/a.ply", "-o", "n.ply", "-q").exit_code == 0
    assert (project / "n.ply").read_bytes() == (project / "in/a.ply").read_bytes()
    assert msal("view", "in/a.ply", "-q", "-o", "p.png").exit_code == 0
    assert (project / "p.png").exists()


def test_the_file_on_the_page_is_accepted(project):
    pages = Path(__file__).resolve().parents[2] / "docs"
    (text,) = re.findall(r"^```toml\n(.+?)^```$", (pages / "usage.md").read_text(), re.M | re.S)
    write(project, text)
    # Its gate is broken by this scan.
    made = msal(*WORDS[:2], "-o", "denoised/", "--json")
    assert made.exit_code == 4
    assert json.loads(made.stdout)["settings"]["parameters"]["mollify"] == 2
    assert (project / "denoised/night.csv").exists()
