"""The HTML report: one page for a whole run, which needs no network and no other file.

Totals, what failed, histograms, the worst files in 3D, and a table of all files with their pictures
that can be sorted and filtered.  The page stays below ``MOST_BYTES``: pictures of the files that
are not among the worst are left out first, then scenes, and the page says so.

A content security policy lets the browser run only the scripts and the styles that were written
here, and load nothing.  What comes from outside, names of files mostly, is escaped in two places:
``_text`` for elements, ``_json`` for the data of the table.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import math
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

from msal_cli.job.display_names import shown
from msal_cli.job.records import DONE, MeshRecord
from msal_cli.report import histogram
from msal_cli.report import rows as table
from msal_cli.report.document import Run, Totals, plain, totals
from msal_cli.report.ranking import WORDS, broken_gates, worst_first
from msal_cli.report.text import chosen_text, percent_text, reason, seconds_text
from msal_cli.view.illustrations import EMPTY, Gallery, Pictures

MOST_BYTES = 25_000_000
"""Bytes of the largest page, as far as the figures of the files alone leave room."""

STATIC_ROWS = 100
"""Rows that stand in the page itself, for readers without scripts."""

_ASSETS = Path(__file__).parent / "assets"
_LONGEST_COMMAND = 20_000
_MOST_FAILURES = 200


def encoded(
    run: Run,
    records: Sequence[MeshRecord],
    gallery: Gallery = EMPTY,
    *,
    most_bytes: int = MOST_BYTES,
) -> bytes:
    """The page as UTF-8."""
    numbers = {id(record): at for at, record in enumerate(records)}
    worst = worst_first(records)
    order = [numbers[id(record)] for record in worst]
    columns = table.columns(worst)
    every = table.rows(worst)
    rows = _json(every)
    static = "".join(_static_row(columns, one) for one in every[:STATIC_ROWS])
    # What surrounds it takes some 50 kB.
    room = most_bytes - len(rows) - len(static) - 200_000 - len(gallery.script)
    scenes, room = _fitting_scenes(order, gallery.scenes, room)
    pictures, n_dropped = _fitting_pictures(order, gallery.pictures, room)
    remarks = list(gallery.remarks)
    sums = totals(records)
    if sums.chosen:
        remarks.insert(0, f"Chosen by --auto: {chosen_text(sums.chosen)}.")
    if n_dropped:
        remarks.append(
            f"Pictures of {n_dropped:,} files that are not among the worst were left out, "
            f"to keep this page below {most_bytes / 1e6:.0f} MB."
        )
    scripts = ([gallery.script] if scenes else []) + [_asset("report.js")]
    styles = ([gallery.style] if scenes else []) + [_asset("report.css")]
    shown_scenes = [(records[at], scenes[at]) for at in order if at in scenes]
    page = Template(_asset("report.html")).substitute(
        policy=html.escape(_policy(scripts, styles)),
        version=_text(run.version),
        title=_text(_title(records)),
        styles="".join(f"<style>{one}</style>" for one in styles),
        verdict=_verdict(run, records, sums),
        totals=_totals(run, records, sums),
        problems=_problems(worst),
        histograms=_histograms(records),
        scenes=_scenes(shown_scenes),
        columns=_json(columns),
        heads="".join(_head(one) for one in columns),
        static=static,
        beyond=_beyond(len(records)),
        words=_text(WORDS),
        scale=_scale(gallery) if pictures else "",
        remarks="".join(f'<p class="note">{_text(one)}</p>' for one in remarks),
        settings=_settings(run),
        rows=rows,
        pictures=_json(pictures) if pictures else "null",
        scripts="".join(f"<script>{one}</script>" for one in scripts),
    )
    return page.encode("utf-8")


# What fits


def _fitting_scenes(
    order: Sequence[int], scenes: Mapping[int, str], room: int
) -> tuple[dict[int, str], int]:
    """The scenes of the worst files that take no more than half of the page, and what is left."""
    kept: dict[int, str] = {}
    most = room // 2
    for at in order:
        if at in scenes and len(scenes[at]) <= most:
            kept[at] = scenes[at]
            most -= len(scenes[at])
            room -= len(scenes[at])
    return kept, room


def _fitting_pictures(
    order: Sequence[int], pictures: Mapping[int, Pictures], room: int
) -> tuple[list[list[str | None] | None], int]:
    """The pictures of the worst files, in the order of the rows, and how many did not fit."""
    kept: list[list[str | None] | None] = []
    n_dropped = 0
    for at in order:
        found = pictures.get(at)
        texts = None if found is None else _base64(found)
        size = sum(len(one or "") + 4 for one in texts) if texts else 0
        if texts and (n_dropped or size > room):
            n_dropped += 1
            texts = None
        else:
            room -= size
        kept.append(texts)
    while kept and kept[-1] is None:
        kept.pop()
    return kept, n_dropped


def _base64(pictures: Pictures) -> list[str | None]:
    several = (pictures.before, pictures.after, pictures.deviation)
    return [None if one is None else base64.b64encode(one).decode("ascii") for one in several]


# Parts of the page


def _title(records: Sequence[MeshRecord]) -> str:
    return f"msal: {_counted(len(records), 'file')}"


def _verdict(run: Run, records: Sequence[MeshRecord], sums: Totals) -> str:
    chips = []
    if sums.failed:
        chips.append(("bad", f"{sums.failed:,} failed"))
    if sums.gate_broken:
        files = "file breaks" if sums.gate_broken == 1 else "files break"
        chips.append(("bad", f"{sums.gate_broken:,} {files} a gate"))
    if sums.planned:
        chips.append(("warn", f"{sums.planned:,} not finished"))
    elif run.interrupted:
        chips.append(("warn", "interrupted"))
    if not chips:
        chips.append(("good", "all well" if records else "nothing done"))
    return "".join(f'<span class="chip {kind}">{_text(told)}</span>' for kind, told in chips)


def _totals(run: Run, records: Sequence[MeshRecord], sums: Totals) -> str:
    tiles = [(f"{sums.files:,}", "files" if sums.files != 1 else "file", "")]
    for count, word, kind in (
        (sums.written, "written", ""),
        (sums.unchanged, "unchanged", ""),
        (sums.up_to_date, "up to date", ""),
        (sums.planned, "not finished", "warn"),
        (sums.gate_broken, "gate broken", "bad"),
        (sums.failed, "failed", "bad"),
    ):
        if count:
            tiles.append((f"{count:,}", word, kind))
    if sums.vertices:
        tiles.append((_short(sums.vertices), "vertices denoised", ""))
    if run.seconds > 0.0:
        tiles.append((seconds_text(run.seconds), "wall time", ""))
        if sums.vertices:
            rate = float(f"{sums.vertices / run.seconds:.3g}")
            tiles.append((_short(rate), "vertices a second", ""))
    spread = sums.volume_change_percent
    if spread is not None:
        tiles.append((percent_text(spread.median), "median volume change", ""))
    moved = [one.displacement.max_edges for one in records if one.displacement is not None]
    if moved and math.isfinite(max(moved)):
        tiles.append((f"{max(moved):.3g}", "edges, largest move", ""))
    return "".join(
        f'<div class="tile {kind}"><b>{_text(figure)}</b><span>{_text(word)}</span></div>'
        for figure, word, kind in tiles
    )


def _problems(worst: Sequence[MeshRecord]) -> str:
    """What failed with reason and hint, broken gates and warnings; nothing if all is well."""
    failed = [record for record in worst if record.error is not None]
    broken = [record for record in worst if broken_gates(record)]
    warned = [record for record in worst if record.warnings and record.error is None]
    parts = []
    if failed:
        lines = "".join(map(_failure, failed[:_MOST_FAILURES]))
        parts.append(_problem_table("Failed", len(failed), ("File", "Reason", "What to do"), lines))
    if broken:
        lines = "".join(
            f"<tr><th scope=row>{_name(record)}</th><td>{gates}</td></tr>"
            for record in broken[:_MOST_FAILURES]
            for gates in ["<br>".join(map(_text, broken_gates(record)))]
        )
        parts.append(_problem_table("Broken gates", len(broken), ("File", "Gate"), lines))
    if warned:
        lines = "".join(
            f"<tr><th scope=row>{_name(record)}</th><td>{texts}</td></tr>"
            for record in warned[:_MOST_FAILURES]
            for texts in ["<br>".join(map(_text, record.warnings))]
        )
        parts.append(_problem_table("Warnings", len(warned), ("File", "Warning"), lines))
    return "".join(parts)


def _problem_table(title: str, count: int, heads: Sequence[str], lines: str) -> str:
    cells = "".join(f'<th scope="col">{one}</th>' for one in heads)
    more = (
        f'<p class="note">{count - _MOST_FAILURES:,} more stand in the table of all files.</p>'
        if count > _MOST_FAILURES
        else ""
    )
    return (
        f'<section class="problems"><h2>{title} <small>{count:,}</small></h2>'
        f'<div class="scroll" tabindex="0" role="region" aria-label="{title}">'
        f"<table><thead><tr>{cells}</tr></thead><tbody>{lines}</tbody></table></div>{more}</section>"
    )


def _failure(record: MeshRecord) -> str:
    failure = record.error
    if failure is None:
        return ""
    why = _text(reason(failure.where, failure.message, ""))
    return (
        f"<tr><th scope=row>{_name(record)}</th><td>{why} <code>{_text(failure.code)}</code></td>"
        f"<td>{_text(failure.hint)}</td></tr>"
    )


def _histograms(records: Sequence[MeshRecord]) -> str:
    changes = [
        one.volume.change_percent
        for one in records
        if one.volume is not None and one.volume.change_percent is not None
    ]
    moves = [one.displacement.max_edges for one in records if one.displacement is not None]
    times = [one.seconds.total for one in records if one.seconds is not None and one.status in DONE]
    several: tuple[tuple[str, str, list[float], Callable[[float], str]], ...] = (
        ("Volume change", "closed files", changes, _percent),
        ("Largest displacement", "mean edge lengths", moves, _figure),
        ("Time for a file", "seconds", times, _figure),
    )
    parts = []
    for title, note, values, words in several:
        if drawn := histogram.svg(title, values, words):
            caption = f"<figcaption><b>{title}</b> <span>{note}</span></figcaption>"
            parts.append(f'<figure class="histogram">{caption}{drawn}</figure>')
    inner = "".join(parts)
    return f'<section class="histograms" aria-label="Histograms">{inner}</section>' if parts else ""


def _scenes(scenes: Sequence[tuple[MeshRecord, str]]) -> str:
    if not scenes:
        return ""
    title = "The worst file in 3D" if len(scenes) == 1 else f"The worst {len(scenes)} in 3D"
    cards = "".join(
        f'<article class="card"><h3>{_name(record)}</h3><p class="note">{_caption(record)}</p>'
        f"{elements}</article>"
        for record, elements in scenes
    )
    return f'<section><h2>{title}</h2><div class="cards">{cards}</div></section>'


def _caption(record: MeshRecord) -> str:
    parts = list(broken_gates(record))
    if record.displacement is not None:
        parts.append(f"moved at most {record.displacement.max_edges:.3g} mean edge lengths")
    if record.volume is not None and record.volume.valid:
        inside_out = ", inside out" if record.inside_out else ""
        parts.append(f"volume {percent_text(record.volume.change_percent)}{inside_out}")
    return _text("; ".join(parts))


def _scale(gallery: Gallery) -> str:
    scale = gallery.scale
    if scale is None:
        return ""
    n = max(1, len(scale.colours))
    wide = f'width="{100 / n + 0.2:.3f}" height="10"'
    rects = "".join(
        f'<rect x="{100 * at / n:.3f}" {wide} fill="{_text(one)}"/>'
        for at, one in enumerate(scale.colours)
    )
    return (
        f'<div class="scale"><span>{_text(scale.title)}</span><span>{_text(scale.low)}</span>'
        f'<svg viewBox="0 0 100 10" preserveAspectRatio="none" aria-hidden="true">{rects}</svg>'
        f"<span>{_text(scale.high)}</span></div>"
    )


def _head(column: Mapping[str, str]) -> str:
    kind = ' class="figure"' if column["kind"] == "figure" else ""
    note = f"<small>{_text(column['unit'])}</small>" if column["unit"] else ""
    return f'<th scope="col"{kind}>{_text(column["title"])}{note}</th>'


def _static_row(columns: Sequence[Mapping[str, str]], data: Mapping[str, Any]) -> str:
    why = dict(data["details"])
    cells = "".join(
        _static_cell(one, value, why.get(one["title"], ""))
        for one, value in zip(columns, data["values"], strict=True)
    )
    if data["kind"] == "failed":
        figures = [one for one in columns if one["kind"] == "figure"]
        first = "".join(map(_static_cell, columns[: -len(figures)], data["values"]))
        cells = f'{first}<td colspan="{len(figures)}">{_text(data["details"][0][1])}</td>'
    return f'<tr class="{_text(data["kind"])}">{cells}</tr>'


def _static_cell(column: Mapping[str, str], value: Any, why: str = "") -> str:
    """A cell of the table; ``why`` explains a word where one points at it."""
    if column["kind"] == "name":
        return f'<th scope="row">{_text(value)}</th>'
    if column["kind"] != "figure":
        title = f' title="{_text(why)}"' if why else ""
        return f"<td{title}>{_text(value or '')}</td>"
    return f'<td class="figure">{"" if value is None else f"{value:,.4g}"}</td>'


def _beyond(count: int) -> str:
    if count <= STATIC_ROWS:
        return ""
    return f'<noscript><p class="note">{count - STATIC_ROWS:,} more need scripts.</p></noscript>'


def _settings(run: Run) -> str:
    command = shlex.join(run.command)
    if len(command) > _LONGEST_COMMAND:
        command = f"{command[:_LONGEST_COMMAND]} ..."
    parts = []
    if command:
        parts.append(f"<h3>Command</h3><pre><code>{_text(command)}</code></pre>")
    for title, data in (
        ("Settings", {**run.settings}),
        ("Program and machine", {"msal": run.version, **run.machine}),
        ("Time", {"started": run.started, "finished": run.finished}),
    ):
        lines = "".join(
            f'<tr><th scope="row">{_text(name)}</th><td>{_text(value)}</td></tr>'
            for name, value in _flat("", data)
        )
        parts.append(f'<div class="facts"><h3>{title}</h3><table>{lines}</table></div>')
    return f'{"".join(parts[:-3])}<div class="grid">{"".join(parts[-3:])}</div>'


def _flat(prefix: str, data: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for name, value in data.items():
        if isinstance(value, Mapping):
            yield from _flat(f"{prefix}{name}.", value)
        elif isinstance(value, list | tuple):
            if value:
                yield f"{prefix}{name}", ", ".join(map(str, value))
        elif value is not None and value != "":
            yield (
                f"{prefix}{name}",
                "yes" if value is True else "no" if value is False else str(value),
            )


# Words


def _name(record: MeshRecord) -> str:
    return _text("standard input" if record.input == "-" else record.input)


def _text(text: str) -> str:
    """``text`` as it may stand between tags and within quotes."""
    return html.escape(shown(str(text)), quote=True)


def _json(data: Any) -> str:
    """``data`` as the content of a script element: nothing in it ends the element or a line."""
    text = json.dumps(plain(data), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    for one in "<>&\u2028\u2029":
        text = text.replace(one, f"\\u{ord(one):04x}")
    return text


def _counted(count: int, word: str) -> str:
    return f"{count:,} {word}" if count == 1 else f"{count:,} {word}s"


def _short(number: float) -> str:
    """A large number in few signs: ``718,940``, ``12.3 M``."""
    if number < 1e6:
        return f"{number:,.0f}"
    return f"{number / 1e6:.3g} M" if number < 999.5e6 else f"{number / 1e9:.3g} G"


def _percent(value: float) -> str:
    return f"{value:+.3g} %"


def _figure(value: float) -> str:
    return f"{value:.3g}"


# The page and its policy


def _policy(scripts: Sequence[str], styles: Sequence[str]) -> str:
    return "; ".join(
        (
            "default-src 'none'",
            f"script-src {' '.join(map(_source, scripts))}",
            f"style-src {' '.join(map(_source, styles))}",
            "img-src data:",
            "base-uri 'none'",
            "form-action 'none'",
        )
    )


def _source(text: str) -> str:
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
    return f"'sha256-{digest}'"


def _asset(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")
