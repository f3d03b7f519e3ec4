"""``msal noise``: add a known amount of noise to meshes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from msal_cli.cli import console as talk
from msal_cli.cli import exit_codes
from msal_cli.cli import option_types as words
from msal_cli.cli.file_options import file_options
from msal_cli.cli.stream_denoise import STREAM
from msal_cli.errors import MsalError, UsageError

if TYPE_CHECKING:
    from msal_cli.analysis.added_noise import AddedNoise
    from msal_cli.job.noise_file import Corrupted

_PATH = click.Path(readable=False, allow_dash=True)
# Those of noise.KINDS, whose module takes numpy to import; a test holds them together.
_KINDS = (
    "gaussian-normal",
    "gaussian",
    "mixed",
    "impulsive",
    "correlated",
    "view",
    "quantised",
    "grazing",
    "half",
    "ramp",
    "property",
    "outliers",
)
# Settings that only some kinds use; noise.OPTIONS says which.
_SETTINGS = ("fraction", "rings", "direction", "step", "border", "property")


@dataclass(frozen=True)
class Request:
    """The command line of ``msal noise``, as click has read it."""

    inputs: tuple[str, ...]
    output: str | None
    kind: str
    level: float
    seed: int
    fraction: float | None
    rings: int | None
    direction: tuple[float, float, float] | None
    step: float | None
    border: float | None
    property: str | None
    include: tuple[str, ...]
    exclude: tuple[str, ...]
    format: str | None
    force: bool
    quiet: bool
    verbose: int


def _share(least: float, most: float, unit: str) -> Any:
    """A callback for a number from ``least`` to ``most``, which ``unit`` may follow."""

    def number(
        context: click.Context, parameter: click.Parameter, value: str | None
    ) -> float | None:
        if value is None:
            return None
        try:
            share = float(value.removesuffix(unit) if unit else value)
        except ValueError:
            share = math.nan
        if not least <= share <= most:
            raise click.BadParameter(f"{value!r} is not a number from {least:g} to {most:g}")
        return share

    return number


@click.command(
    "noise",
    short_help="Add known noise to meshes.",
    epilog="""\b
Examples:
  msal noise clean.ply -o noisy.ply --kind gaussian-normal --level 0.2 --seed 7
  msal noise clean -o noisy --kind impulsive --fraction 0.05
  msal noise clean.ply -o scan.ply --kind view --direction -z --rings 1
\b
Exit status: see msal --help.""",
)
@click.argument("inputs", metavar="INPUT...", nargs=-1, required=True, type=_PATH)
@click.option(
    "-o",
    "--output",
    metavar="OUT",
    type=_PATH,
    help="A file for one input, or a folder, which gets a mirrored tree. - is standard output, the "
    "default when INPUT is -.",
)
@click.option(
    "--kind",
    type=click.Choice(_KINDS),
    metavar="KIND",
    default="gaussian-normal",
    show_default=True,
    help="gaussian-normal: along the vertex normals; gaussian: in each coordinate; mixed: along "
    "the normals and as much across them; impulsive: at a fraction of the vertices; correlated: "
    "shared by neighbours; view: along --direction; quantised: along --direction, with depths in "
    "steps; grazing: along --direction, stronger at grazing angles; half: on one half of the mesh; "
    "ramp: growing from one end of the mesh to the other; property: in proportion to a vertex "
    "property; outliers: a fraction of the vertices far off the surface.",
)
@click.option(
    "--level",
    metavar="NUMBER",
    default="0.2",
    show_default=True,
    callback=_share(0.0, 1000.0, "e"),
    help="Standard deviation in mean edge lengths.",
)
@click.option(
    "--seed",
    metavar="N",
    default="0",
    show_default=True,
    callback=words.count_from(0),
    help="The same number gives the same noise, for each file.",
)
@click.option(
    "--fraction",
    metavar="NUMBER",
    callback=_share(0.0, 1.0, ""),
    help="Share of the vertices that impulsive noise or outliers move.  [default: 0.1]",
)
@click.option(
    "--rings",
    metavar="N",
    callback=words.count_from(0),
    help="How often noise is averaged over one-rings, so that neighbours share it; the level "
    "stays.  [default: 2 for correlated, else 0]",
)
@click.option(
    "--direction",
    metavar="X,Y,Z",
    callback=words.direction,
    help="Direction of the view; for half and ramp, where there is more noise. Three numbers, or "
    "an axis such as -y.  [default: z]",
)
@click.option(
    "--step",
    metavar="NUMBER",
    callback=_share(1e-9, 1000.0, "e"),
    help="Step of quantised depths in mean edge lengths.  [default: 0.5]",
)
@click.option(
    "--border",
    metavar="NUMBER",
    callback=_share(0.0, 1.0, ""),
    help="With --kind half: width over which the noise begins, as a share of the mesh's extent. "
    " [default: 0, sharp]",
)
@click.option(
    "--property",
    metavar="NAME",
    help="With --kind property: vertex property of a PLY file that multiplies the noise.",
)
@file_options("The inputs' format, where neither their name nor their content tells.")
@click.option("--force", is_flag=True, help="Replace files in the output folder.")
@click.option("-q", "--quiet", is_flag=True, help="Tell only errors.")
@click.option(
    "-v", "--verbose", count=True, help="Tell more of what goes on; -vv tells everything."
)
def command(**options: Any) -> int:
    """Add a known amount of noise to meshes, and keep everything else in their files.

    INPUT is a file, a folder, a pattern, or - for standard input. Vertices at one place stay
    together, so seams do not open. The files keep their format.
    """
    from msal_cli.cli import logs
    from msal_cli.storage import urls

    request = Request(**urls.settled_in(options, "inputs", "output"))
    with logs.configured(request.verbose, None):
        return _run(request)


def _run(request: Request) -> int:
    from msal_cli import codecs as files
    from msal_cli.batch import inputs, plan
    from msal_cli.batch import interrupts as signals
    from msal_cli.cli import stream_denoise as pipe
    from msal_cli.job.noise_file import corrupt_file

    format = words.settled_format(request.format, files.readable_suffixes, "--format")
    noise = _build_noise(request)
    one = pipe.pipe(request.inputs, request.output)
    if one is not None:
        return _piped(request, one, noise, format)
    if request.output is None:
        raise UsageError("there is no output", hint="name a file or a folder with -o")
    found = inputs.discover_inputs(
        request.inputs, request.include, request.exclude, output=request.output
    )
    tasks = plan.build_plan(found, request.output, force=request.force).tasks
    n_failed = 0
    for task in tasks:
        try:
            # A signal must not leave a temporary file.
            with signals.noticed(signals.raise_for):
                told = corrupt_file(task.input, task.output, noise, format)
        except MsalError as error:
            n_failed += 1
            talk.say_error(error)
            continue
        _tell(request, task.output, noise, told)
    return exit_codes.of_files(len(tasks), n_failed)


def _build_noise(request: Request) -> AddedNoise:
    """What the command line describes; UsageError for a setting that the kind does not use."""
    from msal_cli.analysis.added_noise import OPTIONS, AddedNoise

    given = {name: value for name in _SETTINGS if (value := getattr(request, name)) is not None}
    for name in given:
        if name not in OPTIONS[request.kind]:
            users = ", ".join(kind for kind, used in OPTIONS.items() if name in used)
            raise UsageError(
                f"--{name} means nothing for {request.kind} noise",
                hint=f"leave it out; it is for --kind {users}",
            )
    if request.kind == "property" and not request.property:
        raise UsageError(
            "--kind property needs --property NAME", hint="msal info lists a file's properties"
        )
    return AddedNoise(request.kind, request.level, request.seed, **given)


def _piped(request: Request, one: Any, noise: AddedNoise, format: str | None) -> int:
    from msal_cli import codecs as files
    from msal_cli.batch import interrupts as signals
    from msal_cli.cli.standard_input import read_stream
    from msal_cli.job import noise_file as corruption
    from msal_cli.job.output import make_folder_of

    if request.include or request.exclude:
        raise UsageError("--include and --exclude are for files, not for standard input or output")
    data = read_stream() if one.source == STREAM else files.read_input(one.source, format)
    output, told = corruption.corrupted(data, one.source, one.target, noise, format)
    if one.target == STREAM:
        talk.put_bytes(output)
    else:
        make_folder_of(one.target)
        with signals.noticed(signals.raise_for):
            files.write_whole(one.target, [output])
    _tell(request, one.target, noise, told)
    return exit_codes.SUCCESS


def _tell(request: Request, name: str, noise: AddedNoise, told: Corrupted) -> None:
    from msal_cli.job.display_names import shown
    from msal_cli.report.text import file_name

    if request.quiet:
        return
    amount = f"{request.level:g} mean edge lengths ({told.deviation:.4g})"
    settings = noise.describe()
    talk.say(
        f"{file_name(name)}: {request.kind} noise of {amount}, "
        f"{shown(settings) + ', ' if settings else ''}"
        f"{told.moved_vertices:,} of {told.vertices:,} vertices moved, seed {request.seed}"
    )
    for warning in told.warnings:
        talk.say(f"warning: {file_name(name)}: {shown(warning)}")
