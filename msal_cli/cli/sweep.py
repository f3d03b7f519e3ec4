"""``msal sweep``: one picture of a mesh denoised with many values of two parameters, and as msal
chooses."""

from __future__ import annotations

import os
from dataclasses import replace
from itertools import chain, repeat
from typing import TYPE_CHECKING

import click

from msal_cli.cli import console, options
from msal_cli.cli.command import Request, grouped_command
from msal_cli.cli.options import PATH, QUIET_AND_VERBOSE, complete_method, group
from msal_cli.cli.view import make_view_group, read_view
from msal_cli.errors import UsageError
from msal_cli.job.display_names import escape_for_display
from msal_cli.job.settings import AUTO, Settings

if TYPE_CHECKING:
    from msal_cli.view.sweep import Cell

SCHEMA = "msal.sweep/1"


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
    from msal_cli.cli.report_files import refuse_target, require_files
    from msal_cli.job.comparison import open_mesh_file, surface_of
    from msal_cli.job.output import write_output
    from msal_cli.job.room import room_for_files
    from msal_cli.view import pictures, sweep
    from msal_cli.view.panels import png_bytes

    source, output, reference = request.source, request.output, request.reference
    view = read_view(request)
    if os.path.splitext(output)[1].lower() != ".png":
        raise UsageError(f"-o {output}: the picture is called NAME.png", hint="give it that suffix")
    names = [source] if reference is None else [source, reference]
    require_files(names)
    refuse_target(output, "the picture", names)
    format = options.resolve_format(request.format)
    options.check_threads_variable()
    fixed: dict[str, str] = {}
    for text in request.assignments:
        option, name, value = options.parse_assignment(text)
        if name in fixed:
            raise UsageError(f"{option}: {name} is set twice", hint="give it once")
        fixed[name] = value
    grid = sweep.grid(methods.find(request.method), request.rows, request.columns, fixed)
    done = []
    filters = []
    with room_for_files(names, format, output, Settings(AUTO, format=format)):
        mesh_file = open_mesh_file(source, format)
        truth = None if reference is None else surface_of(open_mesh_file(reference, format))
        on = sweep.subject(surface_of(mesh_file), source, truth, reference or "", view)
        for cell, mesh, filter in chain(sweep.cells(on, grid), sweep.choice_cells(on, mesh_file)):
            done.append((cell, pictures.panel(mesh, on.camera, view)))
            filters.append(filter)
            if not request.as_json and not request.quiet:
                numbers = ", ".join(sweep.describe_numbers(cell))
                console.put(f"{numbers}: {escape_for_display(cell.command)}\n")
                console.flush()
        errors = estimate_errors(on.ready.mesh, filters) or repeat(None)
        done = [
            (replace(cell, risk_edges=error), image)
            for (cell, image), error in zip(done, errors, strict=False)
        ]
        write_output(output, png_bytes(sweep.sheet(on, grid, done, view)), sources=[source])
    cells = [cell for cell, _ in done]
    nearest = sweep.find_nearest(cells, sweep.RISK)
    closest = sweep.find_nearest(cells, sweep.ANGLE)
    if request.as_json:
        console.put_json(
            SCHEMA,
            input=source,
            reference=reference,
            method=grid.method.name,
            fixed=fixed,
            nearest=nearest and nearest.command,
            nearest_to_reference=closest and closest.command,
            cells=[cell for cell in cells if not cell.choice],
            choices=[cell for cell in cells if cell.choice],
        )
    elif not request.quiet:
        if nearest is None:
            console.put("no risk is estimated: the mesh has no noise to speak of\n")
        console.put(
            _describe_nearest(nearest, cells, "by estimated risk", "risk_edges", ".2g", " e")
        )
        figure = ("to the reference", "mean_angular_error_deg", ".2f", "\N{DEGREE SIGN}")
        console.put(_describe_nearest(closest, cells, *figure))
    if not request.quiet:
        console.say_written(output)
    return console.SUCCESS


def _describe_nearest(
    nearest: Cell | None, cells: list[Cell], words: str, figure: str, form: str, unit: str
) -> str:
    if nearest is None:
        return ""
    plain, auto, least = (
        f"{getattr(cell, figure):{form}}{unit}"
        for cell in (*(cell for cell in cells if cell.choice), nearest)
    )
    return (
        f"nearest {words}, {least} (plain command {plain}, --auto {auto}): "
        f"{escape_for_display(nearest.command)}\n"
    )
