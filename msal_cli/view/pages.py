"""Pages with meshes that can be turned in the browser, by plain WebGL2: the page of ``msal view -o
page.html``, and the parts that it shares with the report of a run.

A page is one file with the viewer, its style, the meshes, and a picture for print and for browsers
without WebGL.  A content security policy lets the browser run only these scripts and styles, and
load nothing.  What comes from outside (mostly file names) is escaped by ``escape``.
"""

import base64
import functools
import hashlib
import html
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from string import Template

from msal_cli.job.display_names import escape_for_display, figure
from msal_cli.version import __version__
from msal_cli.view import pictures
from msal_cli.view.panels import jpeg_bytes
from msal_cli.view.pictures import Scene, View
from msal_cli.view.scene import EncodedScene, encode_scene

_LONG = 23
_SIDES = "blue inwards, orange outwards"
_SPLIT_KEYS = (
    "drag the line; <kbd>[</kbd> <kbd>]</kbd>; arrows on the line; <kbd>1</kbd> before, "
    "<kbd>2</kbd> half, <kbd>3</kbd> after"
)

STILL_SIZE = 560  # largest width in pixels of a panel in the picture of a page

_SCRIPTS = ("decoding.js", "camera.js", "drawing.js", "viewer.js")


def page_of(scene: Scene, view: View, command: str, facts: Sequence[tuple[str, str]] = ()) -> bytes:
    """The page of a scene, at first seen as in ``view``; large meshes are decimated.

    ``command`` is the command that made the page, and ``facts`` are words and texts on the
    difference of two meshes.  The page contains a picture of the scene, too, for print and for
    browsers without WebGL.
    """
    scale = pictures.scale_of_scene(scene)
    still = pictures.draw_picture(scene, replace(view, size=min(view.size, STILL_SIZE)))
    titles = pictures.titles_of(scene.names)
    colours = scene.colours if view.shows_file_colours else ()
    has_deviation = scene.deviation is not None and view.shows_deviation
    drawn = encode_scene(
        scene.before,
        scene.after,
        scene.deviation if has_deviation else None,
        ends=None if scale is None else (scale.low, scale.high),
        view=pictures.camera_of(scene, view).axes,
        colours=colours,
    )
    description = " and ".join(titles)
    if scene.deviation is not None:
        description += f", and the {pictures.deviation_name(scene).lower()}"
    keys = (
        (scene.after is not None, "Split", _SPLIT_KEYS),
        (has_deviation, "Deviation", "<kbd>d</kbd>"),
        (any(own is not None for own in colours), "Colours of the file", "<kbd>c</kbd>"),
    )
    names = ("mesh",) if scene.after is None else ("before", "after")
    rows = [(name, pictures.counts_text(scene, at)) for at, name in enumerate(names)]
    rows += facts or [("mean edge", figure(scene.before.mean_edge_length, ".6g"))]
    notes = [*_notes(scene, view, drawn), f"Made by: {command}"]
    content = Template(asset(__file__, "page.html")).substitute(
        scene=embed_scene(
            "scene",
            drawn,
            picture=jpeg_bytes(still, quality=90),
            description=description,
            starts="now",
            deviation=pictures.deviation_name(scene),
            deviation_note=_SIDES if scene.is_signed else "",
            is_flat=view.shading == "flat",
        ),
        numbers="\n".join(
            f'<tr><th scope="row">{escape(word.capitalize())}</th>'
            f"<td{' class=long' if max(map(len, parts)) > _LONG else ''}>"
            f"{'<br>'.join(map(escape, parts))}</td></tr>"
            for word, text in rows
            if (parts := text.split(", "))
        ),
        notes="\n".join(f'<p class="note">{escape(note)}</p>' for note in notes),
        keys="".join(
            f'<tr><th scope="row">{name}</th><td>{text}</td></tr>\n'
            for is_there, name, text in keys
            if is_there
        ),
    )
    title = " \N{RIGHTWARDS ARROW} ".join(titles)
    return build_page(
        title, content, [viewer_script()], [viewer_style(), asset(__file__, "page.css")]
    )


def _notes(scene: Scene, view: View, drawn: EncodedScene) -> Iterator[str]:
    """Notes for the reader on the picture and the meshes."""
    if any(n_all != n_drawn for n_all, n_drawn in drawn.counts):
        counts = " and ".join(f"{n_drawn:,} of {n_all:,} faces" for n_all, n_drawn in drawn.counts)
        yield (
            f"Decimated for the page: {counts}. Short edges were contracted to one of their ends. "
            "The numbers are those of the full meshes."
        )
    digits = max(0, -math.floor(math.log10(drawn.rounding)))
    upwards = math.ceil(drawn.rounding * 10.0**digits - 1e-9) / 10.0**digits
    rounding = f"{upwards:.{digits}f}" if digits < 9 else f"{upwards:.0e}"
    yield f"Coordinates are drawn to within {rounding} file units."
    if scene.after is not None and not pictures.has_moved(scene):
        yield pictures.NOTHING_MOVED
    if scene.record is not None:
        yield from scene.record.warnings
        if scene.record.volume is not None and scene.record.volume.reason:
            yield f"No volume: {scene.record.volume.reason}."
    if view.shows_file_colours:
        yield from (f"{note}." for note in scene.notes)


# Parts of pages


def build_page(
    title: str,
    content: str,
    scripts: Sequence[str],
    styles: Sequence[str],
    *,
    verdict: str = "",
    version: str = __version__,
) -> bytes:
    """A page as UTF-8, with a button for light and dark.

    ``content`` and ``verdict``, which is shown beside the title, are elements; ``version`` is the
    version of msal that made the content.
    """
    scripts = [*scripts, asset(__file__, "theme.js")]
    styles = [asset(__file__, "frame.css"), *styles]
    # Only these scripts and styles may run, and only pictures in the page are shown.
    policy = (
        "default-src 'none'",
        f"script-src {_hashes(scripts)}",
        f"style-src {_hashes(styles)}",
        "img-src data:",
        "base-uri 'none'",
        "form-action 'none'",
    )
    page = Template(asset(__file__, "frame.html")).substitute(
        policy=html.escape("; ".join(policy)),
        version=escape(version),
        title=escape(title),
        styles="".join(f"<style>{style}</style>" for style in styles),
        verdict=verdict,
        content=content,
        scripts="".join(f"<script>{script}</script>" for script in scripts),
    )
    return page.encode("utf-8")


def viewer_script() -> str:
    """The viewer's script; it starts each ``msal-scene`` that precedes it in the page."""
    inner = "\n".join(asset(__file__, name) for name in _SCRIPTS)
    return f'"use strict";\n(() => {{\n{inner}}})();\n'


def viewer_style() -> str:
    """The viewer's style: only classes that begin with ``msal-``."""
    return asset(__file__, "viewer.css")


def embed_scene(
    key: str,
    drawn: EncodedScene,
    *,
    picture: bytes,
    description: str = "",
    starts: str = "click",
    deviation: str = "Deviation",
    deviation_note: str = "",
    is_flat: bool = False,
) -> str:
    """The elements of one scene, for a page that also has ``viewer_style()`` and, after them,
    ``viewer_script()``.

    Parameters
    ----------
    key : the id of the data: a letter, then letters, digits, ``_`` and ``-``.
    picture : JPEG that is shown until the viewer starts, if it cannot start, and in print.
    description : a text in place of the picture.
    starts : ``click`` to wait for a button, ``now`` to start with the page.
    deviation, deviation_note : the heading of the colour scale, and a note below it.
    is_flat : whether faces are shown flat at the start; else the surface is shown smooth.
    """
    values = {
        "scene": key,
        "start": starts,
        "deviation": deviation,
        "note": deviation_note,
        "shading": "flat" if is_flat else "smooth",
    }
    attributes = " ".join(f'data-{name}="{escape(value)}"' for name, value in values.items())
    image = f"data:image/jpeg;base64,{to_base64(picture)}"
    return (
        f'<div class="msal-scene" {attributes}><figure><img alt="{escape(description)}" '
        f'src="{image}"></figure></div>\n'
        f'<script type="application/octet-stream" id="{key}">{drawn.text}</script>\n'
    )


def escape(text: str) -> str:
    """``text`` escaped for use between tags and within quotes."""
    return html.escape(escape_for_display(text), quote=True)


@functools.cache
def asset(module: str, name: str) -> str:
    """The text of a file in the folder ``assets`` beside a module's file."""
    return (Path(module).parent / "assets" / name).read_text(encoding="utf-8")


def to_base64(data: bytes) -> str:
    """``data`` in characters that have no special meaning in HTML or JSON."""
    return base64.b64encode(data).decode("ascii")


def _hashes(texts: Iterable[str]) -> str:
    hashes = (to_base64(hashlib.sha256(text.encode()).digest()) for text in texts)
    return " ".join(f"'sha256-{digest}'" for digest in hashes)
