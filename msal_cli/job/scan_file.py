"""One mesh scanned by simulation, or one volume made a mesh, from file to file: the bracket behind
``msal scan``.  The output is checked, and appears whole or not at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from msal_cli.errors import InternalError, UsageError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from msal_cli.analysis.simulation import ScannerSettings
    from msal_cli.analysis.simulation.volume_files import VolumeSettings
    from msal_cli.storage.buffers import Buffer

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int32]

VOLUME_SUFFIXES = (".npy", ".raw")


@dataclass(frozen=True)
class Scanned:
    """What was made: the file, the one with the true positions (or None), how many vertices and
    faces both have, and in words what they were made with and what is to be known of them."""

    output: Buffer
    truth: Buffer | None
    n_vertices: int
    n_faces: int
    description: str
    warnings: tuple[str, ...] = ()


def is_volume_name(name: str) -> bool:
    """Whether a file's name is that of a volume."""
    return name.lower().endswith(VOLUME_SUFFIXES)


def is_volume_content(data: Buffer) -> bool:
    """Whether bytes begin as those of a volume that says its own size."""
    from msal_cli.analysis.simulation.volume_files import MAGIC

    return bytes(memoryview(data)[: len(MAGIC)]) == MAGIC


def output_format(target: str, to: str | None) -> str:
    """The format of the output, PLY for a stream; UsageError for one that cannot be written."""
    from msal_cli import codecs as files

    wanted = to or ("ply" if target == "-" else files.format_of_name(target))
    if wanted not in files.writable_formats():
        raise UsageError(
            f"a new mesh cannot be written as {wanted or target!r}",
            hint=f"choose with --to, or the output's suffix: {', '.join(files.writable_formats())}",
        )
    return wanted


def scan_mesh(
    data: Buffer,
    name: str,
    settings: ScannerSettings,
    to: str,
    *,
    truth_to: str | None = None,
    format: str | None = None,
) -> Scanned:
    """What a simulated scanner makes of the mesh file ``name``, as a file of the format ``to``; and
    its true places as one of the format ``truth_to``, if that is given."""
    from msal_cli import codecs as files
    from msal_cli.analysis.simulation import find_truth, simulate_scan
    from msal_cli.mesh import prepare_mesh

    plain, _ = files.expanded(data, name)
    mesh_file = files.open_mesh(plain, name, format)
    ready = prepare_mesh(
        mesh_file.vertices, mesh_file.faces, are_distinct=mesh_file.merged_vertices > 0
    )
    scan = simulate_scan(ready.mesh, settings)
    warnings = mesh_file.warnings
    if n := scan.closed_holes:
        warnings += (
            f"the mesh is open: {n} hole{'s' * (n > 1)} closed, since a volume needs an inside",
        )
    output, losses = _encode(scan.vertices + ready.origin, scan.faces, to)
    truth = None
    if truth_to is not None:
        places = find_truth(ready.mesh, scan) + ready.origin
        truth, truth_losses = _encode(places, scan.faces, truth_to)
        losses += tuple(one for one in truth_losses if one not in losses)
    return Scanned(
        output=output,
        truth=truth,
        n_vertices=len(scan.vertices),
        n_faces=len(scan.faces),
        description=f"{settings.scanner}, cells of {scan.cell:.4g}, seed {settings.seed}",
        warnings=warnings + losses,
    )


def scan_volume_file(data: Buffer, settings: VolumeSettings, to: str) -> Scanned:
    """The surface in a volume file, as a file of the format ``to``."""
    from msal_cli.analysis.simulation.volume_files import mesh_volume

    vertices, faces, iso = mesh_volume(memoryview(data), settings)
    output, losses = _encode(vertices, faces, to)
    return Scanned(
        output=output,
        truth=None,
        n_vertices=len(vertices),
        n_faces=len(faces),
        description=f"the surface at the value {iso:g}",
        warnings=losses,
    )


def _encode(vertices: Floats, faces: Ints, to: str) -> tuple[Buffer, tuple[str, ...]]:
    """A new file, and what its format cannot hold, as warnings."""
    import numpy as np

    from msal_cli import codecs as files

    if not np.isfinite(vertices).all():
        raise InternalError("the scan made a position that is not finite")
    output = files.encode_mesh(vertices, faces, to)
    reopened = files.open_mesh(output, f"scan.{to}")
    if len(reopened.faces) != len(faces):
        raise InternalError(f"the new {to} file has {len(reopened.faces)} faces of {len(faces)}")
    if reopened.precision != "float32":
        return output, ()
    return output, tuple(f"lost in {to}: {loss}" for loss in files.digits_lost(vertices))
