"""The program as a whole: help, completion, errors in one line, pipes, signals."""

import json
import os
import shutil
import subprocess
from unittest.mock import Mock

import click
import pytest

from msal_cli import methods
from msal_cli.cli.command import Command, first_clause
from msal_cli.cli.main import COMMANDS, program
from tests.cli.scans import BAD_SCAN, closed_scan, folder_of, msal, process
from tests.files import posix, run_python


def heavy_modules_after(*arguments):
    code = f"""
import sys
from msal_cli.cli.main import program
heavy = ("numpy", "numba", "trimesh", "meshio", "tqdm")
try:
    program.main({list(arguments)!r})
except SystemExit as end:
    print(end.code, [name for name in heavy if name in sys.modules])
"""
    return run_python(code).splitlines()[-1]


@pytest.mark.parametrize(
    "arguments", [["--help"], ["denoise", "--help"], ["help", "info"]], ids=" ".join
)
def test_help_imports_nothing_heavy(arguments):
    assert heavy_modules_after(*arguments) == "0 []"


def test_no_word_at_all_gets_the_help():
    made = msal()
    assert (made.exit_code, made.stdout) == (2, "")
    assert "Usage: msal" in made.stderr


def test_the_help_of_denoise_tells_the_real_defaults():
    said = " ".join(msal("denoise", "--help-all").stdout.split())
    defaults = methods.find("msal").validate({})
    for option, name in (("-n,", "iterations"), ("-K", "K"), ("--mollify", "mollify")):
        after = said[said.index(f"{option} ") :]
        assert after[after.index("[default: ") :].startswith(
            f"[default: chosen for each mesh; {defaults[name]} with --method msal]"
        )


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (RuntimeError("can't start new thread"), "not enough memory (E_MEMORY)"),
        (FileNotFoundError(2, "none"), "the current folder does not exist any more (E_READ)"),
    ],
    ids=repr,
)
def test_a_fault_of_the_system_is_no_internal_error(error, words, monkeypatch, tmp_path):
    monkeypatch.setattr("msal_cli.job.comparison.inspect_file", Mock(side_effect=error))
    folder_of(tmp_path, a=closed_scan())
    made = msal("info", tmp_path)
    assert (made.exit_code, made.stderr) == (1, f"msal: error: {words}\n")


def test_an_internal_error_is_one_line(monkeypatch, tmp_path):
    monkeypatch.setattr("msal_cli.job.comparison.inspect_file", lambda *given, **named: 1 / 0)
    folder_of(tmp_path, a=closed_scan())
    made = msal("info", tmp_path)
    assert made.exit_code == 1
    assert made.stdout == ""
    assert made.stderr == (
        "msal: internal error: ZeroDivisionError: division by zero; please report it "
        "(-v shows where)\n"
    )
    assert "Traceback" in msal("info", "-v", tmp_path).stderr


# The real process


@posix
def test_a_name_that_is_no_unicode_goes_in_and_out(tmp_path):
    folder = os.fsencode(tmp_path) + b"/in"
    os.mkdir(folder)
    with open(folder + b"/s\xff can\n.ply", "wb") as file:
        file.write(closed_scan())
    with open(folder + b"/bad\xfe\x1b[2J.ply", "wb") as file:
        file.write(BAD_SCAN)
    made = process(
        "denoise", folder, "-o", folder + b"/../o\xfd", "--report", tmp_path / "r.json", "--json"
    )
    assert made.returncode == 3, made.stderr
    assert os.path.exists(folder + b"/../o\xfd/s\xff can\n.ply")
    assert b"\x1b" not in made.stderr
    assert b"s\\xff can\\n.ply" in made.stderr
    assert b"bad\\xfe\\x1b[2J.ply: " in made.stderr
    records = json.loads(made.stdout)["records"]
    assert [one["input"].rpartition("/")[2] for one in records] == [
        "bad\\udcfe\x1b[2J.ply",
        "s\\udcff can\n.ply",
    ]
    assert json.loads((tmp_path / "r.json").read_bytes())["records"] == records


@posix
def test_a_reader_that_goes_away_is_no_noise_and_what_is_to_be_written_is_written(tmp_path):
    scan = folder_of(tmp_path, a=closed_scan()) / "a.ply"
    assert msal("denoise", scan, "-o", tmp_path / "out/", "-q").exit_code == 0
    for name, arguments in (
        ("a.ply", ["denoise", scan, "-o", "-"]),
        ("h.ply", ["compare", scan, scan, "--heatmap", "h.ply"]),
        ("r.csv", ["report", "out", "-o", "r.csv", "--json"]),
    ):
        read, write = os.pipe()
        os.close(read)
        made = process(*arguments, capture_output=False, stdout=write, cwd=tmp_path,
                       stderr=subprocess.PIPE)  # fmt: skip
        os.close(write)
        assert (made.returncode, (tmp_path / name).exists()) == (141, True), arguments
        assert b"rror:" not in made.stderr


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
@pytest.mark.parametrize("command", ["denoise", "--help"])
def test_an_output_that_cannot_be_written_is_fatal(tmp_path, command):
    scan = folder_of(tmp_path, a=closed_scan()) / "a.ply"
    arguments = [scan, "-o", "-"] if command == "denoise" else []
    with open("/dev/full", "wb") as full:
        made = process(
            command, *arguments, capture_output=False, stdout=full, stderr=subprocess.PIPE
        )
    assert made.returncode == 1
    assert b"No space left on device (E_WRITE)" in made.stderr
    assert b"Traceback" not in made.stderr
    assert b"Exception ignored" not in made.stderr


def test_a_setting_for_blas_is_left_alone(monkeypatch):
    code = "import os, msal_cli.__main__; print(os.environ['OPENBLAS_NUM_THREADS'])"
    assert run_python(code, OPENBLAS_NUM_THREADS="3") == "3\n"
    monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    assert run_python(code) == "1\n"


def find_command(name: str) -> tuple[Command, click.Context]:
    command = program.get_command(click.Context(program), name)
    assert isinstance(command, Command)
    parent = click.Context(program, info_name="msal", help_option_names=["-h", "--help"])
    return command, click.Context(command, parent, info_name=name)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_in_exactly_one_group(name):
    command, context = find_command(name)
    grouped = [one for _, options in command.grouped_options(context) for one in options]
    shown = [
        one
        for one in command.get_params(context)
        if isinstance(one, click.Option) and not one.hidden
    ]
    assert sorted(one.opts for one in grouped) == sorted(one.opts for one in shown)
    titles = [title for title, _ in command.grouped_options(context)]
    assert len(set(titles)) == len(titles)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_short_help_fits_a_screen(name, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    shown = msal(name, "--help").stdout
    assert len(shown.splitlines()) <= 56, shown
    assert max(map(len, shown.partition("Examples:")[0].splitlines())) <= 80


@pytest.mark.parametrize(
    ("text", "short"),
    [
        ("File or folder; a folder gets a tree. More.", "File or folder."),
        ("Sweeps.  [default: 4]", "Sweeps.  [default: 4]"),
        ("Of mm, m, in, ... Then lengths. More.", "Of mm, m, in, ... Then lengths."),
        ("Noise of 0.3 and more. And.", "Noise of 0.3 and more."),
        ("One.  [default: " + "long " * 9 + "]", "One."),
    ],
)
def test_the_first_clause(text, short):
    assert first_clause(text) == short


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script(shell):
    made = msal("completion", shell)
    assert made.exit_code == 0
    assert f"_MSAL_COMPLETE={shell}_complete" in made.stdout
    if shutil.which(shell):
        subprocess.run([shell, "-n"], input=made.stdout, text=True, check=True)


@pytest.mark.parametrize(
    ("words", "answers"),
    [
        (["msal", ""], {"plain,denoise", "plain,info", "plain,methods", "plain,completion"}),
        (["msal", "de"], {"plain,denoise"}),
        (["msal", "methods", "ms"], {"plain,msal"}),
        (["msal", "denoise", "--method", ""], {"plain,al", "plain,msal"}),
        (["msal", "denoise", "--enc"], {"plain,--encoding"}),
        (["msal", "denoise", "--encoding", "a"], {"plain,ascii"}),
        (["msal", "denoise", "-o", "x"], {"file,x"}),
        (["msal", "denoise", "sc"], {"file,sc"}),
    ],
)
def test_what_bash_is_answered(words, answers, monkeypatch):
    monkeypatch.setenv("_MSAL_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", " ".join(words))
    monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
    assert answers <= set(msal().stdout.splitlines())


@pytest.mark.parametrize("name", methods.names())
def test_a_page_tells_parameters_ranges_directions_and_source(name):
    method = methods.find(name)
    made = msal("methods", name)
    assert made.exit_code == 0
    assert made.stdout.startswith(f"{name}: {method.summary}")
    assert method.source[:20] in made.stdout
    for spec in method.parameters:
        assert f"  {spec.name} = {spec.default}" in made.stdout
        assert spec.help in made.stdout
        assert f"allowed: {spec.range_text}" in made.stdout
        assert not spec.more or f"more is {spec.more}" in made.stdout
        also = {"iterations": "-n", "mollify": "--mollify", "schedule": "--schedule"}.get(spec.name)
        assert not also or f"  {spec.name} = {spec.default}   (also {also}" in made.stdout


def test_json():
    made = msal("methods", "--json")
    data = json.loads(made.stdout)
    assert data["schema"] == "msal.methods/1"
    assert [one["name"] for one in data["methods"]] == list(methods.names())
    (one,) = json.loads(msal("methods", "msal", "--json").stdout)["methods"]
    factor = next(spec for spec in one["parameters"] if spec["name"] == "K")
    assert (factor["low"], factor["high"], factor["low_open"]) == (0.0, 1.0, True)
    assert (factor["kind"], factor["default"]) == ("float", 0.5)
