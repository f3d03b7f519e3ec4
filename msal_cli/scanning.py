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

    from msal_cli.files.base import Buffer
    from msal_cli.simulation import ScannerSettings
    from msal_cli.simulation.volume_files import VolumeSettings

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


def output_format(target: str, to: str | None) -> str:
    """The format of the output, PLY for a stream; UsageError for one that cannot be written."""
    from msal_cli import files

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
    with_truth: bool = False,
    format: str | None = None,
) -> Scanned:
    """What a simulated scanner makes of the mesh file ``name``, as a file of the format ``to``."""
    from msal_cli import files
    from msal_cli.mesh import prepared
    from msal_cli.simulation import find_truth, simulate_scan

    plain, _ = files.expanded(data, name)
    mesh_file = files.open_mesh(plain, name, format)
    ready = prepared(
        mesh_file.vertices, mesh_file.faces, are_distinct=mesh_file.merged_vertices > 0
    )
    scan = simulate_scan(ready.mesh, settings)
    warnings = mesh_file.warnings
    if n := scan.closed_holes:
        warnings += (f"the mesh is open: {n} hole{'s' * (n > 1)} closed to tell its inside",)
    return Scanned(
        output=_encode(scan.vertices + ready.origin, scan.faces, to),
        truth=_encode(find_truth(ready.mesh, scan) + ready.origin, scan.faces, to)
        if with_truth
        else None,
        n_vertices=len(scan.vertices),
        n_faces=len(scan.faces),
        description=f"{settings.scanner}, cells of {scan.cell:.4g}, seed {settings.seed}",
        warnings=warnings,
    )


def scan_volume_file(data: Buffer, settings: VolumeSettings, to: str) -> Scanned:
    """The surface in a volume file, as a file of the format ``to``."""
    from msal_cli.simulation.volume_files import mesh_volume

    vertices, faces, iso = mesh_volume(memoryview(data), settings)
    return Scanned(
        output=_encode(vertices, faces, to),
        truth=None,
        n_vertices=len(vertices),
        n_faces=len(faces),
        description=f"the surface at the value {iso:g}",
    )


def _encode(vertices: Floats, faces: Ints, to: str) -> Buffer:
    import numpy as np

    from msal_cli import files

    if not np.isfinite(vertices).all():
        raise InternalError("the scan made a position that is not finite")
    output = files.encode_mesh(vertices, faces, to)
    reopened = files.open_mesh(output, f"scan.{to}")
    if len(reopened.faces) != len(faces):
        raise InternalError(f"the new {to} file has {len(reopened.faces)} faces of {len(faces)}")
    return output
