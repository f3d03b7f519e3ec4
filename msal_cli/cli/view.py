"""``msal view``: one mesh, or two and what is between them, as a picture or a page."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from msal_cli.cli import console as talk
from msal_cli.cli import exit_codes
from msal_cli.cli.stream_denoise import STREAM
from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from msal_cli.view.pictures import Scene, View

_PATH = click.Path(readable=False, allow_dash=True)

_SMALLEST, _LARGEST = 48, 4096

_VIEWS = ("auto", "front", "back", "left", "right", "top", "bottom")
_UPS = ("auto", "x", "-x", "y", "-y", "z", "-z")


@dataclass(frozen=True)
class Request:
    """The command line of ``msal view``, as click has read it."""

    before: str
    after: str | None
    output: str
    view: str
    turn: float | None
    tilt: float | None
    up: str
    size: int
    shading: str
    dark: bool
    format: str | None
    quiet: bool
    verbose: int


def _angle(context: click.Context, parameter: click.Parameter, value: str | None) -> float | None:
    if value is None:
        return None
    try:
        angle = float(value)
    except ValueError:
        angle = math.nan
    if not -360.0 <= angle <= 360.0:
        raise click.BadParameter(f"{value!r} is not a number of degrees from -360 to 360")
    return angle


def _pixels(context: click.Context, parameter: click.Parameter, value: str) -> int:
    is_number = value.isascii() and value.isdigit() and len(value) < 6
    if not is_number or not _SMALLEST <= int(value) <= _LARGEST:
        raise click.BadParameter(f"{value!r} is not a whole number from {_SMALLEST} to {_LARGEST}")
    return int(value)


def view_options(size: int) -> Callable[[Any], Any]:
    """The options that say where pictures are taken from and how they look."""
    options = [
        click.option(
            "--view",
            type=click.Choice(_VIEWS),
            default="auto",
            show_default=True,
            help="Where from; front and up are guessed from the shape.",
        ),
        click.option(
            "--turn", metavar="DEGREES", callback=_angle, help="Go round; more is to the right."
        ),
        click.option("--tilt", metavar="DEGREES", callback=_angle, help="Go up; more is higher."),
        click.option(
            "--up",
            type=click.Choice(_UPS),
            default="auto",
            show_default=True,
            help="The axis that points upwards, where the guess is wrong (--up=-y).",
        ),
        click.option(
            "--size",
            metavar="PIXELS",
            default=str(size),
            show_default=True,
            callback=_pixels,
            help="Width of each panel.",
        ),
        click.option(
            "--shading",
            type=click.Choice(("smooth", "flat")),
            default="smooth",
            show_default=True,
            help="smooth rounds all but creases; flat shows every face.",
        ),
        click.option("--dark", is_flag=True, help="Light words on a dark background."),
    ]

    def decorated(command: Any) -> Any:
        for option in reversed(options):
            command = option(command)
        return command

    return decorated


def view_of(request: Any) -> View:
    """The view that the options of ``view_options`` ask for."""
    from msal_cli.view.pictures import View

    return View(
        view=request.view,
        turn_deg=request.turn,
        tilt_deg=request.tilt,
        up=request.up,
        size=request.size,
        style="dark" if request.dark else "light",
        shading=request.shading,
    )


@click.command(
    "view",
    short_help="Make a picture, or a page, of one or two meshes.",
    epilog="""\b
Examples:
  msal view scan.ply -o scan.png
  msal view scan.ply denoised.ply -o both.png --turn 30
  msal view scan.ply denoised.ply -o both.html
\b
Exit status: see msal --help.""",
)
@click.argument("before", metavar="A", type=_PATH)
@click.argument("after", metavar="[B]", required=False, type=_PATH)
@click.option(
    "-o",
    "--output",
    metavar="OUT",
    required=True,
    type=_PATH,
    help="NAME.png for a picture, NAME.html for a page to turn the meshes in; - sends the picture "
    "to standard output.",
)
@view_options(640)
@click.option(
    "--format",
    "format",
    metavar="FORMAT",
    help="The files' format, where neither their names nor their content tells.",
)
@click.option("-q", "--quiet", is_flag=True, help="Tell only errors.")
@click.option(
    "-v", "--verbose", count=True, help="Tell more of what goes on; -vv tells everything."
)
def command(**options: Any) -> int:
    """Show mesh A, or A beside B (before and after) and the deviation of B in colours.

    All panels are seen from one place. Where A and B have the same faces the colours tell how far
    each vertex moved along its normal, else how far it is from A's surface. Neither a display nor
    a graphics card is needed.
    """
    from msal_cli.cli import logs
    from msal_cli.storage import urls

    request = Request(**urls.settled_in(options, "before", "after", "output"))
    with logs.configured(request.verbose, None):
        return _shown(request)


def _shown(request: Request) -> int:
    from msal_cli import codecs as files
    from msal_cli.cli import option_types as words
    from msal_cli.job import comparison
    from msal_cli.view import pictures
    from msal_cli.view.image_files import png_bytes

    kind = _kind(request.output)
    format = words.settled_format(request.format, files.readable_suffixes, "--format")
    names = (request.before,) if request.after is None else (request.before, request.after)
    if STREAM in names:
        raise UsageError("A and B are files", hint="write the stream to a file first")
    surfaces = [comparison.surface_of(comparison.opened(name, format)) for name in names]
    scene = pictures.scene_of(surfaces[0], surfaces[1] if len(surfaces) > 1 else None, names)
    view = view_of(request)
    data = _page(request, scene, view) if kind == "html" else png_bytes(pictures.drawn(scene, view))
    if request.output == STREAM:
        talk.put_bytes(data)
        return exit_codes.SUCCESS
    files.write_whole(request.output, data)
    if not request.quiet:
        from msal_cli.job.display_names import shown

        talk.say(f"wrote {shown(request.output)}", "good")
    return exit_codes.SUCCESS


def _kind(output: str) -> str:
    """``png`` or ``html``, by the output's suffix."""
    suffix = os.path.splitext(output)[1].lower()
    if output == STREAM or suffix == ".png":
        return "png"
    if suffix in (".html", ".htm"):
        return "html"
    raise UsageError(
        f"-o {output}: a picture is called NAME.png and a page NAME.html",
        hint="give the output one of these suffixes",
    )


def _page(request: Request, scene: Scene, view: View) -> bytes:
    import shlex

    from msal_cli.view import pages

    default = ("view", *scene.names, "-o", request.output)
    arguments = click.get_current_context().find_root().obj or default
    return pages.page_of(scene, view, shlex.join(("msal", *arguments)))
