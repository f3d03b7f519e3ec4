"""``msal noise``: add a known amount of noise to meshes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from msal_cli.cli import console, options
from msal_cli.cli.command import MESSAGES, MORE, group
from msal_cli.cli.command import command as grouped_command
from msal_cli.cli.options import STREAM
from msal_cli.errors import MsalError, ResourceError, UsageError

if TYPE_CHECKING:
    from msal_cli.analysis.added_noise import AddedNoise
    from msal_cli.batch.inputs import DiscoveredInput
    from msal_cli.job.output import MadeFile

# Those of added_noise.KINDS, whose module imports numpy; a test compares them.
_KINDS = (
    "gaussian-normal",
    "gaussian",
    "uniform",
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


@grouped_command(
    "noise",
    epilog="""\b
Examples:
  msal noise clean.ply -o noisy.ply --kind gaussian-normal --level 0.2 --seed 7
  msal noise clean -o noisy --kind impulsive --fraction 0.05
  msal noise clean.ply -o scan.ply --kind view --direction -z --rings 1
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
        help="A file for one input, or a folder, which gets a mirrored tree. - is standard "
        "output, the default when INPUT is -.",
    ),
    MORE,
    options.FORCE,
    options.FORMAT,
)
@group(
    "Noise",
    click.option(
        "--kind",
        type=click.Choice(_KINDS),
        metavar="KIND",
        default="gaussian-normal",
        show_default=True,
        help="What kind of noise; gaussian-normal: along the vertex normals; gaussian: in each "
        "coordinate; uniform: in each coordinate, from -level to +level; mixed: along the normals "
        "and as much across them; impulsive: at a fraction of the vertices; correlated: shared by "
        "neighbours; view: along --direction; quantised: along --direction, with depths in steps; "
        "grazing: along --direction, stronger at grazing angles; half: on one half of the mesh; "
        "ramp: growing from one end of the mesh to the other; property: in proportion to a vertex "
        "property; outliers: a fraction of the vertices far off the surface.",
    ),
    click.option(
        "--level",
        metavar="NUMBER",
        default="0.2",
        show_default=True,
        type=options.number(0.0, 1000.0, "e"),
        help="Standard deviation in mean edge lengths; of uniform noise, the largest move of a "
        "coordinate.",
    ),
    click.option(
        "--seed",
        metavar="N",
        default=0,
        show_default=True,
        type=click.IntRange(min=0),
        help="The same number gives the same noise, for each file.",
    ),
    MORE,
    click.option(
        "--fraction",
        metavar="NUMBER",
        type=options.number(0.0, 1.0),
        help="Share of the vertices that impulsive noise or outliers move.  [default: 0.1]",
    ),
    click.option(
        "--rings",
        metavar="N",
        type=click.IntRange(min=0),
        help="How often noise is averaged over one-rings, so that neighbours share it; the level "
        "stays.  [default: 2 for correlated, else 0]",
    ),
    click.option(
        "--direction",
        metavar="X,Y,Z",
        type=options.parse_direction,
        help="Direction of the view; for half and ramp, where there is more noise. Three numbers, "
        "or an axis such as -y.  [default: z]",
    ),
    click.option(
        "--step",
        metavar="NUMBER",
        type=options.number(1e-9, 1000.0, "e"),
        help="Step of quantised depths in mean edge lengths.  [default: 0.5]",
    ),
    click.option(
        "--border",
        metavar="NUMBER",
        type=options.number(0.0, 1.0),
        help="With --kind half: width over which the noise begins, as a share of the mesh's "
        "extent.  [default: 0, sharp]",
    ),
    click.option(
        "--property",
        metavar="NAME",
        help="With --kind property: vertex property of a PLY file that multiplies the noise.",
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
def command(
    inputs: tuple[str, ...],
    output: str | None,
    include: tuple[str, ...],
    exclude: tuple[str, ...],
    format: str | None,
    force: bool,
    quiet: bool,
    **settings: Any,
) -> int:
    """Add a known amount of noise to meshes, and keep everything else in their files.

    INPUT is a file, a folder, a pattern, or - for standard input. Vertices at one place stay
    together, so seams do not open. The files keep their format.
    """
    import os

    from msal_cli.batch import interrupts, plan
    from msal_cli.cli.report_files import refuse_target
    from msal_cli.job.display_names import escape_for_display
    from msal_cli.report.facts import file_name

    format = options.resolve_format(format)
    noise = _build_noise(**settings)
    found = _find_inputs(inputs, include, exclude, output)
    if found is None:
        targets = [(inputs[0], output or STREAM)]
    else:
        tasks = plan.build_plan(found, output, force=force).tasks
        targets = [(task.input, task.output) for task in tasks]
    for _, path in targets:
        if path == STREAM:
            continue
        refuse_target(path, "the output", replaces="")
        if not force and os.path.lexists(path):
            raise UsageError(
                f"the output {path!r} is there already",
                hint="give it another name, or --force to replace it",
            )
    n_failed = 0
    for source, path in targets:
        try:
            # A signal must not leave a temporary file.
            with interrupts.catch_signals(interrupts.raise_for):
                made = _make_noisy_file(source, path, noise, format)
        except MsalError as error:
            if STREAM in (source, path):
                raise
            n_failed += 1
            error.path = error.path or source
            console.say_error(error)
            continue
        if not quiet:
            name = file_name(path)
            console.say(f"{name}: {escape_for_display(made.description)}")
            for warning in made.warnings:
                console.say(f"warning: {name}: {escape_for_display(warning)}")
    return console.status_of_files(len(targets), n_failed)


def _find_inputs(
    inputs: tuple[str, ...], include: tuple[str, ...], exclude: tuple[str, ...], output: str | None
) -> tuple[DiscoveredInput, ...] | None:
    """The files to work on; None if one mesh comes or goes through a standard stream."""
    from msal_cli.batch.inputs import discover_inputs
    from msal_cli.cli.streams import find_stream

    if STREAM not in (*inputs, output):
        if output is None:
            raise UsageError("there is no output", hint="name a file or a folder with -o")
        return discover_inputs(inputs, include, exclude, output=output)
    find_stream(inputs, output)
    if include or exclude:
        raise UsageError("--include and --exclude are for files, not for standard input or output")
    return None


def _make_noisy_file(source: str, path: str, noise: AddedNoise, format: str | None) -> MadeFile:
    """Write one output, whole or not at all."""
    from msal_cli.cli.streams import read_stream
    from msal_cli.codecs import header
    from msal_cli.codecs.companions import list_sources
    from msal_cli.job.output import add_noise_to_file, write_output

    try:
        data = read_stream() if source == STREAM else header.read_input(source, format)
        made = add_noise_to_file(data, source, path, noise, format)
        if path == STREAM:
            console.put_bytes(made.output)
        else:
            sources = (0,) if source == STREAM else list_sources(source, data)
            write_output(path, made.output, made.companions, sources)
    except MemoryError:
        raise ResourceError("not enough memory", code="E_MEMORY") from None
    return made


def _build_noise(kind: str, level: float, seed: int, **settings: Any) -> AddedNoise:
    """The noise; UsageError for a setting that the kind does not use."""
    from msal_cli.analysis.added_noise import AddedNoise, refuse_unused

    given = {name: value for name, value in settings.items() if value is not None}
    refuse_unused(kind, given, "--")
    if kind == "property" and not given.get("property"):
        raise UsageError(
            "--kind property needs --property NAME", hint="msal info lists a file's properties"
        )
    return AddedNoise(kind, level, seed, **given)
