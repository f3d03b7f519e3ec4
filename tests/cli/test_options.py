"""Values of options, and options that contradict or need each other."""

from __future__ import annotations

import click
import pytest

from msal_cli import methods
from msal_cli.cli import options
from msal_cli.errors import UsageError
from tests.cli.scans import msal

SIZE = {"500M": 500 * 10**6, "500mb": 500 * 10**6, "2G": 2 * 10**9, "1.5GiB": 3 << 29}
DURATION = {"90": 90.0, "90s": 90.0, "1.5m": 90.0, "2h": 7200.0, ".5 h": 1800.0, "none": None}
VALUES = {
    options.parse_jobs: {"auto": None, "1": 1, "4096": 4096},
    options.parse_duration: DURATION,
    options.parse_size: {**SIZE, "64 MiB": 64 << 20, "none": None},
    options.parse_percentage: {"2%": 0.02, "0.5 %": 0.005},
    options.parse_list: {"a, b": ("a", "b")},
    options.parse_direction: {
        "-Y": (0.0, -1.0, 0.0),
        "+x": (1.0, 0.0, 0.0),
        "0,-1,0.5": (0.0, -1.0, 0.5),
    },
    options.number(0.0, 9.0, "e"): {"2": 2.0, "2e": 2.0, "-0": 0.0},
}
REFUSED = {
    options.parse_jobs: ("0", "-1", "4097", "1.5", "", "Auto", "²", "9" * 5000),
    options.parse_duration: ("", "x", "-1", "0", "0s", "1e9", "5 parsecs", "inf", "nan", "٣"),
    options.parse_size: ("", "500", "0M", "-2G", "2GG", "1e3M", "0.0000001K", "M"),
    options.parse_percentage: ("", "2", "-1%", "x%", "٣%"),
    options.parse_direction: ("w", "1,2", "nan,0,1", "0,0,0", "inf,0,0", "1e200,0,0"),
    options.number(-2.0, 2.0): ("", "x", "2.5", "-3", "nan", "inf"),
    options.number(): ("nan", "inf", "-inf"),
}


@pytest.mark.parametrize(
    ("parse", "text", "value"),
    [(parse, *pair) for parse, values in VALUES.items() for pair in values.items()],
)
def test_values(parse, text, value):
    assert parse(text) == value
    assert str(parse(text)) == str(value)


@pytest.mark.parametrize(
    ("parse", "text"), [(parse, text) for parse, texts in REFUSED.items() for text in texts]
)
def test_values_that_are_refused(parse, text):
    with pytest.raises(click.BadParameter) as caught:
        parse(text)
    assert repr(text) in caught.value.message


def test_the_methods_found_without_importing_them_are_the_methods():
    assert options.list_methods() == methods.names()
    assert options.complete_method(None, None, "ms") == ["msal"]


@pytest.mark.parametrize("text", ["0", "-1", "two", "1.5"])
def test_a_number_of_threads_that_is_none_is_refused(text, monkeypatch):
    monkeypatch.setenv("MSAL_THREADS", text)
    with pytest.raises(UsageError, match="MSAL_THREADS"):
        options.check_threads_variable()
    monkeypatch.setenv("MSAL_THREADS", "3")
    options.check_threads_variable()


TO_FILE, DASK, STREAM = "a.ply -o out ", "--engine dask --scheduler ", "- -o out.ply "


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("a.ply", "there is no output"),
        (TO_FILE + "-q -v", "--quiet and --verbose contradict"),
        (TO_FILE + "--in-place", "--in-place and --output contradict"),
        ("a.ply --in-place --to obj", "--in-place cannot change the format"),
        ("a.ply --in-place --backup .x --no-backup", "--backup and --no-backup contradict"),
        (TO_FILE + "--backup .x", "--backup needs --in-place"),
        (TO_FILE + "--no-backup", "--no-backup needs --in-place"),
        (TO_FILE + "--fail-fast --max-failures 2", "--fail-fast and --max-failures contradict"),
        ("a.ply --in-place --fields sigma", "the next run in place would take for an input"),
        (TO_FILE + "--scheduler tcp://host:1", "--scheduler needs --engine dask"),
        (TO_FILE + "--engine dask", "--engine dask needs --scheduler"),
        (TO_FILE + DASK + "x", "--scheduler x: this is not an address"),
        (TO_FILE + DASK + "local", "--scheduler local: this is not an address"),
        (TO_FILE + DASK + "tcp://host:1 -j 2", "-j is for this machine"),
        ("a.ply --in-place " + DASK + "tcp://host:1", "--in-place cannot be used with Dask"),
        *(
            (f"{TO_FILE}{one} {other}", f"{one.split(' ')[0]}.* and {other.split(' ')[0]}")
            for one in ("--auto", "--keep edges", "--strength 0", "--prefer normals")
            for other in ("--method msal", "--iterations 3", "-K 1", "--mollify 0", "--set a=1")
        ),
        (TO_FILE + "--strength 1 --schedule plain", "--strength and --schedule contradict"),
        (TO_FILE + "--method auto -n 3", "--method auto and --iterations contradict"),
        (TO_FILE + "--method adaptive -n 3", "--method adaptive and --iterations contradict"),
        (TO_FILE + "--method adaptive --auto", "--auto and --method adaptive contradict"),
        (TO_FILE + "--strength 2.5", "'2.5' is not a number from -2 to 2"),
        (TO_FILE + "--keep noise", "'texture', 'edges', 'shape'"),
        (TO_FILE + "--prefer speed", "'positions', 'normals', 'volume'"),
        (TO_FILE + "--max-move 0", "no length above 0"),
        (TO_FILE + "--lock confidence", "neither 'boundary' nor"),
        (TO_FILE + "--weights q --method al", "al has none with the schedule plain"),
        (TO_FILE + "--weights q --method taubin", "taubin has none"),
        *(
            (STREAM + word, f"{word.split(' ')[0]} is for files, not for standard input")
            for word in (
                "--include x",
                "--timeout 5",
                "--memory-limit 2G",
                "--dry-run",
                "--shard 1/2",
            )
        ),
        (STREAM + "--retries 0", "--retries is for files"),
        (STREAM + "--max-failures 1", "--max-failures is for files"),
        (STREAM + "--retry-failed", "--retry-failed is for files"),
        (STREAM + "--fields sigma", "--fields is for files"),
        (STREAM + "--engine dask", "--engine dask is for files"),
        ("- --in-place", "--in-place is for files"),
        ("- -o - --reference x.ply", "--reference measures a file"),
        ("- -o - --json", "the mesh and --json cannot both go to standard output"),
    ],
)
def test_options_of_denoise_that_do_not_go_together(line, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.ply").touch()
    made = msal("denoise", *line.split())
    assert made.exit_code == 2
    with pytest.raises(AssertionError, match=message):
        raise AssertionError(made.stderr)
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


@pytest.mark.parametrize("text", ["K", "=1", "K=", " = ", ""])
def test_no_assignment(text):
    with pytest.raises(UsageError, match="is not NAME=VALUE"):
        options.parse_assignment(text)


def test_the_shortcuts_are_parameters_of_methods():
    words = {spec.name for name in methods.names() for spec in methods.find(name).parameters}
    assert set(options.SHORTCUTS) <= words
