"""A tile set: files that touch, denoised as the one joined mesh that they are.

First every file is read by itself: what it holds, and its border.  Border vertices of different
files that are one are found, then the joined mesh is denoised, and then every file is read again
and written with its part of the new positions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from msal_cli.errors import ResourceError, UnsupportedError, UsageError
from msal_cli.job.opened_mesh import to_known_error
from msal_cli.job.pipeline import start_record
from msal_cli.job.records import Failure, MeshRecord
from msal_cli.job.settings import (
    FORECAST,
    NO_LIMITS,
    Limits,
    Settings,
    Task,
    forecast,
    least_memory_bytes,
)
from msal_cli.job.tile_records import TileSetPart
from msal_cli.machine import available_bytes, megabytes
from msal_cli.tiles.set_borders import SharedBorders, count_unmatched, share_borders
from msal_cli.tiles.set_member import Arrays, Member, add_seconds, scan_member, write_member
from msal_cli.tiles.set_moves import (
    JointMesh,
    MovedSet,
    RunTiles,
    move_by_tiles,
    move_in_memory,
)

if TYPE_CHECKING:
    from msal_cli.arrays import Flags, Floats


@dataclass(frozen=True)
class EarlierRuns:
    """What earlier runs have found of files that may be missing now.

    Attributes
    ----------
    parts : by the number of a task.
    absent : by name, of files that belonged to the set and are no longer among the tasks.
    """

    parts: Mapping[int, TileSetPart] = field(default_factory=dict)
    absent: Mapping[str, TileSetPart] = field(default_factory=dict)


NOTHING_EARLIER = EarlierRuns()

OnStep = Callable[[int, str, int, int], None]
"""Called as ``on_step(index, stage, done, total)`` with the index of a task."""

_SHARE_OF_MEMORY = 0.8
_SHARED_FIELDS = (
    "method",
    "choice",
    "left_alone",
    "despiked",
    "clamped_vertices",
    "locked_vertices",
    "tiles",
)


def denoise_set(
    tasks: Sequence[Task],
    settings: Settings,
    on_step: OnStep | None = None,
    limits: Limits = NO_LIMITS,
    most_failures: int | None = None,
    run_tiles: RunTiles | None = None,
    earlier: EarlierRuns = NOTHING_EARLIER,
) -> list[MeshRecord]:
    """Denoise files as one mesh and report what happened to each, in their order.

    Beside KeyboardInterrupt and SystemExit only UsageError passes: nothing is written where
    --weld is longer than the mean edge length.  A file that cannot be read fails; what its
    neighbours may share with it stays where it is.  Once ``most_failures`` files cannot be
    read, the others are left ``planned``.  A set that does not fit into memory is denoised by
    ``run_tiles``; without it, it fails.
    """
    run = _SetRun(tasks, settings, on_step or (lambda *step: None), limits, earlier)
    return run.denoise(most_failures, run_tiles)


def survey_set(
    tasks: Sequence[Task], settings: Settings, earlier: EarlierRuns = NOTHING_EARLIER
) -> list[MeshRecord]:
    """What a set holds, without denoising it: records with ``tile_set``, or failures."""
    return _SetRun(tasks, settings, lambda *step: None, NO_LIMITS, earlier).survey()


def memory_of_set(tasks: Sequence[Task], settings: Settings) -> int:
    """Bytes of memory that denoising these files as one in memory will need."""
    base = least_memory_bytes()
    needs = [forecast(one, settings).memory_bytes or base for one in tasks]
    return base + sum(max(0, one - base) for one in needs)


class _SetRun:
    """One set on its way; a *place* is the number of a file among those that could be read."""

    def __init__(
        self,
        tasks: Sequence[Task],
        settings: Settings,
        on_step: OnStep,
        limits: Limits,
        earlier: EarlierRuns,
    ) -> None:
        self._earlier = earlier
        self._weld = 0.0
        self._tasks, self._settings = tasks, settings
        self._on_step, self._limits = on_step, limits
        self._members: list[Member] = []
        self._records: dict[int, MeshRecord] = {}

    def survey(self) -> list[MeshRecord]:
        """See ``survey_set``."""
        self._scan(None)
        for member, part in zip(self._members, self._describe(self._share()), strict=True):
            self._records[member.index] = replace(
                member.record, status="planned", output=member.task.output, tile_set=part
            )
        return [self._records[index] for index in range(len(self._tasks))]

    def denoise(self, most_failures: int | None, run_tiles: RunTiles | None) -> list[MeshRecord]:
        """See ``denoise_set``."""
        try:
            if run_tiles is not None and run_tiles.is_forced:
                run_tiles.refuse(self._settings)
            elif (reason := self._find_want_of_memory()) is not None:
                _require_tiles(run_tiles, self._settings, reason)
            else:
                run_tiles = None
            # A file that does not fit by itself fails before it is loaded.
            self._limits = replace(self._limits, memory_bytes=self._memory_bound)
            arrays: list[Arrays] = []
            self._scan(arrays.append if run_tiles is None else None)
            if most_failures is not None and len(self._records) >= most_failures:
                self._leave_planned()
            elif self._members:
                self._denoise_members(arrays, run_tiles)
        except UsageError:
            raise
        except Exception as error:
            self._fail_all(error)
        return [self._records[index] for index in range(len(self._tasks))]

    def _leave_planned(self) -> None:
        """Leave every file as it is that has not failed."""
        for member in self._members:
            start = start_record(member.task.input, self._settings)
            self._records[member.index] = replace(
                start, status="planned", output=member.task.output
            )

    def _fail_all(self, error: Exception) -> None:
        """The set fails as a whole: every file that has no failure of its own has this one."""
        known = to_known_error(error, "the tile set")
        failure = Failure(known.code, known.message, known.hint, known.where)
        for index, task in enumerate(self._tasks):
            if index not in self._records:
                start = start_record(task.input, self._settings)
                self._records[index] = replace(start, error=failure)

    # What there is

    @property
    def _memory_bound(self) -> int | None:
        """Bytes that may be used; None where it is not known."""
        limit, left = self._limits.memory_bytes, available_bytes()
        return int(_SHARE_OF_MEMORY * left) if limit is None and left is not None else limit

    def _find_want_of_memory(self) -> ResourceError | None:
        """Why the joined mesh does not fit into memory, by forecast; None if it does."""
        needed = memory_of_set(self._tasks, self._settings)
        limit = self._memory_bound
        if limit is not None and needed > limit:
            return ResourceError(
                f"denoising these {len(self._tasks)} files as one takes up to "
                f"{megabytes(needed)}, and there are {megabytes(limit, rounded_up=False)}",
                code="E_MEMORY",
                where=FORECAST,
                hint="use a machine with more memory, or denoise fewer files as one",
            )
        return None

    def _scan(self, on_arrays: Callable[[Arrays], None] | None) -> None:
        """Read every file once."""
        for index, task in enumerate(self._tasks):

            def on_progress(stage: str, done: int, total: int, index: int = index) -> None:
                self._on_step(index, stage, done, total)

            found = scan_member(index, task, self._settings, self._limits, on_progress, on_arrays)
            if isinstance(found, Member):
                self._members.append(found)
            else:
                self._records[index] = found

    @property
    def _mean_edge_length(self) -> float:
        """Of all files, each by the number of its triangles."""
        weights = [one.n_triangles for one in self._members]
        lengths = [one.record.mean_edge_length or 0.0 for one in self._members]
        return float(np.average(lengths, weights=weights))

    def _share(self) -> SharedBorders:
        if self._settings.weld is not None and self._members:
            from msal_cli.job.constraints import parse_length

            edge = self._mean_edge_length
            self._weld = parse_length(self._settings.weld, "--weld").in_units(edge)
            if self._weld > edge:
                raise UsageError(
                    f"--weld {self._settings.weld} is longer than the edges of the files, "
                    f"{edge:.3g} in the mean",
                    hint="give the widest gap between vertices that should be one, such as 0.1e",
                )
        borders = [one.border for one in self._members]
        return share_borders(borders, self._is_single, self._weld)

    @property
    def _is_single(self) -> list[bool]:
        """For each file whether it stores single precision."""
        return [one.record.precision == "float32" for one in self._members]

    def _fixed_points(self, shared: SharedBorders) -> Flags | None:
        """(n,) border points that a file may share which failed or is gone; None if there is none.

        Where an earlier run has read it they lie within its bounds; else any may be its.
        """
        parts = [self._earlier.parts.get(index) for index in self._records]
        parts += self._earlier.absent.values()
        if not parts:
            return None
        if None in parts:
            return ~shared.is_shared
        is_inside = np.zeros(len(shared.group), dtype=np.bool_)
        for part in parts:
            if part is not None and part.low is not None and part.high is not None:
                low, high = np.array(part.low) - self._weld, np.array(part.high) + self._weld
                is_inside |= ((shared.positions >= low) & (shared.positions <= high)).all(axis=1)
        return ~shared.is_shared & is_inside

    def _describe(self, shared: SharedBorders) -> list[TileSetPart]:
        """What each member shares with the others."""
        if not self._members:
            return []
        borders = [one.border for one in self._members]
        neighbours = shared.neighbours()
        unmatched = count_unmatched(borders, shared, self._mean_edge_length)
        gaps = shared.distances(shared.positions)
        is_shared, is_moved = shared.is_shared, shared.is_moved
        fixed = self._fixed_points(shared)
        parts = []
        for place in range(len(self._members)):
            own = shared.of_file(place)
            parts.append(
                TileSetPart(
                    files=len(self._members),
                    neighbours=tuple(self._members[i].task.relative for i in neighbours[place]),
                    shared_vertices=int(is_shared[own].sum()),
                    welded_vertices=int(is_moved[own].sum()),
                    largest_weld=float(gaps[own].max(initial=0.0)),
                    unmatched_vertices=unmatched[place],
                    fixed_border_vertices=0 if fixed is None else int(fixed[own].sum()),
                    **_bounds(shared.positions[own]),
                )
            )
        return parts

    # The work

    def _denoise_members(self, arrays: list[Arrays], run_tiles: RunTiles | None) -> None:
        """Move the vertices of all files, and write each; without ``run_tiles`` in memory."""
        shared = self._share()
        joint = JointMesh(self._members, shared, self._fixed_points(shared))
        parts = self._describe(shared)
        if run_tiles is not None:
            with move_by_tiles(joint, self._settings, run_tiles) as moved:
                self._write_members(moved, shared, parts)
            return
        first = self._members[0].index

        def on_progress(stage: str, done: int, total: int) -> None:
            self._on_step(first, stage, done, total)

        moved = move_in_memory(joint, arrays, self._settings, on_progress)
        self._write_members(moved, shared, parts)

    def _write_members(
        self, moved: MovedSet, shared: SharedBorders, parts: Sequence[TileSetPart]
    ) -> None:
        written = np.full_like(shared.positions, np.nan)
        # What the first file stores that has a point: the others take it from there.
        agreed = np.full_like(shared.positions, np.nan)
        known = {name: getattr(moved.record, name) for name in _SHARED_FIELDS}
        n_vertices = sum(one.n_vertices for one in self._members)
        is_single = np.zeros(len(self._members), dtype=np.bool_)
        for place in self._order_of_writing():
            member = self._members[place]
            vertices = moved.positions(place)
            own = shared.of_file(place)
            new = agreed[shared.group[own]][member.border.points]
            is_known = ~np.isnan(new).any(axis=1)
            vertices[member.border.vertices[is_known]] = new[is_known]

            def on_progress(stage: str, done: int, total: int, index: int = member.index) -> None:
                self._on_step(index, stage, done, total)

            fields = moved.field_values(place)
            record, there = write_member(
                member, vertices, known, self._settings, on_progress, fields
            )
            written[own], is_single[place] = there.positions, there.is_single
            first = shared.group[own]
            is_open = np.isnan(agreed[first]).any(axis=1)
            agreed[first[is_open]] = there.positions[is_open]
            share = member.n_vertices / n_vertices
            record = add_seconds(
                record, (member.record.seconds, 1.0), (moved.record.seconds, share)
            )
            peaks = [one.peak_memory_bytes or 0 for one in (record, moved.record)]
            self._records[member.index] = replace(
                record, tile_set=parts[place], peak_memory_bytes=max(peaks) or None
            )
        mixed = shared.with_single(is_single)
        written[mixed] = written[mixed].astype(np.float32)
        gaps = shared.distances(written)
        gaps[np.isnan(written).any(axis=1) & shared.is_shared] = np.nan
        self._record_gaps(gaps, shared, moved.record.warnings)

    def _order_of_writing(self) -> list[int]:
        """Places of the members, those first that round positions most: so that a point which they
        share with others can be stored alike by all."""
        ranks = {"text": 0, "integer": 0, "float32": 1}
        return sorted(
            range(len(self._members)),
            key=lambda place: ranks.get(self._members[place].record.precision or "", 2),
        )

    # The records

    def _record_gaps(self, gaps: Floats, shared: SharedBorders, warnings: Sequence[str]) -> None:
        """Add to the records what the whole set shows, and what a user should know of it."""
        failed = [
            self._tasks[index].relative
            for index in sorted(self._records)
            if self._records[index].status == "failed"
        ]
        failed += self._earlier.absent
        for index in self._earlier.parts.keys() & {
            index for index, one in self._records.items() if one.status == "failed"
        }:
            self._records[index] = replace(
                self._records[index], tile_set=self._earlier.parts[index]
            )
        notes = [f"the tile set: {one}" for one in warnings]
        for place, member in enumerate(self._members):
            record = self._records[member.index]
            if record.status == "failed":
                continue
            # NaN where an output cannot be read back.
            largest = float(gaps[shared.of_file(place)].max(initial=0.0))
            gap = None if np.isnan(largest) else largest
            notes += _warnings_of(record, gap or 0.0, failed)
            self._records[member.index] = replace(
                record, tile_gap=gap, warnings=(*record.warnings, *notes)
            )
            notes = []


def _require_tiles(run_tiles: RunTiles | None, settings: Settings, reason: ResourceError) -> None:
    """Raise ``reason`` where tiles are no way either."""
    if run_tiles is None:
        raise reason
    try:
        run_tiles.refuse(settings)
    except UnsupportedError as objection:
        reason.hint += f"; it cannot be denoised by tiles: {objection.message}"
        raise reason from None


def _bounds(positions: Floats) -> dict[str, Any]:
    if not len(positions):
        return {}
    return {
        "low": tuple(positions.min(axis=0).tolist()),
        "high": tuple(positions.max(axis=0).tolist()),
    }


def _warnings_of(record: MeshRecord, gap: float, failed: Sequence[str]) -> list[str]:
    """What a user should know of the borders of a file."""
    part = record.tile_set
    assert part is not None
    notes = []
    if part.fixed_border_vertices:
        names = ", ".join(failed[:3]) + (" ..." if len(failed) > 3 else "")
        notes.append(
            f"{part.fixed_border_vertices:,} border vertices were held in their place, because "
            f"files that failed or are gone may share them: {names}"
        )
    if part.unmatched_vertices:
        notes.append(
            f"{part.unmatched_vertices:,} border vertices lie at the border of another file but "
            "are no vertices of it: there the surface stays cut; if they should be the same, give "
            "--weld LENGTH"
        )
    if gap > 0.0:
        notes.append(
            f"shared vertices differ by up to {gap:.3g} from those of other files, which store "
            "positions with other digits"
        )
    return notes
