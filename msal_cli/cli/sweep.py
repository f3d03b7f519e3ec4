"""``msal sweep``: one mesh denoised with many values of two parameters, and as msal chooses, as one
picture."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import asdict, replace
from itertools import repeat
from typing import TYPE_CHECKING

import click

from msal_cli.cli import console, options
from msal_cli.cli.command import Request, grouped_command
from msal_cli.cli.options import PATH, QUIET_AND_VERBOSE, STREAM, complete_method, group
from msal_cli.cli.view import make_view_group, read_view
from msal_cli.errors import UsageError
from msal_cli.job.display_names import escape_for_display
from msal_cli.job.settings import ADAPTIVE, AUTO, Settings

if TYPE_CHECKING:
    from msal_cli.auto.risk import Filter
    from msal_cli.codecs.mesh_file import MeshFile
    from msal_cli.mesh import Mesh
    from msal_cli.view.sweep import Cell, Grid, Subject

SCHEMA = "msal.sweep/1"

_CHOICES = {"plain": Settings(ADAPTIVE), "auto": Settings(AUTO)}
"""What msal chooses by itself, by the name that the picture gives it."""


@grouped_command(
    "sweep",
    group(
        "Input and output",
        "-o, --output OUT.png\n    The picture to write.\nmore:\n--format\n",
        output={"required": True},
    ),
    group(
        "What to try",
        """
--method NAME = msal
    How to denoise; `msal methods` lists them.
--rows NAME=VALUE,...
    A parameter and its values from top to bottom. With neither --rows nor --columns:
    iterations=1,2,4,8.
--columns NAME=VALUE,...
    A parameter and its values from left to right. With neither: K=0.25,0.5,0.75,1, if the method
    has it.
--set NAME=VALUE ... -> assignments
    A parameter that is the same in all cells. Repeatable.
--reference TRUTH
    The clean mesh, with the same faces: adds the mean angle between face normals, and marks the
    cell where it is least.
""",
        method={"shell_complete": complete_method},
    ),
    make_view_group(360),
    group("Reports", "--json -> as_json\n    Print the numbers as one JSON document.\n"),
    QUIET_AND_VERBOSE,
    arguments=[click.Argument(["source"], metavar="FILE", type=PATH)],
    examples="""
  msal sweep scan.ply -o grid.png
  msal sweep noisy.ply -o grid.png --rows mollify=0,1,2 --columns K=0.3,0.6 --reference clean.ply
  msal sweep scan.ply -o grid.png --method al --columns iterations=1,2,4,8
""",
)
def command(request: Request) -> int:
    """Denoise FILE with every pair of values of two parameters, by the plain command and by --auto,
    and show all results beside it.

    The result that is nearest to the true surface by the estimated risk is marked. Each cell of the
    picture has its numbers and the words that make it; the commands are printed too. No mesh is
    written.
    """
    from msal_cli import methods
    from msal_cli.auto.risk import estimate_errors
    from msal_cli.cli.report_files import refuse_target
    from msal_cli.job.comparison import open_mesh_file, open_surface, surface_of
    from msal_cli.job.room import room_for_files
    from msal_cli.storage import atomic
    from msal_cli.view import sweep
    from msal_cli.view.panels import png_bytes

    source, output, reference = request.source, request.output, request.reference
    view = read_view(request)
    if os.path.splitext(output)[1].lower() != ".png":
        raise UsageError(f"-o {output}: the picture is called NAME.png", hint="give it that suffix")
    if STREAM in (source, reference):
        raise UsageError("FILE is a file", hint="write the stream to a file first")
    names = [source] if reference is None else [source, reference]
    refuse_target(output, "the picture", names)
    format = options.resolve_format(request.format)
    options.check_threads_variable()
    fixed = _parse_fixed(request.assignments)
    grid = sweep.grid(methods.find(request.method), request.rows, request.columns, fixed)
    done = []
    filters: list[Filter] = []
    # The picture is the result, even if nothing reads the numbers.
    lost: BrokenPipeError | None = None
    with room_for_files(names, format, output, replace(_CHOICES["auto"], format=format)):
        mesh_file = open_mesh_file(source, format)
        truth = None if reference is None else open_surface(reference, format)
        on = sweep.subject(surface_of(mesh_file), source, truth, reference or "", view)
        for cell, mesh, filter in _results(on, grid, mesh_file):
            done.append((cell, sweep.draw_grid(on, mesh, view)))
            filters.append(filter)
            if not request.as_json and not request.quiet and lost is None:
                try:
                    numbers = ", ".join(sweep.describe_numbers(cell))
                    console.put(f"{numbers}: {escape_for_display(cell.command)}\n")
                    console.flush()
                except BrokenPipeError as error:
                    lost = error
        errors = estimate_errors(on.ready.mesh, filters) or repeat(None)
        done = [
            (replace(cell, risk_edges=error), image)
            for (cell, image), error in zip(done, errors, strict=False)
        ]
        atomic.write_whole(output, png_bytes(sweep.sheet(on, grid, done, view)), sources=[source])
    try:
        if lost is not None:
            raise lost
        cells = [cell for cell, _ in done]
        if request.as_json:
            _print_json(source, reference, grid, cells)
        elif not request.quiet:
            console.put(_describe_nearest(cells))
    finally:
        if not request.quiet:
            console.say_written(output)
    return console.SUCCESS


def _results(on: Subject, grid: Grid, mesh_file: MeshFile) -> Iterator[tuple[Cell, Mesh, Filter]]:
    """Each result with what made it: the cells of the grid, then the choices."""
    from msal_cli import methods
    from msal_cli.auto import NONE
    from msal_cli.job.pipeline import FileRun
    from msal_cli.view import sweep

    for cell, mesh in sweep.cells(on, grid):
        yield cell, mesh, (grid.method, grid.method.validate({**grid.fixed, **cell.parameters}))
    for choice, settings in _CHOICES.items():
        run = FileRun(on.name, settings)
        cell, mesh = sweep.choice_cell(on, choice, run.move_vertices(mesh_file))
        used = run.finish(None).method
        assert used is not None
        method = None if used.name == NONE else methods.find(used.name)
        cell = replace(cell, parameters=dict(used.parameters))
        yield cell, mesh, (method, used.parameters)


def _parse_fixed(assignments: tuple[str, ...]) -> dict[str, str]:
    """Names and values of ``--set``; UsageError for one that is there twice."""
    values: dict[str, str] = {}
    for text in assignments:
        option, name, value = options.parse_assignment(text)
        if name in values:
            raise UsageError(f"{option}: {name} is set twice", hint="give it once")
        values[name] = value
    return values


def _describe_nearest(cells: list[Cell]) -> str:
    from msal_cli.view.sweep import find_nearest

    nearest = find_nearest(cells)
    if nearest is None:
        return "no risk is estimated: the mesh has no noise to speak of\n"
    risks = {cell.choice: cell.risk_edges for cell in cells}
    return (
        f"nearest by estimated risk, {nearest.risk_edges:.2g} e (plain command "
        f"{risks['plain']:.2g} e, --auto {risks['auto']:.2g} e): "
        f"{escape_for_display(nearest.command)}\n"
    )


def _print_json(source: str, reference: str | None, grid: Grid, cells: list[Cell]) -> None:
    from msal_cli.view.sweep import find_nearest

    nearest = find_nearest(cells)
    console.put_json(
        SCHEMA,
        input=source,
        reference=reference,
        method=grid.method.name,
        fixed=dict(grid.fixed),
        nearest=None if nearest is None else nearest.command,
        cells=[asdict(cell) for cell in cells if not cell.choice],
        choices=[asdict(cell) for cell in cells if cell.choice],
    )
