"""What a file will take by tiles, as far as its header shows it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from msal_cli import machine
from msal_cli.job.settings import Limits, Settings, Task, refuse_faces
from msal_cli.job.tile_records import Tiles

if TYPE_CHECKING:
    from msal_cli.batch.tile_options import TileJob
    from msal_cli.tiles.estimates import TileEstimate

SHARE = 0.8
"""Of the memory that is free, as much is used."""


def estimate_tiles(task: Task, settings: Settings, job: TileJob) -> TileEstimate:
    """What a file will take, by its header alone.

    Raises
    ------
    InputError
        if it cannot be denoised by tiles, or is damaged.
    """
    from msal_cli.tiles.eligibility import open_for_tiles
    from msal_cli.tiles.estimates import estimate_run

    mesh = open_for_tiles(task, settings)
    refuse_faces(mesh.n_polygons, job.limits)
    if job.engine is not None:
        # How much memory other machines have is not known: the limit is for each worker.
        most = job.limits.memory_bytes
        return replace(estimate_run(mesh, settings, jobs=1, memory_bytes=most), jobs=job.jobs)
    return estimate_run(mesh, settings, jobs=job.jobs, memory_bytes=memory_bound(job.limits))


def memory_bound(limits: Limits) -> int | None:
    """Bytes that all processes together may use; None where it is not known."""
    if limits.memory_bytes is not None:
        return limits.memory_bytes
    free = machine.available_bytes()
    return None if free is None else int(SHARE * free)


def planned_tiles(expected: TileEstimate) -> Tiles:
    """What is expected, as records have it."""
    return Tiles(
        number=expected.n_tiles,
        jobs=expected.jobs,
        scratch_bytes=expected.scratch_bytes,
        memory_bytes=expected.memory_bytes,
        expected_seconds=expected.seconds,
    )
