"""Scan one mesh file by simulation, or mesh one volume file: the work of ``msal scan``."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from msal_cli.errors import InternalError, UnsupportedError, UsageError
from msal_cli.job.output import MadeFile

if TYPE_CHECKING:
    from msal_cli.analysis.simulation import ScannerSettings
    from msal_cli.analysis.simulation.volume_files import VolumeSettings
    from msal_cli.arrays import Floats, Ints
    from msal_cli.storage.buffers import Buffer

VOLUME_SUFFIXES = (".npy", ".raw")


def is_volume_name(name: str) -> bool:
    """Whether a file's name is that of a volume."""
    return name.lower().endswith(VOLUME_SUFFIXES)


def is_volume_content(data: Buffer) -> bool:
    """Whether bytes begin as those of a volume that says its own size."""
    from msal_cli.analysis.simulation.volume_files import MAGIC

    return bytes(memoryview(data)[: len(MAGIC)]) == MAGIC


def output_format(target: str, to: str | None) -> str:
    """The format of the output, PLY for a stream; UsageError for one that cannot be written."""
    from msal_cli import codecs
    from msal_cli.codecs import detection

    wanted = to or ("ply" if target == "-" else detection.format_of_name(target))
    if wanted not in codecs.writable_formats():
        raise UsageError(
            f"a new mesh cannot be written as {wanted or target!r}",
            hint="choose with --to, or the output's suffix: "
            f"{', '.join(codecs.writable_formats())}",
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
) -> MadeFile:
    """What a simulated scanner makes of the mesh file ``name``, as a file of the format ``to``; and
    its true places as one of the format ``truth_to``, if that is given."""
    from msal_cli.analysis.simulation import find_truth, simulate_scan
    from msal_cli.codecs.detection import format_of_name
    from msal_cli.job.opened_mesh import open_mesh, prepare_mesh

    try:
        mesh_file, _ = open_mesh(data, name, format)
    except UnsupportedError as error:
        if error.code == "E_UNSUPPORTED" and format is None and not format_of_name(name):
            error.hint = (
                "a volume is a .npy file, or a raw one with --dims X,Y,Z; for a mesh, "
                "give its format with --format"
            )
        raise
    ready = prepare_mesh(mesh_file)
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
    return MadeFile(
        output=output,
        truth=truth,
        description=f"{settings.scanner}, cells of {scan.cell:.4g}, seed {settings.seed}: "
        f"{len(scan.vertices):,} vertices, {len(scan.faces):,} faces",
        warnings=warnings + losses,
    )


def mesh_volume_file(data: Buffer, settings: VolumeSettings, to: str) -> MadeFile:
    """The surface in a volume file, as a file of the format ``to``."""
    from msal_cli.analysis.simulation.volume_files import mesh_volume

    vertices, faces, iso = mesh_volume(memoryview(data), settings)
    output, losses = _encode(vertices, faces, to)
    return MadeFile(
        output=output,
        description=f"the surface at the value {iso:g}: "
        f"{len(vertices):,} vertices, {len(faces):,} faces",
        warnings=losses,
    )


def compress_by_name(made: MadeFile, output: str, truth: str | None) -> MadeFile:
    """``made`` with those files compressed by gzip whose names say so."""
    from msal_cli.storage.gzip_streams import compress

    if output.lower().endswith(".gz"):
        made = replace(made, output=compress(made.output))
    if made.truth is not None and truth is not None and truth.lower().endswith(".gz"):
        made = replace(made, truth=compress(made.truth))
    return made


def _encode(vertices: Floats, faces: Ints, to: str) -> tuple[Buffer, tuple[str, ...]]:
    """A new file, and what its format cannot hold, as warnings."""
    import numpy as np

    from msal_cli import codecs

    if not np.isfinite(vertices).all():
        raise InternalError("the scan made a position that is not finite")
    output = codecs.encode_mesh(vertices, faces, to)
    reopened = codecs.open_mesh(output, f"scan.{to}")
    if len(reopened.faces) != len(faces):
        raise InternalError(f"the new {to} file has {len(reopened.faces)} faces of {len(faces)}")
    if reopened.precision != "float32":
        return output, ()
    return output, tuple(f"lost in {to}: {loss}" for loss in codecs.digits_lost(vertices))
