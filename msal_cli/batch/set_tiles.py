"""A tile set that does not fit into memory: the stages of the tiles over all of its files."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msal_cli.batch import tile_scratch
from msal_cli.batch.tile_estimate import memory_bound
from msal_cli.batch.tile_run import TileRun, sweeping_after_errors
from msal_cli.errors import UnsupportedError
from msal_cli.job import output
from msal_cli.job.settings import Settings, Task
from msal_cli.storage.urls import is_url
from msal_cli.tiles import outcome
from msal_cli.tiles.eligibility import refuse_settings
from msal_cli.tiles.estimates import estimate_run
from msal_cli.tiles.file_set import SetSource, open_set

if TYPE_CHECKING:
    from msal_cli.batch.tile_options import TileJob, TileOptions
    from msal_cli.job.records import MeshRecord
    from msal_cli.tiles.estimates import TileEstimate
    from msal_cli.tiles.scratch import Scratch

_NAME = "tile-set"
"""What the scratch folder is called after, beside the outputs."""


@dataclass(frozen=True)
class SetTiles:
    """Runs the tiles of a set, see ``tiles.set_moves.RunTiles``.

    ``home`` is the folder of its outputs.
    """

    tasks: Sequence[Task]
    home: str
    job: TileJob
    options: TileOptions

    @property
    def is_forced(self) -> bool:
        """Whether the set is denoised by tiles although it may fit into memory."""
        return self.options.is_forced or self.job.engine is not None

    def refuse(self, settings: Settings) -> None:
        """Raise UnsupportedError for what cannot be done by tiles."""
        if any(is_url(path) for one in self.tasks for path in (one.input, one.output)):
            raise UnsupportedError(
                "files in a store need the whole mesh in memory",
                hint="copy them to this machine, and back",
            )
        # Every file is measured and written by itself.
        refuse_settings(replace(settings, to=None, encoding="same", precision="same", checks=()))

    def estimate(self, source: SetSource, settings: Settings) -> TileEstimate:
        """What the run will take."""
        mesh, bound = open_set(source.describe(Path())), memory_bound(self.job.limits)
        return estimate_run(mesh, settings, jobs=self.job.jobs, memory_bytes=bound)

    @contextmanager
    def __call__(
        self, source: SetSource, settings: Settings
    ) -> Iterator[tuple[Scratch, MeshRecord]]:
        """The scratch folder with the new positions, and the record of the joined mesh."""
        task = Task(source.files[0].path, os.path.join(self.home, _NAME), _NAME)
        run = _SetRun(task, settings, self.job, source)
        expected = self.estimate(source, settings)
        path = tile_scratch.scratch_path(task.output, self.options.scratch)
        tile_scratch.check_space(path, task.output, expected)
        output.make_folder_of(task.output)
        with tile_scratch.lock_scratch(path) as scratch, sweeping_after_errors(scratch):
            run.work(scratch, expected)
            yield scratch, run.describe(scratch)
            scratch.remove()


@dataclass
class _SetRun(TileRun):
    """The files of a set as one mesh."""

    source: SetSource

    @property
    def name(self) -> str:
        """What messages call it."""
        return f"the tile set of {len(self.source.files)} files"

    def describe_source(self, folder: Path) -> dict[str, Any]:
        """How tasks open the files."""
        return self.source.describe(folder)

    def prepare_source(self, folder: Path) -> None:
        """Write which vertices are read at other places."""
        self.source.write(folder)

    def describe(self, scratch: Scratch) -> MeshRecord:
        """The record of the joined mesh."""
        with self.leading("join"):
            mesh = open_set(self.describe_source(scratch.path))
            known = outcome.describe_result(scratch, mesh)
            tiles = self.describe_tiles(scratch)
        self.know(
            **known.fields,
            warnings=tuple(known.warnings),
            seconds=self.all_seconds(),
            peak_memory_bytes=self.peak_bytes(),
            tiles=tiles,
        )
        return self.record
