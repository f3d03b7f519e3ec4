"""One mesh that does not fit into memory: denoised by tiles in worker processes, to its record.

The tasks are those of ``tiles.stages``; this process leads: it reduces each stage, and moves the
output to its place.  A run that is killed or interrupted goes on from its finished tasks when it is
started again; the scratch folder is removed once the output is there, and after an error that would
come again.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from msal_cli.batch import tile_scratch
from msal_cli.batch.tile_estimate import estimate_tiles, planned_tiles
from msal_cli.batch.tile_help import KEPT
from msal_cli.batch.tile_options import TileJob
from msal_cli.batch.tile_stages import StageRunner
from msal_cli.errors import OutputError, ResourceError
from msal_cli.job import output
from msal_cli.job.opened_mesh import to_known_error
from msal_cli.job.pipeline import start_record
from msal_cli.job.records import Failure, MeshRecord, Seconds
from msal_cli.job.settings import Settings, Task
from msal_cli.tiles import outcome, stages
from msal_cli.tiles import source as sources
from msal_cli.tiles.eligibility import open_for_tiles
from msal_cli.tiles.join import finish_output
from msal_cli.tiles.opening import open_run
from msal_cli.tiles.plan import read_globals

if TYPE_CHECKING:
    from msal_cli.tiles.estimates import TileEstimate
    from msal_cli.tiles.scratch import Scratch

_log = logging.getLogger("msal.batch")


def denoise_by_tiles(task: Task, settings: Settings, job: TileJob) -> MeshRecord:
    """Denoise one file and report what happened, as ``pipeline.denoise_file``; only
    KeyboardInterrupt and SystemExit pass."""
    run = _TileRun(task, settings, job)
    try:
        return run.run()
    except Exception as error:
        return run.fail(error)


@dataclass
class _TileRun:
    task: Task
    settings: Settings
    job: TileJob

    def __post_init__(self) -> None:
        self._runner = StageRunner(self.task.input, self.job)
        self._record = start_record(self.task.input, self.settings)

    def run(self) -> MeshRecord:
        """The record of a file that was written."""
        task = self.task
        mesh = open_for_tiles(task, self.settings)
        self._know(**outcome.describe_source(mesh))
        expected = estimate_tiles(task, self.settings, self.job)
        assert self.job.options is not None
        path = tile_scratch.scratch_path(task.output, self.job.options.scratch)
        tile_scratch.check_space(path, task.output, expected)
        output.make_folder_of(task.output)
        with tile_scratch.lock_scratch(path) as scratch, _sweeping_after_errors(scratch):
            self._work(scratch, expected)
            return self._finish(scratch, expected)

    def fail(self, error: Exception) -> MeshRecord:
        """The record of a file that was not written."""
        known = to_known_error(error, self.task.input)
        failure = Failure(known.code, known.message, known.hint, known.where)
        self._know(seconds=self._all_seconds(), peak_memory_bytes=self._peak_bytes())
        self._know(status="failed", error=failure)
        return self._record

    def _know(self, **values: Any) -> None:
        self._record = replace(self._record, **values)

    # The stages

    def _work(self, scratch: Scratch, expected: TileEstimate) -> None:
        """Run all stages that are left."""
        with self._runner.leading("open"):
            n_resumed = self._open(scratch, expected)
        self._know(tiles=replace(planned_tiles(expected), resumed_tasks=n_resumed))
        self._runner.run(scratch, expected.jobs, self._next_stage)

    def _open(self, scratch: Scratch, expected: TileEstimate) -> int:
        """Make the plan, or take that of an earlier run; how many of its tasks are finished."""
        source = {
            "kind": sources.FILE,
            "path": self.task.input,
            "format": self.settings.format,
        }
        identity = tile_scratch.identify(self.task, self.settings, source, expected)
        if tile_scratch.can_go_on(scratch, identity):
            n_finished = stages.count_finished(scratch)
            _log.warning(
                "%r: going on with the tiles of an earlier run, of which %d tasks are finished",
                self.task.input,
                n_finished,
            )
            return n_finished
        tile_scratch.clear(scratch)
        open_run(
            self.task,
            self.settings,
            scratch,
            tile_vertices=expected.tile_vertices,
            chunk_vertices=expected.chunk_vertices,
        )
        scratch.write_json(tile_scratch.IDENTITY, identity)
        return 0

    def _next_stage(self, scratch: Scratch) -> stages.Stage | None:
        stage = stages.next_stage(scratch)
        if stage is not None and stage.name == "join" and not scratch.has(KEPT):
            if outcome.reject_harmful(scratch):
                return stages.next_stage(scratch)
            scratch.write_json(KEPT, True)
        return stage

    # The end

    def _finish(self, scratch: Scratch, expected: TileEstimate) -> MeshRecord:
        task = self.task
        with self._runner.leading("join"):
            mesh = sources.open_source({"kind": sources.FILE, **self._source()})
            known = outcome.describe_result(scratch, mesh)
            scratch_bytes = tile_scratch.used_bytes(scratch.path)
            if task.in_place and task.backup:
                output.keep_backup_of_file(task)
            mode_like = task.input if task.in_place else None
            finished = finish_output(scratch, path=task.output, mode_like=mode_like)
            notes: tuple[str, ...] = ()
            if mesh.references and not task.in_place:
                from msal_cli.storage import sidecars

                notes = tuple(sidecars.carry(mesh.references, task.input, task.output))
            made = read_globals(scratch)
        known.warnings += [
            note.removeprefix("warning: ") for note in notes if note.startswith("warning: ")
        ]
        seconds = self._all_seconds()
        choice, n = made["choice"], known.fields.get("vertices") or mesh.n_vertices
        tiles = self._record.tiles
        assert tiles is not None
        self._know(
            **known.fields,
            status="written" if finished.is_changed else "unchanged",
            output=task.output,
            input_sha256=finished.input_sha256,
            output_sha256=finished.output_sha256,
            sidecars=notes,
            warnings=tuple(known.warnings),
            warning_codes=tuple(known.warning_codes),
            seconds=seconds,
            vertices_per_second=n / seconds.total if seconds.total else None,
            peak_memory_bytes=self._peak_bytes(),
            tiles=replace(
                tiles,
                number=len(made["tile_starts"]) - 1,
                scratch_bytes=scratch_bytes,
                rings=made["rings"],
                choice_vertices=None if choice["is_whole"] else choice["vertices"],
            ),
        )
        scratch.remove()
        return self._record

    def _source(self) -> dict[str, Any]:
        return {"path": self.task.input, "format": self.settings.format}

    def _all_seconds(self) -> Seconds:
        return Seconds(**self._runner.seconds, total=self._runner.total_seconds)

    def _peak_bytes(self) -> int | None:
        return self._runner.peak_bytes(0 if self._record.tiles is None else self._record.tiles.jobs)


@contextmanager
def _sweeping_after_errors(scratch: Scratch) -> Iterator[None]:
    """Remove the scratch folder after an error that would come again; a lack of space, memory or
    time may be mended."""
    try:
        yield
    except (OutputError, ResourceError):
        raise
    except Exception:
        scratch.remove()
        raise
