"""The HTML report: one page for a whole run, which needs no network and no other file.

Totals, what failed, histograms, the worst files in 3D, and a table of all files with their pictures
that can be sorted and filtered.  The page stays below ``MOST_BYTES``: pictures of the files that
are not among the worst are left out first, then scenes, and the page says so.

A content security policy lets the browser run only the scripts and the styles that were written
here, and load nothing.  What comes from outside, names of files mostly, is escaped in two places:
``escape`` for elements, ``_json`` for the data of the table.
"""

from __future__ import annotations

import html
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from string import Template
from typing import Any

from msal_cli.job.display_names import figure
from msal_cli.job.records import DONE, MeshRecord
from msal_cli.report import histogram
from msal_cli.report import rows as table
from msal_cli.report.document import Run, Totals, known_values, plain, totals
from msal_cli.report.phrases import (
    chosen_text,
    command_text,
    failure_text,
    file_name,
    format_count,
    percent_text,
    seconds_text,
    unsure_text,
)
from msal_cli.report.ranking import WORDS, broken_gates, worst_first
from msal_cli.view.html_parts import asset, content_policy, escape, to_base64
from msal_cli.view.illustrations import EMPTY, Gallery, Pictures

MOST_BYTES = 25_000_000
"""Bytes of the largest page, as far as the figures of the files alone leave room."""

STATIC_ROWS = 100
"""Rows in the page itself, for readers without scripts."""

_LONGEST_COMMAND = 20_000
_MOST_FAILURES = 200


def render(
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
        remarks.insert(0, f"Chosen: {chosen_text(sums.chosen)}.")
    if n_dropped:
        remarks.append(
            f"Pictures of {n_dropped:,} files that are not among the worst were left out, "
            f"to keep this page below {most_bytes / 1e6:.0f} MB."
        )
    scripts = ([gallery.script] if scenes else []) + [asset(__file__, "report.js")]
    styles = ([gallery.style] if scenes else []) + [asset(__file__, "report.css")]
    shown_scenes = [(records[at], scenes[at]) for at in order if at in scenes]
    page = Template(asset(__file__, "report.html")).substitute(
        policy=content_policy(scripts, styles),
        version=escape(run.version),
        title=f"msal: {format_count(len(records), 'file')}",
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
        words=escape(WORDS),
        scale=_scale(gallery) if pictures else "",
        remarks="".join(f'<p class="note">{escape(one)}</p>' for one in remarks),
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
        several = (found.before, found.after, found.deviation) if found else ()
        texts = [None if one is None else to_base64(one) for one in several]
        size = sum(len(one or "") + 4 for one in texts)
        if texts and (n_dropped or size > room):
            n_dropped += 1
            kept.append(None)
        else:
            room -= size
            kept.append(texts or None)
    while kept and kept[-1] is None:
        kept.pop()
    return kept, n_dropped


# Parts of the page


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
    return "".join(f'<span class="chip {kind}">{escape(text)}</span>' for kind, text in chips)


def _totals(run: Run, records: Sequence[MeshRecord], sums: Totals) -> str:
    moves = known_values(records, "displacement.max_edges")
    spread = sums.volume_change_percent
    is_timed = run.seconds > 0.0
    rate = float(f"{sums.vertices / run.seconds:.3g}") if is_timed else 0.0
    tiles = [
        (f"{count:,}", word, kind)
        for count, word, kind in (
            (sums.written, "written", ""),
            (sums.unchanged, "unchanged", ""),
            (sums.up_to_date, "up to date", ""),
            (sums.planned, "not finished", "warn"),
            (sums.gate_broken, "gate broken", "bad"),
            (sums.failed, "failed", "bad"),
        )
        if count
    ]
    tiles.insert(0, (f"{sums.files:,}", "files" if sums.files != 1 else "file", ""))
    if sums.vertices:
        tiles.append((_short(sums.vertices), "vertices denoised", ""))
    if is_timed:
        tiles.append((seconds_text(run.seconds), "wall time", ""))
    if is_timed and sums.vertices:
        tiles.append((_short(rate), "vertices a second", ""))
    if spread is not None:
        tiles.append((percent_text(spread.median), "median volume change", ""))
    if moves and math.isfinite(max(moves)):
        tiles.append((f"{max(moves):.3g}", "edges, largest move", ""))
    return "".join(
        f'<div class="tile {kind}"><b>{escape(text)}</b><span>{escape(word)}</span></div>'
        for text, word, kind in tiles
    )


def _problems(worst: Sequence[MeshRecord]) -> str:
    """What failed with reason and hint, broken gates, warnings, and what may be noise or texture;
    nothing if all is well."""
    failed = [(one, _failure_cells(one)) for one in worst if one.error is not None]
    broken = [(one, [_lines(gates)]) for one in worst if (gates := broken_gates(one))]
    warned = [(one, [_lines(one.warnings)]) for one in worst if one.warnings and not one.error]
    unsure = [(one, [escape(text)]) for one in worst if (text := unsure_text(one))]
    return (
        _problem_table("Failed", ("File", "Reason", "What to do"), failed)
        + _problem_table("Broken gates", ("File", "Gate"), broken)
        + _problem_table("Warnings", ("File", "Warning"), warned)
        + _problem_table("Look at these", ("File", "Noise or texture"), unsure)
    )


def _failure_cells(record: MeshRecord) -> list[str]:
    failure = record.error
    assert failure is not None
    why = escape(failure_text(failure, with_code=False))
    return [f"{why} <code>{escape(failure.code)}</code>", escape(failure.hint)]


def _lines(texts: Sequence[str]) -> str:
    return "<br>".join(map(escape, texts))


def _problem_table(
    title: str, heads: Sequence[str], rows: Sequence[tuple[MeshRecord, list[str]]]
) -> str:
    if not rows:
        return ""
    cells = "".join(f'<th scope="col">{one}</th>' for one in heads)
    lines = "".join(
        f"<tr><th scope=row>{_name(record)}</th><td>{'</td><td>'.join(inner)}</td></tr>"
        for record, inner in rows[:_MOST_FAILURES]
    )
    n_left = len(rows) - _MOST_FAILURES
    more = f'<p class="note">{n_left:,} more are in the table of all files.</p>'
    return (
        f'<section class="problems"><h2>{title} <small>{len(rows):,}</small></h2>'
        f'<div class="scroll" tabindex="0" role="region" aria-label="{title}"><table><thead><tr>'
        f"{cells}</tr></thead><tbody>{lines}</tbody></table></div>{more if n_left > 0 else ''}"
        "</section>"
    )


def _histograms(records: Sequence[MeshRecord]) -> str:
    done = [record for record in records if record.status in DONE]
    parts = []
    for title, note, values, form in (
        ("Volume change", "closed files", known_values(records, "volume.change_percent"), "+.3g"),
        ("Largest displacement", "mean edge lengths",
         known_values(records, "displacement.max_edges"), ".3g"),
        ("Time for a file", "seconds", known_values(done, "seconds.total"), ".3g"),
    ):  # fmt: skip
        if drawn := histogram.svg(title, values, form, " %" if "+" in form else ""):
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
    return escape("; ".join(parts))


def _scale(gallery: Gallery) -> str:
    scale = gallery.scale
    if scale is None:
        return ""
    n = max(1, len(scale.colours))
    wide = f'width="{100 / n + 0.2:.3f}" height="10"'
    rects = "".join(
        f'<rect x="{100 * at / n:.3f}" {wide} fill="{escape(one)}"/>'
        for at, one in enumerate(scale.colours)
    )
    return (
        f'<div class="scale"><span>{escape(scale.title)}</span><span>{escape(scale.low)}</span>'
        f'<svg viewBox="0 0 100 10" preserveAspectRatio="none" aria-hidden="true">{rects}</svg>'
        f"<span>{escape(scale.high)}</span></div>"
    )


def _head(column: Mapping[str, str]) -> str:
    kind = ' class="figure"' if column["kind"] == "figure" else ""
    note = f"<small>{escape(column['unit'])}</small>" if column["unit"] else ""
    return f'<th scope="col"{kind}>{escape(column["title"])}{note}</th>'


def _static_row(columns: Sequence[Mapping[str, str]], row: Mapping[str, Any]) -> str:
    why = dict(row["details"])
    cells = []
    for column, value in zip(columns, row["values"], strict=True):
        if column["kind"] == "name":
            cells.append(f'<th scope="row">{escape(value)}</th>')
        elif column["kind"] == "figure":
            label = escape(", ".join(filter(None, (column["title"], column["unit"]))))
            cells.append(f'<td class="figure" data-title="{label}">{figure(value, ",.4g")}</td>')
        else:
            # The detail of the column's name explains the word where one points at it.
            detail = why.get(column["title"], "") if row["kind"] != "failed" else ""
            title = f' title="{escape(detail)}"' if detail else ""
            cells.append(f"<td{title}>{escape(value or '')}</td>")
    if row["kind"] == "failed":
        n_figures = sum(column["kind"] == "figure" for column in columns)
        cells[-n_figures:] = [f'<td colspan="{n_figures}">{escape(row["details"][0][1])}</td>']
    return f'<tr class="{escape(row["kind"])}">{"".join(cells)}</tr>'


def _beyond(count: int) -> str:
    if count <= STATIC_ROWS:
        return ""
    return f'<noscript><p class="note">{count - STATIC_ROWS:,} more need scripts.</p></noscript>'


def _settings(run: Run) -> str:
    command = command_text(run.command, _LONGEST_COMMAND)
    head = f"<h3>Command</h3><pre><code>{escape(command)}</code></pre>" if command else ""
    parts = []
    for title, data in (
        ("Settings", run.settings),
        ("Program and machine", {"msal": run.version, **run.machine}),
        ("Time", {"started": run.started, "finished": run.finished}),
    ):
        lines = "".join(
            f'<tr><th scope="row">{escape(name)}</th><td>{escape(value)}</td></tr>'
            for name, value in _flat("", data)
        )
        parts.append(f'<div class="facts"><h3>{title}</h3><table>{lines}</table></div>')
    return f'{head}<div class="grid">{"".join(parts)}</div>'


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


def _name(record: MeshRecord) -> str:
    return html.escape(file_name(record.input))


def _json(data: Any) -> str:
    """``data`` as the content of a script element: nothing in it ends the element or a line."""
    text = json.dumps(plain(data), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    for one in "<>&\u2028\u2029":
        text = text.replace(one, f"\\u{ord(one):04x}")
    return text


def _short(number: float) -> str:
    """A large number in few signs: ``718,940``, ``12.3 M``."""
    if number < 1e6:
        return f"{number:,.0f}"
    return f"{number / 1e6:.3g} M" if number < 999.5e6 else f"{number / 1e9:.3g} G"
