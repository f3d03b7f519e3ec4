"""The elements of a page that show meshes in the browser, with plain WebGL2.

The viewer, its style, the meshes and a picture, for where there is no WebGL and for print, all
are in the page, which loads nothing.
"""

from __future__ import annotations

import re

from msal_cli.errors import InternalError
from msal_cli.view.html_parts import asset, escape, to_base64
from msal_cli.view.scene import EncodedScene

_SCRIPTS = ("decoding.js", "camera.js", "drawing.js", "viewer.js")
_KEY = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")


def script() -> str:
    """The viewer's script; it starts every ``msal-scene`` before it in the page."""
    inner = "\n".join(asset(__file__, name) for name in _SCRIPTS)
    return f'"use strict";\n(() => {{\n{inner}}})();\n'


def style() -> str:
    """The viewer's style: only classes that begin with ``msal-``."""
    return asset(__file__, "viewer.css")


def embedded_scene(
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
    """The elements of one scene, for a page that also holds ``script()`` (behind) and ``style()``.

    Parameters
    ----------
    key : the id of the data, a letter and then letters, digits, ``_`` and ``-``.
    picture : PNG that is shown until the viewer starts, where it cannot, and in print.
    description : what the picture shows, for those who do not see it.
    starts : ``click`` to wait for a button, ``now`` to start with the page.
    deviation, deviation_note : the heading of the colour scale, and what is to be said below it.
    is_flat : whether every face is shown at the start, not a rounded surface.
    """
    if not _KEY.fullmatch(key):
        raise InternalError(f"{key!r} cannot be the id of a scene")
    values = {
        "scene": key,
        "start": starts,
        "before": "Before",
        "after": "After",
        "deviation": deviation,
        "note": deviation_note,
        "shading": "flat" if is_flat else "smooth",
    }
    attributes = " ".join(f'data-{name}="{escape(value)}"' for name, value in values.items())
    image = f"data:image/png;base64,{to_base64(picture)}"
    return (
        f'<div class="msal-scene" {attributes}><figure><img alt="{escape(description)}" '
        f'src="{image}"></figure></div>\n'
        f'<script type="application/octet-stream" id="{key}">{drawn.text}</script>\n'
    )
