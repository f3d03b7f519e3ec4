"""What a file will take by tiles, as far as its header shows it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from msal_cli import machine
from msal_cli.errors import ResourceError
from msal_cli.job.settings import FORECAST, Limits, Settings, Task, refuse_faces
from msal_cli.job.tile_records import Tiles
from msal_cli.machine import megabytes

if TYPE_CHECKING:
    from msal_cli.batch.tile_options import TileJob
    from msal_cli.tiles.estimates import TileEstimate
    from msal_cli.tiles.outlook import Found

SHARE = 0.8
"""Of the memory that is free, as much is used."""


def estimate_tiles(
    task: Task, settings: Settings, job: TileJob, found: Found | None = None
) -> TileEstimate:
    """What a file will take, by its header, or by the size of a text or of a compressed file.

    ``found`` is what ``look_for_tiles`` finds, or the mesh once it is opened.

    Raises
    ------
    InputError
        if it cannot be denoised by tiles, or is damaged.
    ResourceError
        if it takes more memory than the limit.
    """
    from msal_cli.tiles.eligibility import look_for_tiles
    from msal_cli.tiles.estimates import estimate_run
    from msal_cli.tiles.outlook import Outlook

    if found is None:
        found = look_for_tiles(task, settings)
    converted_bytes = 0
    if isinstance(found, Outlook):
        converted_bytes = found.converted_bytes
    else:
        refuse_faces(found.n_polygons, job.limits)
    if job.engine is not None:
        # How much memory other machines have is not known: the limit is for each worker.
        most = job.limits.memory_bytes
        expected = replace(estimate_run(found, settings, jobs=1, memory_bytes=most), jobs=job.jobs)
    else:
        most = memory_bound(job.limits)
        expected = estimate_run(found, settings, jobs=job.jobs, memory_bytes=most)
    limit = job.limits.memory_bytes
    if limit is not None and expected.memory_bytes > limit:
        raise ResourceError(
            f"tiles take up to {megabytes(expected.memory_bytes)}, "
            f"and the limit is {megabytes(limit)}",
            code="E_MEMORY",
            where=FORECAST,
            hint="raise --memory-limit",
        )
    return replace(expected, scratch_bytes=expected.scratch_bytes + converted_bytes)


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
