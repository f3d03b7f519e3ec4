"""Add noise to one mesh file: the work of ``msal noise``.

The output is the input with other positions (and normals, where the file has them), as after
denoising; it is checked before it is written.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from msal_cli.errors import InternalError, MsalError, UnsupportedError
from msal_cli.job.output import MadeFile

if TYPE_CHECKING:
    from msal_cli.analysis.added_noise import AddedNoise
    from msal_cli.arrays import Floats
    from msal_cli.codecs.mesh_file import MeshFile, Surface
    from msal_cli.mesh import PreparedMesh
    from msal_cli.storage.buffers import Buffer


def add_noise_to_file(
    data: Buffer, name: str, target: str, noise: AddedNoise, format: str | None = None
) -> MadeFile:
    """The output for the bytes of the input ``name``.

    ``target`` is the output's name, which must be of the same format; ``-`` has none.
    """
    import numpy as np

    from msal_cli import codecs
    from msal_cli.analysis.added_noise import add_noise
    from msal_cli.codecs import detection
    from msal_cli.job.opened_mesh import open_mesh, prepare_mesh
    from msal_cli.storage import gzip_streams

    mesh_file, is_compressed = open_mesh(data, name, format)
    wanted = detection.format_of_name(target)
    if wanted and wanted != mesh_file.format:
        raise UnsupportedError(
            f"noise keeps the format, {mesh_file.format}, and the output's name says {wanted}",
            hint=f"name it .{mesh_file.format}, and convert with msal denoise --to",
        )
    ready = prepare_mesh(mesh_file)
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
    is_kept = not n_moved and compress == is_compressed
    if n_moved:
        output = _replace_positions(mesh_file, vertices)
    else:
        output = data if is_kept else gzip_streams.expand(data, name)[0]
    path = None if target == "-" else target
    output, companions = codecs.with_companions(mesh_file, output, vertices, path)
    settings = noise.describe()
    return MadeFile(
        output=gzip_streams.compress(output) if compress and not is_kept else output,
        description=f"{noise.kind} noise of {noise.level:g} mean edge lengths "
        f"({noise.level * ready.mesh.mean_edge_length:.4g}), {settings + ', ' if settings else ''}"
        f"{n_moved:,} of {len(original):,} vertices moved, seed {noise.seed}",
        warnings=mesh_file.warnings,
        companions=companions,
    )


def _replace_positions(mesh_file: MeshFile, vertices: Floats) -> Buffer:
    try:
        output = mesh_file.replaced(vertices)
    except MsalError as error:
        if error.code == "E_RANGE":
            error.hint = "choose a lower --level: this file's numbers are near their limit"
        raise
    mesh_file.check(output, vertices)
    return output


def read_weights(mesh_file: Surface, ready: PreparedMesh, name: str) -> Floats:
    """A vertex property of the file at the mesh's vertices (n,); of vertices at one place the
    first in the file counts."""
    import numpy as np

    from msal_cli import codecs

    values = codecs.vertex_property(mesh_file, name)
    if ready.vertex_map is None:
        return values
    is_used = ready.vertex_map >= 0
    _, first = np.unique(ready.vertex_map[is_used], return_index=True)
    return values[is_used][first]
