"""Plans of files that arrive: one that is refused stops no other."""

import pytest

from msal_cli.batch.arrival_plan import ArrivalPlanner
from msal_cli.batch.inputs import discover_inputs
from msal_cli.batch.plan import build_plan


@pytest.fixture
def planner(tmp_path):
    return ArrivalPlanner(lambda files: build_plan(files, str(tmp_path / "out"), to="ply"))


def files_of(tmp_path, *names):
    folder = tmp_path / "in"
    folder.mkdir(exist_ok=True)
    for name in names:
        (folder / name).write_text("x")
    return [one for one in discover_inputs([str(folder)]) if one.relative in names]


def inputs_of(plans):
    return [task.relative for plan in plans for task in plan.tasks]


def test_files_that_can_be_planned_are_one_plan(planner, tmp_path):
    plans, refused = planner.plan(files_of(tmp_path, "a.ply", "b.obj", "c.stl"))
    assert len(plans) == 1
    assert inputs_of(plans) == ["a.ply", "b.obj", "c.stl"]
    assert refused == []


def test_an_output_that_is_not_ours_costs_its_own_file_only(planner, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out/b.ply").write_text("foreign")
    plans, refused = planner.plan(files_of(tmp_path, "a.ply", "b.obj", "c.stl"))
    assert inputs_of(plans) == ["a.ply", "c.stl"]
    ((file, record),) = refused
    assert file.relative == "b.obj"
    assert record.status == "failed"
    assert record.error.code == "E_USAGE"
    assert "--force" in record.error.hint


@pytest.mark.parametrize("together", [True, False])
def test_of_two_files_with_one_output_the_first_has_it(planner, tmp_path, together):
    files = files_of(tmp_path, "a.obj", "a.stl")
    batches = [files] if together else [files[:1], files[1:]]
    plans, refused = [], []
    for batch in batches:
        more, bad = planner.plan(batch)
        plans += more
        refused += bad
    assert inputs_of(plans) == ["a.obj"]
    assert [one.relative for one, _ in refused] == ["a.stl"]
    assert "a.obj" in refused[0][1].error.message


def test_an_output_whose_input_is_gone_is_free_again(planner, tmp_path):
    first, second = files_of(tmp_path, "a.obj", "a.stl")
    planner.plan([first])
    (tmp_path / "in/a.obj").unlink()
    plans, refused = planner.plan([second])
    assert inputs_of(plans) == ["a.stl"]
    assert refused == []


def test_a_file_that_changed_is_planned_again(planner, tmp_path):
    files = files_of(tmp_path, "a.obj")
    planner.plan(files)
    plans, refused = planner.plan(files)
    assert inputs_of(plans) == ["a.obj"]
    assert refused == []
