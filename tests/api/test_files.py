"""denoise_file and denoise_folder: files as the command writes them, and errors as exceptions."""

import inspect
import json
import pickle
import signal
import sys
import threading
import time
from pathlib import Path

import pytest

import msal_cli as msal
from tests.campaigns import runs
from tests.cli.scans import BAD_SCAN, closed_scan, folder_of, open_scan
from tests.cli.scans import msal as run_command
from tests.files import tree
from tests.ply_files import to_ply
from tests.shapes import torus

OPTIONS = {"method": "msal", "K": 0.4}
ONE = OPTIONS | {"jobs": 1}
WORDS = ("-K", "0.4")


@pytest.fixture
def scans(tmp_path):
    scans = folder_of(tmp_path / "scans", a=closed_scan(), b=closed_scan(1), c=open_scan())
    folder_of(scans / "below", d=open_scan())
    return scans


# One file


def test_a_file_has_the_bytes_of_the_command(scans, tmp_path):
    record = msal.denoise_file(scans / "a.ply", tmp_path / "api.ply", **OPTIONS)
    run_command("denoise", scans / "a.ply", "-o", tmp_path / "cli.ply", *WORDS)
    assert (tmp_path / "api.ply").read_bytes() == (tmp_path / "cli.ply").read_bytes()
    assert record.status == "written" and record.output == str(tmp_path / "api.ply")
    assert record.method.parameters["K"] == 0.4
    assert all("more than msal is made for" in warning for warning in record.warnings)


def test_a_file_that_fails_raises_and_writes_nothing(scans, tmp_path):
    (scans / "bad.ply").write_bytes(BAD_SCAN)
    with pytest.raises(msal.ContentError) as caught:
        msal.denoise_file(scans / "bad.ply", tmp_path / "out.ply")
    assert caught.value.code == "E_INDEX" and caught.value.path == str(scans / "bad.ply")
    assert not (tmp_path / "out.ply").exists()
    with pytest.raises(msal.LossError):
        vertices, faces = torus()
        (scans / "trust.ply").write_bytes(to_ply(vertices, faces, trust=vertices[:, 0]))
        msal.denoise_file(scans / "trust.ply", tmp_path / "out.stl", strict=True, **OPTIONS)
    with pytest.raises(msal.OutputError):
        msal.denoise_file(scans / "a.ply", f"{tmp_path}/{'x' * 300}/out.ply", **OPTIONS)


@pytest.mark.parametrize(
    "arguments",
    [
        {"input": [1]},
        {"output": None},
        {"input": "scans"},
        {"output": "scans"},
        {"output": "a\0.ply"},
    ]
    + [{"output": "scans/a.ply"}, {"output": "out.doc"}, {"precision": "float16"}, {"k": 1}]
    + [{"fail_on": "volume >"}, {"fail_on": "hausdorff > 1e"}],
    ids=str,
)
def test_calls_that_mean_nothing_are_refused(scans, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    before = tree(tmp_path)
    with pytest.raises(msal.UsageError):
        msal.denoise_file(**{"input": "scans/a.ply", "output": "out.ply"} | arguments)
    assert tree(tmp_path) == before


# Folders


def test_a_folder_has_the_files_and_the_manifest_of_the_command(scans, tmp_path):
    (scans / "bad.ply").write_bytes(BAD_SCAN)
    records = list(msal.denoise_folder(scans, tmp_path / "api", jobs=2, **OPTIONS))
    done = run_command("denoise", scans, "-o", tmp_path / "cli", "-j", "2", *WORDS)
    assert done.exit_code == 3
    assert tree(tmp_path / "api") == tree(tmp_path / "cli")
    status = {Path(record.input).name: record.status for record in records}
    assert status == dict.fromkeys(["a.ply", "b.ply", "c.ply", "d.ply"], "written") | {
        "bad.ply": "failed"
    }
    assert next(one for one in records if one.error).error.code == "E_INDEX"
    # Either goes on with what the other has done.
    again = run_command("denoise", scans, "-o", tmp_path / "api", *WORDS, "--json")
    assert {one["status"] for one in json.loads(again.stdout)["records"]} == {
        "up-to-date",
        "failed",
    }
    records = list(msal.denoise_folder(scans, tmp_path / "cli", fail_on="volume.valid", **OPTIONS))
    assert {record.status for record in records} == {"up-to-date", "failed"}
    assert sum(gate.broken for record in records for gate in record.gates) == 2


def test_arguments_are_checked_before_the_first_record(scans, tmp_path):
    for wrong in ({"output": None}, {"method": "msla"}, {"include": "*.obj"}, {"to": "doc"}):
        with pytest.raises(msal.MsalError):
            msal.denoise_folder(**{"inputs": scans, "output": tmp_path / "out"} | wrong)
    with pytest.raises(msal.NothingMatched):
        msal.denoise_folder(scans, tmp_path / "out", include="*.obj")
    records = msal.denoise_folder(scans, tmp_path / "out")
    assert inspect.isgenerator(records) and not (tmp_path / "out").exists()
    records.close()
    wrong = {"jobs": (0, "2"), "retries": (-1,), "timeout": (0, "10m"), "memory_limit": (1, "4G")}
    wrong |= {"max_failures": (0,), "K": (2,), "method": ("",)}
    for name, value in ((name, value) for name, values in wrong.items() for value in values):
        with pytest.raises(msal.UsageError):
            msal.denoise_folder(scans, tmp_path / "out", **{name: value})


def test_the_loop_may_be_left_and_gone_on_with(scans, tmp_path):
    for record in msal.denoise_folder(scans, tmp_path / "out", **ONE):
        assert record.status == "written"
        break
    # The lock of the folder is free, and what was finished is known.
    records = list(msal.denoise_folder(scans, tmp_path / "out", **ONE))
    statuses = [one.status for one in records]
    assert len(statuses) == 4 and "up-to-date" in statuses
    assert not [one for one in threading.enumerate() if one.name == "msal"]


SLOW = """
import sys, msal_cli as msal
print("begun", flush=True)
for record in msal.denoise_folder(sys.argv[1], sys.argv[2], "l0", jobs=1, iterations=1000):
    print(record.status, flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals")
def test_ctrl_c_ends_the_run_at_once_as_a_keyboard_interrupt(tmp_path):
    scans = folder_of(tmp_path / "scans", a=to_ply(*torus(300, 100)))
    command = [sys.executable, "-c", SLOW, str(scans), str(tmp_path / "out")]
    process = runs.started(command, text=True)
    assert process.stdout.readline() == "begun\n"
    deadline = time.monotonic() + 60
    while not (tmp_path / "out").is_dir() and time.monotonic() < deadline:
        time.sleep(0.02)
    time.sleep(0.3)
    started = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert time.monotonic() - started < 10
    assert errors.rstrip().endswith("KeyboardInterrupt")
    # The folder is free for another run.
    assert list(msal.denoise_folder(scans, tmp_path / "out", "al", fresh=True, force=True))


def test_a_missing_file_is_a_file_not_found_error(tmp_path):
    with pytest.raises(FileNotFoundError) as caught:
        msal.denoise_file(tmp_path / "none.ply", tmp_path / "out.ply")
    assert isinstance(caught.value, msal.UsageError)
    with pytest.raises(FileNotFoundError, match="cannot be read") as caught:
        msal.compare(tmp_path / "none.ply", tmp_path / "none.ply")
    assert isinstance(caught.value, msal.InputError) and caught.value.code == "E_READ"
    again = pickle.loads(pickle.dumps(caught.value))
    assert (type(again), again.path) == (msal.MissingFileError, caught.value.path)
