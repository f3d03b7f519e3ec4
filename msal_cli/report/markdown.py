"""The Markdown report: totals, what failed and why, and the files worst first.

It is made for the summary of a step on GitHub, which refuses more than 1 MiB, and for comments on
a change.  It is GitHub's Markdown, and nothing of a file's name is markup in it.  Rows that do not
fit into ``MOST_BYTES`` are left out, and the page says how many.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from msal_cli.job.display_names import escape_for_display, figure, shorten_name
from msal_cli.job.plain_data import value_at
from msal_cli.job.records import Failure, MeshRecord
from msal_cli.report.document import Run, Totals, plain, totals
from msal_cli.report.phrases import (
    chosen_text,
    command_text,
    failure_text,
    format_count,
    percent_text,
    seconds_text,
)
from msal_cli.report.ranking import WORDS, broken_gates, worst_first

MOST_BYTES = 900_000
"""Bytes of the largest report: below the 1 MiB that the summary of a step may have."""

MOST_ROWS = 1_000
"""Rows in a table: more is slow to show, and every file is in the other forms."""

_OPEN_ROWS = 25
_LONGEST_TEXT = 1_000
_LONGEST_COMMAND = 4_000

# All that Markdown, GitHub's extensions of it or HTML could take for more than text.  Underscores
# within words, which names are full of, are text everywhere.
_MARKUP = re.compile(
    r"[&<>|`*~$\\\[\]#@]|:(?=\S)|(?<=www)\.|(?<![^\W_])_|_(?![^\W_])", re.ASCII | re.IGNORECASE
)


@dataclass(frozen=True)
class _Table:
    """A section with a table: the first of ``n_rows`` rows, as Markdown.

    Figures are ``n_figures`` columns after the first two.
    """

    title: str
    words: str
    heads: tuple[str, ...]
    n_rows: int
    rows: Sequence[tuple[str, ...]]
    n_figures: int = 0


def render(run: Run, records: Sequence[MeshRecord], *, most_bytes: int = MOST_BYTES) -> bytes:
    """The report as UTF-8, in at most ``most_bytes`` (or what the page takes without rows)."""
    sums = totals(records)
    parts = [_heading(run, sums), _totals(run, sums), _settings(run)]
    left = most_bytes - sum(len(part.encode()) for part in parts)
    for table in _tables(worst_first(records)):
        # Many failures must not take the place of the figures.
        text = _section(table, left // 2)
        left -= len(text.encode())
        parts.insert(-1, text)
    return "".join(parts).encode()


# What comes before and after the tables


def _heading(run: Run, sums: Totals) -> str:
    n_broken = sums.gate_broken
    words = [
        f"{count:,} {word}"
        for count, word in (
            (sums.failed, "failed"),
            (n_broken, "broke a gate" if n_broken == 1 else "broke gates"),
            (sums.planned, "not finished"),
        )
        if count
    ]
    sign = "❌" if sums.failed or n_broken else "⚠️" if sums.planned or run.interrupted else "✅"
    files = format_count(sums.files, "file")
    return f"## {sign} msal denoise: {files}, {', '.join(words) or 'all well'}\n\n"


def _totals(run: Run, sums: Totals) -> str:
    spread, is_timed = sums.volume_change_percent, run.seconds > 0.0
    change = (
        ""
        if spread is None
        else (
            f"{percent_text(spread.median)} (from {percent_text(spread.lowest)} "
            f"to {percent_text(spread.highest)})"
        )
    )
    rows = (
        ("written", f"{sums.written:,}"),
        ("unchanged: no vertex moved", figure(sums.unchanged or None, ",")),
        ("up to date", figure(sums.up_to_date or None, ",")),
        ("not finished", figure(sums.planned or None, ",")),
        ("**failed**", f"**{sums.failed:,}**" if sums.failed else ""),
        ("vertices denoised", figure(sums.vertices or None, ",")),
        ("time", seconds_text(run.seconds) if is_timed else ""),
        ("chosen", _markup_free(chosen_text(sums.chosen))),
        ("volume change, median", change),
    )
    cells = "".join(f"| {word} | {text} |\n" for word, text in rows if text)
    return f"| | |\n|---|--:|\n{cells}\n"


def _settings(run: Run) -> str:
    command = command_text(run.command, _LONGEST_COMMAND)
    version, started, finished = map(escape_for_display, (run.version, run.started, run.finished))
    made = f"msal {version}, {started} to {finished}"
    settings = json.dumps(plain(dict(run.settings)), ensure_ascii=False)
    lines = [_markup_free(made)]
    lines += [f"Command: {_code(command)}"] if command else []
    lines += [f"Settings: {_code(settings[:_LONGEST_COMMAND])}"] if run.settings else []
    return (
        "<details><summary>Command and settings</summary>\n\n"
        + "\n\n".join(lines)
        + ("\n\n</details>\n")
    )


# Tables


def _tables(worst: Sequence[MeshRecord]) -> Iterator[_Table]:
    failed = [(one, one.error) for one in worst if one.error is not None]
    codes = Counter(failure.code for _, failure in failed)
    counts = ", ".join(f"{count:,} × {_code(code)}" for code, count in codes.most_common(12))
    rows = [_failure_row(*one) for one in failed[:MOST_ROWS]]
    yield _Table("Failed", counts, ("file", "reason", "hint"), len(failed), rows)
    broken = [(one, "; ".join(gates)) for one in worst if (gates := broken_gates(one))]
    yield _text_table("Broken gates", "gate", broken)
    yield _figure_table([one for one in worst if one.status not in ("failed", "planned")])
    warnings = [(record, one) for record in worst for one in record.warnings]
    yield _text_table("Warnings", "warning", warnings)


def _text_table(title: str, head: str, texts: Sequence[tuple[MeshRecord, str]]) -> _Table:
    rows = [(_name(record), _text(text)) for record, text in texts[:MOST_ROWS]]
    return _Table(title, "", ("file", head), len(texts), rows)


def _failure_row(record: MeshRecord, failure: Failure) -> tuple[str, ...]:
    why = f"{_text(failure_text(failure, with_code=False))} {_code(failure.code)}"
    return _name(record), why, _text(failure.hint)


_FIGURES = (
    ("mean move, edges", "displacement.mean_edges", ".3f"),
    ("max move, edges", "displacement.max_edges", ".3f"),
    ("max move, file units", "displacement.max", ".4g"),
    ("flipped", "flipped_faces", ","),
    ("outliers", "despiked", ","),
    ("seconds", "seconds.total", ".2f"),
)
_TO_REFERENCE = ("to reference, deg", "reference.mean_angular_error_deg", ".2f")


def _corners(record: MeshRecord) -> str:
    """The corners, for behind the vertices, where the file stores these (STL)."""
    return "" if record.corners is None else f" ({record.corners:,} corners)"


def _figure_table(done: Sequence[MeshRecord]) -> _Table:
    has_reference = any(record.reference is not None for record in done)
    has_choice = any(record.choice is not None for record in done)
    figures = (*_FIGURES, *([_TO_REFERENCE] if has_reference else []))
    heads = ("file", "status", "vertices", "volume", *(head for head, _, _ in figures))
    rows = [
        (
            _name(record),
            "**gate**" if broken_gates(record) else record.status,
            # Beside the vertices the corners, where the file stores these (STL).
            figure(
                record.vertices,
                ",",
                f" ({n:,} corners)" if (n := record.corners) is not None else "",
            ),
            percent_text(value_at(record, "volume.change_percent"))
            + (" (inside out)" if record.inside_out else ""),
            *(figure(value_at(record, path), form) for _, path, form in figures),
            *([_text(value_at(record, "choice.reason") or "")] if has_choice else []),
        )
        for record in done[:MOST_ROWS]
    ]
    n_figures = len(heads) - 2
    return _Table("Files", WORDS, heads + ("chosen",) * has_choice, len(done), rows, n_figures)


def _section(table: _Table, most_bytes: int) -> str:
    """A title and a table in about ``most_bytes``; nothing for a table without rows."""
    if not table.rows:
        return ""
    rule = ["---"] * len(table.heads)
    rule[2 : 2 + table.n_figures] = ["--:"] * table.n_figures
    head = f"{_line(table.heads)}{_line(rule)}"
    text = f"### {table.title}: {table.n_rows:,}\n\n"
    text += f"{table.words}\n\n" if table.words else ""
    lines: list[str] = []
    left = most_bytes - len(text.encode()) - 2 * len(head.encode()) - 200
    for row in table.rows:
        line = _line(row)
        left -= len(line.encode())
        if left < 0:
            break
        lines.append(line)
    text += f"{head}{''.join(lines[:_OPEN_ROWS])}\n"
    if lines[_OPEN_ROWS:]:
        more = f"{len(lines) - _OPEN_ROWS:,} more"
        inside = f"{head}{''.join(lines[_OPEN_ROWS:])}"
        text += f"<details><summary>{more}</summary>\n\n{inside}\n</details>\n\n"
    if n_left := table.n_rows - len(lines):
        text += f"{n_left:,} more are not shown here; they are in a report in .json or .csv.\n\n"
    return text


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |\n"


# Text that is no markup


def _name(record: MeshRecord) -> str:
    return _code("standard input" if record.input == "-" else record.input)


def _code(text: str) -> str:
    # Code by a tag, because a bar within backquotes would still end the cell.
    return f"<code>{_markup_free(shorten_name(escape_for_display(text), _LONGEST_COMMAND))}</code>"


def _text(text: str) -> str:
    text = escape_for_display(text)
    return _markup_free(text if len(text) <= _LONGEST_TEXT else f"{text[:_LONGEST_TEXT]} ...")


def _markup_free(text: str) -> str:
    """One line of text as Markdown that shows it; a character by its number is never markup."""
    return _MARKUP.sub(lambda one: f"&#{ord(one[0])};", text)
