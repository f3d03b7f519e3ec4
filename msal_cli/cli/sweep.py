"""``msal sweep``: one mesh denoised with many values of two parameters, as one picture."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from msal_cli.cli import console as talk
from msal_cli.cli import exit_codes
from msal_cli.cli import option_types as words
from msal_cli.cli.stream_denoise import STREAM
from msal_cli.cli.view import view_of, view_options
from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from msal_cli.view.parameter_grid import Cell, Grid

_PATH = click.Path(readable=False, allow_dash=True)

SCHEMA = "msal.sweep/1"


@dataclass(frozen=True)
class Request:
    """The command line of ``msal sweep``, as click has read it."""

    source: str
    output: str
    method: str
    rows: str | None
    columns: str | None
    assignments: tuple[str, ...]
    reference: str | None
    view: str
    turn: float | None
    tilt: float | None
    up: str
    size: int
    shading: str
    dark: bool
    format: str | None
    as_json: bool
    quiet: bool
    verbose: int


@click.command(
    "sweep",
    short_help="Try many values of two parameters on one mesh.",
    epilog="""\b
Examples:
  msal sweep scan.ply -o grid.png
  msal sweep noisy.ply -o grid.png --rows mollify=0,1,2 --columns K=0.3,0.6 --reference clean.ply
  msal sweep scan.ply -o grid.png --method al --columns iterations=1,2,4,8
\b
Exit status: see msal --help.""",
)
@click.argument("source", metavar="FILE", type=_PATH)
@click.option(
    "-o", "--output", metavar="OUT.png", required=True, type=_PATH, help="The picture to write."
)
@click.option(
    "--method",
    metavar="NAME",
    default="msal",
    show_default=True,
    shell_complete=words.completed_method,
    help="How to denoise; `msal methods` lists them.",
)
@click.option(
    "--rows",
    metavar="NAME=VALUE,...",
    help="A parameter and its values from top to bottom. With neither --rows nor --columns: "
    "iterations=1,2,4,8.",
)
@click.option(
    "--columns",
    metavar="NAME=VALUE,...",
    help="A parameter and its values from left to right. With neither: K=0.25,0.5,0.75,1, if the "
    "method has it.",
)
@click.option(
    "--set",
    "assignments",
    metavar="NAME=VALUE",
    multiple=True,
    help="A parameter that is the same in all cells. Repeatable.",
)
@click.option(
    "--reference",
    metavar="TRUTH",
    type=_PATH,
    help="The clean mesh, with the same faces: adds the mean angle between face normals, and marks "
    "the cell where it is least.",
)
@view_options(360)
@click.option(
    "--format",
    "format",
    metavar="FORMAT",
    help="The files' format, where neither their names nor their content tells.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the numbers as one JSON document.")
@click.option("-q", "--quiet", is_flag=True, help="Tell only errors.")
@click.option(
    "-v", "--verbose", count=True, help="Tell more of what goes on; -vv tells everything."
)
def command(**options: Any) -> int:
    """Denoise FILE with every pair of values of two parameters, and show all results beside it.

    Each cell of the picture has its numbers and the words that make it; the commands are printed
    too. No mesh is written.
    """
    from msal_cli.cli import logs
    from msal_cli.storage import urls

    request = Request(**urls.settled_in(options, "source", "output", "reference"))
    with logs.configured(request.verbose, None):
        return _swept(request)


def _swept(request: Request) -> int:
    from msal_cli import codecs as files
    from msal_cli import methods
    from msal_cli.job import comparison
    from msal_cli.view import parameter_grid
    from msal_cli.view.image_files import png_bytes

    if os.path.splitext(request.output)[1].lower() != ".png":
        raise UsageError(
            f"-o {request.output}: the picture is called NAME.png", hint="give it that suffix"
        )
    if STREAM in (request.source, request.reference):
        raise UsageError("FILE is a file", hint="write the stream to a file first")
    format = words.settled_format(request.format, files.readable_suffixes, "--format")
    words.check_threads_variable()
    method = methods.find(request.method)
    fixed = _fixed(request.assignments)
    wanted = parameter_grid.grid(method, request.rows, request.columns, fixed)
    surface = comparison.surface_of(comparison.opened(request.source, format))
    truth = None
    if request.reference is not None:
        truth = comparison.surface_of(comparison.opened(request.reference, format))
    view = view_of(request)
    on = parameter_grid.subject(surface, request.source, truth, request.reference or "", view)
    done = []
    # The picture is what was asked for, even if nothing reads the numbers.
    with talk.work_goes_on():
        for cell, mesh in parameter_grid.cells(on, wanted):
            done.append((cell, parameter_grid.drawn(on, mesh, view)))
            if not request.as_json and not request.quiet:
                talk.put(_told(cell))
                talk.flush()
        picture = parameter_grid.sheet(on, wanted, done, view)
        files.write_whole(request.output, png_bytes(picture))
        if request.as_json:
            _print_json(request, wanted, [cell for cell, _ in done])
        if not request.quiet:
            from msal_cli.job.display_names import shown

            talk.say(f"wrote {shown(request.output)}", "good")
    return exit_codes.SUCCESS


def _fixed(assignments: tuple[str, ...]) -> dict[str, str]:
    """Names and values of ``--set``; UsageError for one that is there twice."""
    from msal_cli.cli.method_parameters import assignment

    values: dict[str, str] = {}
    for text in assignments:
        said, name, value = assignment(text)
        if name in values:
            raise UsageError(f"{said}: {name} is set twice", hint="give it once")
        values[name] = value
    return values


def _told(cell: Cell) -> str:
    from msal_cli.job.display_names import shown

    numbers = [f"moved {cell.mean_displacement_edges:.4g} e"]
    if cell.volume_change_percent is not None:
        numbers.append(f"volume {cell.volume_change_percent:+.3g} %")
    if cell.mean_angular_error_deg is not None:
        numbers.append(f"normals {cell.mean_angular_error_deg:.3f} degrees off")
    return f"{', '.join(numbers)}: {shown(cell.command)}\n"


def _print_json(request: Request, wanted: Grid, cells: list[Cell]) -> None:
    from msal_cli import __version__
    from msal_cli.report import document
    from msal_cli.report import json_report as as_json

    data = {
        "schema": SCHEMA,
        "version": __version__,
        "input": request.source,
        "reference": request.reference,
        "method": wanted.method.name,
        "fixed": dict(wanted.fixed),
        "cells": [
            {
                "parameters": cell.parameters,
                "command": cell.command,
                "mean_displacement": cell.mean_displacement,
                "mean_displacement_edges": cell.mean_displacement_edges,
                "volume_change_percent": cell.volume_change_percent,
                "mean_angular_error_deg": cell.mean_angular_error_deg,
            }
            for cell in cells
        ],
    }
    talk.put_bytes(as_json.json_bytes(document.plain(data)))
