"""``msal scan``: meshes as scanners make them, from clean meshes or from volumes."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import click

from msal_cli.cli import options
from msal_cli.cli.command import MESSAGES, MORE, group
from msal_cli.cli.command import command as grouped_command
from msal_cli.cli.conflicts import find_given, refuse_conflicts
from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from msal_cli.analysis.simulation import ScannerSettings
    from msal_cli.analysis.simulation.volume_files import VolumeSettings
    from msal_cli.cli.make_files import Target
    from msal_cli.job.output import MadeFile
    from msal_cli.storage.buffers import Buffer

# Those of simulation.SCANNERS and volume_files.TYPES, whose modules import numpy; a test
# compares them.
_SCANNERS = ("voxels", "ct", "slices", "depth", "fusion")
_TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float32", "float64")


@grouped_command(
    "scan",
    epilog="""\b
Examples:
  msal scan part.stl -o scan.ply --scanner ct --level 0.1 --truth truth.ply
  msal scan part.stl -o scan.ply --scanner depth --direction -y --resolution 200
  msal scan parts -o scans --scanner voxels --to ply
  msal scan volume.npy -o mesh.ply --iso 300 --spacing 0.5,0.5,1.5
\b
Exit status: see msal --help.""",
)
@options.INPUTS
@group(
    "Input and output",
    click.option(
        "-o",
        "--output",
        metavar="OUT",
        type=options.PATH,
        help="A file for one input, or a folder, which gets a mirrored tree. - is standard output.",
    ),
    click.option(
        "--truth",
        metavar="OUT2",
        type=options.PATH,
        help="Write the scan a second time, with its vertices in their true places: to a file, "
        "or a folder.",
    ),
    MORE,
    click.option(
        "--to",
        metavar="FORMAT",
        help="Format of the output.  [default: by OUT's suffix, or as INPUT]",
    ),
    options.FORCE,
    options.FORMAT,
)
@group(
    "Scanner",
    click.option(
        "--scanner",
        type=click.Choice(_SCANNERS),
        help="What kind of scanner; voxels: binary occupancy; ct: grey values with noise; slices: "
        "binary, several voxels apart; depth: one depth camera; fusion: several, fused.  "
        "[default: voxels]",
    ),
    click.option(
        "--resolution",
        metavar="N",
        type=options.parse_resolution,
        help="Voxels or pixels along the longest side (96), or their edge in mean edge lengths "
        "(0.8e).  [default: 96]",
    ),
    click.option(
        "--direction",
        metavar="X,Y,Z",
        type=options.parse_direction,
        help="Direction from the object to the camera, across the slices, or of the third axis of "
        "the grid. Three numbers, or an axis such as -y.  [default: z]",
    ),
    click.option(
        "--seed",
        metavar="N",
        type=click.IntRange(min=0),
        help="The same number gives the same noise and the same place of the grid.  [default: 0]",
    ),
    click.option(
        "--level",
        metavar="NUMBER",
        type=options.number(),
        help="Standard deviation of the noise; of ct, a share of the contrast between object and "
        "air; of cameras, pixels of depth before their smoothing.  [default: ct 0.1; cameras 1]",
    ),
    MORE,
    click.option(
        "--correlation",
        metavar="NUMBER",
        type=options.number(),
        help="Over how many cells neighbours share noise; the level stays.  [default: 0, white]",
    ),
    click.option(
        "--smoothing",
        metavar="NUMBER",
        type=options.number(),
        help="Over how many cells the scanner itself averages: more removes noise, and detail. "
        " [default: ct 0.5; cameras 1]",
    ),
    click.option(
        "--step",
        metavar="NUMBER",
        type=options.number(),
        help="Step of a camera's depths in pixels, 0 for none.  [default: 0.3]",
    ),
    click.option(
        "--slices",
        metavar="N",
        type=click.IntRange(min=1),
        help="Voxels from slice to slice.  [default: 3]",
    ),
    click.option(
        "--views",
        metavar="N",
        type=click.IntRange(min=1),
        help="Cameras of fusion.  [default: 14]",
    ),
    click.option(
        "--misalignment",
        metavar="NUMBER",
        type=options.number(),
        help="Standard deviation of the positions of fusion's cameras from the true ones, in "
        "pixels.  [default: 0.1]",
    ),
)
@group(
    "Volumes",
    click.option(
        "--iso",
        metavar="NUMBER",
        type=options.number(),
        help="For a volume: value at the surface; greater values are inside.  [default: half-way "
        "between the least and the greatest]",
    ),
    click.option(
        "--spacing",
        metavar="X,Y,Z",
        type=options.parse_lengths,
        help="For a volume: size of a voxel along each axis.  [default: 1,1,1]",
    ),
    MORE,
    click.option(
        "--dims",
        metavar="X,Y,Z",
        type=options.parse_counts,
        help="For a raw volume: number of voxels along each axis.",
    ),
    click.option(
        "--type",
        type=click.Choice(_TYPES),
        help="For a raw volume: type of its numbers, little-endian.  [default: uint8]",
    ),
)
@group(
    "Many files",
    options.FILES,
)
@group(
    MESSAGES,
    options.QUIET,
    options.verbose,
)
@click.pass_context
def command(
    context: click.Context,
    /,
    inputs: tuple[str, ...],
    output: str | None,
    truth: str | None,
    to: str | None,
    include: tuple[str, ...],
    exclude: tuple[str, ...],
    format: str | None,
    force: bool,
    quiet: bool,
    **settings: Any,
) -> int:
    """Simulate a scanner: make the mesh that it would make of a clean one, with a known truth.

    INPUT is a clean mesh, a folder or a pattern of them, or - for standard input. It may also be
    a volume: a .npy array with the axes z, y, x, or raw numbers with --dims. A folder is searched
    for meshes only; several volumes are named, or given as a pattern such as 'volumes/*.npy'.
    All scanners but depth, and volumes, need scikit-image (msal-cli[simulation]).
    """
    from msal_cli import codecs
    from msal_cli.batch import plan
    from msal_cli.cli.make_files import Target, find_inputs, make_files, refuse_existing
    from msal_cli.cli.streams import Stream, choose_format
    from msal_cli.codecs import header_check
    from msal_cli.job import scan_file
    from msal_cli.storage import gzip_streams

    refuse_conflicts(find_given(context))
    format = options.resolve_format(format)
    to = options.resolve_format(to, codecs.writable_formats, "--to")
    if truth == options.STREAM:
        raise UsageError(
            "--truth needs a file or a folder, and - is standard output",
            hint="name a file, such as --truth truth.ply",
        )
    found = find_inputs(inputs, include, exclude, output)
    if found is None:
        targets = [Target(inputs[0], output or options.STREAM, truth)]
    else:
        outputs = [task.output for task in plan.build_plan(found, output, to=to, force=force).tasks]
        truths: list[str] | list[None] = [None] * len(found)
        if truth is not None:
            truths = [
                task.output for task in plan.build_plan(found, truth, to=to, force=force).tasks
            ]
        sources = [one.path for one in found]
        targets = [Target(*paths) for paths in zip(sources, outputs, truths, strict=True)]
    _refuse_shared_names(targets)

    def is_volume(name: str) -> bool:
        return settings["dims"] is not None or scan_file.is_volume_name(name)

    def find_formats(target: Target) -> list[str | None]:
        """Those of the output and of the file of true positions."""
        return [
            path and scan_file.output_format(path, choose_format(Stream(target.source, path), to))
            for path in (target.output, target.truth)
        ]

    known = None
    if found is None:
        # Before the stream is read.
        find_formats(targets[0])
    else:
        are_volumes = [is_volume(target.source) for target in targets]
        known = _build_settings(are_volumes, truth, **settings)

    def read(name: str) -> Buffer:
        # What shows that a file is no mesh means nothing for a volume.
        return (
            gzip_streams.read_whole(name)
            if is_volume(name)
            else header_check.read_input(name, format)
        )

    def make(data: Buffer, target: Target) -> MadeFile:
        source = target.source
        as_volume = is_volume(source) or (
            source == options.STREAM and scan_file.is_volume_content(data)
        )
        scanner, volume = known or _build_settings([as_volume], truth, **settings)
        output_format, truth_format = find_formats(target)
        made = (
            scan_file.mesh_volume_file(data, volume, str(output_format))
            if as_volume
            else scan_file.scan_mesh(
                data, source, scanner, str(output_format), truth_to=truth_format, format=format
            )
        )
        return scan_file.compress_by_name(made, target.output, target.truth)

    refuse_existing(targets, force=force)
    return make_files(targets, read, make, quiet=quiet)


def _refuse_shared_names(targets: list[Target]) -> None:
    """Refuse true positions in the place of an input or of an output; UsageError."""
    from msal_cli.storage.urls import is_url

    def identify(path: str) -> str:
        return path if is_url(path) else os.path.realpath(path)

    others = {identify(path) for one in targets for path in (one.source, one.output)}
    if any(one.truth is not None and identify(one.truth) in others for one in targets):
        raise UsageError(
            "--truth needs a file of its own, neither an input nor an output",
            hint="give it another name or folder",
        )


def _build_settings(
    are_volumes: list[bool],
    truth: str | None,
    *,
    scanner: str | None,
    resolution: tuple[int | None, float | None] | None,
    iso: float | None,
    spacing: tuple[float, float, float] | None,
    dims: tuple[int, int, int] | None,
    type: str | None,
    **settings: Any,
) -> tuple[ScannerSettings, VolumeSettings]:
    """The scanner and the way volumes are meshed; UsageError for an option that no input uses."""
    from msal_cli.analysis.simulation import OPTIONS, ScannerSettings
    from msal_cli.analysis.simulation.volume_files import VolumeSettings

    of_volumes = {"iso": iso, "spacing": spacing, "dims": dims, "type": type}
    of_meshes = {"scanner": scanner, "resolution": resolution, **settings, "truth": truth}
    for name, value in of_meshes.items():
        if value is not None and all(are_volumes):
            raise UsageError(f"--{name} is for meshes that are scanned, and not for a volume")
    for name, value in of_volumes.items():
        if value is not None and not any(are_volumes):
            raise UsageError(
                f"--{name} is for volumes, and not for meshes that are scanned",
                hint="a volume is a .npy file, or a raw one with --dims X,Y,Z",
            )
    given = {name: value for name, value in settings.items() if value is not None}
    scanner = scanner or _SCANNERS[0]
    for name in given.keys() - {"direction", "seed"} - set(OPTIONS[scanner]):
        users = ", ".join(one for one, used in OPTIONS.items() if name in used)
        raise UsageError(
            f"--{name} means nothing for --scanner {scanner}",
            hint=f"leave it out; it is for --scanner {users}",
        )
    cells, cell_edges = resolution or (None, None)
    if cells is not None:
        given["cells"] = cells
    volume = VolumeSettings(
        iso=iso, spacing=spacing or (1.0, 1.0, 1.0), counts=dims, number_type=type or _TYPES[0]
    )
    return ScannerSettings(scanner, cell_edges=cell_edges, **given), volume
