"""A plan whose files are denoised as the one mesh that they are together."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import TYPE_CHECKING

from msal_cli.batch import interrupts, temporary_files
from msal_cli.batch.events import Progress
from msal_cli.batch.manifest_dirs import output_folders
from msal_cli.errors import UnsupportedError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from msal_cli.batch.events import OnEvent
    from msal_cli.batch.manifest import Manifest
    from msal_cli.batch.plan import Plan
    from msal_cli.batch.set_tiles import SetTiles
    from msal_cli.batch.tile_options import TileJob
    from msal_cli.job.records import MeshRecord
    from msal_cli.job.settings import Settings
    from msal_cli.job.tile_records import Tiles, TileSetPart
    from msal_cli.tiles.set_run import EarlierRuns


def denoise_set(
    plan: Plan,
    settings: Settings,
    on_event: OnEvent,
    most_failures: int | None,
    manifests: Mapping[str, Manifest],
    job: TileJob,
) -> dict[int, MeshRecord]:
    """The records of all files that were dealt with, by the numbers of their tasks.

    A set that does not fit into memory is denoised by tiles, as ``job`` says.

    Once ``most_failures`` files cannot be read, no other is written: their records are not there.
    """
    from msal_cli.tiles import set_run

    def on_step(index: int, stage: str, done: int, total: int) -> None:
        if job.cancellation is not None:
            job.cancellation.check()
        on_event(Progress(index, stage, done, total))

    def clean() -> None:
        for folder in output_folders(plan.tasks):
            temporary_files.sweep_after(os.getpid(), folder)

    with interrupts.noticed(interrupts.raise_for), interrupts.ended_late(clean):
        records = set_run.denoise_set(
            plan.tasks,
            settings,
            on_step,
            job.limits,
            most_failures,
            run_tiles=_build_tiles(plan, job),
            earlier=read_earlier(plan, manifests),
        )
    return {index: one for index, one in enumerate(records) if one.status != "planned"}


def survey_set(
    plan: Plan, settings: Settings, manifests: Mapping[str, Manifest], job: TileJob
) -> dict[int, MeshRecord]:
    """What would be denoised: records with counts, neighbours and the tiles of a set that does not
    fit into memory; the files are only read."""
    from msal_cli.tiles import set_run

    earlier = read_earlier(plan, manifests)
    records = set_run.survey_set(plan.tasks, settings, earlier)
    tiles = _plan_tiles(plan, settings, records, job)
    return {
        index: replace(one, tiles=tiles) if one.status == "planned" else one
        for index, one in enumerate(records)
    }


def _plan_tiles(
    plan: Plan, settings: Settings, records: Sequence[MeshRecord], job: TileJob
) -> Tiles | None:
    """The tiles that a set would be cut into; None where it fits, or tiles are no way."""
    from msal_cli.batch.tile_estimate import memory_bound, planned_tiles
    from msal_cli.tiles.file_set import SetFile, SetSource
    from msal_cli.tiles.set_run import memory_of_set

    run_tiles, bound = _build_tiles(plan, job), memory_bound(job.limits)
    found = [
        (task, one)
        for task, one in zip(plan.tasks, records, strict=True)
        if one.status == "planned"
    ]
    if run_tiles is None or not found:
        return None
    fits = bound is None or memory_of_set(plan.tasks, settings) <= bound
    if fits and not run_tiles.is_forced:
        return None
    try:
        run_tiles.refuse(settings)
    except UnsupportedError:
        return None
    files = [
        SetFile(task.input, one.vertices or 0, one.triangles or 0, os.stat(task.input).st_size)
        for task, one in found
    ]
    is_single = all(one.precision == "float32" for _, one in found)
    vertex_type = "float32" if is_single else "float64"
    source = SetSource(files, settings.format, vertex_type, b"")
    return planned_tiles(run_tiles.estimate(source, settings))


def _build_tiles(plan: Plan, job: TileJob) -> SetTiles | None:
    """What denoises the set by tiles; None where that is no way."""
    if job.options is None:
        return None
    from msal_cli.batch.set_tiles import SetTiles

    home = plan.homes[0] or os.path.dirname(plan.tasks[0].output)
    return SetTiles(plan.tasks, home, job, job.options)


def read_earlier(plan: Plan, manifests: Mapping[str, Manifest]) -> EarlierRuns:
    """What the manifests say of the files of a set and, unless all is to be done afresh, of files
    that belonged to it and are gone."""
    from msal_cli.tiles.set_run import EarlierRuns

    parts: dict[int, TileSetPart] = {}
    absent: dict[str, TileSetPart] = {}
    keys: dict[str, set[str]] = {home: set() for home in manifests}
    for index, home in enumerate(plan.homes):
        if home is not None:
            key = plan.manifest_key(index)
            keys[home].add(key)
            record = _read_record(manifests[home], key)
            if record is not None and record.tile_set is not None:
                parts[index] = record.tile_set
    for home, manifest in manifests.items():
        for key in sorted(manifest.names() - keys[home]) if not plan.fresh else ():
            record = _read_record(manifest, key)
            if record is not None and record.tile_set is not None:
                absent[record.input] = record.tile_set
    return EarlierRuns(parts, absent)


def _read_record(manifest: Manifest, key: str) -> MeshRecord | None:
    entry = manifest.get(key)
    return None if entry is None else entry.record()
