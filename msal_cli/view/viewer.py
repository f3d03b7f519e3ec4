"""Parts of pages: escaped text, scripts, styles and their policy, and the elements that show meshes
in the browser with plain WebGL2.

The viewer, its style, the meshes and a picture, for where there is no WebGL and for print, all
are in the page, which loads nothing.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import html
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from msal_cli.errors import InternalError
from msal_cli.job.display_names import escape_for_display
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
    """The elements of one scene, for a page that also holds ``script()`` (behind) and ``style()``.

    Parameters
    ----------
    key : the id of the data, a letter and then letters, digits, ``_`` and ``-``.
    picture : JPEG that is shown until the viewer starts, where it cannot, and in print.
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
    image = f"data:image/jpeg;base64,{to_base64(picture)}"
    return (
        f'<div class="msal-scene" {attributes}><figure><img alt="{escape(description)}" '
        f'src="{image}"></figure></div>\n'
        f'<script type="application/octet-stream" id="{key}">{drawn.text}</script>\n'
    )


def escape(text: str) -> str:
    """``text`` as it may be between tags and within quotes."""
    return html.escape(escape_for_display(text), quote=True)


@functools.cache
def asset(module: str, name: str) -> str:
    """The text of a file in the folder ``assets`` beside a module's file."""
    return (Path(module).parent / "assets" / name).read_text(encoding="utf-8")


def to_base64(data: bytes) -> str:
    """``data`` in letters that mean nothing in HTML or JSON."""
    return base64.b64encode(data).decode("ascii")


def content_policy(scripts: Sequence[str], styles: Sequence[str]) -> str:
    """A content security policy, escaped: it allows these inline scripts and styles, pictures in
    the page, and no other.

    Each is the whole text between the tags.
    """
    policy = (
        "default-src 'none'",
        f"script-src {_hashes(scripts)}",
        f"style-src {_hashes(styles)}",
        "img-src data:",
        "base-uri 'none'",
        "form-action 'none'",
    )
    return html.escape("; ".join(policy))


def _hashes(texts: Iterable[str]) -> str:
    hashes = (to_base64(hashlib.sha256(text.encode()).digest()) for text in texts)
    return " ".join(f"'sha256-{digest}'" for digest in hashes) or "'none'"
