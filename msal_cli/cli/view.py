"""``msal view``: one mesh, or two and what is between them, as a picture or a page."""

from __future__ import annotations

import dataclasses
import functools
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from msal_cli.cli import console, options
from msal_cli.cli.command import MESSAGES, MORE, group
from msal_cli.cli.command import command as grouped_command
from msal_cli.cli.options import STREAM
from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from msal_cli.view.pictures import View

_VIEWS = ("auto", "front", "back", "left", "right", "top", "bottom")
_COLOURS = ("auto", "file", "deviation", "none")
_UPS = ("auto", "x", "-x", "y", "-y", "z", "-z")


def view_options(size: int) -> Callable[[Any], Any]:
    """The options that say where pictures are taken from and how they look.

    The command gets them as one argument, ``view``.
    """

    def decorate(command: Callable[..., int]) -> Any:
        @functools.wraps(command)
        def run(
            view: str,
            turn: float | None,
            tilt: float | None,
            up: str,
            size: int,
            shading: str,
            dark: bool,
            **given: Any,
        ) -> int:
            from msal_cli.view.pictures import View

            style = "dark" if dark else "light"
            return command(view=View(view, turn, tilt, up, size, style, shading), **given)

        return group(
            "Picture",
            click.option(
                "--view",
                type=click.Choice(_VIEWS),
                default="auto",
                show_default=True,
                help="Where from; front and up are guessed from the shape.",
            ),
            click.option(
                "--turn",
                metavar="DEGREES",
                type=options.number(-360.0, 360.0),
                help="Go round; more is to the right.",
            ),
            click.option(
                "--tilt",
                metavar="DEGREES",
                type=options.number(-360.0, 360.0),
                help="Go up; more is higher.",
            ),
            click.option(
                "--up",
                type=click.Choice(_UPS),
                default="auto",
                show_default=True,
                help="The axis that points upwards, where the guess is wrong (--up=-y).",
            ),
            MORE,
            click.option(
                "--size",
                metavar="PIXELS",
                default=size,
                show_default=True,
                type=click.IntRange(48, 4096),
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
        )(run)

    return decorate


@grouped_command(
    "view",
    epilog="""\b
Examples:
  msal view scan.ply denoised.ply
  msal view scan.ply -o scan.png
  msal view scan.ply denoised.ply -o both.png --turn 30
  msal view scan.ply denoised.ply -o both.html
\b
Exit status: see msal --help.""",
)
@click.argument("before", metavar="A", type=options.PATH)
@click.argument("after", metavar="[B]", required=False, type=options.PATH)
@group(
    "Input and output",
    click.option(
        "-o",
        "--output",
        metavar="OUT",
        type=options.PATH,
        help="NAME.png for a picture, NAME.html for a page to turn the meshes in; - sends the "
        "picture to standard output. Without it: a page in the current folder, shown in the "
        "browser where there is a display.",
    ),
    options.FORMAT,
)
@view_options(640)
@group(
    "Colours",
    click.option(
        "--colours",
        type=click.Choice(_COLOURS),
        default="auto",
        show_default=True,
        help="auto: those of the files, and of two the deviation; or one of these, or none.",
    ),
)
@group(
    MESSAGES,
    options.QUIET,
    options.verbose,
)
def command(
    before: str,
    after: str | None,
    output: str | None,
    view: View,
    colours: str,
    format: str | None,
    quiet: bool,
) -> int:
    """Show mesh A, or A beside B (before and after) and the deviation of B in colours.

    All panels show the same view. Where A and B have the same faces the colours show how far
    each vertex moved along its normal, else how far it is from A's surface. Neither a display nor
    a graphics card is needed.
    """
    import shlex

    from msal_cli.cli.report_files import refuse_target
    from msal_cli.job.display_names import escape_for_display
    from msal_cli.job.room import room_for_files
    from msal_cli.storage import atomic
    from msal_cli.view import pages, pictures
    from msal_cli.view.colours import open_coloured_surface
    from msal_cli.view.panels import png_bytes

    kind = "html" if output is None else _find_kind(output)
    format = options.resolve_format(format)
    names = (before,) if after is None else (before, after)
    if STREAM in names:
        raise UsageError("A and B are files", hint="write the stream to a file first")
    if output is not None and output != STREAM:
        refuse_target(output, "the picture", names)
    view = dataclasses.replace(view, colours=colours)
    with room_for_files(names, format):
        first, *second = (open_coloured_surface(name, format) for name in names)
        scene = pictures.scene_of(first, second[0] if second else None, names)
        if view.shows_file_colours and not quiet:
            for note in scene.notes:
                console.say(f"msal: {escape_for_display(note)}", "warn")
        if kind == "html":
            default = ("view", *names, *(("-o", output) if output else ()))
            arguments = click.get_current_context().find_root().obj or default
            data = pages.page_of(scene, view, shlex.join(("msal", *arguments)))
        else:
            data = png_bytes(pictures.draw_picture(scene, view))
    if output is None:
        page = _write_own_page(names, data)
        if not quiet:
            console.say_written(page)
        _show_in_browser(page)
        return console.SUCCESS
    if output == STREAM:
        console.put_bytes(data)
        return console.SUCCESS
    atomic.write_whole(output, data, sources=names)
    if not quiet:
        console.say_written(output)
    return console.SUCCESS


def _find_kind(output: str) -> str:
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


def _write_own_page(sources: tuple[str, ...], data: bytes) -> str:
    """Write ``data`` into the current folder under a name after that of the mesh, which no file has
    that another program made; the name."""
    from itertools import count

    from msal_cli.storage import atomic

    stem = os.path.splitext(os.path.basename(sources[-1]).removesuffix(".gz"))[0].lstrip("-")
    for number in count(1):
        name = f"{stem}.view{'' if number == 1 else number}.html"
        if atomic.write_new(name, [data], sources=sources):
            break
        if _is_own_page(name):
            atomic.write_whole(name, data, sources=sources)
            break
    return name


def _is_own_page(name: str) -> bool:
    from msal_cli.storage.regular import open_regular

    try:
        with open_regular(name) as file:
            return b'<meta name="generator" content="msal ' in file.read(4096)
    except OSError:
        return False


def _show_in_browser(page: str) -> None:
    has_display = sys.platform in ("darwin", "win32")
    if has_display or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        import webbrowser

        webbrowser.open(Path(page).absolute().as_uri())
