"""New positions for the vertices of a tile set: of the joined mesh in memory, or by tiles."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from msal_cli.codecs.joined_mesh import JoinedMesh
from msal_cli.errors import TooLargeError
from msal_cli.job.pipeline import FileRun
from msal_cli.job.settings import NO_LIMITS, Settings
from msal_cli.tiles.file_set import FIXED, SetFile, SetSource, build_table
from msal_cli.tiles.join import MOVED, gather_rows, read_stored
from msal_cli.tiles.plan import load_plan
from msal_cli.tiles.set_borders import SharedBorders
from msal_cli.tiles.set_member import Arrays, Member
from msal_cli.tiles.source import open_source

if TYPE_CHECKING:
    from collections.abc import Iterator

    from msal_cli.arrays import Flags, Floats, Longs
    from msal_cli.job.pipeline import OnProgress
    from msal_cli.job.records import MeshRecord
    from msal_cli.tiles.scratch import Scratch


class MovedSet(Protocol):
    """A joined mesh that was denoised."""

    @property
    def record(self) -> MeshRecord:
        """Its own."""
        ...

    def positions(self, place: int) -> Floats:
        """The new positions (n, 3) of the vertices of a member, float64, file units."""
        ...

    def field_values(self, place: int) -> dict[str, Floats]:
        """The fields of --fields at the vertices (n,) of a member."""
        ...


class RunTiles(Protocol):
    """What runs all stages of the tiles over a set."""

    @property
    def is_forced(self) -> bool:
        """Whether the set is denoised by tiles although it may fit into memory."""
        ...

    def refuse(self, settings: Settings) -> None:
        """Raise UnsupportedError for what cannot be done by tiles."""
        ...

    def __call__(
        self, source: SetSource, settings: Settings
    ) -> AbstractContextManager[tuple[Scratch, MeshRecord]]:
        """The scratch folder with the new positions, which is removed at the end, and the record of
        the joined mesh."""
        ...


@dataclass(frozen=True, eq=False)
class JointMesh:
    """The files of a set as one mesh that is to be denoised.

    Attributes
    ----------
    members : its files.
    shared : which of their border points are one.
    fixed : (n,) border points that stay where they are; None for none.
    """

    members: Sequence[Member]
    shared: SharedBorders
    fixed: Flags | None

    @property
    def starts(self) -> list[int]:
        """First vertex of each file, and the one behind the last."""
        starts = [0]
        for one in self.members:
            starts.append(starts[-1] + one.n_vertices)
        return starts

    def replaced_vertices(self) -> tuple[Longs, Floats]:
        """The vertices, ascending, that take another position before anything else, and these."""
        shared = self.shared
        positions, is_moved = shared.positions[shared.group], shared.is_moved
        rows, places = [], []
        for place, (member, start) in enumerate(zip(self.members, self.starts, strict=False)):
            own, border = shared.of_file(place), member.border
            at = is_moved[own][border.points]
            rows.append(start + border.vertices[at])
            places.append(positions[own][border.points[at]])
        return np.concatenate(rows), np.concatenate(places)

    def fixed_vertices(self) -> Longs:
        """The vertices, ascending, that stay where they are."""
        if self.fixed is None:
            return np.empty(0, dtype=np.int64)
        rows = []
        for place, (member, start) in enumerate(zip(self.members, self.starts, strict=False)):
            at = self.fixed[self.shared.of_file(place)][member.border.points]
            rows.append(start + member.border.vertices[at])
        return np.concatenate(rows)


@dataclass(frozen=True, eq=False)
class _InMemory:
    """See ``MovedSet``."""

    record: MeshRecord
    vertices: Floats
    fields: dict[str, Floats]
    starts: Sequence[int]

    def _part(self, place: int) -> slice:
        return slice(self.starts[place], self.starts[place + 1])

    def positions(self, place: int) -> Floats:
        return np.array(self.vertices[self._part(place)])

    def field_values(self, place: int) -> dict[str, Floats]:
        return {name: values[self._part(place)] for name, values in self.fields.items()}


def move_in_memory(
    joint: JointMesh, arrays: list[Arrays], settings: Settings, on_progress: OnProgress
) -> MovedSet:
    """Denoise the joined mesh; the arrays of the files are freed on the way."""
    starts = joint.starts
    if starts[-1] > np.iinfo(np.int32).max:
        raise TooLargeError(
            f"the files have {starts[-1]:,} vertices, too many for one mesh in memory",
            hint="give a --memory-limit, so that it is denoised by tiles",
        )
    vertices = np.concatenate([one.vertices for one in arrays])
    faces = np.concatenate(
        [one.faces + np.int32(start) for one, start in zip(arrays, starts, strict=False)]
    )
    names = arrays[0].properties
    properties = {name: np.concatenate([one.properties[name] for one in arrays]) for name in names}
    arrays.clear()
    rows, positions = joint.replaced_vertices()
    vertices[rows] = positions
    pinned = None
    if joint.fixed is not None:
        pinned = np.zeros(len(vertices), dtype=np.bool_)
        pinned[joint.fixed_vertices()] = True
    run = FileRun("the tile set", settings, on_progress, NO_LIMITS)
    moved = run.move_vertices(JoinedMesh(vertices, faces, properties), pinned)
    return _InMemory(run.finish(None), moved, run.field_values, starts)


@dataclass(frozen=True, eq=False)
class _ByTiles:
    """See ``MovedSet``."""

    record: MeshRecord
    scratch: Scratch
    starts: Sequence[int]

    def positions(self, place: int) -> Floats:
        if self.scratch.has(MOVED):
            read = gather_rows(self.scratch, MOVED)
        else:
            read = read_stored(open_source(load_plan(self.scratch).source))
        return read(self.starts[place], self.starts[place + 1])

    def field_values(self, place: int) -> dict[str, Floats]:
        return {}


@contextmanager
def move_by_tiles(joint: JointMesh, settings: Settings, run_tiles: RunTiles) -> Iterator[MovedSet]:
    """Denoise the set through a scratch folder, which is there until this ends."""
    is_single = all(one.record.precision == "float32" for one in joint.members)
    vertex_type = "float32" if is_single else "float64"
    files = [
        SetFile(one.task.input, one.n_vertices, one.n_triangles, one.size) for one in joint.members
    ]
    table = build_table(*joint.replaced_vertices(), joint.fixed_vertices())
    source = SetSource(files, settings.format, vertex_type, table)
    joined = settings
    if joint.fixed is not None:
        joined = replace(settings, lock=(*settings.lock, f"{FIXED} > 0.5"))
    with run_tiles(source, joined) as (scratch, record):
        if not settings.lock:
            record = replace(record, locked_vertices=None)
        yield _ByTiles(record, scratch, joint.starts)
