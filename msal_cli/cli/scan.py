"""``msal scan``: meshes as scanners make them, from clean meshes or from volumes."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from msal_cli.cli import console as talk
from msal_cli.cli import exit_codes, scan_values
from msal_cli.cli import option_types as words
from msal_cli.cli.file_options import file_options
from msal_cli.cli.stream_denoise import STREAM
from msal_cli.errors import MsalError, ResourceError, UnsupportedError, UsageError

if TYPE_CHECKING:
    from msal_cli.analysis.simulation import ScannerSettings
    from msal_cli.analysis.simulation.volume_files import VolumeSettings
    from msal_cli.cli.stream_denoise import Pipe
    from msal_cli.job.scan_file import Scanned
    from msal_cli.storage.buffers import Buffer

_PATH = click.Path(readable=False, allow_dash=True)
# Those of simulation.SCANNERS and volume_files.TYPES, whose modules take numpy to import; a test
# holds them together.
_SCANNERS = ("voxels", "ct", "slices", "depth", "fusion")
_TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float32", "float64")
_MESH_OPTIONS = ("scanner", "resolution", "direction", "seed")
# Settings that only some scanners use; simulation.OPTIONS says which.
_SETTINGS = ("level", "correlation", "smoothing", "step", "slices", "views", "misalignment")
_VOLUME_OPTIONS = ("iso", "spacing", "dims", "type")


@dataclass(frozen=True)
class Request:
    """The command line of ``msal scan``, as click has read it; None for what is not given."""

    inputs: tuple[str, ...]
    output: str | None
    truth: str | None
    to: str | None
    scanner: str | None
    resolution: tuple[int | None, float | None] | None
    direction: tuple[float, float, float] | None
    seed: int | None
    level: float | None
    correlation: float | None
    smoothing: float | None
    step: float | None
    slices: int | None
    views: int | None
    misalignment: float | None
    iso: float | None
    spacing: tuple[float, float, float] | None
    dims: tuple[int, int, int] | None
    type: str | None
    include: tuple[str, ...]
    exclude: tuple[str, ...]
    format: str | None
    force: bool
    quiet: bool
    verbose: int


@click.command(
    "scan",
    short_help="Scan meshes by simulation, or mesh a volume.",
    epilog="""\b
Examples:
  msal scan part.stl -o scan.ply --scanner ct --level 0.1 --truth truth.ply
  msal scan part.stl -o scan.ply --scanner depth --direction -y --resolution 200
  msal scan parts -o scans --scanner voxels --to ply
  msal scan volume.npy -o mesh.ply --iso 300 --spacing 0.5,0.5,1.5
\b
Exit status: see msal --help.""",
)
@click.argument("inputs", metavar="INPUT...", nargs=-1, required=True, type=_PATH)
@click.option(
    "-o",
    "--output",
    metavar="OUT",
    type=_PATH,
    help="A file for one input, or a folder, which gets a mirrored tree. - is standard output.",
)
@click.option(
    "--truth",
    metavar="OUT2",
    type=_PATH,
    help="Write the scan a second time, with its vertices in their true places: to a file, "
    "or a folder.",
)
@click.option(
    "--to", metavar="FORMAT", help="Format of the output.  [default: by OUT's suffix, or as INPUT]"
)
@click.option(
    "--scanner",
    type=click.Choice(_SCANNERS),
    help="voxels: binary occupancy; ct: grey values with noise; slices: binary, several voxels "
    "apart; depth: one depth camera; fusion: several, fused.  [default: voxels]",
)
@click.option(
    "--resolution",
    metavar="N",
    callback=scan_values.parse_resolution,
    help="Voxels or pixels along the longest side (96), or their edge in mean edge lengths (0.8e). "
    " [default: 96]",
)
@click.option(
    "--direction",
    metavar="X,Y,Z",
    callback=words.direction,
    help="Direction from the object to the camera, across the slices, or of the third axis of the "
    "grid. Three numbers, or an axis such as -y.  [default: z]",
)
@click.option(
    "--seed",
    metavar="N",
    callback=words.count_from(0),
    help="The same number gives the same noise and the same place of the grid.  [default: 0]",
)
@click.option(
    "--level",
    metavar="NUMBER",
    callback=scan_values.parse_number,
    help="Standard deviation of the noise: of ct, a share of the contrast between object and air; "
    "of cameras, pixels of depth before their smoothing.  [default: ct 0.1; cameras 1]",
)
@click.option(
    "--correlation",
    metavar="NUMBER",
    callback=scan_values.parse_number,
    help="Over how many cells neighbours share noise; the level stays.  [default: 0, white]",
)
@click.option(
    "--smoothing",
    metavar="NUMBER",
    callback=scan_values.parse_number,
    help="Over how many cells the scanner itself averages: more removes noise, and detail. "
    " [default: ct 0.5; cameras 1]",
)
@click.option(
    "--step",
    metavar="NUMBER",
    callback=scan_values.parse_number,
    help="Step of a camera's depths in pixels, 0 for none.  [default: 0.3]",
)
@click.option(
    "--slices",
    metavar="N",
    callback=words.count_from(1),
    help="Voxels from slice to slice.  [default: 3]",
)
@click.option(
    "--views",
    metavar="N",
    callback=words.count_from(1),
    help="Cameras of fusion.  [default: 14]",
)
@click.option(
    "--misalignment",
    metavar="NUMBER",
    callback=scan_values.parse_number,
    help="Standard deviation of the positions of fusion's cameras from the true ones, in pixels. "
    " [default: 0.1]",
)
@click.option(
    "--iso",
    metavar="NUMBER",
    callback=scan_values.parse_number,
    help="For a volume: value at the surface; greater values are inside.  [default: half-way "
    "between the least and the greatest]",
)
@click.option(
    "--spacing",
    metavar="X,Y,Z",
    callback=scan_values.parse_lengths,
    help="For a volume: size of a voxel along each axis.  [default: 1,1,1]",
)
@click.option(
    "--dims",
    metavar="X,Y,Z",
    callback=scan_values.parse_counts,
    help="For a raw volume: number of voxels along each axis.",
)
@click.option(
    "--type",
    type=click.Choice(_TYPES),
    help="For a raw volume: type of its numbers, little-endian.  [default: uint8]",
)
@file_options("The meshes' format, where neither their name nor their content tells.")
@click.option("--force", is_flag=True, help="Replace files in the output folder.")
@click.option("-q", "--quiet", is_flag=True, help="Tell only errors.")
@click.option(
    "-v", "--verbose", count=True, help="Tell more of what goes on; -vv tells everything."
)
def command(**options: Any) -> int:
    """Simulate a scanner: make the mesh that it would make of a clean one, with a known truth.

    INPUT is a clean mesh, a folder or a pattern of them, or - for standard input. It may also be
    a volume: a .npy array with the axes z, y, x, or raw numbers with --dims. A folder is searched
    for meshes only; several volumes are named, or given as a pattern such as 'volumes/*.npy'.
    All scanners but depth, and volumes, need scikit-image (msal-cli[simulation]).
    """
    from msal_cli.cli import logs
    from msal_cli.storage import urls

    request = Request(**urls.settled_in(options, "inputs", "output", "truth"))
    with logs.configured(request.verbose, None):
        return _run(request)


def _run(request: Request) -> int:
    from msal_cli import codecs as files
    from msal_cli.batch import inputs, plan
    from msal_cli.batch import interrupts as signals
    from msal_cli.cli import stream_denoise as pipe

    format = words.settled_format(request.format, files.readable_suffixes, "--format")
    to = words.settled_format(request.to, files.writable_formats, "--to")
    one = pipe.pipe(request.inputs, request.output)
    if one is not None:
        return _piped(request, one, to, format)
    if request.output is None:
        raise UsageError("there is no output", hint="name a file or a folder with -o")
    _refuse_stream_as_truth(request)
    found = inputs.discover_inputs(
        request.inputs, request.include, request.exclude, output=request.output
    )
    tasks = plan.build_plan(found, request.output, to=to, force=request.force).tasks
    truths: tuple[str | None, ...] = (None,) * len(tasks)
    if request.truth is not None:
        truth_plan = plan.build_plan(found, request.truth, to=to, force=request.force)
        truths = tuple(task.output for task in truth_plan.tasks)
        outputs = {_place(task.output) for task in tasks}
        if not outputs.isdisjoint(_place(task.output) for task in truth_plan.tasks):
            raise UsageError(
                "--truth and -o name the same file", hint="give the truth another name or folder"
            )
    settings = _build_settings(request, [_is_volume(request, task.input) for task in tasks])
    n_failed = 0
    for task, truth in zip(tasks, truths, strict=True):
        try:
            # A signal must not leave a temporary file.
            with signals.noticed(signals.raise_for):
                made = _scan_file(request, task.input, task.output, truth, to, settings, format)
        except MsalError as error:
            n_failed += 1
            talk.say_error(error)
            continue
        _tell(request, task.output, made)
    return exit_codes.of_files(len(tasks), n_failed)


def _refuse_stream_as_truth(request: Request) -> None:
    if request.truth == STREAM:
        raise UsageError(
            "--truth needs a file or a folder, and - is standard output",
            hint="name a file, such as --truth truth.ply",
        )


def _place(path: str) -> str:
    """One name for all names of a file."""
    from msal_cli.codecs import is_url

    return path if is_url(path) else os.path.realpath(path)


def _piped(request: Request, one: Pipe, to: str | None, format: str | None) -> int:
    from msal_cli import codecs as files
    from msal_cli.batch import interrupts as signals
    from msal_cli.cli import stream_denoise as pipe
    from msal_cli.cli.standard_input import read_stream
    from msal_cli.job.scan_file import is_volume_content, output_format

    if request.include or request.exclude:
        raise UsageError("--include and --exclude are for files, not for standard input or output")
    _refuse_stream_as_truth(request)
    wanted = output_format(one.target, pipe.target_format(one, to))
    truth_format = None
    if request.truth is not None:
        if _place(request.truth) in (_place(one.source), _place(one.target)):
            raise UsageError(
                "--truth needs a file of its own, neither the input nor the output",
                hint="give it another name",
            )
        truth = pipe.Pipe(one.source, request.truth)
        truth_format = output_format(request.truth, pipe.target_format(truth, to))
    is_volume = _is_volume(request, one.source)
    if one.source == STREAM:
        data = read_stream()
        is_volume = is_volume or is_volume_content(data)
    else:
        data = files.read_whole(one.source) if is_volume else files.read_input(one.source, format)
    settings = _build_settings(request, [is_volume])
    made = _scan(data, one.source, settings, wanted, truth_format, format, is_volume=is_volume)
    with signals.noticed(signals.raise_for):
        if made.truth is not None:
            _write(str(request.truth), made.truth)
        if one.target == STREAM:
            talk.put_bytes(made.output)
        else:
            _write(one.target, made.output)
    _tell(request, one.target, made)
    return exit_codes.SUCCESS


def _scan_file(
    request: Request,
    source: str,
    target: str,
    truth: str | None,
    to: str | None,
    settings: tuple[ScannerSettings, VolumeSettings],
    format: str | None,
) -> Scanned:
    """Read one file, scan it and write what comes of it, or raise what names the file."""
    from msal_cli import codecs as files
    from msal_cli.job.scan_file import output_format

    is_volume = _is_volume(request, source)
    try:
        wanted = output_format(target, to)
        truth_format = None if truth is None else output_format(truth, to)
        # What shows that a file is no mesh says nothing of a volume.
        data = files.read_whole(source) if is_volume else files.read_input(source, format)
        made = _scan(data, source, settings, wanted, truth_format, format, is_volume=is_volume)
        for path, content in ((target, made.output), (truth, made.truth)):
            if path is not None and content is not None:
                _write(path, content)
    except MsalError as error:
        error.path = error.path or source
        raise
    except MemoryError:
        raise ResourceError("not enough memory", code="E_MEMORY", path=source) from None
    return made


def _write(path: str, content: Buffer) -> None:
    from msal_cli import codecs as files
    from msal_cli.job.output import make_folder_of

    make_folder_of(path)
    is_compressed = path.lower().endswith(".gz")
    files.write_whole(path, [files.compressed(content) if is_compressed else content])


def _scan(
    data: Buffer,
    source: str,
    settings: tuple[ScannerSettings, VolumeSettings],
    to: str,
    truth_to: str | None,
    format: str | None,
    *,
    is_volume: bool,
) -> Scanned:
    from msal_cli.codecs import format_of_name
    from msal_cli.job.scan_file import scan_mesh, scan_volume_file

    scanner, volume = settings
    if is_volume:
        return scan_volume_file(data, volume, to)
    try:
        return scan_mesh(data, source, scanner, to, truth_to=truth_to, format=format)
    except UnsupportedError as error:
        if error.code == "E_UNSUPPORTED" and format is None and not format_of_name(source):
            error.hint = (
                "a volume is a .npy file, or a raw one with --dims X,Y,Z; for a mesh, "
                "give its format with --format"
            )
        raise


def _is_volume(request: Request, source: str) -> bool:
    from msal_cli.job.scan_file import is_volume_name

    return request.dims is not None or is_volume_name(source)


def _build_settings(
    request: Request, are_volumes: list[bool]
) -> tuple[ScannerSettings, VolumeSettings]:
    """The scanner and the way volumes are meshed; UsageError for an option that no input uses."""
    from msal_cli.analysis.simulation import OPTIONS, ScannerSettings
    from msal_cli.analysis.simulation.volume_files import VolumeSettings

    scanner = request.scanner or "voxels"
    for name in (*_MESH_OPTIONS, *_SETTINGS, "truth"):
        if getattr(request, name) is not None and all(are_volumes):
            raise UsageError(f"--{name} is for meshes that are scanned, and not for a volume")
    for name in _VOLUME_OPTIONS:
        if getattr(request, name) is not None and not any(are_volumes):
            raise UsageError(
                f"--{name} is for volumes, and not for meshes that are scanned",
                hint="a volume is a .npy file, or a raw one with --dims X,Y,Z",
            )
    given = {name: value for name in _SETTINGS if (value := getattr(request, name)) is not None}
    for name in given:
        if name not in OPTIONS[scanner]:
            users = ", ".join(one for one, used in OPTIONS.items() if name in used)
            raise UsageError(
                f"--{name} means nothing for --scanner {scanner}",
                hint=f"leave it out; it is for --scanner {users}",
            )
    for name in ("direction", "seed"):
        if getattr(request, name) is not None:
            given[name] = getattr(request, name)
    cells, cell_edges = request.resolution or (None, None)
    if cells is not None:
        given["cells"] = cells
    volume = VolumeSettings(
        iso=request.iso,
        spacing=request.spacing or (1.0, 1.0, 1.0),
        counts=request.dims,
        number_type=request.type or "uint8",
    )
    if request.type is not None and request.dims is None:
        raise UsageError("--type is for a raw volume", hint="give its counts, too: --dims X,Y,Z")
    return ScannerSettings(scanner, cell_edges=cell_edges, **given), volume


def _tell(request: Request, name: str, made: Scanned) -> None:
    from msal_cli.job.display_names import shown
    from msal_cli.report.text import file_name

    if request.quiet:
        return
    talk.say(
        f"{file_name(name)}: {made.description}: {made.n_vertices:,} vertices, "
        f"{made.n_faces:,} faces"
    )
    for warning in made.warnings:
        talk.say(f"warning: {file_name(name)}: {shown(warning)}")
