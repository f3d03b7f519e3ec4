"""The Markdown report: totals, what failed and why, and the files worst first.

It is made for the summary of a step on GitHub, which refuses more than 1 MiB, and for comments on
a change.  It is GitHub's Markdown, and nothing of a file's name is markup in it.  Rows that do not
fit into ``MOST_BYTES`` are left out, and the page says how many.
"""

from __future__ import annotations

import json
import re
import shlex
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from msal_cli.job.display_names import shortened, shown
from msal_cli.job.records import MeshRecord
from msal_cli.report.document import Run, Totals, plain, totals
from msal_cli.report.ranking import WORDS, broken_gates, worst_first
from msal_cli.report.text import chosen_text, percent_text, rate_text, seconds_text

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
    rows: list[tuple[str, ...]]
    n_figures: int = 0


def encoded(run: Run, records: Sequence[MeshRecord], *, most_bytes: int = MOST_BYTES) -> bytes:
    """The report as UTF-8, in at most ``most_bytes`` (or what the page takes without rows)."""
    sums = totals(records)
    parts = [_heading(run, records, sums), _totals(run, records, sums), _settings(run)]
    left = most_bytes - sum(len(part.encode()) for part in parts)
    for table in _tables(worst_first(records)):
        # Many failures must not take the place of the figures.
        text = _section(table, left // 2)
        left -= len(text.encode())
        parts.insert(-1, text)
    return "".join(parts).encode()


# What comes before and after the tables


def _heading(run: Run, records: Sequence[MeshRecord], sums: Totals) -> str:
    n_broken = sum(bool(broken_gates(record)) for record in records)
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
    files = "1 file" if sums.files == 1 else f"{sums.files:,} files"
    return f"## {sign} msal denoise: {files}, {', '.join(words) or 'all well'}\n\n"


def _totals(run: Run, records: Sequence[MeshRecord], sums: Totals) -> str:
    rows = [
        ("written", f"{sums.written:,}"),
        ("unchanged: no vertex moved", f"{sums.unchanged:,}" if sums.unchanged else ""),
        ("up to date", f"{sums.up_to_date:,}" if sums.up_to_date else ""),
        ("not finished", f"{sums.planned:,}" if sums.planned else ""),
        ("**failed**", f"**{sums.failed:,}**" if sums.failed else ""),
        ("vertices denoised", f"{sums.vertices:,}" if sums.vertices else ""),
        ("time", seconds_text(run.seconds) if run.seconds > 0.0 else ""),
    ]
    if sums.vertices and run.seconds > 0.0:
        rows.append(("vertices/s", rate_text(sums.vertices / run.seconds)))
    if sums.chosen:
        rows.append(("chosen by --auto", _markup_free(chosen_text(sums.chosen))))
    spread = sums.volume_change_percent
    if spread is not None:
        rows.append(
            (
                "volume change, median",
                f"{percent_text(spread.median)} (from {percent_text(spread.lowest)} "
                f"to {percent_text(spread.highest)})",
            )
        )
    cells = "".join(f"| {word} | {figure} |\n" for word, figure in rows if figure)
    return f"| | |\n|---|--:|\n{cells}\n"


def _settings(run: Run) -> str:
    command = shlex.join(run.command)
    if len(command) > _LONGEST_COMMAND:
        command = f"{command[:_LONGEST_COMMAND]} ..."
    told = f"msal {shown(run.version)}, {shown(run.started)} to {shown(run.finished)}"
    settings = json.dumps(plain(dict(run.settings)), ensure_ascii=False)
    lines = [_markup_free(told)]
    lines += [f"Command: {_code(command)}"] if command else []
    lines += [f"Settings: {_code(settings[:_LONGEST_COMMAND])}"] if run.settings else []
    return (
        "<details><summary>Command and settings</summary>\n\n"
        + "\n\n".join(lines)
        + ("\n\n</details>\n")
    )


# Tables


def _tables(worst: Sequence[MeshRecord]) -> Iterator[_Table]:
    failed = [record for record in worst if record.error is not None]
    codes = Counter(record.error.code for record in failed if record.error is not None)
    told = ", ".join(f"{count:,} × {_code(code)}" for code, count in codes.most_common(12))
    rows = [_failure(record) for record in failed[:MOST_ROWS]]
    yield _Table("Failed", told, ("file", "reason", "hint"), len(failed), rows)
    broken = [(record, gates) for record in worst if (gates := broken_gates(record))]
    rows = [(_name(record), _text("; ".join(gates))) for record, gates in broken[:MOST_ROWS]]
    yield _Table("Broken gates", "", ("file", "gate"), len(broken), rows)
    done = [record for record in worst if record.status not in ("failed", "planned")]
    rows = [_figures(record) for record in done[:MOST_ROWS]]
    heads: tuple[str, ...] = _HEADS
    if any(record.reference is not None for record in done):
        heads = (*heads, "to reference, deg")
        rows = [
            (*row, _to_reference(record))
            for row, record in zip(rows, done[:MOST_ROWS], strict=True)
        ]
    n_figures = len(heads) - 2
    if any(record.choice is not None for record in done):
        heads = (*heads, "chosen")
        rows = [(*row, _chosen(record)) for row, record in zip(rows, done[:MOST_ROWS], strict=True)]
    yield _Table("Files", WORDS, heads, len(done), rows, n_figures)
    warnings = [(record, one) for record in worst for one in record.warnings]
    rows = [(_name(record), _text(one)) for record, one in warnings[:MOST_ROWS]]
    yield _Table("Warnings", "", ("file", "warning"), len(warnings), rows)


_HEADS = (
    "file",
    "status",
    "vertices",
    "volume",
    "mean move, edges",
    "max move, edges",
    "max move, file units",
    "flipped",
    "seconds",
)


def _figures(record: MeshRecord) -> tuple[str, ...]:
    volume, moved, seconds = record.volume, record.displacement, record.seconds
    change = percent_text(volume.change_percent if volume is not None else None)
    return (
        _name(record),
        "**gate**" if broken_gates(record) else record.status,
        _vertices(record),
        change + (" (inside out)" if record.inside_out else ""),
        f"{moved.mean_edges:.3f}" if moved is not None else "",
        f"{moved.max_edges:.3f}" if moved is not None else "",
        f"{moved.max:.4g}" if moved is not None else "",
        f"{record.flipped_faces:,}" if record.flipped_faces is not None else "",
        f"{seconds.total:.2f}" if seconds is not None else "",
    )


def _vertices(record: MeshRecord) -> str:
    """Vertices, with the corners where the file stores these (STL)."""
    beside = f" ({record.corners:,} corners)" if record.corners is not None else ""
    return "" if record.vertices is None else f"{record.vertices:,}{beside}"


def _chosen(record: MeshRecord) -> str:
    """Why --auto did what it did; empty without it."""
    return "" if record.choice is None else _text(record.choice.reason)


def _to_reference(record: MeshRecord) -> str:
    """The mean angle to the reference's face normals; empty if it is not known."""
    angle = record.reference.mean_angular_error_deg if record.reference is not None else None
    return "" if angle is None else f"{angle:.2f}"


def _failure(record: MeshRecord) -> tuple[str, ...]:
    failure = record.error
    if failure is None:
        return (_name(record), "", "")
    place = f"{failure.where}: " if failure.where else ""
    return (
        _name(record),
        f"{_text(place + failure.message)} {_code(failure.code)}",
        _text(failure.hint),
    )


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
    return f"<code>{_markup_free(shortened(shown(text), _LONGEST_COMMAND))}</code>"


def _text(text: str) -> str:
    told = shown(text)
    return _markup_free(told if len(told) <= _LONGEST_TEXT else f"{told[:_LONGEST_TEXT]} ...")


def _markup_free(text: str) -> str:
    """One line of text as Markdown that shows it; a character by its number is never markup."""
    return _MARKUP.sub(lambda one: f"&#{ord(one[0])};", text)
