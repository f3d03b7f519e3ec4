"""One file with noise added, from start to end: the bracket behind ``msal noise``.

The output is the input with other positions (and normals, where the file has them), as after
denoising; it is checked before it is written, and appears whole or not at all.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

from msal_cli.errors import InternalError, MsalError, OutputError, ResourceError, UnsupportedError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from msal_cli.analysis.added_noise import AddedNoise
    from msal_cli.codecs.mesh_file import Companion, MeshFile
    from msal_cli.mesh import PreparedMesh
    from msal_cli.storage.buffers import Buffer


@dataclass(frozen=True)
class Corrupted:
    """What was done to a file: its vertices, how many moved, the standard deviation of the noise in
    file units, and the files that belong beside the output."""

    vertices: int
    moved_vertices: int
    deviation: float
    warnings: tuple[str, ...]
    companions: tuple[Companion, ...] = ()


def corrupt_file(
    source: str, target: str, noise: AddedNoise, format: str | None = None
) -> Corrupted:
    """Write the file ``source`` with noise added to ``target``.

    Raises
    ------
    MsalError
        if the file cannot be read or written; then there is no output.
    """
    from msal_cli import codecs as files

    try:
        output, result = corrupted(files.read_input(source, format), source, target, noise, format)
        if not files.is_url(target):
            _make_folder_of(target)
        if result.companions:
            from msal_cli.codecs.companions import write_companions

            write_companions(result.companions, target)
        files.write_whole(target, [output])
    except MsalError as error:
        error.path = error.path or source
        raise
    except MemoryError:
        raise ResourceError("not enough memory", code="E_MEMORY", path=source) from None
    return result


def corrupted(
    data: Buffer, name: str, target: str, noise: AddedNoise, format: str | None = None
) -> tuple[Buffer, Corrupted]:
    """The bytes of the output for the bytes of the input ``name``, and what was done.

    ``target`` is the output's name, which must be of the same format; ``-`` has none.
    """
    import numpy as np

    from msal_cli import codecs as files
    from msal_cli.analysis.added_noise import add_noise
    from msal_cli.mesh import prepare_mesh

    plain, is_compressed = files.expanded(data, name)
    mesh_file = files.open_mesh(plain, name, format)
    wanted = files.format_of_name(target)
    if wanted and wanted != mesh_file.format:
        raise UnsupportedError(
            f"noise keeps the format, {mesh_file.format}, and the output's name says {wanted}",
            hint=f"name it .{mesh_file.format}, and convert with msal denoise --to",
        )
    ready = prepare_mesh(
        mesh_file.vertices, mesh_file.faces, are_distinct=mesh_file.merged_vertices > 0
    )
    weights = None
    if noise.kind == "property":
        weights = read_weights(mesh_file, ready, noise.property)
    positions = add_noise(ready.mesh, noise, weights)
    if not np.isfinite(positions).all():
        raise InternalError("noise made a position that is not finite")
    original = mesh_file.vertices
    vertices = ready.to_file_vertices(positions, original)
    n_moved = int(np.count_nonzero((vertices != original).any(axis=1)))
    compress = target.lower().endswith(".gz") if target != "-" else is_compressed
    output: Buffer = data if not n_moved and compress == is_compressed else plain
    if n_moved:
        output = _replace_positions(mesh_file, vertices)
    path = None if target == "-" else target
    output, companions = files.with_companions(mesh_file, output, vertices, path)
    result = Corrupted(
        vertices=len(original),
        moved_vertices=n_moved,
        deviation=noise.level * ready.mesh.mean_edge_length,
        warnings=mesh_file.warnings,
        companions=companions,
    )
    if not n_moved and compress == is_compressed:
        return output, result
    return files.compressed(output) if compress else output, result


def _replace_positions(mesh_file: MeshFile, vertices: NDArray[np.float64]) -> Buffer:
    try:
        output = mesh_file.replaced(vertices)
    except MsalError as error:
        if error.code == "E_RANGE":
            error.hint = "choose a lower --level: this file's numbers are near their limit"
        raise
    mesh_file.check(output, vertices)
    return output


def read_weights(mesh_file: MeshFile, ready: PreparedMesh, name: str) -> NDArray[np.float64]:
    """A vertex property of the file at the mesh's vertices (n,); of vertices at one place the
    first in the file counts."""
    import numpy as np

    from msal_cli import codecs as files

    values = files.vertex_property(mesh_file, name)
    if ready.vertex_map is None:
        return values
    is_used = ready.vertex_map >= 0
    _, first = np.unique(ready.vertex_map[is_used], return_index=True)
    return values[is_used][first]


def _make_folder_of(path: str) -> None:
    folder = os.path.dirname(path) or os.curdir
    try:
        os.makedirs(folder, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"the folder {folder!r} cannot be made: {error.strerror}", path=path
        ) from None
