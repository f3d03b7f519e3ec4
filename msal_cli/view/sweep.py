"""The numbers and the picture of ``msal sweep``: one mesh denoised with every pair of values of two
parameters, and as msal chooses."""

import itertools
import math
import operator
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from msal_cli.analysis import measures
from msal_cli.codecs.mesh_file import MeshFile, Surface
from msal_cli.errors import ContentError, UsageError
from msal_cli.job.changes import size_fields
from msal_cli.job.pipeline import FileRun
from msal_cli.job.room import prepare_mesh
from msal_cli.job.settings import ADAPTIVE, AUTO, Settings
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh, PreparedMesh
from msal_cli.methods import Method, find, names
from msal_cli.view import pictures
from msal_cli.view.panels import Panel, draw_panels
from msal_cli.view.pictures import View
from msal_cli.view.rendering import WHITE, Camera, Image

MAX_CELLS = 100

USUAL = ("iterations=1,2,4,8", "K=0.25,0.5,0.75,1")
"""The default for rows and columns, as in Fig. 6 of the paper; a parameter that the method does not
have is left out."""

CHOICES = {"plain": (ADAPTIVE, ()), "auto": (AUTO, ("--auto",))}
"""Choices of msal itself: the method, and the options of ``msal denoise`` that select it."""

_SHORT_OPTIONS = {"iterations": "-n", "K": "-K"}

Filter = tuple[Method | None, Mapping[str, Any]]
"""A method with its parameters; None leaves a mesh as it is."""


@dataclass(frozen=True)
class Cell:
    parameters: dict[str, Any]  # those that vary between cells; of a choice all
    command: str  # the command line that makes the mesh; OUT is the file to write
    # mean_displacement, mean_displacement_edges: in file units and in mean edge lengths
    mean_displacement: float
    mean_displacement_edges: float
    volume_change_percent: float | None  # None if the mesh has no volume
    mean_angular_error_deg: float | None  # against the reference; None without one
    choice: str = ""  # of ``CHOICES``; empty for a cell of the grid
    # estimated distance from the true surface, mean edge lengths; None if unknown
    risk_edges: float | None = None


@dataclass(frozen=True, eq=False)
class Grid:
    method: Method  # of ``methods``
    fixed: Mapping[str, object]  # parameters that are the same in all cells
    # the values of varying parameters by name: along rows and columns, or along columns only
    axes: Mapping[str, tuple[Any, ...]]

    def settings(self) -> Iterator[dict[str, Any]]:
        """The varying parameters of each cell, row by row."""
        for values in itertools.product(*self.axes.values()):
            yield dict(zip(self.axes, values, strict=True))


def grid(
    method: Method, rows: str | None, columns: str | None, fixed: Mapping[str, object]
) -> Grid:
    """The grid for the texts of a command line; ``USUAL`` if neither axis is given.

    Raises UsageError for invalid texts, a parameter that is given twice, and too many cells.
    """
    if rows is None and columns is None:
        known = {spec.name for spec in method.parameters}
        rows, columns = (text if text.partition("=")[0] in known else None for text in USUAL)
        if rows is None and columns is None:
            raise UsageError(
                f"{method.name} has neither iterations nor K, which vary by default",
                hint=f"say what does with --columns; see `msal methods {method.name}`",
            )
    axes: dict[str, tuple[Any, ...]] = {}
    taken = {method.spec(name).name for name in fixed}
    for text, option in ((rows, "--rows"), (columns, "--columns")):
        if text is None:
            continue
        name, sign, listed = text.partition("=")
        words = [word.strip() for word in listed.split(",")]
        if not sign or not all(words):
            raise UsageError(
                f"{option} {text}: not of the form NAME=VALUE,VALUE,...",
                hint=f"for example {option} iterations=1,2,4,8",
            )
        spec = method.spec(name.strip())
        if spec.name in taken:
            raise UsageError(f"{spec.name} is set in two places", hint="give it once")
        taken.add(spec.name)
        axes[spec.name] = tuple(spec.validate(word) for word in words)
        if len(set(axes[spec.name])) < len(words):
            hint = "give each value once"
            raise UsageError(f"{option} {text}: a value is there twice", hint=hint)
    if math.prod(map(len, axes.values())) > MAX_CELLS:
        raise UsageError(f"that makes more than {MAX_CELLS} cells", hint="try fewer values")
    wanted = Grid(method, fixed, axes)
    for chosen in wanted.settings():
        method.validate({**fixed, **chosen})
    return wanted


@dataclass(frozen=True, eq=False)
class Subject:
    """The mesh to denoise, the reference in the same place (None without one), and the camera."""

    name: str
    ready: PreparedMesh
    reference: Mesh | None
    camera: Camera
    enclosed: measures.Enclosure


def subject(
    surface: Surface, name: str, reference: Surface | None, reference_name: str, view: View
) -> Subject:
    """Prepare a mesh for denoising and drawing; ContentError for a file without a surface, and for
    a reference with other faces."""
    ready = prepare_mesh(surface, name)
    truth = None
    if reference is not None:
        if not surface.has_same_faces(reference):
            raise ContentError(
                "the reference has not the same vertices and faces",
                path=reference_name,
                hint="give the mesh from which the noisy one was made",
            )
        prepare_mesh(reference, reference_name)
        truth = measures.at_other_positions(ready, reference.vertices)
    camera = pictures.camera_of(pictures.Scene((name,), ready.mesh), view)
    return Subject(name, ready, truth, camera, measures.measure_enclosure(ready))


def cells(on: Subject, wanted: Grid) -> Iterator[tuple[Cell, Mesh, Filter]]:
    """The numbers, the mesh and the filter of each cell, row by row, as they are made."""
    mesh = on.ready.outward()
    for chosen in wanted.settings():
        parameters = wanted.method.validate({**wanted.fixed, **chosen})
        moved = on.ready.mesh.with_vertices(wanted.method.denoise(mesh, parameters).vertices)
        words = [] if wanted.method.name == "msal" else ["--method", wanted.method.name]
        for name, value in (*wanted.fixed.items(), *chosen.items()):
            short = _SHORT_OPTIONS.get(wanted.method.spec(name).name)
            words += [short, _plain(value)] if short else ["--set", f"{name}={_plain(value)}"]
        yield _measure(on, moved, chosen, words), moved, (wanted.method, parameters)


def choice_cells(on: Subject, mesh_file: MeshFile) -> Iterator[tuple[Cell, Mesh, Filter]]:
    """As ``cells``, for each of ``CHOICES`` and the mesh in an open file."""
    for choice, (name, words) in CHOICES.items():
        run = FileRun(on.name, Settings(name))
        moved = measures.at_other_positions(on.ready, run.move_vertices(mesh_file))
        used = run.finish(None).method
        assert used is not None
        cell = replace(_measure(on, moved, used.parameters, words), choice=choice)
        yield cell, moved, (find(used.name) if used.name in names() else None, used.parameters)


def _measure(
    on: Subject, moved: Mesh, parameters: Mapping[str, Any], options: Sequence[str]
) -> Cell:
    mesh = on.ready.mesh
    source = on.name if not on.name.startswith("-") else f"./{on.name}"
    change = on.enclosed.change(mesh, moved, measures.measure_surface_change(mesh, moved))
    mean = measures.displacement(mesh, moved).mean
    sizes = size_fields(change.areas, change.volumes, on.ready.defects.volume_objection)
    error = None
    if on.reference is not None:
        error = measures.measure_surface_change(on.reference, moved).mean_angular_error_deg
    return Cell(
        parameters=dict(parameters),
        command=shlex.join(("msal", "denoise", source, "-o", "OUT", *options)),
        mean_displacement=mean,
        mean_displacement_edges=mean / mesh.mean_edge_length,
        volume_change_percent=sizes["volume"].change_percent,
        mean_angular_error_deg=error,
    )


RISK, ANGLE = "risk_edges", "mean_angular_error_deg"
"""Figures that say how near a result is to the true surface: estimated, or by a reference."""


def find_nearest(cells: Sequence[Cell], figure: str) -> Cell | None:
    """The cell whose ``figure`` (``RISK`` or ``ANGLE``) is the least; None if no cell has it."""
    rated = [cell for cell in cells if getattr(cell, figure) is not None]
    return min(rated, key=operator.attrgetter(figure), default=None)


def sheet(on: Subject, wanted: Grid, done: Sequence[tuple[Cell, Image]], view: View) -> Image:
    """(H, W, 3) uint8: on the left the input, the choices and the reference, then the grid with its
    numbers.  ``done`` contains the cells of the grid and of the choices."""
    title = pictures.titles_of((on.name,))[0]
    nearest, least = (find_nearest([cell for cell, _ in done], by) for by in (RISK, ANGLE))
    sides: list[Panel] = [(pictures.panel(on.ready.mesh, on.camera, view), title, ["input"])]
    cells: list[Panel] = []
    for cell, image in done:
        # The options after OUT; the rest of the command is the same for all, and in the footer.
        options = cell.command.partition(" -o OUT ")[2].replace(" -", "  -")
        lines = [*describe_numbers(cell), *filter(None, [options])]
        words = ", ".join(f"{name} = {_plain(value)}" for name, value in cell.parameters.items())
        words = {"plain": "plain command", "auto": "--auto"}.get(cell.choice, words)
        notes = ["least error"] * (cell is least) + ["nearest by risk"] * (cell is nearest)
        words += f" ({', '.join(notes)})" if notes else ""
        (sides if cell.choice else cells).append((image, words, lines))
    if on.reference is not None:
        error = measures.measure_surface_change(on.reference, on.ready.mesh).mean_angular_error_deg
        words = f"normals of the input {error:.2f}\N{DEGREE SIGN}"
        sides.append((pictures.panel(on.reference, on.camera, view), "reference", [words]))
    empty: Panel = (np.full_like(sides[0][0], WHITE), "", [])
    width = len([*wanted.axes.values()][-1])
    panels: list[Panel] = []
    for at in range(max(-(-len(cells) // width), len(sides))):
        row = cells[at * width : (at + 1) * width]
        panels += [sides[at] if at < len(sides) else empty, *row, *[empty] * (width - len(row))]
    footer = [
        f"Each cell: msal denoise {title} -o OUT, and the options below it.",
        "e: mean edge lengths of the input.",
    ]
    if nearest is not None:
        footer.append("Risk: estimated distance from the true surface.")
    if least is not None:
        footer.append("Normals: mean angle between face normals and those of the reference.")
    return draw_panels(panels, columns=width + 1, footer=footer)


def _plain(value: object) -> str:
    """A value as text, without a trailing ``.0``."""
    return str(value).removesuffix(".0")


def describe_numbers(cell: Cell) -> list[str]:
    """Text: how far vertices moved and, if known, how far the result is from the truth."""
    moved = [f"moved {cell.mean_displacement_edges:.3g} e"]
    if cell.volume_change_percent is not None:
        moved.append(f"volume {cell.volume_change_percent:+.2g} %")
    errors = [] if cell.risk_edges is None else [f"risk {cell.risk_edges:.2g} e"]
    if cell.mean_angular_error_deg is not None:
        errors.append(f"normals {cell.mean_angular_error_deg:.2f}\N{DEGREE SIGN}")
    return [", ".join(words) for words in (moved, errors) if words]
