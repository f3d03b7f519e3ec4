"""One mesh that does not fit into memory: denoised by tiles in worker processes, to its record.

The tasks are those of ``tiles.stages``; this process leads: it reduces each stage, and moves the
output to its place.  A run that is killed or interrupted goes on from its finished tasks when it is
started again; the scratch folder is removed once the output is there, and after an error that would
come again.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
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
from msal_cli.tiles.eligibility import look_for_tiles
from msal_cli.tiles.join import finish_output
from msal_cli.tiles.opening import open_run
from msal_cli.tiles.outlook import Outlook
from msal_cli.tiles.plan import read_globals

if TYPE_CHECKING:
    from pathlib import Path

    from msal_cli.job.tile_records import Tiles
    from msal_cli.tiles.estimates import TileEstimate
    from msal_cli.tiles.scratch import Scratch

_log = logging.getLogger("msal.batch")


def denoise_by_tiles(task: Task, settings: Settings, job: TileJob) -> MeshRecord:
    """Denoise one file and report what happened, as ``pipeline.denoise_file``; only
    KeyboardInterrupt and SystemExit pass."""
    run = TileRun(task, settings, job)
    try:
        return run.run()
    except Exception as error:
        return run.fail(error)


@dataclass
class TileRun:
    """One mesh on its way; a tile set has another source, and writes its files by itself."""

    task: Task
    settings: Settings
    job: TileJob

    def __post_init__(self) -> None:
        self._runner = StageRunner(self.name, self.job)
        self.record = start_record(self.task.input, self.settings)

    @property
    def name(self) -> str:
        """What messages call it."""
        return repr(self.task.input)

    def run(self) -> MeshRecord:
        """The record of a file that was written."""
        task = self.task
        assert self.job.options is not None
        path = tile_scratch.scratch_path(task.output, self.job.options.scratch)
        found = look_for_tiles(task, self.settings)
        if not isinstance(found, Outlook):
            self.know(**outcome.describe_source(found))
        expected = estimate_tiles(task, self.settings, self.job, found)
        if isinstance(found, Outlook):
            tile_scratch.check_scratch_room(path, found.converted_bytes)
        else:
            tile_scratch.check_space(path, task.output, expected)
        output.make_folder_of(task.output)
        with tile_scratch.lock_scratch(path) as scratch, sweeping_after_errors(scratch):
            if isinstance(found, Outlook):
                with self._runner.leading("open"), _sweeping_unbegun(scratch):
                    expected = self._convert(scratch, expected)
            self.work(scratch, expected)
            return self._finish(scratch, expected)

    def fail(self, error: Exception) -> MeshRecord:
        """The record of a file that was not written."""
        known = to_known_error(error, self.task.input)
        failure = Failure(known.code, known.message, known.hint, known.where)
        self.know(seconds=self.all_seconds(), peak_memory_bytes=self.peak_bytes())
        self.know(status="failed", error=failure)
        return self.record

    def know(self, **values: Any) -> None:
        """Set fields of the record."""
        self.record = replace(self.record, **values)

    # The stages

    def work(self, scratch: Scratch, expected: TileEstimate) -> None:
        """Run all stages that are left."""
        with self._runner.leading("open"):
            n_resumed = self._open(scratch, expected)
        self.know(tiles=replace(planned_tiles(expected), resumed_tasks=n_resumed))
        self._runner.run(scratch, expected.jobs, self._next_stage)

    def _convert(self, scratch: Scratch, expected: TileEstimate) -> TileEstimate:
        """Convert a text or a compressed file, where that is not done yet; the estimate by what it
        holds."""
        source = self.describe_source(scratch.path)
        identity = tile_scratch.identify(self.task, self.settings, source, expected)
        if not tile_scratch.is_of_run(scratch, identity):
            tile_scratch.clear(scratch)
        mesh = sources.open_source(source)
        self.know(**outcome.describe_source(mesh))
        expected = estimate_tiles(self.task, self.settings, self.job, mesh)
        converted_bytes = tile_scratch.used_bytes(scratch.path / sources.TEXT)
        expected = replace(expected, scratch_bytes=expected.scratch_bytes + converted_bytes)
        tile_scratch.check_space(scratch.path, self.task.output, expected)
        return expected

    def _open(self, scratch: Scratch, expected: TileEstimate) -> int:
        """Make the plan, or take that of an earlier run; how many of its tasks are finished."""
        source = self.describe_source(scratch.path)
        identity = tile_scratch.identify(self.task, self.settings, source, expected)
        if tile_scratch.can_go_on(scratch, identity):
            n_finished = stages.count_finished(scratch)
            _log.warning(
                "%s: going on with the tiles of an earlier run, of which %d tasks are finished",
                self.name,
                n_finished,
            )
            return n_finished
        tile_scratch.clear(scratch, keep=sources.TEXT)
        self.prepare_source(scratch.path)
        open_run(
            self.task,
            self.settings,
            scratch,
            tile_vertices=expected.tile_vertices,
            chunk_vertices=expected.chunk_vertices,
            source=source,
        )
        tile_scratch.begin(scratch, identity)
        return 0

    def describe_source(self, folder: Path) -> dict[str, Any]:
        """How tasks open the input, see ``TilePlan``; ``folder`` is the scratch folder."""
        return {
            "kind": sources.FILE,
            "path": self.task.input,
            "format": self.settings.format,
            "folder": os.path.abspath(folder / sources.TEXT),
        }

    def prepare_source(self, folder: Path) -> None:
        """Write into the scratch folder what tasks read beside the input."""

    def describe_tiles(self, scratch: Scratch) -> Tiles:
        """The tiles that the mesh was cut into, once all are finished."""
        made, tiles = read_globals(scratch), self.record.tiles
        assert tiles is not None
        choice = made["choice"]
        return replace(
            tiles,
            number=len(made["tile_starts"]) - 1,
            scratch_bytes=tile_scratch.used_bytes(scratch.path),
            rings=made["rings"],
            choice_vertices=None if choice["is_whole"] else choice["vertices"],
        )

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
        with self.leading("join"):
            mesh = sources.open_source(self.describe_source(scratch.path))
            known = outcome.describe_result(scratch, mesh)
            tiles = self.describe_tiles(scratch)
            if task.in_place and task.backup:
                output.keep_backup_of_file(task)
            finished = finish_output(scratch, path=task.output, files=[task.input])
            notes: tuple[str, ...] = ()
            if mesh.references and not task.in_place:
                from msal_cli.storage import sidecars

                notes = tuple(sidecars.carry(mesh.references, task.input, task.output))
        known.warnings += [
            note.removeprefix("warning: ") for note in notes if note.startswith("warning: ")
        ]
        seconds = self.all_seconds()
        n = known.fields.get("vertices") or mesh.n_vertices
        self.know(
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
            peak_memory_bytes=self.peak_bytes(),
            tiles=tiles,
        )
        scratch.remove()
        return self.record

    def leading(self, stage: str) -> AbstractContextManager[None]:
        """What this process does itself, as a part of a stage."""
        return self._runner.leading(stage)

    def all_seconds(self) -> Seconds:
        """Seconds of all stages so far."""
        return Seconds(**self._runner.seconds, total=self._runner.total_seconds)

    def peak_bytes(self) -> int | None:
        """Memory of this process and of as many workers as work at the same time."""
        return self._runner.peak_bytes(0 if self.record.tiles is None else self.record.tiles.jobs)


@contextmanager
def sweeping_after_errors(scratch: Scratch) -> Iterator[None]:
    """Remove the scratch folder after an error that would come again; a lack of space, memory or
    time may be mended."""
    try:
        yield
    except (OutputError, ResourceError):
        raise
    except Exception:
        scratch.remove()
        raise


@contextmanager
def _sweeping_unbegun(scratch: Scratch) -> Iterator[None]:
    """Remove the scratch folder after whatever ends a conversion, but for the tasks of an earlier
    run."""
    try:
        yield
    except BaseException:
        if not scratch.has(tile_scratch.IDENTITY):
            scratch.remove()
        raise
