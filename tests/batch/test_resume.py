"""What an earlier run has done: case by case, with one file and one line of a manifest."""

import dataclasses
import hashlib
import os
import threading
from types import SimpleNamespace

import pytest

from msal_cli.batch import resume
from msal_cli.batch.manifest import FileStat, done_line, encode_line, intent_line, parse_line
from msal_cli.batch.plan import Plan, manifest_key
from msal_cli.job.records import Failure, FieldsFile, MeshRecord, MethodUsed
from msal_cli.job.settings import Task
from msal_cli.storage.urls import ObjectMark


def sha256(data):
    return hashlib.sha256(data).hexdigest()


class Case:
    """A file ``in`` of a task, its output ``out``, and the entry of the manifest, if any."""

    def __init__(self, folder, **task):
        self.folder = folder
        self.write("in.ply", b"the input")
        self.path, out = str(folder / "in.ply"), str(folder / "out.ply")
        out = self.path if task.get("in_place") else out
        self.task = Task(self.path, out, "in.ply", manifest_dir=str(folder), **task)
        self.entry = None
        self.options = {}

    def write(self, name, data):
        (self.folder / name).write_bytes(data)

    def begin(self):
        self.entry = parse_line(encode_line(intent_line("out.ply", self.task.input)))

    def finish(self, settings="s", **changes):
        """Write the output and its line."""
        self.write(os.path.basename(self.task.output), b"the output")
        values = {
            "input": "other name",
            "output": self.task.output,
            "status": "written",
            "input_sha256": sha256(b"the input"),
            "output_sha256": sha256(b"the output"),
            "method": MethodUsed("msal", {"K": 0.5}),
        }
        record = MeshRecord(**(values | changes))
        line = done_line("out.ply", settings, record, self.task.input)
        self.entry = parse_line(encode_line(line))

    def state(self, threads=1):
        plan = Plan((self.task,), **self.options)
        name = manifest_key(self.task)
        manifests = {str(self.folder): SimpleNamespace(get={name: self.entry}.get)}
        (state,) = resume.file_states(plan, manifests, {"s"}, threads=threads)
        return state

    def todo(self):
        return self.state() == resume.FileState(0, None, "", False)


@pytest.fixture
def case(tmp_path):
    return Case(tmp_path)


def test_an_output_that_is_current(case):
    assert case.todo()
    case.finish()
    record = case.state().record
    assert (record.status, record.input) == ("up-to-date", case.task.input)
    assert record.output == case.task.output
    assert record.input_sha256 is case.entry.input_sha256
    assert record.output_sha256 is case.entry.output_sha256
    assert record.method == MethodUsed("msal", {"K": 0.5})
    case.finish(status="unchanged")
    assert case.state().record.status == "up-to-date"


@pytest.mark.parametrize(
    "change",
    [
        lambda case: case.write("in.ply", b"THE INPUT"),
        lambda case: case.write("out.ply", b"THE OUTPUT"),
        lambda case: os.remove(case.task.output),
        lambda case: case.finish("other settings"),
        lambda case: case.finish(status="failed"),
        lambda case: case.finish(input_sha256=""),
        lambda case: case.finish(output_sha256=""),
        lambda case: case.finish(sidecars=("copied a.mtl",)),
        lambda case: case.finish(sidecars=(f"wrote in.ply (SHA-256 {'0' * 64})",)),
        lambda case: case.finish(fields=FieldsFile("a.fields.ply", (), "", "", 0.0, 1.0, "hash")),
        lambda case: case.options.update(fresh=True),
        lambda case: case.begin(),
    ],
)
def test_what_makes_a_file_be_done_again(case, change):
    case.finish()
    change(case)
    assert case.todo()


def test_the_mesh_of_a_gltf_file_may_be_elsewhere(tmp_path):
    case = Case(tmp_path)
    case.write("in.gltf", b"the input")
    case.task = dataclasses.replace(case.task, input=str(tmp_path / "in.gltf"))
    case.finish()
    assert case.todo()


@pytest.mark.parametrize(
    ("code", "is_known"),
    [
        *((f"E_{name}", True) for name in ("FORMAT", "TRUNCATED", "CONTENT", "NONFINITE", "INDEX")),
        *((f"E_{name}", True) for name in ("NO_FACES", "RANGE", "LOSS")),
        *((f"E_{name}", False) for name in ("MEMORY", "CRASH", "TIMEOUT", "WRITE", "READ")),
        *((f"E_{name}", False) for name in ("UNSUPPORTED", "TOO_LARGE", "INTERNAL")),
    ],
)
def test_a_failure_that_comes_again_is_not_tried(case, code, is_known):
    failed = {"status": "failed", "error": Failure(code, "words", "hint"), "output": None}
    case.finish(**failed)
    record = case.state().record
    assert (record is not None) == is_known
    if record is not None:
        assert (record.status, record.remembered, record.output) == ("failed", True, None)
        assert (record.input, record.error.code) == (case.task.input, code)
    case.options["retry_failed"] = True
    assert case.todo()
    case.options.clear()
    case.write("in.ply", b"THE INPUT")
    assert case.todo()


@pytest.mark.parametrize(
    ("now", "is_current"),
    [
        (ObjectMark(9, "tag"), True),
        (ObjectMark(9, "other"), False),
        (ObjectMark(8, "tag"), False),
        (None, False),
    ],
)
def test_objects_are_compared_by_their_tags(case, now, is_current):
    output = "memory://store/out.ply"
    case.finish(output=output, output_object=ObjectMark(9, "tag"))
    case.task = dataclasses.replace(case.task, output=output, manifest_dir="memory://store")
    case.options["objects"] = {} if now is None else {output: now}
    plan = Plan((case.task,), **case.options)
    manifests = {"memory://store": SimpleNamespace(get=lambda name: case.entry)}
    (state,) = resume.file_states(plan, manifests, {"s"}, threads=1)
    assert (state.record is not None) == is_current


@pytest.mark.parametrize(("tag", "is_current"), [("tag", True), ("", False)])
def test_an_input_in_a_store_has_the_mark_of_its_listing(case, tag, is_current):
    mark = ObjectMark(9, tag)
    case.finish(input_object=mark)
    case.task = dataclasses.replace(case.task, input="memory://store/in.ply", input_mark=mark)
    assert (case.state().record is not None) == is_current


def test_equal_methods_are_one_and_states_come_in_order(tmp_path):
    names = [f"{k:03}" for k in range(100)]
    tasks, entries = [], {}
    for name in names:
        (tmp_path / name).mkdir()
        case = Case(tmp_path / name)
        case.finish()
        tasks.append(dataclasses.replace(case.task, manifest_dir=str(tmp_path)))
        entries[f"{name}/out.ply"] = case.entry
    plan = Plan(tuple(tasks))
    manifests = {str(tmp_path): entries}
    for threads in (1, 3):
        states = list(resume.file_states(plan, manifests, {"s"}, threads=threads))
        assert [state.index for state in states] == list(range(100))
        assert [state.record.input for state in states] == [task.input for task in tasks]
        assert len({id(state.record.method) for state in states}) == 1


def test_threads_are_for_several_files_and_end_with_the_iterator(tmp_path, monkeypatch):
    seen = []
    real = resume.hash_file

    def hash_file(path, is_stopped=lambda: False):
        seen.append(threading.current_thread() is threading.main_thread())
        return real(path, is_stopped)

    monkeypatch.setattr(resume, "hash_file", hash_file)
    case = Case(tmp_path)
    case.finish()
    case.state(threads=3)
    assert all(seen) and seen
    tasks = (case.task, case.task)
    manifests = {str(tmp_path): {"out.ply": case.entry}}
    seen.clear()
    states = resume.file_states(Plan(tasks), manifests, "s", threads=2)
    assert next(states).record is not None
    states.close()
    assert not any(seen)
    assert not [one for one in threading.enumerate() if "ThreadPool" in one.name]


def in_place(folder, backup):
    return Case(folder, in_place=True, backup=backup)


def test_without_a_backup_a_changed_file_may_be_done(tmp_path):
    case = in_place(tmp_path, None)
    case.begin()
    assert case.todo()
    case.write("in.ply", b"denoised, perhaps")
    record = case.state().record
    assert (record.status, record.error.code) == ("failed", "E_CHANGED")
    assert record.input == case.task.input
    case.options["fresh"] = True
    assert case.todo()
    case.options.clear()
    case.finish("other settings")
    case.write("in.ply", b"something else")
    assert case.todo()


@pytest.mark.parametrize("other", [b"the input", b"THE INPUT", b"another size"])
def test_a_backup_that_is_not_the_file_is_an_obstacle(tmp_path, other):
    case = in_place(tmp_path, ".orig")
    backup = case.path + ".orig"
    case.write("in.ply.orig", other)
    if other == b"the input":
        assert case.todo()
    else:
        assert case.state() == resume.FileState(0, obstacle=backup)
        # What is not the size that the input had is not its backup.
        case.write("in.ply", b"before")
        case.begin()
        assert case.state() == resume.FileState(0, obstacle=backup)
    for target in (case.path, "nothing") if os.name == "posix" else ():
        os.remove(backup)
        os.symlink(target, backup)
        assert case.state().obstacle == backup


def test_a_backup_of_an_interrupted_run_is_restored(tmp_path):
    case = in_place(tmp_path, ".orig")
    case.begin()
    case.write("in.ply.orig", b"the input")
    for now in (b"denoised!", b"denoised, longer"):
        case.write("in.ply", now)
        assert case.state() == resume.FileState(0, restores=True)
    case.entry = dataclasses.replace(case.entry, is_done=True)
    assert case.state().obstacle
    os.remove(case.path)
    case.entry = dataclasses.replace(case.entry, is_done=False)
    assert case.state() == resume.FileState(0, restores=True)


@pytest.mark.parametrize("backup", [None, ".orig"])
def test_rolling_back(tmp_path, backup):
    case = in_place(tmp_path, backup)
    before = FileStat.of(case.path)
    assert resume.roll_back(case.task, before) == ""
    if backup:
        case.write("in.ply.orig", b"the input")
        assert resume.roll_back(case.task, before) == ""
        assert FileStat.of(case.path) == before
    case.write("in.ply", b"denoised")
    words = resume.roll_back(case.task, before)
    if backup:
        assert (words, (tmp_path / "in.ply").read_bytes()) == ("", b"the input")
        return
    assert "may be denoised already" in words
    assert resume.roll_back(dataclasses.replace(case.task, in_place=False), before) == ""


def test_files_are_hashed_in_blocks_until_it_is_to_stop(tmp_path, monkeypatch):
    path = tmp_path / "a"
    for size in (0, 1, (1 << 20) - 1, 1 << 20, (1 << 20) + 1):
        path.write_bytes(b"x" * size)
        assert resume.hash_file(str(path)) == sha256(b"x" * size)
        assert resume.hash_file(str(path), lambda: True) == ("" if size else sha256(b""))
    for name in ("none", "", "nul\0"):
        assert resume.hash_file(str(tmp_path / name)) == ""
