"""``msal view``: a picture or a page of one mesh, or of two and their difference."""

from __future__ import annotations

import dataclasses
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from msal_cli.cli import console
from msal_cli.cli.command import Request, grouped_command
from msal_cli.cli.options import PATH, QUIET_AND_VERBOSE, STREAM, OptionGroup, group, resolve_format
from msal_cli.errors import UsageError
from msal_cli.job.display_names import escape_for_display

if TYPE_CHECKING:
    from msal_cli.view.pictures import View


def make_view_group(size: int) -> OptionGroup:
    """The options for the view and the look of pictures of ``size`` pixels."""
    return group(
        "Picture",
        f"""
--view [auto|front|back|left|right|top|bottom] = auto
    Where from; front and up are guessed from the shape.
--turn DEGREES
    Go round; more is to the right.
--tilt DEGREES
    Go up; more is higher.
--up [auto|x|-x|y|-y|z|-z] = auto
    The axis that points upwards, where the guess is wrong (--up=-y).
more:
--size PIXELS = {size}
    Width of each panel.
--shading [smooth|flat] = smooth
    smooth rounds all but creases; flat shows every face.
""",
        size=click.IntRange(48, 4096),
    )


def read_view(request: Request) -> View:
    """The view that the options of ``make_view_group`` give."""
    from msal_cli.view.pictures import View

    place = (request.view, request.turn, request.tilt, request.up)
    return View(*place, request.size, request.shading)


@grouped_command(
    "view",
    group(
        "Input and output",
        """
-o, --output OUT
    NAME.png for a picture, NAME.html for a page to turn the meshes in; - sends the picture to
    standard output. Without it: a page in the current folder, shown in the browser where there is
    a display.
--format
""",
    ),
    make_view_group(640),
    group(
        "Colours",
        """
--colours [auto|file|deviation|none] = auto
    auto: those of the files, and of two the deviation; or one of these, or none.
""",
    ),
    QUIET_AND_VERBOSE,
    arguments=[
        click.Argument(["before"], metavar="A", type=PATH),
        click.Argument(["after"], metavar="[B]", required=False, type=PATH),
    ],
    examples="""
  msal view scan.ply denoised.ply
  msal view scan.ply -o scan.png
  msal view scan.ply denoised.ply -o both.png --turn 30
  msal view scan.ply denoised.ply -o both.html
""",
)
def command(request: Request) -> int:
    """Show mesh A, or A beside B (before and after) and the deviation of B in colours.

    All panels show the same view. Where A and B have the same faces the colours show how far
    each vertex moved along its normal, else how far it is from A's surface. Neither a display nor
    a graphics card is needed.
    """
    import shlex

    from msal_cli.cli.report_files import REPORT, refuse_target, require_files
    from msal_cli.job.room import DISTANCES_BYTES_PER_FACE, room_for_files
    from msal_cli.report.comparison import list_facts
    from msal_cli.storage import atomic
    from msal_cli.view import pages, pictures
    from msal_cli.view.panels import png_bytes

    names = (request.before,) if request.after is None else (request.before, request.after)
    require_files(names)
    if request.after is None and request.colours == "deviation":
        raise UsageError("--colours deviation needs a mesh B", hint="name the one to compare with")
    format, output = resolve_format(request.format), request.output
    kind = "html" if output is None else _find_kind(output)
    if output is None:
        stem = os.path.splitext(os.path.basename(names[-1]).removesuffix(".gz"))[0].lstrip("-")
        output = f"{stem}.view.html"
        refuse_target(output, "the page", names, replaces=REPORT)
    elif output != STREAM:
        refuse_target(output, "the picture", names)
    view = dataclasses.replace(read_view(request), colours=request.colours)
    with room_for_files(names, format, bytes_per_face=DISTANCES_BYTES_PER_FACE):
        first, *second = (pictures.open_coloured_surface(name, format) for name in names)
        scene = pictures.scene_of(first, second[0] if second else None, names)
        if view.shows_file_colours and not request.quiet:
            for note in scene.notes:
                console.say(f"msal: {escape_for_display(note)}", "warn")
        if kind == "html":
            command = shlex.join(("msal", *request.context.obj))
            found = [] if scene.record is None else list_facts(scene.record)
            # Warnings are among the notes of the page.
            facts = [(fact.word, fact.text) for fact in found if fact.word != "warning"]
            data = pages.page_of(scene, view, command, facts)
        else:
            data = png_bytes(pictures.draw_picture(scene, view))
    if output == STREAM:
        console.put_bytes(data)
        return console.SUCCESS
    atomic.write_whole(output, data, sources=names)
    if not request.quiet:
        console.say_written(output)
    if request.output is None:
        _show_in_browser(output)
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


def _show_in_browser(page: str) -> None:
    has_display = sys.platform in ("darwin", "win32")
    if has_display or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        import webbrowser

        webbrowser.open(Path(page).absolute().as_uri())
