"""A page, or a part of one, that shows meshes in the browser.

Everything stands in the one file: the viewer in plain WebGL2, its style, the meshes and a picture
for where there is no WebGL and for print.  A content security policy lets the browser run only the
script and the style that were written here, and load nothing.  What comes from outside (names of
files, mostly) is escaped in one place, ``escape``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from string import Template

from msal_cli import __version__
from msal_cli.arrays import Floats
from msal_cli.errors import InternalError
from msal_cli.mesh import Mesh
from msal_cli.view import scene
from msal_cli.view.html_parts import asset, content_policy, escape, to_base64

_SCRIPTS = ("decoding.js", "camera.js", "drawing.js", "viewer.js")
_SHORT = 20
_KEY = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")

Figures = Sequence[tuple[str, Sequence[tuple[str, ...]]]]
"""Tables of numbers: a heading, and rows of a name and values; one without a name heads columns."""


def script() -> str:
    """The viewer's script; it starts every ``msal-scene`` that stands before it in the page."""
    inner = "\n".join(asset(__file__, name) for name in _SCRIPTS)
    return f'"use strict";\n(() => {{\n{inner}}})();\n'


def style() -> str:
    """The viewer's style: only classes that begin with ``msal-``."""
    return asset(__file__, "viewer.css")


def embedded_scene(
    key: str,
    drawn: scene.Scene | None,
    *,
    picture: bytes | None = None,
    description: str = "",
    starts: str = "click",
    before: str = "Before",
    after: str = "After",
    deviation: str = "Deviation",
    deviation_note: str = "",
    is_flat: bool = False,
) -> str:
    """The elements of one scene, for a page that also holds ``script()`` (behind) and ``style()``.

    Parameters
    ----------
    key : the id of the data, a letter and then letters, digits, ``_`` and ``-``.
    drawn : of ``scene.encoded``; None for the picture alone.
    picture : PNG that stands there until the viewer starts, where it cannot, and in print.
    description : what the picture shows, for those who do not see it.
    starts : ``click`` to wait for a button, ``now`` to start with the page.
    before, after : what the two sides are called.
    deviation, deviation_note : the heading of the colour scale, and what is to be said below it.
    is_flat : whether every face is shown at the start, not a rounded surface.
    """
    if drawn is None:
        return f'<div class="msal-scene">{_still(picture, description)}</div>'
    if not _KEY.fullmatch(key):
        raise InternalError(f"{key!r} cannot be the id of a scene")
    told = {
        "scene": key,
        "start": starts,
        "before": before,
        "after": after,
        "deviation": deviation,
        "note": deviation_note,
        "shading": "flat" if is_flat else "smooth",
    }
    attributes = " ".join(f'data-{name}="{escape(value)}"' for name, value in told.items())
    box = f'<div class="msal-scene" {attributes}>{_still(picture, description)}</div>'
    return f'{box}\n<script type="application/octet-stream" id="{key}">{drawn.text}</script>\n'


def page_bytes(
    title: str,
    before: Mesh,
    after: Mesh | None = None,
    deviation: Floats | None = None,
    *,
    numbers: Figures = (),
    notes: Sequence[str] = (),
    picture: bytes | None = None,
    description: str = "",
    names: tuple[str, str] = ("Before", "After"),
    deviation_name: str = "Deviation",
    deviation_note: str = "",
    ends: tuple[float, float] | None = None,
    view: Floats | None = None,
    is_flat: bool = False,
    theme: str = "",
    most_faces: int = scene.MOST_FACES,
) -> bytes:
    """A self-contained HTML page that shows one mesh, or two with a slider between them.

    Parameters
    ----------
    title : what the page is called; any text.
    before, after, deviation, ends, view, most_faces : see ``scene.encoded``.
    numbers : tables to stand beside the view.
    notes : sentences below them, such as the command that made the page.
    picture, description : see ``embedded_scene``.
    names : what the two sides are called.
    deviation_name, deviation_note, is_flat : see ``embedded_scene``.
    theme : ``light`` or ``dark`` at the start, empty for what the reader's system has.
    """
    drawn = scene.encoded(before, after, deviation, ends=ends, view=view, most_faces=most_faces)
    has_deviation = deviation is not None
    code = script() + f"{{\n{asset(__file__, 'theme.js')}}}\n"
    looks = style() + asset(__file__, "page.css")
    said = [*_decimation(drawn), *_precision(drawn), *notes]
    page = Template(asset(__file__, "page.html")).substitute(
        policy=content_policy([code], [looks]),
        version=escape(__version__),
        title=escape(title),
        style=looks,
        scene=embedded_scene(
            "scene",
            drawn,
            picture=picture,
            description=description or title,
            starts="now",
            before=names[0],
            after=names[1],
            deviation=deviation_name,
            deviation_note=deviation_note,
            is_flat=is_flat,
        ),
        theme=f' data-theme="{escape(theme)}"' if theme else "",
        numbers="\n".join(_table(heading, rows) for heading, rows in numbers),
        notes="\n".join(f'<p class="note">{escape(note)}</p>' for note in said),
        keys=_keys(after is not None, has_deviation),
        script=code,
    )
    return page.encode("utf-8")


def _still(picture: bytes | None, description: str) -> str:
    if picture is None:
        return ""
    data = to_base64(picture)
    return f'<figure><img alt="{escape(description)}" src="data:image/png;base64,{data}"></figure>'


def _table(heading: str, rows: Sequence[tuple[str, ...]]) -> str:
    lines = []
    for name, *values in rows:
        if name:
            # A short value stays on its line.
            kinds = [" class=long" if len(value) > _SHORT else "" for value in values]
            texts = zip(kinds, map(escape, values), strict=True)
            cells = "".join(f"<td{kind}>{text}</td>" for kind, text in texts)
            lines.append(f'<tr><th scope="row">{escape(name)}</th>{cells}</tr>')
        else:
            heads = "".join(f"<th>{escape(value)}</th>" for value in values)
            lines.append(f"<tr><td></td>{heads}</tr>")
    return f"<section><h2>{escape(heading)}</h2><table>{''.join(lines)}</table></section>"


def _decimation(drawn: scene.Scene) -> list[str]:
    """What the page holds of the files' faces, where that is not all."""
    if not drawn.is_decimated:
        return []
    counts = f"{drawn.drawn_faces:,} of {drawn.faces:,} faces"
    how = "Short edges were contracted to one of their ends"
    if drawn.after_faces is None:
        return [f"Decimated for the page: {counts}. {how}."]
    if (drawn.after_faces, drawn.drawn_after_faces) == (drawn.faces, drawn.drawn_faces):
        where = "the same of both meshes"
        how += ", the same on both sides; vertices that stay keep their places"
    else:
        where = f"and {drawn.drawn_after_faces:,} of {drawn.after_faces:,} after"
    return [
        f"Decimated for the page: {counts}, {where}. {how}."
        " The numbers are those of the full meshes."
    ]


def _precision(drawn: scene.Scene) -> list[str]:
    digits = max(0, -math.floor(math.log10(drawn.rounding)))
    upwards = math.ceil(drawn.rounding * 10.0**digits - 1e-9) / 10.0**digits
    rounding = f"{upwards:.{digits}f}" if digits < 9 else f"{upwards:.0e}"
    return [f"Coordinates are drawn to within {rounding} file units."]


def _keys(is_pair: bool, has_deviation: bool) -> str:
    """Rows of the table of keys for what not every page has."""
    rows = ""
    if is_pair:
        rows += (
            '<tr><th scope="row">Split</th><td>drag the line; <kbd>[</kbd> <kbd>]</kbd>;'
            " arrows on the line; <kbd>1</kbd> before, <kbd>2</kbd> half, <kbd>3</kbd> after"
            "</td></tr>\n"
        )
    if has_deviation:
        rows += '<tr><th scope="row">Deviation</th><td><kbd>d</kbd></td></tr>\n'
    return rows
