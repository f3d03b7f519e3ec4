"""Values of options, and command lines that are refused: with a message, and nothing is touched."""

import os
import re
import shlex

import click
import pytest

from msal_cli import methods
from msal_cli.cli import options
from msal_cli.errors import UsageError
from tests.cli.scans import BAD_SCAN, closed_scan, folder_of, msal_on, open_scan, ply_text
from tests.files import posix, time_limit, tree

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
NO_VALUES = {
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
    ("parse", "text"), [(parse, text) for parse, texts in NO_VALUES.items() for text in texts]
)
def test_values_that_are_refused(parse, text):
    with pytest.raises(click.BadParameter) as caught:
        parse(text)
    assert repr(text) in caught.value.message


def test_methods_are_completed():
    assert options.complete_method(None, None, "ms") == ["msal"]


@pytest.mark.parametrize("text", ["0", "-1", "two", "1.5"])
def test_a_number_of_threads_that_is_none_is_refused(text, monkeypatch):
    monkeypatch.setenv("MSAL_THREADS", text)
    with pytest.raises(UsageError, match="MSAL_THREADS"):
        options.check_threads_variable()
    monkeypatch.setenv("MSAL_THREADS", "3")
    options.check_threads_variable()


@pytest.mark.parametrize("text", ["K", "=1", "K=", " = ", ""])
def test_no_assignment(text):
    with pytest.raises(UsageError, match="is not NAME=VALUE"):
        options.parse_assignment(text)


def test_the_shortcuts_are_parameters_of_methods():
    words = {spec.name for name in methods.names() for spec in methods.find(name).parameters}
    assert set(options.SHORTCUTS) <= words


# Command lines that are refused: with a message and a status, nothing printed, nothing touched


SCAN = closed_scan()


@pytest.fixture
def place(tmp_path, monkeypatch):
    """The current folder: scans, other files, and links and pipes where there are some."""
    monkeypatch.chdir(tmp_path)
    folder_of(tmp_path, a=SCAN, b=closed_scan(1), bad=BAD_SCAN, open=open_scan())
    folder_of(tmp_path, points=ply_text([(0.0, 0.0, 0.0)], []))
    folder_of(tmp_path / "in", a=SCAN)
    for name in ("mesh.json", "mesh.png"):
        (tmp_path / name).write_bytes(open_scan())
    (tmp_path / "notes.txt").write_text("precious")
    if os.name == "posix":
        os.link("in/a.ply", "hard.csv")
        os.symlink("in/a.ply", "soft.csv")
        for suffix in ("ply", "json", "jsonl", "csv"):
            os.mkfifo(f"pipe.{suffix}")
    return tmp_path


# Command lines; parts of the message, with & between them.  The status is 2 if no other stands
# before the line.
REFUSED = """
denose | did you mean 'denoise'? & hint: msal --help shows how it is used
frob | hint: msal --help shows how it is used
--iterations | hint: msal --help shows how it is used
den | hint: msal --help shows how it is used
# Options have no abbreviations.
denoise a.ply -o new.ply --iter=3 | --iter

denoise a.ply | there is no output & -o OUT, or replace the inputs with --in-place
methods msl | there is no method 'msl' & hint: did you mean msal?
denoise a.ply -o new --method msaal | there is no method 'msaal' & did you mean msal
denoise a.ply -o new -n 3 --set iterations=4 | two different values & once
denoise a.ply -o new --encoding hex | 'hex' is not one of & denoise --help
denoise a.ply -o new --report r.json --report r.json | given twice
denoise a.ply -o a.ply | overwritten by its own output & --in-place
denoise a.ply -o new -q -v | --quiet and --verbose contradict
denoise a.ply -o new --in-place | --in-place and --output contradict
denoise a.ply -o new --backup .x | --backup needs --in-place
denoise a.ply -o new --no-backup | --no-backup needs --in-place
denoise a.ply --in-place --to obj | --in-place cannot change the format
denoise a.ply --in-place --backup .x --no-backup | --backup and --no-backup contradict
denoise a.ply --in-place --backup .ply | would be inputs of the next run & .orig
denoise a.ply --in-place --fields sigma | the next run in place would take for an input
denoise a.ply -o new --fail-fast --max-failures 2 | --fail-fast and --max-failures contradict
denoise a.ply -o new --strength 1 --schedule plain | --strength and --schedule contradict
denoise a.ply -o new --method adaptive -n 3 | --method adaptive and --iterations contradict
denoise a.ply -o new --method adaptive --auto | --auto and --method adaptive contradict
denoise a.ply -o new --method adaptive --keep edges | --keep: this is for a choice among all methods
denoise a.ply -o new --method umbrella -K 0.3 | K = 0.3 means nothing to the schedule plain
denoise a.ply -o new --strength 2.5 | '2.5' is not a number from -2 to 2
denoise a.ply -o new --keep noise | 'texture', 'edges', 'shape'
denoise a.ply -o new --max-move 0 | no length above 0
denoise a.ply -o new --lock confidence | neither 'boundary' nor
denoise a.ply -o new --weights q --method al | al has none as it is set
denoise a.ply -o new --weights q --method taubin | taubin has none
denoise a.ply -o new --scheduler tcp://host:1 | --scheduler needs --engine dask
denoise a.ply -o new --engine dask | --engine dask needs --scheduler
denoise a.ply -o new --engine dask --scheduler x | --scheduler x: this is not an address
denoise a.ply -o new --engine dask --scheduler tcp://host:1 -j 2 | -j is for this machine
denoise a.ply --in-place --engine dask --scheduler tcp://host:1 | cannot be used with Dask
denoise in --tile-set --in-place | --in-place cannot be used with --tile-set
denoise in -o new --tile-set --shard 1/2 | the files of a tile set are one mesh
denoise in -o new --tile-set --engine dask --scheduler tcp://host:1 | of a tile set are one mesh
denoise in -o new --strength | hint: msal denoise --help
denoise in -o new --scratch none | --scratch none: there is no such folder
denoise in -o new --fail-on 'volume_chnge > 1%' | the gate 'volume_chnge > 1%', column & hint:
denoise in -o new --fail-on 'x > ' | the gate 'x >', column & hint:
# As of a variable that is not set.
denoise in -o '' | '--output': it is empty
denoise in '' -o new | 'INPUT...': it is empty
denoise in -o new --fail-on '' | '--fail-on': it is empty
denoise in -o=new | '=new' begins with '='
denoise in -o new --config '' | cannot be read
view '' | 'A': it is empty
denoise in -o new --fail-on 'hausdorff > 0' | against a reference & give --reference TRUTH
denoise a.ply -o new.ply --reference none.ply | none.ply
denoise a.ply -o - --reference b.ply | --reference

# Streams
denoise - -o new.ply --engine dask | --engine dask is for files
denoise - --in-place | --in-place is for files
denoise - -o - --reference b.ply | --reference measures a file
denoise - -o - --json | the mesh and --json cannot both go to standard output
denoise - a.ply -o new.ply | hold one mesh, not several
denoise a.ply a.ply -o - | hold one mesh, not several
denoise in -o - | is a folder
denoise nowhere.ply -o - | is no file
denoise - -o in | has no name to put there
denoise - -o new/ | has no name to put there
denoise - --report - | needs the name of a file
denoise - -o new.ply --to stl | say two formats
denoise - -o y.stp | no mesh format
denoise a.ply -o - --report a.ply | unknown report format

compare a.ply - | write the stream to a file
compare a.ply b.ply in | two folders
compare in in --heatmap h.ply | --heatmap
compare a.ply b.ply --heatmap a.ply |
compare a.ply b.ply --heatmap heat.obj |
compare a.ply b.ply --heatmap . |
compare a.ply b.ply --tolerance 2% | --baseline
compare a.ply b.ply --baseline none.json | none.json

info - in |
info - --include '*' |
info nowhere.ply |
info |
5 info in --include '*.stl' |
info in --format zzz |

sweep a.ply -o g.png --rows K | --rows K: not of the form & NAME=VALUE
sweep a.ply -o g.png --rows K=0.5,,1 | NAME=VALUE
sweep a.ply -o g.png --rows K=0.5,2 | K = 2
sweep a.ply -o g.png --columns k=0.5 | no parameter
sweep a.ply -o g.png --columns K=0.5,0.50 | twice
sweep a.ply -o g.png --columns K=0.5 --rows K=1 | two places
sweep a.ply -o g.png --columns K=0.5 --set mollify=1 --set mollify=2 | twice
sweep a.ply -o g.png --rows K=0.1,0.2,0.3 --columns iterations=NUMBERS | 100 cells
sweep a.ply -o g.png --method nothing | no method
sweep a.ply -o g.ply | NAME.png
sweep a.ply -o notes.txt/g.png --columns K=1 | cannot be written to the folder
1 sweep a.ply -o g.png --reference open.ply | open.ply & same vertices and faces

view missing.ply -o p.png | missing.ply
1 view bad.ply -o p.png | bad.ply
1 view a.ply bad.ply -o p.png | bad.ply
1 view points.ply -o p.png | E_NO_FACES
1 view a.ply -o none/p.png | the output folder does not exist
view a.ply -o p.png --colours deviation | needs a mesh B
view a.ply -o a.ply | NAME.png
view a.ply -o p.png --size 9 | 48
view a.ply -o p.png --turn nan | from -360 to 360
view a.ply -o p.png --view inside | inside
view - -o p.png | stream

noise a.ply -o new.ply --level much |
noise a.ply -o new.ply --seed -3 |
noise a.ply -o new.ply --fraction 1.5 |
noise a.ply -o new.ply --kind salt |
noise a.ply -o new.ply --kind property |
noise a.ply -o new.ply --kind view --direction up |
noise a.ply -o new.ply --kind view --rings 1.5 |
noise a.ply -o new.ply --kind quantised --step 0 |
noise a.ply -o a.ply |
1 noise a.ply -o new.stl | the format

watch none -o new --idle-exit 1s | there is no folder
watch in -o in --idle-exit 1s | is the folder that is watched
watch in -o notes.txt --idle-exit 1s | is no folder
watch s3://bucket/in -o new --idle-exit 1s | folders of this machine

# What is read is a file.
info pipe.ply | file
view a.ply pipe.ply -o p.png | file
sweep pipe.ply -o g.png | file
compare a.ply pipe.ply | file
compare a.ply a.ply --baseline pipe.json | file
noise pipe.ply -o new.ply | file
denoise pipe.ply -o - | file
denoise a.ply -o new.ply --reference pipe.ply | file
1 denoise a.ply -o pipe.ply | file
report pipe.json | file
report pipe.jsonl | file

# What would be replaced is none of msal's, or is at work.
denoise in/a.ply -o out --report hard.csv |
denoise in/a.ply -o out --report soft.csv |
denoise in/a.ply -o out --report pipe.csv |
denoise in/a.ply -o out --report mesh.json |
denoise in/a.ply -o out --report out/.msal-manifest.jsonl |
denoise in/a.ply -o out --report OUT/.MSAL-manifest.jsonl |
compare in/a.ply in/a.ply --heatmap b.ply |
compare in/a.ply in/a.ply --heatmap in/a.ply |
compare in/a.ply in/a.ply --heatmap .msal-x.ply |
view in/a.ply -o mesh.png |
sweep in/a.ply -o mesh.png |
noise in/a.ply -o b.ply |
"""


FOR_FILES = ("--include x", "--timeout 5", "--memory-limit 2G", "--dry-run", "--shard 1/2")
FOR_FILES += ("--retries 0", "--max-failures 1", "--retry-failed", "--fields sigma")


def read_refused():
    for status, line, words in re.findall(r"^(\d?) ?([^#\n].*?) \|(.*)$", REFUSED, re.M):
        marks = [posix] if re.search("pipe|hard|soft", line) else []
        yield pytest.param(line, words.split("&"), int(status or 2), marks=marks, id=line)
    for one in FOR_FILES:
        words = [f"{one.split()[0]} is for files, not for standard input"]
        yield pytest.param(f"denoise - -o new.ply {one}", words, 2)
    for one in ("--auto", "--keep edges", "--strength 0"):
        for other in ("--method msal", "--iterations 3", "-K 1", "--mollify 0", "--set a=1"):
            words = [f"{one.split()[0]} ", f" and {other.split()[0]}"]
            yield pytest.param(f"denoise a.ply -o new {one} {other}", words, 2)


@pytest.mark.parametrize(("line", "words", "status"), list(read_refused()))
def test_it_is_refused(place, line, words, status):
    before = tree(place, has_own=True)
    given = shlex.split(line.replace("NUMBERS", ",".join(map(str, range(1, 41)))))
    with time_limit(60.0):  # A test that waits for a pipe fails.
        made = msal_on(SCAN, *given)
    assert (made.exit_code, made.stdout) == (status, ""), made.stderr
    assert "msal: error: " in made.stderr
    assert "Traceback" not in made.stderr and "internal" not in made.stderr
    assert all(word.strip() in made.stderr for word in words), made.stderr
    assert tree(place, has_own=True) == before
