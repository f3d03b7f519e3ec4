"""The order of stages, and tasks that are run once."""

from __future__ import annotations

import errno
import pickle
from dataclasses import replace

import numpy as np
import pytest

from msal_cli.errors import InternalError, OutputError
from msal_cli.tiles import stages
from msal_cli.tiles.plan import TilePlan
from msal_cli.tiles.scratch import Scratch
from msal_cli.tiles.stages import Stage, next_stage, reduce_stage, run_here, run_task

ORDER = ["count", "number", "faces", "weld", "choose", "rim", "prepare"]


def replace_functions(monkeypatch, record):
    """Tasks and reductions become ``record(function)``; stages that are not always there go."""
    table = {
        kind: replace(steps, run=record(steps.run), reduce=steps.reduce and record(steps.reduce))
        for kind, steps in stages._STAGES.items()
        if steps.is_needed is None
    }
    monkeypatch.setattr(stages, "_STAGES", table)


@pytest.fixture
def calls(monkeypatch):
    """What was called, in order; two rounds of denoising."""
    made = []

    def record(function):
        name = f"{function.__module__.rpartition('.')[2]}.{function.__name__}"

        def call(scratch, *arguments):
            made.append((name, *arguments))
            return arguments[0] == 0 if name == "sweep.reduce_denoise" else {"is": name}

        return call

    replace_functions(monkeypatch, record)
    return made


@pytest.fixture
def scratch(tmp_path):
    """A plan of two vertex chunks, three face chunks, four tiles and two pieces."""
    scratch = Scratch(tmp_path)
    chunk = [(0, 1), 0, (0, 1)]
    TilePlan(
        {}, {}, {}, None, 2, 3, "float32", [0] * 3, [0.0] * 3, 4, [(0, 1), (1, 2)],
        [chunk] * 3, [(0, 1), (1, 2)],
    ).save(scratch)  # fmt: skip
    return scratch


def test_all_stages_run_in_order_and_each_task_once(scratch, calls):
    seen = []
    run_here(scratch, lambda *progress: seen.append(progress))
    names = list(dict.fromkeys(name for name, _, _ in seen))
    assert names == [*ORDER, "denoise-0", "denoise-1", "join"]
    tasks = [call for call in calls if ".run_" in call[0]]
    assert len(tasks) == len(set(tasks)) == 2 + 2 + 3 + 4 + 1 + 4 + 4 + 2 * 4 + 2
    assert ("sweep.run_denoise", 1, 3) in tasks
    assert all(done == total for _, done, total in [seen[-1]])
    assert next_stage(scratch) is None
    calls.clear()
    run_here(scratch)
    assert not calls


def test_a_killed_run_goes_on_from_finished_tasks(scratch, calls):
    run_task(pickle.loads(pickle.dumps((str(scratch.path), "count", 1))))
    assert next_stage(scratch) == Stage("count", 2, [0])
    result = run_task((str(scratch.path), "count", 0))
    assert run_task((str(scratch.path), "count", 0)) == result == scratch.result("count", 0)
    assert calls == [("cut.run_count", 1), ("cut.run_count", 0)]
    # Killed before the reduction: only that is left.
    assert next_stage(scratch) == Stage("count", 2, [])
    reduce_stage(scratch, "count")
    assert next_stage(scratch) == Stage("number", 2, [0, 1])


def test_a_stage_is_not_reduced_before_its_tasks_are_finished(scratch, calls):
    run_task((str(scratch.path), "count", 1))
    with pytest.raises(InternalError, match="1 of its tasks"):
        reduce_stage(scratch, "count")


def test_what_a_killed_task_left_is_not_a_result(scratch):
    (scratch.path / "done/count").mkdir(parents=True)
    (scratch.path / "done/count/.msal-0.json.tmp").write_bytes(b"{")
    assert next_stage(scratch) == Stage("count", 2, [0, 1])


def test_no_space_for_temporary_files_is_no_defect(scratch, monkeypatch):
    def call(scratch, index):
        raise OSError(errno.ENOSPC, "No space left on device")

    replace_functions(monkeypatch, lambda function: call)
    with pytest.raises(OutputError, match="temporary files of tiles: No space left") as caught:
        run_task((str(scratch.path), "count", 0))
    assert caught.value.code == "E_WRITE"
    assert str(scratch.path) in str(caught.value.path)
    assert "--scratch" in caught.value.hint


def test_rows_are_written_where_they_belong(tmp_path):
    scratch = Scratch(tmp_path)
    scratch.create("rows", np.float64, (9, 2))
    rows = np.array([7, 2, 3, 8, 0], dtype=np.uint32)
    values = np.arange(10.0).reshape(5, 2)
    scratch.write_rows("rows", rows, values)
    expected = np.zeros((9, 2))
    expected[rows] = values
    assert (scratch.array("rows", np.float64, 2) == expected).all()
    scratch.write_rows("rows", rows[:0], values[:0])
