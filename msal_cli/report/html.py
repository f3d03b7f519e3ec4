"""The HTML report: one page for a whole run, which needs no network and no other file.

It shows totals, failures, histograms, the worst files in 3D, and a table of all files, with
pictures, that can be sorted and filtered.

Pictures and scenes are made from the inputs and outputs, which are read once more.  A file that is
gone, or is no longer the one that was denoised, has no picture and no message.  Time, the size of
pictures and the number of faces are limited, the worst files come first, and the page says what
was left out because of the limits.

What comes from outside, mostly file names, is escaped in two places: ``escape`` for elements,
``_json`` for the data of the table.
"""

import hashlib
import json
import logging
import math
import os
import statistics
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from string import Template
from typing import Any, NamedTuple

from msal_cli.codecs import header
from msal_cli.codecs.colours import colour_table, map_colours
from msal_cli.codecs.mesh_file import Surface
from msal_cli.errors import format_count
from msal_cli.job.display_names import escape_for_display
from msal_cli.job.records import WITH_OUTPUT, MeshRecord, Run
from msal_cli.job.room import open_mesh
from msal_cli.job.settings import DEFAULT_BACKUP
from msal_cli.mesh import Mesh
from msal_cli.report import facts
from msal_cli.report.data import plain, setting_texts
from msal_cli.report.facts import Fact, Tone, Totals
from msal_cli.view import pages, pictures
from msal_cli.view.pages import asset, escape, to_base64
from msal_cli.view.panels import jpeg_bytes
from msal_cli.view.rendering import Image, shade
from msal_cli.view.scene import encode_scene

_log = logging.getLogger("msal")

_MAX_COMMAND = 20_000
_MAX_PROBLEMS = 200


class Pictures(NamedTuple):
    """JPEGs of one mesh from one viewpoint: before, after, and the deviation (None: not known); and
    the elements of ``pages.embed_scene`` if the mesh can be turned."""

    before: bytes
    after: bytes
    deviation: bytes | None = None
    scene: str = ""


class Gallery(NamedTuple):
    """Pictures by the path of the output, for the files that have some.

    ``legend`` are elements that explain the colours of all deviations.
    ``remarks`` say what was left out, and why.
    """

    pictures: Mapping[str, Pictures]
    legend: str = ""
    remarks: tuple[str, ...] = ()


EMPTY_GALLERY = Gallery({})


def render(run: Run, records: Sequence[MeshRecord], gallery: Gallery = EMPTY_GALLERY) -> bytes:
    """The page as UTF-8."""
    worst = facts.worst_first(records)
    columns, data = build_table(worst)
    shown = [gallery.pictures.get(record.output or "") for record in worst]
    images = [
        parts and [None if image is None else to_base64(image) for image in parts[:3]]
        for parts in shown
    ]
    scenes = [
        (record, parts.scene)
        for record, parts in zip(worst, shown, strict=True)
        if parts and parts.scene
    ]
    scripts = ([pages.viewer_script()] if scenes else []) + [asset(__file__, "report.js")]
    styles = ([pages.viewer_style()] if scenes else []) + [asset(__file__, "report.css")]
    sums = facts.totals(records)
    content = Template(asset(__file__, "report.html")).substitute(
        totals=_totals(run, sums),
        notes="".join(
            f'<p class="note">{escape(fact.word.capitalize())}: {escape(fact.text)}</p>'
            for fact in facts.total_facts(records, sums)
        ),
        problems=_problems(worst),
        scenes=_scenes(scenes),
        columns=_json(columns),
        heads="".join(
            f'<th scope="col"{" class=figure" if column["kind"] == "figure" else ""}>'
            f"{escape(column['title'])}<small>{escape(column['unit'])}</small></th>"
            for column in columns
        ),
        words=escape(facts.ORDER_TEXT),
        scale=gallery.legend if gallery.pictures else "",
        remarks="".join(f'<p class="note">{escape(remark)}</p>' for remark in gallery.remarks),
        settings=_settings(run),
        rows=_json(data),
        pictures=_json(images) if gallery.pictures else "null",
    )
    title, verdict = f"msal: {format_count(sums.files, 'file')}", _verdict(run, sums)
    return pages.build_page(title, content, scripts, styles, verdict=verdict, version=run.version)


# The table of all files, as data for the page's script


def build_table(records: Sequence[MeshRecord]) -> tuple[list[dict[str, str]], list[dict[str, Any]]]:
    """The columns, with ``kind`` ``name``, ``word`` or ``figure``, and a row for each record: its
    ``kind`` (``failed``, ``gate``, ``planned``, ``good``), ``values`` in the order of the columns
    (None: not known) and ``details``, pairs of a word and a text."""
    figures = facts.list_figures(records, facts.DETAIL)
    has_choice = any(record.choice is not None for record in records)
    heads = [("File", "", "name"), ("Status", "", "word")]
    heads += [("Chosen", "", "word")] if has_choice else []
    heads += [(item.title, item.unit, "figure") for item in figures]
    columns = [dict(zip(("title", "unit", "kind"), head, strict=True)) for head in heads]
    rows = []
    for record in records:
        kind = "gate" if facts.list_broken(record) else "good"
        kind = record.status if record.status in ("failed", "planned") else kind
        status = {"planned": "not done", "up-to-date": "up to date"}.get(
            record.status, "gate broken" if kind == "gate" else record.status
        )
        values: list[Any] = [facts.file_name(record.input), status]
        if has_choice:
            chosen = record.method.name if record.choice and record.method else ""
            values.append(escape_for_display(chosen))
        values += [_round(item.value(record)) for item in figures]
        details = [[fact.word.capitalize(), fact.text] for fact in facts.list_facts(record)]
        details += [["Output", escape_for_display(record.output)]] if record.output else []
        rows.append({"kind": kind, "values": values, "details": details})
    return columns, rows


def _round(value: float | None) -> float | None:
    """Round to six digits, which are enough to read; more would make large pages larger."""
    if value is None or isinstance(value, int):
        return value
    return float(f"{value:.6g}") if math.isfinite(value) else None


# Parts of the page


_KINDS: Mapping[Tone, str] = {"bad": "bad", "faint": "warn"}


def _verdict(run: Run, sums: Totals) -> str:
    chips = [
        (_KINDS[fact.tone], f"{fact.text} {fact.word}")
        for fact in facts.count_states(sums)
        if fact.tone in _KINDS
    ]
    if run.interrupted and not sums.planned:
        chips.append(("warn", "interrupted"))
    chips = chips or [("good", "all well" if sums.files else "nothing done")]
    parts = (f'<span class="chip {kind}">{escape(text)}</span>' for kind, text in chips)
    return f'<div class="verdict">{"".join(parts)}</div>'


def _totals(run: Run, sums: Totals) -> str:
    tiles = [
        Fact("file" if sums.files == 1 else "files", f"{sums.files:,}"),
        *facts.count_states(sums),
    ]
    if sums.vertices:
        tiles.append(Fact("vertices denoised", _count_text(sums.vertices)))
    if run.seconds > 0.0:
        tiles.append(Fact("wall time", facts.seconds_text(run.seconds)))
        if sums.vertices:
            rate = float(f"{sums.vertices / run.seconds:.3g}")
            tiles.append(Fact("vertices a second", _count_text(rate)))
    return "".join(
        f'<div class="tile {_KINDS.get(tile.tone, "")}"><b>{escape(tile.text)}</b>'
        f"<span>{escape(tile.word)}</span></div>"
        for tile in tiles
    )


def _problems(worst: Sequence[MeshRecord]) -> str:
    parts = []
    for title, heads, rows in facts.problem_tables(worst):
        cells = "".join(f'<th scope="col">{head.capitalize()}</th>' for head in ("file", *heads))
        lines = "".join(
            f"<tr><th scope=row>{escape(facts.file_name(record.input))}</th>"
            f"<td>{'</td><td>'.join(map(escape, texts))}</td></tr>"
            for record, texts in rows[:_MAX_PROBLEMS]
        )
        n_left = len(rows) - _MAX_PROBLEMS
        more = f'<p class="note">{n_left:,} more are in the table of all files.</p>'
        parts.append(
            f'<section class="problems"><h2>{title} <small>{len(rows):,}</small></h2>'
            f'<div class="scroll" tabindex="0" role="region" aria-label="{title}"><table><thead>'
            f"<tr>{cells}</tr></thead><tbody>{lines}</tbody></table></div>"
            f"{more if n_left > 0 else ''}</section>"
        )
    return "".join(parts)


def _scenes(scenes: Sequence[tuple[MeshRecord, str]]) -> str:
    if not scenes:
        return ""
    title = "The worst file in 3D" if len(scenes) == 1 else f"The worst {len(scenes)} in 3D"
    cards = []
    for record, elements in scenes:
        caption = "; ".join(
            fact.text if fact.word == "gate" else f"{fact.word} {fact.text}"
            for fact in facts.list_facts(record)
            if fact.word == "moved" or (fact.word == "gate" and fact.tone == "bad")
        )
        cards.append(
            f'<article class="card"><h3>{escape(facts.file_name(record.input))}</h3>'
            f'<p class="note">{escape(caption)}</p>{elements}</article>'
        )
    return f'<section><h2>{title}</h2><div class="cards">{"".join(cards)}</div></section>'


def _settings(run: Run) -> str:
    command = facts.command_text(run.command, _MAX_COMMAND)
    head = f"<h3>Command</h3><pre><code>{escape(command)}</code></pre>" if command else ""
    parts = []
    for title, values in (
        ("Settings", run.settings),
        ("Program and machine", {"msal": run.version, **run.machine}),
        ("Time", {"started": run.started, "finished": run.finished}),
    ):
        lines = "".join(
            f'<tr><th scope="row">{escape(name)}</th><td>{escape(value)}</td></tr>'
            for name, value in setting_texts(values)
        )
        parts.append(f'<div class="facts"><h3>{title}</h3><table>{lines}</table></div>')
    return f'{head}<div class="grid">{"".join(parts)}</div>'


def _count_text(number: float) -> str:
    return f"{number:,.0f}" if number < 1e7 else f"{number / 1e6:,.1f} M"


def _json(data: Any) -> str:
    """``data`` as the content of a script element; nothing in it can end the element or a line."""
    text = json.dumps(plain(data), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


# Pictures and scenes

_SIZE = 240, 180
_POSTER = 480, 320
_BACKGROUND = 236, 238, 241
# Moves below this, in mean edge lengths, are rounding.
_ROUNDING_EDGES = 1e-9

MAX_SECONDS, MAX_PICTURE_BYTES = 60.0, 14_000_000
"""Limits for the pictures of all files; a picture that was begun is finished."""

MAX_FACES = 1_000_000
"""A mesh with more faces gets no pictures."""

MAX_SCENES, MAX_SCENE_FACES = 5, 100_000
"""So many of the worst files can be turned in 3D, each with at most so many faces."""


def build_gallery(
    records: Sequence[MeshRecord],
    *,
    backup: str = DEFAULT_BACKUP,
    on_file: Callable[[int, int], None] | None = None,
) -> Gallery:
    """Pictures of as many files as the limits allow, and scenes of the worst ones.

    Never raises for a bad file.  ``backup`` is the suffix of the originals of files that were
    denoised in place.  ``on_file`` is called before each file with the number of files done and of
    all files.
    """
    reach = _reach(records)
    end = time.monotonic() + MAX_SECONDS
    images: dict[str, Pictures] = {}
    n_left = n_bytes = 0
    is_decimated = False
    # Only files with both meshes on this disk; an output of two runs may be from either of them.
    n_named = Counter(record.output for record in records)
    candidates = [
        record
        for record in facts.worst_first(records)
        if record.status in WITH_OUTPUT
        and n_named[record.output] == 1
        and not any(name == "-" or "://" in name for name in (record.input, record.output or "-"))
    ]
    for done, record in enumerate(candidates):
        if on_file is not None:
            on_file(done, len(candidates))
        is_over = time.monotonic() > end or n_bytes > MAX_PICTURE_BYTES
        if is_over or (record.triangles or record.faces or 0) > MAX_FACES:
            n_left += 1
            continue
        # The worst ones can be turned.
        key = f"scene{len(images)}" if len(images) < MAX_SCENES else ""
        try:
            drawn = _draw(record, backup, reach, key)
        except Exception:
            # A picture is an extra: no error here may prevent the report.
            _log.info("%s: no picture", record.input, exc_info=True)
            continue
        if drawn is not None:
            images[str(record.output)] = drawn
            n_bytes += sum(len(image or b"") for image in drawn[:3])
            is_decimated |= bool(key) and (record.triangles or 0) > MAX_SCENE_FACES
    remarks = []
    if n_left:
        remarks.append(
            f"{format_count(n_left, 'file')} without pictures, which are made of the worst files, "
            f"of up to {MAX_FACES:,} faces, in {MAX_SECONDS:.0f} seconds and "
            f"{MAX_PICTURE_BYTES / 1e6:.0f} MB; `msal view` makes others."
        )
    if is_decimated:
        remarks.append(
            f"In 3D, meshes of more than {MAX_SCENE_FACES:,} faces are decimated; the figures "
            "are those of the full meshes."
        )
    return Gallery(images, _draw_legend(reach), tuple(remarks))


def _draw(record: MeshRecord, backup: str, reach: float, key: str) -> Pictures | None:
    """Three pictures from one viewpoint, and a scene if it has a ``key``; None if a file is not
    what the record says.  Colours extend to ``reach`` mean edge lengths."""
    output = str(record.output)
    is_in_place = os.path.realpath(record.input) == os.path.realpath(output)
    source = record.input + backup if is_in_place else record.input
    before = _surface(source, record.input_sha256, record.format)
    after = _surface(output, record.output_sha256, None)
    if before is None or after is None:
        return None
    scene = pictures.scene_of(before, after, (source, output), to_surface=False)
    assert scene.after is not None
    camera = pictures.camera_of(scene, pictures.View())

    def image(mesh: Mesh, painted: Image | None, kind: str, size: tuple[int, int] = _SIZE) -> bytes:
        place = (mesh.vertices, mesh.faces, camera, *size)
        return jpeg_bytes(shade(*place, painted, background=_BACKGROUND, colours_are=kind))

    # The deviation is known if the faces are the same.
    moved, end = scene.deviation, reach * scene.before.mean_edge_length
    painted = None if moved is None else map_colours(moved, -end, end, "diverging")
    shown = Pictures(
        image(scene.before, scene.painted(0), "paint"),
        image(scene.after, scene.painted(1), "paint"),
        None if painted is None else image(scene.after, painted, "map"),
    )
    if not key:
        return shown
    data = encode_scene(
        scene.before,
        scene.after,
        moved,
        ends=(-end, end),
        view=camera.axes,
        colours=scene.colours,
        max_faces=MAX_SCENE_FACES,
    )
    poster = image(scene.after, scene.painted(1), "paint", _POSTER)
    scene_of = pages.embed_scene(key, data, picture=poster, description=f"{record.input}, after")
    return shown._replace(scene=scene_of)


def _surface(path: str, sha256: str | None, format: str | None) -> Surface | None:
    """The surface in the file at ``path``; None if it is missing, or has another SHA-256."""
    if not os.path.isfile(path):
        return None
    data = header.read_input(path, format)
    if sha256 is not None and hashlib.sha256(data).hexdigest() != sha256:
        return None
    return pictures.coloured_surface_of(open_mesh(data, path, format), path)


def _reach(records: Sequence[MeshRecord]) -> float:
    """Mean edge lengths at the ends of the colour scale, the same for all files.

    It is twice the displacement that 95 % of the vertices of a typical file stay below, rounded up,
    so that a bad file is visible.
    """
    done = [record for record in records if record.status in WITH_OUTPUT]
    moves = facts.known_values(done, "displacement.p95_edges")
    sizes = [size for size in moves if math.isfinite(size) and size > _ROUNDING_EDGES]
    if not sizes:
        return 0.5
    wanted = 2.0 * statistics.median(sizes)
    power = 10.0 ** math.floor(math.log10(wanted))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= wanted * 0.999)


def _draw_legend(reach: float) -> str:
    shades = colour_table("diverging")[::8]
    size = 100 / len(shades)
    rects = [
        f'<rect x="{at * size:.3f}" width="{size + 0.2:.3f}" height="10" fill="rgb{tuple(shade)}"/>'
        for at, shade in enumerate(shades.tolist())
    ]
    return (
        '<div class="scale"><span>Deviation, along the normals, the same scale for all files:'
        f"</span><span>\N{MINUS SIGN}{reach:g} (inwards)</span>"
        '<svg viewBox="0 0 100 10" preserveAspectRatio="none" aria-hidden="true">'
        f"{''.join(rects)}</svg><span>+{reach:g} mean edge lengths (outwards)</span></div>"
    )
