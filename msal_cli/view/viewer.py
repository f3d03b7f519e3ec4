"""A page, or a part of one, that shows meshes in the browser.

Everything stands in the one file: the viewer in plain WebGL2, its style, the meshes and a picture
for where there is no WebGL and for print.  A content security policy lets the browser run only the
script and the style that were written here, and load nothing.  What comes from outside (names of
files, mostly) is escaped in one place, ``_text``.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import html
import math
import re
from collections.abc import Sequence
from pathlib import Path
from string import Template

from msal_cli import __version__
from msal_cli.arrays import Floats
from msal_cli.errors import InternalError
from msal_cli.job.display_names import shown
from msal_cli.mesh import Mesh
from msal_cli.view import scene

_ASSETS = Path(__file__).parent / "assets"
_SCRIPTS = ("decoding.js", "camera.js", "drawing.js", "viewer.js")
_SHORT = 20
_KEY = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")

Figures = Sequence[tuple[str, Sequence[tuple[str, ...]]]]
"""Tables of numbers: a heading, and rows of a name and values; one without a name heads columns."""


def script() -> str:
    """The viewer's script; it starts every ``msal-scene`` that stands before it in the page."""
    inner = "\n".join(_asset(name) for name in _SCRIPTS)
    return f'"use strict";\n(() => {{\n{inner}}})();\n'


def style() -> str:
    """The viewer's style: only classes that begin with ``msal-``."""
    return _asset("viewer.css")


def scene_data(before: Mesh, after: Mesh | None = None, deviation: Floats | None = None) -> str:
    """One scene as base64: the content of ``<script type="application/octet-stream" id=...>``."""
    return scene.encoded(before, after, deviation).text


def content_policy(scripts: Sequence[str], styles: Sequence[str]) -> str:
    """A policy that allows these inline scripts and styles, pictures in the page, and no other.

    Each is the whole text between the tags.
    """
    return "; ".join(
        (
            "default-src 'none'",
            f"script-src {' '.join(map(_source, scripts)) or chr(39) + 'none' + chr(39)}",
            f"style-src {' '.join(map(_source, styles)) or chr(39) + 'none' + chr(39)}",
            "img-src data:",
            "base-uri 'none'",
            "form-action 'none'",
        )
    )


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
    attributes = " ".join(f'data-{name}="{_text(value)}"' for name, value in told.items())
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
    code = script() + f"{{\n{_asset('theme.js')}}}\n"
    looks = style() + _asset("page.css")
    said = [*_decimation(drawn), *_precision(drawn), *notes]
    page = Template(_asset("page.html")).substitute(
        policy=html.escape(content_policy([code], [looks])),
        version=_text(__version__),
        title=_text(title),
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
        theme=f' data-theme="{_text(theme)}"' if theme else "",
        numbers="\n".join(_table(heading, rows) for heading, rows in numbers),
        notes="\n".join(f'<p class="note">{_text(note)}</p>' for note in said),
        keys=_keys(after is not None, has_deviation),
        script=code,
    )
    return page.encode("utf-8")


def _still(picture: bytes | None, description: str) -> str:
    if picture is None:
        return ""
    data = base64.b64encode(picture).decode("ascii")
    return f'<figure><img alt="{_text(description)}" src="data:image/png;base64,{data}"></figure>'


def _table(heading: str, rows: Sequence[tuple[str, ...]]) -> str:
    lines = "".join(_row(name, values) for name, *values in rows)
    return f"<section><h2>{_text(heading)}</h2><table>{lines}</table></section>"


def _row(name: str, values: Sequence[str]) -> str:
    if not name:
        return f"<tr><td></td>{''.join(f'<th>{_text(value)}</th>' for value in values)}</tr>"
    # A short value stays on its line.
    cells = "".join(
        f"<td{' class=long' if len(value) > _SHORT else ''}>{_text(value)}</td>" for value in values
    )
    return f'<tr><th scope="row">{_text(name)}</th>{cells}</tr>'


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


def _text(text: str) -> str:
    """``text`` as it may stand between tags and within quotes."""
    return html.escape(shown(text), quote=True)


def _source(text: str) -> str:
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
    return f"'sha256-{digest}'"


@functools.cache
def _asset(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")
