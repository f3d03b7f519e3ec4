"""Shards that help one another with a mesh that is denoised by tiles.

The shard to which a file belongs plans it, moves its output to its place and records it.  All
others take tasks from its scratch folder, which must be where all of them see it, once their own
files are done.
"""

from __future__ import annotations

import logging
import time
from pathlib import Path
from typing import TYPE_CHECKING

from msal_cli.batch import tile_scratch
from msal_cli.batch.lock import lock_owners
from msal_cli.batch.memory_budget import estimate_memory
from msal_cli.batch.oversized import find_oversized
from msal_cli.batch.tile_stages import LOOKS_EVERY_S, StageRunner
from msal_cli.tiles import stages
from msal_cli.tiles.plan import PLAN
from msal_cli.tiles.scratch import Scratch

if TYPE_CHECKING:
    from msal_cli.batch.plan import Plan
    from msal_cli.batch.tile_options import TileJob
    from msal_cli.job.settings import Settings, Task
    from msal_cli.tiles.estimates import TileEstimate

WAIT_S = 60.0
"""How long the beginning of another shard is waited for."""

KEPT = "kept.json"
"""In the scratch folder once the result is known to do no harm, so that it may be joined."""

_log = logging.getLogger("msal.batch")


def help_others(plan: Plan, settings: Settings, job: TileJob) -> None:
    """Take tasks of the files of other shards that are denoised by tiles; faults of these files
    are for their shards to report."""
    if plan.shard is None or plan.whole is None or job.options is None:
        return
    others = [task for task in plan.whole.tasks if not plan.shard.has(task.relative)]
    tasks = dict(enumerate(others))
    budget = estimate_memory(tasks, settings, job.limits)
    for index, expected in find_oversized(tasks, settings, budget, job).by_tiles.items():
        _Helper(tasks[index], settings, job, expected).run()


class _Helper:
    """One file of another shard."""

    def __init__(
        self, task: Task, settings: Settings, job: TileJob, expected: TileEstimate
    ) -> None:
        assert job.options is not None
        self._task, self._settings, self._job, self._expected = task, settings, job, expected
        self._path = tile_scratch.scratch_path(task.output, job.options.scratch)
        self._scratch = Scratch(self._path)

    def run(self) -> None:
        """Help until all stages are finished, or until no process leads any more."""
        try:
            if not self._wait_for_plan():
                return
            _log.info("%r: taking tiles of the shard that it belongs to", self._task.input)
            runner = StageRunner(self._task.input, self._job)
            runner.run(self._scratch, self._expected.jobs, self._next_stage)
        except Exception as error:
            # The folder is removed when the file is done, also while this process looks into it.
            level = logging.WARNING if self._scratch.has(PLAN) else logging.DEBUG
            _log.log(level, "%r: no more tiles are taken: %r", self._task.input, error)
        finally:
            self._sweep()

    def _wait_for_plan(self) -> bool:
        """Whether the shard that leads has made its plan."""
        source = {"kind": "file", "path": self._task.input, "format": self._settings.format}
        wanted = tile_scratch.identify(self._task, self._settings, source, self._expected)
        end = time.monotonic() + WAIT_S
        while True:
            is_own = tile_scratch.is_own(self._path)
            known = self._scratch.read_json(tile_scratch.IDENTITY) if is_own else None
            if known is not None and known | {"tile_vertices": 0} == wanted | {"tile_vertices": 0}:
                return True
            if not self._has_leader() and (self._is_done() or time.monotonic() > end):
                return False
            time.sleep(LOOKS_EVERY_S)

    def _next_stage(self, scratch: Scratch) -> stages.Stage | None:
        """The stage to take tasks of; what does harm is not joined."""
        while True:
            stage = stages.next_stage(scratch)
            if stage is None or stage.name != "join" or scratch.has(KEPT):
                return stage
            if not self._has_leader():
                return None
            time.sleep(LOOKS_EVERY_S)

    def _has_leader(self) -> bool:
        return tile_scratch.is_own(self._path) and bool(lock_owners(str(self._path)))

    def _is_done(self) -> bool:
        """Whether there is an output that is newer than the input."""
        source, output = Path(self._task.input), Path(self._task.output)
        return output.exists() and output.stat().st_mtime > source.stat().st_mtime

    def _sweep(self) -> None:
        """Remove what a task left after the folder had been removed."""
        is_rest = self._path.is_dir() and not self._scratch.has(tile_scratch.IDENTITY)
        if is_rest and not self._has_leader():
            self._scratch.remove()
