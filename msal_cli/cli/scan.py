"""``msal scan``: meshes as scanners make them, from clean meshes or from volumes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from msal_cli.cli import exit_codes, talk, words
from msal_cli.cli.file_options import file_options
from msal_cli.cli.pipe import STREAM
from msal_cli.errors import MsalError, ResourceError, UsageError

if TYPE_CHECKING:
    from msal_cli.scanning import Scanned
    from msal_cli.simulation import ScannerSettings
    from msal_cli.simulation.volume_files import VolumeSettings

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


def _number(context: click.Context, parameter: click.Parameter, value: str | None) -> float | None:
    if value is None:
        return None
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise click.BadParameter(f"{value!r} is not a number")
    return number


def _resolution(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> tuple[int | None, float | None] | None:
    """``96`` cells along the longest side, or cells of ``0.8e``, mean edge lengths."""
    if value is None:
        return None
    if value.isascii() and value.isdigit() and len(value) < 6:
        return int(value), None
    try:
        edges = float(value.removesuffix("e")) if value.endswith("e") else math.nan
    except ValueError:
        edges = math.nan
    if not math.isfinite(edges):
        raise click.BadParameter(
            f"{value!r} is neither a number of cells such as 96 nor a cell such as 0.8e"
        )
    return None, edges


def _lengths(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> tuple[float, ...] | None:
    """Three numbers above 0 between commas."""
    if value is None:
        return None
    try:
        numbers = tuple(float(word) for word in value.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != 3 or not all(0.0 < one < math.inf for one in numbers):
        raise click.BadParameter(f"{value!r} is not three numbers above 0 such as 1,1,3")
    return numbers


def _counts(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> tuple[int, ...] | None:
    """Three whole numbers above 0 between commas."""
    if value is None:
        return None
    texts = value.split(",")
    if len(texts) != 3 or not all(
        one.isascii() and one.isdigit() and int(one[:9]) > 0 and len(one) < 10 for one in texts
    ):
        raise click.BadParameter(f"{value!r} is not three whole numbers such as 512,512,100")
    return tuple(map(int, texts))


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
    help="Write the scan with its vertices in their true places, too: a file, or a folder.",
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
    callback=_resolution,
    help="Voxels or pixels along the longest side (96), or their edge in mean edge lengths (0.8e). "
    " [default: 96]",
)
@click.option(
    "--direction",
    metavar="X,Y,Z",
    callback=words.direction,
    help="From the object to the camera; across the slices; third axis of the grid. Or x, -y, z, "
    "...  [default: z]",
)
@click.option(
    "--seed",
    metavar="N",
    callback=words.count_from(0),
    help="Of the noise, and of where the grid lies.  [default: 0]",
)
@click.option(
    "--level",
    metavar="NUMBER",
    callback=_number,
    help="Noise: of ct in the volume, as a share of the contrast; of cameras in pixels, before "
    "their smoothing.  [default: ct 0.1; cameras 1]",
)
@click.option(
    "--correlation",
    metavar="NUMBER",
    callback=_number,
    help="Noise shared over so many cells, at the same level.  [default: 0, white]",
)
@click.option(
    "--smoothing",
    metavar="NUMBER",
    callback=_number,
    help="What the scanner averages itself, in cells.  [default: ct 0.5; cameras 1]",
)
@click.option(
    "--step",
    metavar="NUMBER",
    callback=_number,
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
    callback=_number,
    help="How far off a camera of fusion is, in pixels.  [default: 0.1]",
)
@click.option(
    "--iso",
    metavar="NUMBER",
    callback=_number,
    help="Of a volume: value at the surface, greater is inside.  [default: half-way]",
)
@click.option(
    "--spacing",
    metavar="X,Y,Z",
    callback=_lengths,
    help="Of a volume: size of a voxel.  [default: 1,1,1]",
)
@click.option("--dims", metavar="X,Y,Z", callback=_counts, help="Of a raw volume: how many voxels.")
@click.option(
    "--type",
    type=click.Choice(_TYPES),
    help="Of a raw volume: its numbers, little endian.  [default: uint8]",
)
@file_options("The meshes' format, where neither their name nor their content tells.")
@click.option("--force", is_flag=True, help="Replace files in the output folder.")
@click.option("-q", "--quiet", is_flag=True, help="Tell only errors.")
@click.option(
    "-v", "--verbose", count=True, help="Tell more of what goes on; -vv tells everything."
)
def command(**options: Any) -> int:
    """Make meshes as scanners make them, with their noise and a known truth.

    INPUT is a clean mesh, a folder or a pattern of them, or - for standard input; or a volume: a
    .npy array with the axes z, y, x, or raw numbers with --dims. Needs scikit-image
    (msal-cli[simulation]) for everything but depth.
    """
    from msal_cli.cli import logs
    from msal_cli.files import urls

    request = Request(**urls.settled_in(options, "inputs", "output", "truth"))
    with logs.configured(request.verbose, None):
        return _run(request)


def _run(request: Request) -> int:
    from msal_cli import files
    from msal_cli.batch import inputs, plan, signals
    from msal_cli.cli import pipe

    format = words.settled_format(request.format, files.readable_suffixes, "--format")
    to = words.settled_format(request.to, files.writable_formats, "--to")
    one = pipe.pipe(request.inputs, request.output)
    if one is not None:
        return _piped(request, one, to, format)
    if request.output is None:
        raise UsageError("there is no output", hint="name a file or a folder with -o")
    found = inputs.found(request.inputs, request.include, request.exclude, output=request.output)
    tasks = plan.built(found, request.output, to=to, force=request.force).tasks
    truths: tuple[str | None, ...] = (None,) * len(tasks)
    if request.truth is not None:
        truth_plan = plan.built(found, request.truth, to=to, force=request.force)
        truths = tuple(task.output for task in truth_plan.tasks)
        outputs = {task.output for task in tasks}
        if outputs & set(truths):
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


def _piped(request: Request, one: Any, to: str | None, format: str | None) -> int:
    from msal_cli.cli.standard_input import read_stream
    from msal_cli.scanning import output_format

    if request.include or request.exclude:
        raise UsageError("--include and --exclude are for files, not for standard input or output")
    if request.truth in (STREAM, one.source, one.target):
        raise UsageError("--truth needs a file of its own", hint="give it another name")
    settings = _build_settings(request, [_is_volume(request, one.source)])
    data = read_stream() if one.source == STREAM else _read(request, one.source, format)
    wanted = output_format(one.target, to)
    made = _scan(request, data, one.source, wanted, settings, format)
    if one.target == STREAM:
        talk.put_bytes(made.output)
    else:
        _write(one.target, made.output)
    if made.truth is not None:
        _write(str(request.truth), made.truth)
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
    from msal_cli.output import make_folder_of
    from msal_cli.scanning import output_format

    try:
        wanted = output_format(target, to)
        data = _read(request, source, format)
        made = _scan(request, data, source, wanted, settings, format)
        for path, content in ((target, made.output), (truth, made.truth)):
            if path is not None and content is not None:
                make_folder_of(path)
                _write(path, content)
    except MsalError as error:
        error.path = error.path or source
        raise
    except MemoryError:
        raise ResourceError("not enough memory", code="E_MEMORY", path=source) from None
    return made


def _write(path: str, content: Any) -> None:
    from msal_cli import files

    is_compressed = path.lower().endswith(".gz")
    files.write_whole(path, [files.compressed(content) if is_compressed else content])


def _read(request: Request, source: str, format: str | None) -> Any:
    from msal_cli import files

    # What shows that a file is no mesh says nothing of a volume.
    is_volume = _is_volume(request, source)
    return files.read_whole(source) if is_volume else files.read_input(source, format)


def _scan(
    request: Request,
    data: Any,
    source: str,
    to: str,
    settings: tuple[ScannerSettings, VolumeSettings],
    format: str | None,
) -> Scanned:
    from msal_cli.scanning import scan_mesh, scan_volume_file

    scanner, volume = settings
    if _is_volume(request, source):
        return scan_volume_file(data, volume, to)
    with_truth = request.truth is not None
    return scan_mesh(data, source, scanner, to, with_truth=with_truth, format=format)


def _is_volume(request: Request, source: str) -> bool:
    from msal_cli.scanning import is_volume_name

    return request.dims is not None or is_volume_name(source)


def _build_settings(
    request: Request, are_volumes: list[bool]
) -> tuple[ScannerSettings, VolumeSettings]:
    """The scanner and the way volumes are meshed; UsageError for an option that no input uses."""
    from msal_cli.simulation import OPTIONS, ScannerSettings
    from msal_cli.simulation.volume_files import VolumeSettings

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
    from msal_cli.report.as_text import file_name
    from msal_cli.report.names import shown

    if request.quiet:
        return
    talk.say(
        f"{file_name(name)}: {made.description}: {made.n_vertices:,} vertices, "
        f"{made.n_faces:,} faces"
    )
    for warning in made.warnings:
        talk.say(f"warning: {shown(warning)}")
