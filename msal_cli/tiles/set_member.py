"""One file of a tile set: what is found in it first, and its output in the end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from msal_cli.errors import InputError, MsalError
from msal_cli.job import changes, output
from msal_cli.job.pipeline import FileRun
from msal_cli.job.records import MeshRecord, Seconds
from msal_cli.job.settings import NO_LIMITS
from msal_cli.tiles.set_borders import Border, find_border

if TYPE_CHECKING:
    from msal_cli.arrays import Floats, Ints
    from msal_cli.codecs.mesh_file import MeshFile
    from msal_cli.job.pipeline import OnProgress
    from msal_cli.job.settings import Limits, Settings, Task
    from msal_cli.storage.buffers import Buffer


@dataclass(frozen=True, eq=False)
class Member:
    """A file of a set that could be read.

    Attributes
    ----------
    index : its task's, in the order of names.
    record : what is known of it, with the seconds of the first reading.
    n_vertices, n_triangles : as its codec gives them: of an STL the welded vertices.
    border : its border points.
    size : bytes of the file.
    """

    index: int
    task: Task
    record: MeshRecord
    n_vertices: int
    n_triangles: int
    border: Border
    size: int


@dataclass(frozen=True, eq=False)
class WrittenBorder:
    """The border points of an output: positions (k, 3), NaN where they cannot be read, and
    whether they are stored in single precision."""

    positions: Floats
    is_single: bool = False


@dataclass(frozen=True, eq=False)
class Arrays:
    """What the mathematics needs of a file: vertices (n, 3), faces (m, 3), properties (n,)."""

    vertices: Floats
    faces: Ints
    properties: Mapping[str, Floats]


def scan_member(
    index: int,
    task: Task,
    settings: Settings,
    limits: Limits,
    on_progress: OnProgress | None,
    on_arrays: Callable[[Arrays], None] | None = None,
) -> Member | MeshRecord:
    """What is in a file, or the record of its failure; ``on_arrays`` gets its arrays."""
    run = FileRun(task.input, settings, on_progress, limits)
    try:
        data = run.read(task)
        mesh_file, _ = run.open(data)
        with run.stage("connectivity"):
            ready = run.prepare_mesh(mesh_file)
            border = find_border(ready, mesh_file)
            properties = read_properties(mesh_file, settings)
        vertices, faces = mesh_file.vertices, mesh_file.faces
        if on_arrays is not None:
            on_arrays(Arrays(vertices, faces, properties))
        return Member(index, task, run.finish(None), len(vertices), len(faces), border, len(data))
    except Exception as error:
        return run.fail(error)


def read_properties(mesh_file: MeshFile, settings: Settings) -> dict[str, Floats]:
    """The properties of vertices that --lock and --weights name, of one file."""
    from msal_cli import codecs
    from msal_cli.job.constraints import parse_lock

    locks = (parse_lock(one) for one in settings.lock)
    names = {one.name for one in locks if one is not None}
    if settings.weights is not None:
        names.add(settings.weights)
    return {name: codecs.vertex_property(mesh_file, name) for name in sorted(names)}


def write_member(
    member: Member,
    vertices: Floats,
    known: Mapping[str, Any],
    settings: Settings,
    on_progress: OnProgress | None,
    field_values: Mapping[str, Floats],
) -> tuple[MeshRecord, WrittenBorder]:
    """Write a file with new positions (n, 3); its record, and its border as it was written.

    ``known`` are fields of the record that all files of the set share.
    """
    from msal_cli.analysis.correspondence import at_other_positions

    task = member.task
    run = FileRun(task.input, settings, on_progress, NO_LIMITS)
    try:
        data = run.read(task)
        mesh_file, is_compressed = run.open(data)
        if run.record.input_sha256 != member.record.input_sha256:
            raise InputError(
                "the file changed while its tile set was denoised",
                code="E_CHANGED",
                hint="run the same command again once it is complete",
            )
        with run.stage("connectivity"):
            ready = run.prepare_mesh(mesh_file)
        with run.stage("measure"):
            moved = at_other_positions(ready, vertices).vertices
            run.know_changes(changes.measure(ready, moved, None))
            run.check_intersections(ready, moved)
            run.know(seam_gap=ready.seam_gap(vertices), **known)
            ready.mesh.release_normals()
        run.field_values = dict(field_values)
        source = output.Source(data, task.input, is_compressed)
        made = run.build(mesh_file, vertices, task.output, source)
        record = run.write(task, data, made)
        return record, read_points(member.border, mesh_file, made.data, task.output)
    except Exception as error:
        return run.fail(error), _unknown(member.border)


def read_points(
    border: Border, mesh_file: MeshFile, written: Buffer, output_path: str
) -> WrittenBorder:
    """The border of a file as it stands in the bytes of its output."""
    from msal_cli.codecs.detection import readable_suffixes
    from msal_cli.job.opened_mesh import open_mesh
    from msal_cli.job.settings import suffix

    if not len(border.positions):
        return _unknown(border)
    is_named = suffix(output_path) in readable_suffixes()
    try:
        there, _ = open_mesh(written, output_path, None if is_named else mesh_file.format)
    except MsalError:
        return _unknown(border)
    has_same_vertices = (
        len(there.vertices) == len(mesh_file.vertices)
        and there.merged_vertices == mesh_file.merged_vertices == 0
    )
    if has_same_vertices:
        points = np.empty_like(border.positions)
        points[border.points[::-1]] = there.vertices[border.vertices[::-1]]
    elif len(there.faces) == len(mesh_file.faces):
        # The order of vertices is another, such as that of STL, but faces have kept theirs.
        points = there.vertices[there.faces.reshape(-1)[border.corners]]
    else:
        return _unknown(border)
    return WrittenBorder(points, there.precision == "float32")


def _unknown(border: Border) -> WrittenBorder:
    return WrittenBorder(np.full_like(border.positions, np.nan))


def add_seconds(record: MeshRecord, *others: tuple[Seconds | None, float]) -> MeshRecord:
    """A record whose seconds have those of other work added, each times a share of it."""
    if record.seconds is None:
        return record
    sums = {
        one.name: getattr(record.seconds, one.name)
        + sum(share * getattr(more, one.name) for more, share in others if more is not None)
        for one in fields(Seconds)
    }
    total = sums["total"]
    speed = (record.vertices or 0) / total if total > 0.0 and record.error is None else None
    return replace(record, seconds=Seconds(**sums), vertices_per_second=speed)
