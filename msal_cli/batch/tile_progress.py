"""How far a run by tiles is: the cost of finished tasks over that of all."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from msal_cli.tiles.stages import finished_stages

if TYPE_CHECKING:
    from msal_cli.tiles.scratch import Scratch
    from msal_cli.tiles.stages import Stage

TOTAL = 1000
"""What ``done`` is counted in: parts of the whole."""

COSTS = {
    "count": 3.0,
    "number": 6.0,
    "faces": 16.0,
    "weld": 4.0,
    "choose": 2.0,
    "rim": 6.0,
    "values": 1.0,
    "pins": 1.0,
    "prepare": 22.0,
    "wind": 0.0,
    "turn": 0.0,
    "denoise": 30.0,
    "join": 11.0,
}
"""Shares of the seconds of a run that all tasks of a stage take; measured by
benchmarks/beyond_memory.py."""

USUAL_ROUNDS = 5
"""Rounds of ``denoise`` that are expected: those of ``msal`` with four sweeps."""


class TileProgress:
    """Reports ``("tiles", done, TOTAL)`` after every task.

    How many rounds ``denoise`` takes is not known before: each takes a share of what is left.
    """

    def __init__(self, scratch: Scratch, on_progress: Callable[[str, int, int], None]) -> None:
        self._on_progress = on_progress
        self._n_tasks = 1
        self._done = self._stage_cost = 0.0
        self._reported = -1
        self._scratch = scratch

    def begin(self, stage: Stage) -> None:
        """Tasks of a stage follow."""
        earlier = finished_stages(self._scratch)
        done = sum(self._cost(name) for name in earlier)
        self._n_tasks = stage.n_tasks
        self._stage_cost = self._cost(stage.name)
        finished = stage.n_tasks - len(stage.todo)
        self._done = done + self._stage_cost * finished / max(stage.n_tasks, 1)
        self._report()

    def step(self) -> None:
        """A task of the stage is finished."""
        self._done += self._stage_cost / self._n_tasks
        self._report()

    def _cost(self, stage: str) -> float:
        kind, _, number = stage.partition("-")
        if not number:
            return COSTS[kind]
        # 1/5, 1/5, 1/5, 1/5, and then half of what is left each time.
        beyond = int(number) - USUAL_ROUNDS + 2
        return COSTS[kind] / USUAL_ROUNDS * (0.5**beyond if beyond > 0 else 1.0)

    def _report(self) -> None:
        done = min(TOTAL - 1, int(TOTAL * self._done / sum(COSTS.values())))
        if done > self._reported:
            self._reported = done
            self._on_progress("tiles", done, TOTAL)
