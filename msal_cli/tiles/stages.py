"""The stages of a run by tiles, their order, and the one way to run a task of any of them.

A task reads what earlier stages left in the scratch folder and writes ranges of its own; its
result is a small JSON value.  When all tasks of a stage are finished, the leader reduces their
results to what all tasks of later stages need.  Tasks of one stage do not depend on each other.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from msal_cli.errors import InternalError
from msal_cli.tiles import cut, halo, join, representative, sweep, vertex_data, windings
from msal_cli.tiles.plan import TilePlan, load_plan
from msal_cli.tiles.scratch import Scratch

TaskRef = tuple[str, str, int]
"""Path of the scratch folder, name of the stage, number of the task."""

OnProgress = Callable[[str, int, int], None]
"""Called as ``on_progress(stage, done, total)``."""

DENOISE = "denoise"
"""The stage that is run in rounds."""

_ROUND = re.compile(rf"{DENOISE}-(\d+)")


@dataclass(frozen=True)
class Stage:
    """A stage that is not finished.

    Attributes
    ----------
    name : such as ``count`` or ``denoise-0``.
    n_tasks : all its tasks, numbered from 0.
    todo : those without a result, ascending; none where only the reduction is left.
    """

    name: str
    n_tasks: int
    todo: list[int]


@dataclass(frozen=True)
class _Steps:
    """What a stage consists of.

    Attributes
    ----------
    n_tasks : how many tasks it has.
    run : a task, called as ``run(scratch, index) -> result``.
    reduce : the reduction, called as ``reduce(scratch)``; None if there is none.
    is_needed : says whether there is such a stage in this run, called as ``is_needed(scratch)``
        once the stages before it are finished; None if there always is.

    The rounds of ``denoise`` have their number before the other arguments, and their reduction
    returns whether another round is needed.
    """

    n_tasks: Callable[[TilePlan], int]
    run: Callable[..., Any]
    reduce: Callable[..., Any] | None = None
    is_needed: Callable[[Scratch], bool] | None = None


def _n_vertex_chunks(plan: TilePlan) -> int:
    return len(plan.vertex_chunks)


def _n_face_chunks(plan: TilePlan) -> int:
    return len(plan.face_chunks)


def _n_tiles(plan: TilePlan) -> int:
    return plan.n_tiles


def _n_pieces(plan: TilePlan) -> int:
    return len(plan.pieces)


def _one(plan: TilePlan) -> int:
    return 1


_STAGES = {
    "count": _Steps(_n_vertex_chunks, cut.run_count, cut.reduce_count),
    "number": _Steps(_n_vertex_chunks, cut.run_number),
    "faces": _Steps(_n_face_chunks, cut.run_faces, cut.reduce_faces),
    "weld": _Steps(_n_tiles, cut.run_weld, cut.reduce_weld),
    "choose": _Steps(_one, representative.run_choose, representative.reduce_choose),
    "rim": _Steps(_n_tiles, halo.run_rim, halo.reduce_rim),
    "values": _Steps(
        _n_vertex_chunks,
        vertex_data.run_values,
        vertex_data.reduce_values,
        vertex_data.has_values,
    ),
    "pins": _Steps(_n_tiles, vertex_data.run_pins, is_needed=vertex_data.has_pins),
    "prepare": _Steps(_n_tiles, sweep.run_prepare, sweep.reduce_prepare),
    "wind": _Steps(_n_tiles, windings.run_wind, windings.reduce_wind, windings.is_needed),
    "turn": _Steps(_n_tiles, windings.run_turn, windings.reduce_turn, windings.is_needed),
    DENOISE: _Steps(_n_tiles, sweep.run_denoise, sweep.reduce_denoise),
    "join": _Steps(_n_pieces, join.run_join),
}
"""All stages in their order.  ``denoise`` stands for ``denoise-0``, ``denoise-1`` ...: a round
follows as long as the reduction of the one before says so."""


def next_stage(scratch: Scratch) -> Stage | None:
    """The first stage that is not finished; None if all are."""
    plan = load_plan(scratch)
    for kind, steps in _STAGES.items():
        name = _next_round(scratch) if kind == DENOISE else kind
        if name is None or scratch.stage_result(name) is not None:
            continue
        if steps.is_needed is not None and not steps.is_needed(scratch):
            continue
        n_tasks = steps.n_tasks(plan)
        finished = scratch.finished(name)
        return Stage(name, n_tasks, [one for one in range(n_tasks) if one not in finished])
    return None


def finished_stages(scratch: Scratch) -> list[str]:
    """The stages that are finished, in their order."""
    names: list[str] = []
    for kind in _STAGES:
        number = 0
        while scratch.stage_result(name := _round_name(kind, number)) is not None:
            names.append(name)
            number += 1
            if kind != DENOISE:
                break
    return names


def count_finished(scratch: Scratch) -> int:
    """How many tasks of all stages are finished."""
    names = finished_stages(scratch)
    stage = next_stage(scratch)
    return sum(len(scratch.finished(name)) for name in names) + (
        0 if stage is None else stage.n_tasks - len(stage.todo)
    )


def run_task(ref: TaskRef, common: object = None, on_progress: OnProgress | None = None) -> Any:
    """Run one task and record its result, which is returned; a task that is finished is not run.

    Any process that sees the scratch folder can call it.  ``common`` and ``on_progress`` are what
    engines give to every function; a task is too short for a progress of its own.
    """
    path, name, index = ref
    scratch = Scratch(path)
    known = scratch.result(name, index)
    if known is not None:
        return known
    kind, arguments = _parse_name(name)
    with scratch.explain_failures():
        result = _STAGES[kind].run(scratch, *arguments, index)
        scratch.finish(name, index, result)
    return result


def reduce_stage(scratch: Scratch, name: str) -> None:
    """Reduce the results of a stage whose tasks are all finished; only the leader does this.

    A reduction that was killed is repeated from the results of the tasks.
    """
    kind, arguments = _parse_name(name)
    missing = _STAGES[kind].n_tasks(load_plan(scratch)) - len(scratch.finished(name))
    if missing:
        raise InternalError(f"stage {name} is reduced before {missing} of its tasks are finished")
    again, reduce = False, _STAGES[kind].reduce
    with scratch.explain_failures():
        if reduce is not None:
            again = bool(reduce(scratch, *arguments))
        scratch.finish_stage(name, {"again": again})


def run_here(scratch: Scratch, on_progress: OnProgress | None = None) -> None:
    """Run all stages that are left in this process, one task after another."""
    while (stage := next_stage(scratch)) is not None:
        for index in stage.todo:
            if on_progress is not None:
                on_progress(stage.name, index, stage.n_tasks)
            run_task((str(scratch.path), stage.name, index))
        reduce_stage(scratch, stage.name)
        if on_progress is not None:
            on_progress(stage.name, stage.n_tasks, stage.n_tasks)


def _next_round(scratch: Scratch) -> str | None:
    """The name of the first round of denoising that is not finished, None if no other follows."""
    number = 0
    while (result := scratch.stage_result(_round_name(DENOISE, number))) is not None:
        if not result["again"]:
            return None
        number += 1
    return _round_name(DENOISE, number)


def _round_name(kind: str, number: int) -> str:
    return f"{DENOISE}-{number}" if kind == DENOISE else kind


def _parse_name(name: str) -> tuple[str, tuple[int, ...]]:
    """The stage in the table, and the number of the round where there are several."""
    match = _ROUND.fullmatch(name)
    return (DENOISE, (int(match[1]),)) if match else (name, ())
