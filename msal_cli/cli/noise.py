"""``msal noise``: add a known amount of noise to meshes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from msal_cli.cli import exit_codes, talk, words
from msal_cli.cli.file_options import file_options
from msal_cli.cli.pipe import STREAM
from msal_cli.errors import MsalError, UsageError

if TYPE_CHECKING:
    from msal_cli.corruption import Corrupted, Noise

_PATH = click.Path(readable=False, allow_dash=True)
# Those of noise.KINDS, whose module takes numpy to import; a test holds them together.
_KINDS = ("gaussian-normal", "gaussian", "mixed", "impulsive")


@dataclass(frozen=True)
class Request:
    """The command line of ``msal noise``, as click has read it."""

    inputs: tuple[str, ...]
    output: str | None
    kind: str
    level: float
    seed: int
    fraction: float
    include: tuple[str, ...]
    exclude: tuple[str, ...]
    format: str | None
    force: bool
    quiet: bool
    verbose: int


def _share(least: float, most: float, unit: str) -> Any:
    """A callback for a number from ``least`` to ``most``, which ``unit`` may follow."""

    def number(context: click.Context, parameter: click.Parameter, value: str) -> float:
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
    default="gaussian-normal",
    show_default=True,
    help="Gaussian along the vertex normals; Gaussian in each coordinate; mixed: along the normals "
    "and as much across them; impulsive: along the normals at a fraction of the vertices.",
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
    default="0.1",
    show_default=True,
    callback=_share(0.0, 1.0, ""),
    help="Share of the vertices that impulsive noise moves.",
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
    from msal_cli.files import urls

    request = Request(**urls.settled_in(options, "inputs", "output"))
    with logs.configured(request.verbose, None):
        return _run(request)


def _run(request: Request) -> int:
    from msal_cli import files
    from msal_cli.batch import inputs, plan, signals
    from msal_cli.cli import pipe
    from msal_cli.corruption import Noise, corrupt_file

    format = words.settled_format(request.format, files.readable_suffixes, "--format")
    noise = Noise(request.kind, request.level, request.seed, request.fraction)
    one = pipe.pipe(request.inputs, request.output)
    if one is not None:
        return _piped(request, one, noise, format)
    if request.output is None:
        raise UsageError("there is no output", hint="name a file or a folder with -o")
    found = inputs.found(request.inputs, request.include, request.exclude, output=request.output)
    tasks = plan.built(found, request.output, force=request.force).tasks
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
        _tell(request, task.output, told)
    return exit_codes.of_files(len(tasks), n_failed)


def _piped(request: Request, one: Any, noise: Noise, format: str | None) -> int:
    from msal_cli import corruption, files
    from msal_cli.cli.standard_input import read_stream

    if request.include or request.exclude:
        raise UsageError("--include and --exclude are for files, not for standard input or output")
    data = read_stream() if one.source == STREAM else files.read_input(one.source, format)
    output, told = corruption.corrupted(data, one.source, one.target, noise, format)
    if one.target == STREAM:
        talk.put_bytes(output)
    else:
        files.write_whole(one.target, [output])
    _tell(request, one.target, told)
    return exit_codes.SUCCESS


def _tell(request: Request, name: str, told: Corrupted) -> None:
    from msal_cli.report.as_text import file_name
    from msal_cli.report.names import shown

    if request.quiet:
        return
    amount = f"{request.level:g} mean edge lengths ({told.deviation:.4g})"
    talk.say(
        f"{file_name(name)}: {request.kind} noise of {amount}, "
        f"{told.moved_vertices:,} of {told.vertices:,} vertices moved, seed {request.seed}"
    )
    for warning in told.warnings:
        talk.say(f"warning: {shown(warning)}")
