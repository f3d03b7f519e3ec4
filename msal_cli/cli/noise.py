"""``msal noise``: add a known amount of noise to meshes."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import click

from msal_cli.cli import options
from msal_cli.cli.command import MESSAGES, MORE, group
from msal_cli.cli.command import command as grouped_command
from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from msal_cli.analysis.added_noise import AddedNoise
    from msal_cli.cli.make_files import Target
    from msal_cli.job.output import MadeFile
    from msal_cli.storage.buffers import Buffer

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
    from msal_cli.batch import plan
    from msal_cli.cli.make_files import Target, find_inputs, make_files, refuse_existing
    from msal_cli.codecs import header_check
    from msal_cli.job.noise_file import add_noise_to_file

    format = options.resolve_format(format)
    noise = _build_noise(**settings)
    found = find_inputs(inputs, include, exclude, output)
    if found is None:
        targets = [Target(inputs[0], output or options.STREAM)]
    else:
        tasks = plan.build_plan(found, output, force=force).tasks
        targets = [Target(task.input, task.output) for task in tasks]
    refuse_existing(targets, force=force)

    def make(data: Buffer, target: Target) -> MadeFile:
        return add_noise_to_file(data, target.source, target.output, noise, format)

    return make_files(targets, partial(header_check.read_input, format=format), make, quiet=quiet)


def _build_noise(kind: str, level: float, seed: int, **settings: Any) -> AddedNoise:
    """The noise; UsageError for a setting that the kind does not use."""
    from msal_cli.analysis.added_noise import OPTIONS, AddedNoise

    given = {name: value for name, value in settings.items() if value is not None}
    for name in given:
        if name not in OPTIONS[kind]:
            users = ", ".join(kind for kind, used in OPTIONS.items() if name in used)
            raise UsageError(
                f"--{name} means nothing for {kind} noise",
                hint=f"leave it out; it is for --kind {users}",
            )
    if kind == "property" and not given.get("property"):
        raise UsageError(
            "--kind property needs --property NAME", hint="msal info lists a file's properties"
        )
    return AddedNoise(kind, level, seed, **given)
