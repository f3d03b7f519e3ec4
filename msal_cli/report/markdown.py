"""The Markdown report: totals, what failed and why, and the files worst first.

It is made for the summary of a step on GitHub, which refuses more than 1 MiB, and for comments on
a change.  It is GitHub's Markdown, and nothing of a file's name is markup in it.  Rows that do not
fit into ``MAX_BYTES`` are left out, and the page says how many.

Annotations are commands that GitHub's runner reads from the log.  A command is one line,
``::error file=NAME,title=TITLE::MESSAGE``.  In the message per cent signs and line ends are
escaped, in the properties colons and commas too: nothing that a name or a reason holds can end the
line, add a property or begin a command of its own.
"""

import json
import re
from collections import Counter
from collections.abc import Sequence

from msal_cli.job.display_names import escape_for_display, shorten_name
from msal_cli.job.records import MeshRecord
from msal_cli.report import facts
from msal_cli.report.data import Run, Totals, plain, totals

MAX_BYTES = 900_000
"""Bytes of the largest report: below the 1 MiB that the summary of a step may have."""

MAX_ROWS = 1_000
"""Rows in a table: more is slow to show, and every file is in the other forms."""

MAX_ANNOTATIONS = 10
"""GitHub shows no more errors of one step."""

_N_OPEN_ROWS = 25
_MAX_TEXT = 1_000
_MAX_COMMAND = 4_000

# All that Markdown, GitHub's extensions of it or HTML could take for more than text.  Underscores
# within words, which names are full of, are text everywhere.
_MARKUP = re.compile(
    r"[&<>|`*~$\\\[\]#@]|:(?=\S)|(?<=www)\.|(?<![^\W_])_|_(?![^\W_])", re.ASCII | re.IGNORECASE
)


def render(run: Run, records: Sequence[MeshRecord]) -> bytes:
    """The report as UTF-8, in at most ``MAX_BYTES`` (or what the page takes without rows)."""
    sums = totals(records)
    is_bad = sums.failed or sums.gate_broken
    sign = "❌" if is_bad else "⚠️" if sums.planned or run.interrupted else "✅"
    heading = f"## {sign} msal denoise: {facts.totals_text(sums)}\n\n"
    parts = [heading, _totals(run, records, sums), _settings(run)]
    left = MAX_BYTES - sum(len(part.encode()) for part in parts)
    worst = facts.worst_first(records)
    for table in facts.problem_tables(worst):
        codes: Counter[str] = Counter()
        if table.title == "Failed":
            codes.update(record.error.code for record, _ in table.rows if record.error is not None)
        counts = codes.most_common(12)
        remark = ", ".join(f"{count:,} × {_code(code)}" for code, count in counts)
        rows = [(_name(record), *map(_text, cells)) for record, cells in table.rows[:MAX_ROWS]]
        heads = ("file", *table.heads)
        # Many failures must not take the place of the figures.
        parts.insert(-1, _section(table.title, remark, heads, rows, len(table.rows), left // 2))
        left -= len(parts[-2].encode())
    parts.insert(-1, _file_section(worst, left // 2))
    return "".join(parts).encode()


def _totals(run: Run, records: Sequence[MeshRecord], sums: Totals) -> str:
    rows = [(fact.word, fact.text) for fact in facts.total_facts(records, sums)]
    rows += [("denoised", speed)] if (speed := facts.speed_text(run, sums)) else []
    lines = "".join(f"| {word} | {_text(text)} |\n" for word, text in rows)
    return f"| | |\n|---|---|\n{lines}\n" if lines else ""


def _settings(run: Run) -> str:
    command = facts.command_text(run.command, _MAX_COMMAND)
    lines = [_text(f"msal {run.version}, {run.started} to {run.finished}")]
    lines += [f"Command: {_code(command)}"] if command else []
    settings = json.dumps(plain(dict(run.settings)), ensure_ascii=False)
    lines += [f"Settings: {_code(settings[:_MAX_COMMAND])}"] if run.settings else []
    inside = "\n\n".join(lines)
    return f"<details><summary>Command and settings</summary>\n\n{inside}\n\n</details>\n"


def _file_section(worst: Sequence[MeshRecord], max_bytes: int) -> str:
    done = [record for record in worst if record.status not in ("failed", "planned")]
    figures = facts.list_figures(done, facts.DETAIL)
    has_choice = any(record.choice is not None for record in done)
    heads = ["file", "status"] + ["chosen"] * has_choice
    heads += [", ".join(filter(None, (figure.title.lower(), figure.unit))) for figure in figures]
    rows = []
    for record in done[:MAX_ROWS]:
        status: str = "**gate**" if facts.list_broken(record) else record.status
        chosen = "" if record.choice is None else record.choice.reason
        status += ", inside out" if record.inside_out else ""
        cells = [figure.text(record) for figure in figures]
        rows.append((_name(record), status, *[_text(chosen)] * has_choice, *cells))
    return _section("Files", facts.ORDER_TEXT, heads, rows, len(done), max_bytes, len(figures))


def _section(
    title: str,
    remark: str,
    heads: Sequence[str],
    rows: Sequence[Sequence[str]],
    n_rows: int,
    max_bytes: int,
    n_figures: int = 0,
) -> str:
    """A title and a table in about ``max_bytes``, its last columns figures; nothing for a table
    without rows.  ``n_rows`` is the number of all rows, of which ``rows`` are the first."""
    if not rows:
        return ""
    rule = ["---"] * (len(heads) - n_figures) + ["--:"] * n_figures
    head = f"{_line(heads)}{_line(rule)}"
    text = f"### {title}: {n_rows:,}\n\n" + (f"{remark}\n\n" if remark else "")
    lines: list[str] = []
    left = max_bytes - len(text.encode()) - 2 * len(head.encode()) - 200
    for row in rows:
        line = _line(row)
        left -= len(line.encode())
        if left < 0:
            break
        lines.append(line)
    text += f"{head}{''.join(lines[:_N_OPEN_ROWS])}\n"
    if folded := lines[_N_OPEN_ROWS:]:
        inside = f"{head}{''.join(folded)}"
        text += f"<details><summary>{len(folded):,} more</summary>\n\n{inside}\n</details>\n\n"
    if n_left := n_rows - len(lines):
        text += f"{n_left:,} more are not shown here; they are in a report in .json or .csv.\n\n"
    return text


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |\n"


# Text that is no markup


def _name(record: MeshRecord) -> str:
    return _code("standard input" if record.input == "-" else record.input)


def _code(text: str) -> str:
    # Code by a tag, because a bar within backquotes would still end the cell.
    return f"<code>{_markup_free(shorten_name(escape_for_display(text), _MAX_COMMAND))}</code>"


def _text(text: str) -> str:
    text = escape_for_display(text)
    return _markup_free(text if len(text) <= _MAX_TEXT else f"{text[:_MAX_TEXT]} ...")


def _markup_free(text: str) -> str:
    """One line of text as Markdown that shows it; a character by its number is never markup."""
    return _MARKUP.sub(lambda found: f"&#{ord(found[0])};", text)


# Annotations


def list_annotations(records: Sequence[MeshRecord], folder: str = "") -> list[str]:
    """The commands for the worst files that failed or broke a gate.

    ``folder`` is where relative names begin, as a path from the root of the repository; empty if
    that is where the program runs.
    """
    commands = []
    for record in facts.worst_first(records):
        if texts := facts.problem_texts(record):
            n_gates = len(texts) - 1
            title = "broken gate" if n_gates == 1 else f"{n_gates} broken gates"
            title = "failed" if record.error is not None else title
            properties = _properties(record.input, folder, f"msal: {title}")
            message = _message("\n".join(map(escape_for_display, texts)))
            commands.append(f"::error {properties}::{message}")
    return commands[:MAX_ANNOTATIONS]


def _properties(name: str, folder: str, title: str) -> str:
    properties = f"title={_property(title)}"
    if name == "-" or "://" in name:
        return properties
    if folder and not name.startswith("/"):
        name = f"{folder.rstrip('/')}/{name}"
    # Marks that a terminal obeys are escaped: better a name that leads nowhere.
    return f"file={_property(escape_for_display(name))},{properties}"


def _message(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _message(text).replace(":", "%3A").replace(",", "%2C")
