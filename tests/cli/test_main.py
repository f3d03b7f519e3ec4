"""The program as a whole: help without numpy, errors in one line, pipes, signals."""

import json
import os
import subprocess
from unittest.mock import Mock

import pytest

from msal_cli import methods
from tests.cli.scans import BAD_SCAN, closed_scan, folder_of, msal, process
from tests.files import posix, run_python

HEAVY = "('numpy', 'numba', 'trimesh', 'meshio', 'tqdm')"


def heavy_modules_after(*arguments):
    code = f"""
import sys
from msal_cli.cli.main import program
try:
    program.main({list(arguments)!r})
except SystemExit as end:
    print(end.code, [name for name in {HEAVY} if name in sys.modules])
"""
    return run_python(code).splitlines()[-1]


@pytest.mark.parametrize(
    "arguments", [["--help"], ["denoise", "--help"], ["completion", "--help"]], ids=" ".join
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
    monkeypatch.setattr("msal_cli.job.inspection.inspect_file", Mock(side_effect=error))
    folder_of(tmp_path, a=closed_scan())
    made = msal("info", tmp_path)
    assert (made.exit_code, made.stderr) == (1, f"msal: error: {words}\n")


def test_an_internal_error_is_one_line(monkeypatch, tmp_path):
    monkeypatch.setattr("msal_cli.job.inspection.inspect_file", lambda *given, **named: 1 / 0)
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
