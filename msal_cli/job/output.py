"""Build the bytes of an output file, denoised or with noise added, check and write them."""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from msal_cli import codecs
from msal_cli.codecs import detection
from msal_cli.errors import InternalError, LossError, MsalError, OutputError, UnsupportedError
from msal_cli.job.room import open_mesh, prepare_mesh
from msal_cli.job.settings import Settings, Task
from msal_cli.light_dataclass import dataclass
from msal_cli.storage import atomic, gzip_streams
from msal_cli.storage.urls import ObjectMark, is_url

if TYPE_CHECKING:
    from msal_cli.analysis.added_noise import AddedNoise
    from msal_cli.arrays import Floats
    from msal_cli.codecs.mesh_file import Companion, MeshFile, Surface
    from msal_cli.storage.regular import Buffer


@dataclass(frozen=True, eq=False)
class Output:
    """An output file that is yet to be written."""

    data: Buffer  # its bytes; those of the input itself if nothing has changed
    # files that the input and the output refer to; a conversion drops them
    references: tuple[str, ...] = ()
    companions: tuple[Companion, ...] = ()  # files that it refers to and that contain a part of it
    losses: tuple[str, ...] = ()  # what its format cannot store
    sources: tuple[str, ...] = ()  # files beside the input that its mesh was read from
    stale: Sequence[str] = ()  # warnings about the input that are false for the output


def build_output(
    mesh_file: MeshFile, vertices: Floats, settings: Settings, path: str | None, data: Buffer
) -> Output:
    """Build the output for positions (n, 3) of a file's vertices; check it by reading it back.

    ``path`` is where it is to be written, None for a pipe; ``data`` are the bytes of the input.

    Raises LossError if ``settings`` are strict and a conversion would lose something, and
    InternalError if the output does not contain what it should.
    """
    is_compressed = gzip_streams.is_gzip(data)
    compress = is_compressed if path is None else gzip_streams.is_gzip_name(path)
    target, *how = _format_of_output(mesh_file, settings, path)
    lost: tuple[str, ...] = ()
    stale: list[str] = []
    references = mesh_file.references
    companions: tuple[Companion, ...] = ()
    if [target, *how] != [mesh_file.format, "same", "same"]:
        from msal_cli.codecs import conversion

        output, losses = conversion.convert(mesh_file, vertices, target, *how)
        if losses and settings.strict:
            raise LossError(
                f"{mesh_file.format} to {target} would lose {', '.join(losses)}",
                hint="leave --strict away, or keep format, encoding and precision",
            )
        _check_reopened(output, target, mesh_file, vertices)
        lost = tuple(f"lost in {target}: {loss}" for loss in losses)
        stale = conversion.stale_warnings(mesh_file, target, *how)
    elif not np.array_equal(vertices, mesh_file.vertices):
        output = mesh_file.replaced(vertices)
        mesh_file.check(output, vertices)
    elif compress == is_compressed:
        output, compress = data, False
    else:
        output = gzip_streams.expand(data)
    if target == mesh_file.format:
        output, companions = mesh_file.beside(output, vertices, path)
    elif {target, mesh_file.format} != detection.SCENES:
        # A scene that only changes its container still names its images.
        references = ()
    output = gzip_streams.compress(output) if compress else output
    return Output(output, references, companions, lost, mesh_file.sources, stale)


def as_stored(
    mesh_file: MeshFile, settings: Settings, path: str | None, vertices: Floats
) -> Floats:
    """New positions (n, 3) rounded to the number type of the output at ``path``; a text may round
    them to fewer digits."""
    how = _format_of_output(mesh_file, settings, path)
    if how == (mesh_file.format, "same", "same"):
        return mesh_file.as_stored(vertices)
    from msal_cli.codecs import conversion

    return conversion.as_stored(mesh_file, vertices, *how)


def _format_of_output(
    mesh_file: MeshFile, settings: Settings, path: str | None
) -> tuple[str, str, str]:
    """Format (``--to``, else by the output's name, else the input's), encoding and precision."""
    named = detection.format_of_name(path or "") or mesh_file.format
    target = (settings.to or named).lower().lstrip(".")
    return target, settings.encoding, settings.precision


def _check_reopened(output: Buffer, target: str, mesh_file: MeshFile, vertices: Floats) -> None:
    """Read a re-encoded or converted file back before it is trusted."""
    try:
        again = codecs.open_mesh(bytes(output), f"output.{target}", target)
    except MsalError as error:
        raise InternalError(f"the {target} output cannot be read back: {error}") from error
    faces = mesh_file.faces if mesh_file.has_same_grid(again) else again.faces
    if len(faces) != len(mesh_file.faces):
        raise InternalError(
            f"the {target} output has {len(faces):,} triangles, not {len(mesh_file.faces):,}"
        )
    span = float(np.abs(vertices).max(initial=0.0))
    corners = again.vertices[faces.reshape(-1)]
    wanted = vertices[mesh_file.faces.reshape(-1)]
    if float(np.abs(corners - wanted).max(initial=0.0)) > 1e-5 * span:
        raise InternalError(f"the {target} output holds other positions than it should")


def make_folder_of(path: str) -> None:
    """Make the folder that a file is to be written to, if it is not there; stores have none."""
    if not is_url(path):
        atomic.make_folder(os.path.dirname(path) or os.curdir)


def keep_backup(task: Task, data: Buffer) -> None:
    """Write the original beside the file that is replaced; OutputError if its name is taken."""
    backup = task.backup_path
    try:
        if not os.path.lexists(backup) and atomic.write_new(backup, [data], sources=[task.input]):
            return
    except OutputError as error:
        error.message = error.message.replace("the file", f"the backup (*{task.backup})", 1)
        if getattr(error.__cause__, "errno", 0) == errno.ENAMETOOLONG:
            error.hint = "choose a shorter --backup suffix, or rename the file"
        raise
    # A link could point to the very file that is to be replaced.
    is_file = os.path.isfile(backup) and not os.path.islink(backup)
    if not is_file or gzip_streams.read_whole(backup) != data:
        raise OutputError(
            f"the backup {backup!r} exists and is not this file",
            hint="move it away or choose another --backup suffix",
        )


def write_output(
    path: str, data: Buffer, companions: tuple[Companion, ...] = (), sources: atomic.Sources = ()
) -> tuple[tuple[str, ...], ObjectMark | None]:
    """Write a file after its ``companions``, which contain a part of it; make its folder.

    ``sources`` limit the permission bits, see ``atomic.write_whole``.  Returns what was done about
    the companions, for the record, and the mark of an object.
    """
    make_folder_of(path)
    notes: tuple[str, ...] = ()
    if companions:
        from msal_cli.codecs.gltf import write_companions

        notes = write_companions(companions, path, sources)
    return notes, atomic.write_whole(path, [data], sources=sources)


def carry_references(made: Output, task: Task) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Copy the files that an output refers to; what was done, for the record, and warnings."""
    from msal_cli.storage import sidecars

    given = task.input, task.output
    notes = sidecars.carry(made.references, *given, force=task.force, depth=task.depth)
    marked = (note for note in notes if note.startswith("warning: "))
    return notes, tuple(note.removeprefix("warning: ") for note in marked)


# The output of msal noise


def add_noise_to_file(
    data: Buffer, name: str, target: str, noise: AddedNoise, format: str | None = None
) -> tuple[Output, str, tuple[str, ...]]:
    """Add noise to ``data``, the bytes of the input ``name``: the output, a description, warnings.

    ``target`` is the output's name, which must be of the same format; ``-`` has none.
    """
    mesh_file = open_mesh(data, name, format)
    wanted = detection.format_of_name(target)
    if wanted and wanted != mesh_file.format:
        raise UnsupportedError(
            f"noise keeps the format, {mesh_file.format}, and the output's name says {wanted}",
            hint=f"name it .{mesh_file.format}, and convert with msal denoise --to",
        )
    vertices, edge = move_by_noise(mesh_file, noise)
    path = None if target == "-" else target
    settings, original = Settings("noise"), mesh_file.vertices
    vertices = as_stored(mesh_file, settings, path, vertices)
    n_moved = int(np.count_nonzero((vertices != original).any(axis=1)))
    try:
        made = build_output(mesh_file, vertices, settings, path, data)
    except MsalError as error:
        if error.code == "E_RANGE":
            error.hint = "choose a lower --level: this file's numbers are near their limit"
        raise
    words = noise.describe()
    description = (
        f"{noise.kind} noise of {noise.level:g} mean edge lengths "
        f"({noise.level * edge:.4g}), {words + ', ' if words else ''}"
        f"{n_moved:,} of {len(original):,} vertices moved, seed {noise.seed}"
    )
    return made, description, mesh_file.warnings


def move_by_noise(surface: Surface, noise: AddedNoise) -> tuple[Floats, float]:
    """Add noise to a surface: new positions (n, 3) of its vertices, and its mean edge length."""
    from msal_cli.analysis.added_noise import add_noise

    ready = prepare_mesh(surface)
    positions = add_noise(ready.mesh, noise)
    if not np.isfinite(positions).all():
        raise InternalError("noise made a position that is not finite")
    return ready.to_file_vertices(positions, surface.vertices), ready.mesh.mean_edge_length
