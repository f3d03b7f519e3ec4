"""A tile set: files that touch, denoised as one joined mesh.

First every file is read alone: its contents, and its border.  Then the border vertices that files
share are found, the joined mesh is denoised in memory, and every file is read again and written
with its part of the new positions.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from msal_cli.analysis import shared_borders
from msal_cli.analysis.measures import at_other_positions
from msal_cli.analysis.shared_borders import Border, SharedBorders
from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.batch.schedule import OnEvent, Progress
from msal_cli.batch.workers import limited_memory
from msal_cli.codecs.detection import format_of_name
from msal_cli.codecs.header import BASE_BYTES
from msal_cli.codecs.mesh_file import MeshFile, Surface
from msal_cli.errors import InputError, MsalError, TooLargeError, UsageError
from msal_cli.job import changes, output, room
from msal_cli.job.pipeline import FileRun, OnProgress, start_record
from msal_cli.job.records import Failure, MeshRecord, Seconds, TileSetPart
from msal_cli.job.settings import AXES, NO_LIMITS, Limits, Settings, Task, parse_lock
from msal_cli.light_dataclass import dataclass
from msal_cli.machine import memory_bytes

# Fields that the records of all files of a set share.
_OF_SET = ("method", "choice", "left_alone", "despiked", "clamped_vertices", "locked_vertices")
_ROUNDING = {"text": 0, "integer": 0, "float32": 1}
"""Precisions that are coarser than double precision, the coarsest first."""


@dataclass(frozen=True, eq=False)
class Member:
    """A file of a set that could be read: the index of its task, and its record so far."""

    index: int
    task: Task
    record: MeshRecord
    border: Border


@dataclass(eq=False, kw_only=True)
class JoinedMesh(Surface):
    """The joined vertices and faces of several files; ``properties`` (n,) of vertices by name."""

    properties: Mapping[str, Floats]

    def vertex_property(self, name: str) -> Floats:
        return self.properties[name]


def memory_of_set(tasks: Sequence[Task], settings: Settings) -> int:
    """Bytes of memory that denoising these files as one will need, by forecast."""
    needs = [room.forecast(task, settings).memory_bytes or BASE_BYTES for task in tasks]
    return BASE_BYTES + sum(max(0, need - BASE_BYTES) for need in needs)


@dataclass(eq=False)
class SetRun:
    """One run over a set; a *place* is the index of a file among those that could be read."""

    tasks: Sequence[Task]
    settings: Settings
    on_event: OnEvent = lambda event: None
    limits: Limits = NO_LIMITS

    def __post_init__(self) -> None:
        self._members: list[Member] = []
        # Vertices (n, 3), faces (m, 3) and properties of each member, until they are joined.
        self._arrays: list[tuple[Floats, Ints, dict[str, Floats]]] = []
        self._records: dict[int, MeshRecord] = {}

    def survey(self) -> dict[int, MeshRecord]:
        """Read the set without denoising it: records with ``tile_set``, or failures, by index."""
        try:
            self._find_scratch()
        except MsalError as error:
            return self._fail_rest(error)
        for index in range(len(self.tasks)):
            self._scan(index)
            self._arrays.clear()
        for member, part in zip(self._members, self._describe()[1], strict=True):
            self._records[member.index] = replace(
                member.record, status="planned", output=member.task.output, tile_set=part
            )
        return self._records

    def denoise(self, max_failures: int | None = None) -> dict[int, MeshRecord]:
        """Denoise the files as one mesh; returns records by the indices of their tasks.

        A file that cannot be read fails; border vertices that it may share stay where they are.
        Once ``max_failures`` files cannot be read, nothing is written, and only they have records.
        """
        limit = self.limits.memory_bytes
        if limit is not None:  # the memory that this process had before does not count
            limit += max(0, memory_bytes("VmRSS") - BASE_BYTES)
        try:
            with limited_memory(limit), room.use_scratch(self._find_scratch()):
                for index in range(len(self.tasks)):
                    self._scan(index)
                has_given_up = max_failures is not None and len(self._records) >= max_failures
                if self._members and not has_given_up:
                    self._denoise_members()
        except UsageError:
            raise
        except Exception as error:
            self._fail_rest(error)
        return self._records

    def _find_scratch(self) -> room.Scratch | None:
        work = f"denoising these {len(self.tasks):,} files as one"
        needed = memory_of_set(self.tasks, self.settings)
        return room.find_scratch(work, needed, self.limits, self.tasks[0].output)

    def _fail_rest(self, error: Exception) -> dict[int, MeshRecord]:
        """The set fails as a whole: every file without a failure of its own gets this one."""
        failure = Failure.of(room.to_known_error(error, "the tile set"))
        for index, task in enumerate(self.tasks):
            if index not in self._records:
                self._records[index] = start_record(task.input, self.settings, error=failure)
        return self._records

    def _progress_of(self, index: int) -> OnProgress:
        return lambda stage, done, total: self.on_event(Progress(index, stage, done, total))

    def _scan(self, index: int) -> None:
        """Read a file for the first time; add a member, or the record of a failure."""
        task = self.tasks[index]
        run = FileRun(task.input, self.settings, self._progress_of(index))
        try:
            mesh_file = run.open(run.read(task))
            with run.stage("connectivity"):
                border = shared_borders.find_border(
                    run.prepare_mesh(mesh_file), mesh_file.vertices, mesh_file.faces
                )
                # Properties that --lock and --weights name; coordinates are in any file.
                locks = map(parse_lock, self.settings.lock)
                names = {lock.name for lock in locks if lock and lock.name not in AXES}
                if self.settings.weights is not None:
                    names.add(self.settings.weights)
                properties = {name: mesh_file.vertex_property(name) for name in sorted(names)}
            arrays = mesh_file.vertices, mesh_file.faces, properties
            record = run.finish(None)
        except Exception as error:
            self._records[index] = run.fail(error)
            return
        self._arrays.append(arrays)
        self._members.append(Member(index, task, record, border))

    def _fixed_points(self, shared: SharedBorders) -> Flags | None:
        """Border points (n,) that a failed file may share; None if no file has failed."""
        return ~shared.is_shared if self._records else None

    def _describe(self) -> tuple[SharedBorders, list[TileSetPart]]:
        """The borders that members share, and the ``tile_set`` of each member's record."""
        borders = [member.border for member in self._members]
        is_single = [member.record.precision == "float32" for member in self._members]
        shared = shared_borders.share_borders(borders, is_single)
        if not self._members:
            return shared, []
        lengths = np.array([member.record.mean_edge_length or 0.0 for member in self._members])
        n_triangles = np.array([member.record.triangles or 0 for member in self._members])
        edge = float(np.average(lengths, weights=n_triangles))
        unmatched = shared_borders.count_unmatched(borders, shared, edge)
        neighbours, gaps = shared.neighbours(), shared.distances(shared.positions)
        is_shared, fixed = shared.is_shared, self._fixed_points(shared)
        is_moved = (shared.joined_positions != shared.positions).any(axis=1)
        parts = []
        for place in range(len(self._members)):
            own = shared.of_file(place)
            bounds: dict[str, Any] = {}
            if len(positions := shared.positions[own]):
                bounds = {
                    "low": tuple(positions.min(axis=0).tolist()),
                    "high": tuple(positions.max(axis=0).tolist()),
                }
            parts.append(
                TileSetPart(
                    files=len(self._members),
                    neighbours=tuple(self._members[i].task.relative for i in neighbours[place]),
                    shared_vertices=int(is_shared[own].sum()),
                    welded_vertices=int(is_moved[own].sum()),
                    largest_weld=float(gaps[own].max(initial=0.0)),
                    unmatched_vertices=unmatched[place],
                    fixed_border_vertices=0 if fixed is None else int(fixed[own].sum()),
                    **bounds,
                )
            )
        return shared, parts

    def _denoise_members(self) -> None:
        shared, parts = self._describe()
        # For STL these are the welded vertices.
        counts = [member.record.vertices or 0 for member in self._members]
        starts = [0, *itertools.accumulate(counts)]
        on_progress = self._progress_of(self._members[0].index)
        run = FileRun("the tile set", self.settings, on_progress)
        moved = run.move_vertices(*self._join(shared, starts))
        joint = run.finish(None)
        known = {name: getattr(joint, name) for name in _OF_SET}
        written = np.full_like(shared.positions, np.nan)
        # Positions as the first file that has a point stores it; later files use the same.
        agreed = np.full_like(shared.positions, np.nan)
        is_single = np.zeros(len(self._members), dtype=np.bool_)
        # The coarsest precision goes first, so that all files can store a shared point alike.
        for place in sorted(
            range(len(self._members)),
            key=lambda place: _ROUNDING.get(self._members[place].record.precision or "", 2),
        ):
            member, part = self._members[place], slice(starts[place], starts[place + 1])
            vertices, own = np.array(moved[part]), shared.of_file(place)
            new = agreed[shared.group[own]][member.border.points]
            is_known = ~np.isnan(new).any(axis=1)
            vertices[member.border.vertices[is_known]] = new[is_known]
            values = {name: column[part] for name, column in run.field_values.items()}
            record, points, is_single[place] = self._write(member, vertices, known, values)
            written[own] = points
            first = shared.group[own]
            is_open = np.isnan(agreed[first]).any(axis=1)
            agreed[first[is_open]] = points[is_open]
            share = counts[place] / starts[-1]
            peak = joint.peak_memory_bytes or 0
            # Of writing it and reading it first, and its share of the joint work.
            seconds = {
                stage.name: getattr(record.seconds, stage.name)
                + getattr(member.record.seconds, stage.name)
                + share * getattr(joint.seconds, stage.name)
                for stage in fields(Seconds)
            }
            self._records[member.index] = replace(
                record,
                tile_set=parts[place],
                seconds=Seconds(**seconds),
                peak_memory_bytes=max(record.peak_memory_bytes or 0, peak) or None,
            )
        self._record_gaps(shared, written, is_single, joint.warnings)

    def _join(
        self, shared: SharedBorders, starts: Sequence[int]
    ) -> tuple[JoinedMesh, Flags | None]:
        """The joined mesh, and which of its vertices (n,) are fixed; frees the files' arrays."""
        if starts[-1] > np.iinfo(np.int32).max:
            raise TooLargeError(
                f"the files have {starts[-1]:,} vertices, too many for one mesh",
                hint="denoise fewer files as one",
            )
        vertices = np.concatenate([rows for rows, _, _ in self._arrays])
        faces = np.concatenate(
            [
                rows + np.int32(start)
                for (_, rows, _), start in zip(self._arrays, starts, strict=False)
            ]
        )
        properties = {
            name: np.concatenate([found[name] for _, _, found in self._arrays])
            for name in self._arrays[0][2]
        }
        self._arrays.clear()
        fixed = self._fixed_points(shared)
        pinned = None if fixed is None else np.zeros(len(vertices), dtype=np.bool_)
        positions = shared.joined_positions
        for place, (member, start) in enumerate(zip(self._members, starts, strict=False)):
            own, border = shared.of_file(place), member.border
            vertices[start + border.vertices] = positions[own][border.points]
            if pinned is not None and fixed is not None:
                pinned[start + border.vertices] = fixed[own][border.points]
        return JoinedMesh(vertices, faces, properties=properties), pinned

    def _write(
        self,
        member: Member,
        vertices: Floats,
        known: Mapping[str, Any],
        field_values: dict[str, Floats],
    ) -> tuple[MeshRecord, Floats, bool]:
        """Write a file with new positions (n, 3); returns its record, its border points (k, 3) as
        stored in the output, and whether that has single precision.

        ``known`` are fields that the records of all files of the set share.
        """
        task = member.task
        run = FileRun(task.input, self.settings, self._progress_of(member.index))
        try:
            data = run.read(task)
            mesh_file = run.open(data)
            if run.record.input_sha256 != member.record.input_sha256:
                raise InputError(
                    "the file changed while its tile set was denoised",
                    code="E_CHANGED",
                    hint="run the same command again once it is complete",
                )
            with run.stage("connectivity"):
                ready = run.prepare_mesh(mesh_file)
            with run.stage("measure"):
                vertices = output.as_stored(mesh_file, self.settings, task.output, vertices)
                moved = at_other_positions(ready, vertices).vertices
                run.know_changes(changes.measure(ready, moved, ready.mesh), ready, moved)
                run.know(seam_gap=ready.seam_gap(vertices), **known)
                ready.mesh.release_normals()
            run.field_values = field_values
            made = run.build(mesh_file, vertices, task.output, data)
            record = run.write(task, data, made)
            return record, *_read_points(member.border, mesh_file, made, task.output)
        except Exception as error:
            return run.fail(error), np.full_like(member.border.positions, np.nan), False

    def _record_gaps(
        self, shared: SharedBorders, written: Floats, is_single: Flags, warnings: Sequence[str]
    ) -> None:
        # If only some of the files that have a point have single precision, compare in that.
        counts = np.bincount(shared.group, minlength=len(shared.group))
        n_single = np.bincount(
            shared.group, weights=is_single[shared.file_of], minlength=len(shared.group)
        )
        mixed = ((n_single > 0) & (n_single < counts))[shared.group]
        written[mixed] = written[mixed].astype(np.float32)
        gaps = shared.distances(written)
        gaps[np.isnan(written).any(axis=1) & shared.is_shared] = np.nan
        failed = sorted(i for i, record in self._records.items() if record.status == "failed")
        names = [self.tasks[index].relative for index in failed]
        notes = [f"the tile set: {warning}" for warning in warnings]
        for place, member in enumerate(self._members):
            record = self._records[member.index]
            if record.status == "failed":
                continue
            # NaN where an output cannot be read back.
            largest = float(gaps[shared.of_file(place)].max(initial=0.0))
            gap = None if np.isnan(largest) else largest
            notes += _border_warnings(record, gap or 0.0, names)
            self._records[member.index] = replace(
                record, tile_gap=gap, warnings=(*record.warnings, *notes)
            )
            notes = []


def _border_warnings(record: MeshRecord, gap: float, failed: Sequence[str]) -> list[str]:
    part = record.tile_set
    assert part is not None
    notes = []
    if part.fixed_border_vertices:
        names = ", ".join(failed[:3]) + (" ..." if len(failed) > 3 else "")
        notes.append(
            f"{part.fixed_border_vertices:,} border vertices were held in their place, because "
            f"files that failed may share them: {names}"
        )
    if part.unmatched_vertices:
        notes.append(
            f"{part.unmatched_vertices:,} border vertices lie at the border of another file but "
            "are no vertices of it: there the surface stays cut"
        )
    if gap > 0.0:
        notes.append(
            f"shared vertices differ by up to {gap:.3g} from those of other files, which store "
            "positions with other digits"
        )
    return notes


def _read_points(
    border: Border, mesh_file: MeshFile, made: output.Output, output_path: str
) -> tuple[Floats, bool]:
    """The border points (k, 3) of a file as stored in its output (NaN where they cannot be read),
    and whether that has single precision."""
    unknown = np.full_like(border.positions, np.nan)
    format = None if format_of_name(output_path) else mesh_file.format
    try:
        stored = room.open_mesh(made.data, output_path, format)
    except MsalError:
        return unknown, False
    has_same_vertices = (
        len(stored.vertices) == len(mesh_file.vertices)
        and stored.merged_vertices == mesh_file.merged_vertices == 0
    )
    if has_same_vertices:
        unknown[border.points[::-1]] = stored.vertices[border.vertices[::-1]]
        return unknown, stored.precision == "float32"
    if len(stored.faces) == len(mesh_file.faces):
        # The vertices have another order, as in STL, but the faces have kept theirs.
        corners = stored.faces.reshape(-1)[border.corners]
        return stored.vertices[corners], stored.precision == "float32"
    return unknown, False
