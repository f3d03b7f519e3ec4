"""What a run over files does by tiles; all that computes is imported only where there is such."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from msal_cli.batch.plan import Plan
    from msal_cli.batch.tile_options import TileJob
    from msal_cli.job.records import MeshRecord
    from msal_cli.job.settings import Settings, Task


def denoise_oversized(task: Task, settings: Settings, job: TileJob) -> MeshRecord:
    """Denoise one of the files by tiles, to its record."""
    from msal_cli.batch.tile_run import denoise_by_tiles

    return denoise_by_tiles(task, settings, job)


def help_others(plan: Plan, settings: Settings, job: TileJob) -> None:
    """Take tiles of the files of other shards, if there are any."""
    if plan.shard is not None and job.options is not None:
        from msal_cli.batch import tile_help

        tile_help.help_others(plan, settings, job)
