"""Pages with meshes to turn in the browser by plain WebGL2: that of ``msal view -o page.html``, and
the parts that it shares with the page of a run.

A page is one file: the viewer, its style, the meshes and a picture, for where there is no WebGL and
for print, are all in it.  A content security policy lets the browser run only the scripts and the
styles that were written here, and load nothing.  What comes from outside (names of files, mostly)
is escaped by ``escape``.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import html
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from string import Template

from msal_cli.errors import InternalError
from msal_cli.job.display_names import escape_for_display, figure
from msal_cli.job.records import ComparisonRecord, SurfaceDistance
from msal_cli.version import __version__
from msal_cli.view import pictures
from msal_cli.view.panels import jpeg_bytes
from msal_cli.view.pictures import Scene, View
from msal_cli.view.scene import EncodedScene, encode_scene

Rows = list[tuple[str, ...]]
"""A table of figures: a name and values in each row; a row without a name has the heads."""

_MINUS = "\N{MINUS SIGN}"
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_SIDES = "blue inwards, orange outwards"
_SHORT = 20

STILL_SIZE = 560
"""Pixels in the width of each panel of the picture in a page, at most."""

_SCRIPTS = ("decoding.js", "camera.js", "drawing.js", "viewer.js")
_KEY = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")


def page_of(scene: Scene, view: View, command: str) -> bytes:
    """The page of a scene, seen at the start as in ``view``; large meshes are decimated.

    ``command`` is what made the page, for its readers.  A picture of the scene is in the page too,
    for where there is no WebGL and for print, so always on white.
    """
    scale = pictures.scale_of_scene(scene)
    still = replace(view, size=min(view.size, STILL_SIZE), style="light")
    titles = pictures.titles_of(scene.names)
    colours = scene.colours if view.shows_file_colours else ()
    drawn = encode_scene(
        scene.before,
        scene.after,
        scene.deviation if view.shows_deviation else None,
        ends=None if scale is None else (scale.low, scale.high),
        view=pictures.camera_of(scene, view).axes,
        colours=colours,
    )
    code = viewer_script() + f"{{\n{asset(__file__, 'theme.js')}}}\n"
    looks = viewer_style() + asset(__file__, "page.css")
    notes = [
        *_thinning(scene),
        *_decimation(drawn),
        *_precision(drawn),
        *_warnings(scene),
        *(f"{note}." for note in scene.notes if view.shows_file_colours),
        f"Made by: {command}",
    ]
    page = Template(asset(__file__, "page.html")).substitute(
        policy=content_policy([code], [looks]),
        version=escape(__version__),
        title=escape(" \N{RIGHTWARDS ARROW} ".join(titles)),
        style=looks,
        scene=embed_scene(
            "scene",
            drawn,
            picture=jpeg_bytes(pictures.draw_picture(scene, still), quality=90),
            description=_description(titles, scene),
            starts="now",
            deviation=pictures.deviation_name(scene),
            deviation_note=_SIDES if scene.is_signed else "",
            is_flat=view.shading == "flat",
        ),
        theme=' data-theme="dark"' if view.style == "dark" else "",
        numbers="\n".join(_table(heading, rows) for heading, rows in figures_of(scene)),
        notes="\n".join(f'<p class="note">{escape(note)}</p>' for note in notes),
        keys=_keys(
            scene.after is not None,
            scene.deviation is not None and view.shows_deviation,
            any(own is not None for own in colours),
        ),
        script=code,
    )
    return page.encode("utf-8")


def figures_of(scene: Scene) -> list[tuple[str, Rows]]:
    """Tables of numbers for beside a scene: a heading, and rows of a name and a value."""
    record, mesh = scene.record, scene.before
    if record is None:
        counts = scene.counts or ((len(mesh.faces), pictures.count_of_vertices(mesh)),)
        rows: Rows = [("Vertices", f"{counts[0][1]:,}"), ("Triangles", f"{counts[0][0]:,}")]
        if not scene.counts:
            rows.append(("Mean edge length", _number(mesh.mean_edge_length)))
        return [("Mesh", rows)]
    tables = (
        ("Displacement", record.displacement),
        ("Distance, after to before", record.distance_to_before),
        ("Distance, before to after", record.distance_to_after),
    )
    kinds = tables[1:] if record.displacement is None else tables[:1]
    return [
        *((heading, _lengths(lengths)) for heading, lengths in kinds if lengths is not None),
        ("Change", _changes(record)),
        ("Meshes", _sizes(record)),
    ]


def _lengths(distance: SurfaceDistance) -> Rows:
    """Each in file units, and in mean edge lengths (e)."""
    rows: Rows = [("", "file units", "e")]
    for title, word in (("Mean", "mean"), ("RMS", "rms"), ("95 %", "p95"), ("Maximum", "max")):
        lengths = (getattr(distance, name) for name in (word, f"{word}_edges"))
        rows.append((title, *map(_number, lengths)))
    return rows


def _changes(record: ComparisonRecord) -> Rows:
    volume = "" if record.volume is None else "unknown"
    rows = (
        ("Volume", _percent(record.volume_change_percent) or volume),
        ("Area", _percent(record.area_change_percent)),
        ("Mean normal angle", figure(record.mean_angular_error_deg, ".3g", "°")),
        ("Largest normal angle", figure(record.max_angular_error_deg, ".3g", "°")),
        ("Flipped faces", figure(record.flipped_faces, ",")),
        ("Vertex error", figure(record.vertex_error_percent, ".3g", " % of e")),
        ("Hausdorff distance", _number(record.hausdorff)),
    )
    return [row for row in rows if row[1]]


def _sizes(record: ComparisonRecord) -> Rows:
    rows: Rows = []
    for name, before, after in (
        ("Vertices", record.vertices_before, record.vertices_after),
        ("Triangles", record.faces_before, record.faces_after),
    ):
        if before is not None and after is not None:
            end = "" if before == after else f" \N{RIGHTWARDS ARROW} {after:,}"
            rows.append((name, f"{before:,}{end}"))
    if record.mean_edge_length is not None:
        rows.append(("Mean edge length, e", _number(record.mean_edge_length)))
    return rows


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


def _warnings(scene: Scene) -> list[str]:
    is_still = scene.after is not None and not pictures.has_moved(scene)
    texts = [pictures.NOTHING_MOVED] if is_still else []
    if scene.record is None:
        return texts
    texts += scene.record.warnings
    if scene.record.volume is not None and scene.record.volume.reason:
        texts.append(f"No volume: {scene.record.volume.reason}.")
    return texts


def _thinning(scene: Scene) -> list[str]:
    """What the pictures show of meshes beyond the memory."""
    meshes = (scene.before, scene.after)
    parts = [
        f"{pictures.count_of_vertices(mesh):,} of {n_vertices:,} vertices"
        for mesh, (_, n_vertices) in zip(meshes, scene.counts, strict=False)
        if mesh is not None
    ]
    if not parts:
        return []
    return [f"Beyond the memory: {' and '.join(parts)} are drawn, one in each cell of a grid."]


def _decimation(drawn: EncodedScene) -> list[str]:
    """What the page holds of the files' faces, where that is not all."""
    if not drawn.is_decimated:
        return []
    counts = f"{drawn.drawn_faces:,} of {drawn.faces:,} faces"
    if drawn.after_faces is not None:
        counts += f", and {drawn.drawn_after_faces:,} of {drawn.after_faces:,} after"
    how = "Short edges were contracted to one of their ends"
    return [f"Decimated for the page: {counts}. {how}. The numbers are those of the full meshes."]


def _precision(drawn: EncodedScene) -> list[str]:
    digits = max(0, -math.floor(math.log10(drawn.rounding)))
    upwards = math.ceil(drawn.rounding * 10.0**digits - 1e-9) / 10.0**digits
    rounding = f"{upwards:.{digits}f}" if digits < 9 else f"{upwards:.0e}"
    return [f"Coordinates are drawn to within {rounding} file units."]


def _keys(is_pair: bool, has_deviation: bool, has_colours: bool) -> str:
    """Rows of the table of keys for what not every page has."""
    split = (
        "drag the line; <kbd>[</kbd> <kbd>]</kbd>; arrows on the line; <kbd>1</kbd> before, "
        "<kbd>2</kbd> half, <kbd>3</kbd> after"
    )
    rows = (
        (is_pair, "Split", split),
        (has_deviation, "Deviation", "<kbd>d</kbd>"),
        (has_colours, "Colours of the file", "<kbd>c</kbd>"),
    )
    return "".join(
        f'<tr><th scope="row">{name}</th><td>{keys}</td></tr>\n'
        for is_there, name, keys in rows
        if is_there
    )


def _description(titles: Sequence[str], scene: Scene) -> str:
    if scene.after is None:
        return titles[0]
    words = f"{titles[0]} and {titles[1]}"
    if scene.deviation is None:
        return words
    return f"{words}, and the {pictures.deviation_name(scene).lower()}"


def _number(value: float | None) -> str:
    text = figure(value, ".3g")
    if "e" in text:
        digits, exponent = text.split("e")
        text = f"{digits}·10{str(int(exponent)).translate(_RAISED)}"
    return text.replace("-", _MINUS)


def _percent(value: float | None) -> str:
    return figure(value, "+.3g", " %").replace("-", _MINUS)


# Parts of pages


def viewer_script() -> str:
    """The viewer's script; it starts every ``msal-scene`` before it in the page."""
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
    """The elements of one scene, for a page that also holds ``viewer_script()`` (behind) and
    ``viewer_style()``.

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
