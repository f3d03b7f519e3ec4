"""``msal noise``: add a known amount of noise to meshes."""

from __future__ import annotations

from typing import TYPE_CHECKING, get_args

import click

from msal_cli.batch import interrupts
from msal_cli.cli import console
from msal_cli.cli.command import Request, grouped_command
from msal_cli.cli.options import INPUTS, QUIET_AND_VERBOSE, STREAM, group, number, resolve_format
from msal_cli.errors import MsalError, ResourceError, UsageError
from msal_cli.job.display_names import escape_for_display
from msal_cli.job.settings import NoiseKind

if TYPE_CHECKING:
    from collections.abc import Sequence

    from msal_cli.analysis.added_noise import AddedNoise
    from msal_cli.job.settings import Task


@grouped_command(
    "noise",
    group(
        "Input and output",
        """
-o, --output OUT
    A file for one input, or a folder, which gets a mirrored tree. - is standard output, the
    default when INPUT is -.
more:
--force
--format
""",
    ),
    group(
        "Noise",
        """
--kind KIND = gaussian-normal
    What kind of noise; gaussian-normal: along the vertex normals; gaussian: in each coordinate;
    uniform: in each coordinate, from -level to +level; mixed: along the normals and as much across
    them; impulsive: at a fraction of the vertices; correlated: shared by neighbours; view: along
    --direction; quantised: along --direction, with depths in steps; grazing: along --direction,
    stronger at grazing angles; half: on one half of the mesh; ramp: growing from one end of the
    mesh to the other; outliers: a fraction of the vertices far off the surface.
--level NUMBER = 0.2
    Standard deviation in mean edge lengths; of uniform noise, the largest move of a coordinate.
--seed N = 0
    The same number gives the same noise, for each file.
more:
--fraction NUMBER
    Share of the vertices that impulsive noise or outliers move. [default: 0.1]
--rings N
    How often noise is averaged over one-rings, so that neighbours share it; the level stays.
    [default: 2 for correlated, else 0]
--direction X,Y,Z
    Direction of the view; for half and ramp, where there is more noise. Three numbers, or an axis
    such as -y. [default: z]
--step NUMBER
    Step of quantised depths in mean edge lengths. [default: 0.5]
--border NUMBER
    With --kind half: width over which the noise begins, as a share of the mesh's extent.
    [default: 0, sharp]
""",
        kind=click.Choice(get_args(NoiseKind)),
        level=number(0.0, 1000.0, "e"),
        seed=click.IntRange(min=0),
        fraction=number(0.0, 1.0),
        rings=click.IntRange(min=0),
        step=number(1e-9, 1000.0, "e"),
        border=number(0.0, 1.0),
    ),
    group("Many files", "--include\n--exclude\n"),
    QUIET_AND_VERBOSE,
    arguments=[INPUTS],
    examples="""
  msal noise clean.ply -o noisy.ply --kind gaussian-normal --level 0.2 --seed 7
  msal noise clean -o noisy --kind impulsive --fraction 0.05
  msal noise clean.ply -o scan.ply --kind view --direction -z --rings 1
""",
)
def command(request: Request) -> int:
    """Add a known amount of noise to meshes, and keep everything else in their files.

    INPUT is a file, a folder, a pattern, or - for standard input. Vertices at one place stay
    together, so seams do not open. The files keep their format.
    """
    import os

    from msal_cli.analysis.added_noise import build_noise
    from msal_cli.cli.report_files import refuse_target
    from msal_cli.report.facts import file_name

    format = resolve_format(request.format)
    names = ("fraction", "rings", "direction", "step", "border")
    given = {name: value for name in names if (value := getattr(request, name)) is not None}
    noise = build_noise(request.kind, request.level, request.seed, given, "--")
    tasks = _find_tasks(request)
    for path in (task.output for task in tasks):
        if path == STREAM:
            continue
        refuse_target(path, "the output", replaces="")
        if not request.force and os.path.lexists(path):
            raise UsageError(
                f"the output {path!r} is there already",
                hint="give it another name, or --force to replace it",
            )
    n_failed = 0
    for task in tasks:
        source, path = task.input, task.output
        try:
            # A signal must not leave a temporary file.
            with interrupts.catch_signals():
                description, warnings = _make_noisy_file(task, noise, format)
        except MsalError as error:
            if STREAM in (source, path):
                raise
            n_failed += 1
            error.path = error.path or source
            console.say_error(error)
            continue
        if not request.quiet:
            name = file_name(path)
            console.say(f"{name}: {escape_for_display(description)}")
            for warning in warnings:
                console.say(f"warning: {name}: {escape_for_display(warning)}")
    return console.status_of_files(len(tasks), n_failed)


def _find_tasks(request: Request) -> Sequence[Task]:
    """Each input with its output; a single pair may have a standard stream."""
    from msal_cli.batch.inputs import discover_inputs
    from msal_cli.batch.plan import build_plan
    from msal_cli.cli.streams import find_stream

    inputs, output = request.inputs, request.output
    patterns = request.include, request.exclude
    if STREAM in (*inputs, output):
        if any(patterns):
            raise UsageError(
                "--include and --exclude are for files, not for standard input or output"
            )
        return [find_stream(inputs, output)]
    if output is None:
        raise UsageError("there is no output", hint="name a file or a folder with -o")
    found = discover_inputs(inputs, *patterns, output=output)
    return build_plan(found, output, force=request.force).tasks


def _make_noisy_file(
    task: Task, noise: AddedNoise, format: str | None
) -> tuple[str, tuple[str, ...]]:
    """Write one output, whole or not at all; returns its description, and warnings."""
    from contextlib import nullcontext

    from msal_cli.cli.streams import read_stream
    from msal_cli.codecs import header
    from msal_cli.job.output import add_noise_to_file, carry_references, write_output
    from msal_cli.job.room import room_for_files

    source, path = task.input, task.output
    is_stream = source == STREAM
    target = None if path == STREAM else path
    try:
        with nullcontext() if is_stream else room_for_files((source,), format, target):
            data = read_stream() if is_stream else header.read_input(source, format)
            made, description, warnings = add_noise_to_file(data, source, path, noise, format)
            if path == STREAM:
                console.put_bytes(made.data)
            else:
                sources = (0,) if is_stream else (source, *made.sources)
                if made.references and not is_stream:
                    warnings += carry_references(made, task)[1]
                write_output(path, made.data, made.companions, sources)
    except MemoryError:
        raise ResourceError("not enough memory", code="E_MEMORY") from None
    return description, warnings
