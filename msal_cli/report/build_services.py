"""Reports that build services show: Markdown, annotations and JUnit.

Markdown is for the summary of a step on GitHub, which refuses more than 1 MiB, and for comments on
a change: totals, what failed and why, and the files, worst first.  It is GitHub's Markdown, and
nothing in a file name acts as markup.  Rows that do not fit into ``MAX_BYTES`` are left out, and
the page says how many.

Annotations are commands that GitHub's runner reads from the log.  A command is one line,
``::error file=NAME,title=TITLE::MESSAGE``.  Per cent signs and line ends are escaped in the
message, in properties colons and commas, too, so that no name or reason can end the line, add a
property or begin another command.

JUnit is XML that is shown as tests.  A suite is a folder, a case is a file, a broken gate is a
failure, a failed file is an error, and a file that was not processed is skipped.  The document fits
the schemas of both Ant and Jenkins: it has every attribute that either requires, and none that
either does not know.  XML 1.0 cannot contain most control characters; in names and reasons they
are written as ``\\xNN`` or ``\\uNNNN``, as on a terminal.
"""

import json
import os
import re
import shlex
from collections import Counter
from collections.abc import Iterable, Sequence
from xml.etree import ElementTree as Xml

from msal_cli.job.display_names import escape_for_display, shorten_name
from msal_cli.job.records import DONE, MeshRecord, Run
from msal_cli.report import facts
from msal_cli.report.data import plain, setting_texts

MAX_BYTES = 900_000
"""Bytes of the largest report: less than the 1 MiB that GitHub allows for a summary."""

MAX_ROWS = 1_000
"""Rows in a table: more would be slow to show, and other formats have every file."""

MAX_ANNOTATIONS = 10
"""GitHub shows no more errors of one step."""

_N_OPEN_ROWS = 25
_MAX_TEXT = 1_000
_MAX_COMMAND = 4_000

# Everything that Markdown, GitHub's extensions of it or HTML could read as markup.  Underscores
# within words, which are frequent in names, are text everywhere.
_MARKUP = re.compile(
    r"[&<>|`*~$\\\[\]#@]|:(?=\S)|(?<=www)\.|(?<![^\W_])_|_(?![^\W_])", re.ASCII | re.IGNORECASE
)


def render_markdown(run: Run, records: Sequence[MeshRecord]) -> bytes:
    """The report as UTF-8, in at most ``MAX_BYTES`` (or the size of the page without rows)."""
    sums = facts.totals(records)
    is_bad = sums.failed or sums.gate_broken
    sign = "❌" if is_bad else "⚠️" if sums.planned or run.interrupted else "✅"
    top = f"## {sign} msal denoise: {facts.totals_text(sums)}\n\n"
    figures = [(fact.word, fact.text) for fact in facts.total_facts(records, sums)]
    figures += [("denoised", speed)] if (speed := facts.speed_text(run, sums)) else []
    lines = "".join(f"| {word} | {_text(text)} |\n" for word, text in figures)
    top += f"| | |\n|---|---|\n{lines}\n" if lines else ""
    notes = [_text(f"msal {run.version}, {run.started} to {run.finished}")]
    command = facts.command_text(run.command, _MAX_COMMAND)
    notes += [f"Command: {_code(command)}"] if command else []
    settings = json.dumps(plain(dict(run.settings)), ensure_ascii=False)
    notes += [f"Settings: {_code(settings[:_MAX_COMMAND])}"] if run.settings else []
    inside = "\n\n".join(notes)
    end = f"<details><summary>Command and settings</summary>\n\n{inside}\n\n</details>\n"
    left = MAX_BYTES - len((top + end).encode())
    worst = facts.worst_first(records)
    for title, heads, rows in facts.problem_tables(worst):
        failures = (record.error for record, _ in rows if title == "Failed")
        codes = Counter(failure.code for failure in failures if failure is not None)
        remark = ", ".join(f"{count:,} × {_code(code)}" for code, count in codes.most_common(12))
        cells = [(record, map(_text, texts)) for record, texts in rows]
        # Many failures must leave room for the figures.
        section = _section(title, remark, heads, cells, left // 2)
        left -= len(section.encode())
        top += section
    return (top + _file_section(worst, left // 2) + end).encode()


def _file_section(worst: Sequence[MeshRecord], max_bytes: int) -> str:
    done = [record for record in worst if record.status not in ("failed", "planned")]
    figures = facts.list_figures(done, facts.DETAIL)
    has_choice = any(record.choice is not None for record in done)
    heads = ["status"] + ["chosen"] * has_choice
    heads += [", ".join(filter(None, (figure.title.lower(), figure.unit))) for figure in figures]
    rows = []
    for record in done:
        status: str = "**gate**" if facts.list_broken(record) else record.status
        status += ", inside out" if record.inside_out else ""
        chosen = "" if record.choice is None else record.choice.reason
        cells = [figure.text(record) for figure in figures]
        rows.append((record, [status, *[_text(chosen)] * has_choice, *cells]))
    return _section("Files", facts.ORDER_TEXT, heads, rows, max_bytes, len(figures))


def _section(
    title: str,
    remark: str,
    heads: Sequence[str],
    rows: Sequence[tuple[MeshRecord, Iterable[str]]],
    max_bytes: int,
    n_figures: int = 0,
) -> str:
    """A title and a table of files in about ``max_bytes``; its last ``n_figures`` columns are
    figures.  Empty if there are no rows."""
    if not rows:
        return ""
    heads = ("file", *heads)
    rule = ["---"] * (len(heads) - n_figures) + ["--:"] * n_figures
    head = f"{_line(heads)}{_line(rule)}"
    text = f"### {title}: {len(rows):,}\n\n" + (f"{remark}\n\n" if remark else "")
    lines: list[str] = []
    left = max_bytes - len(text.encode()) - 2 * len(head.encode()) - 200
    for record, cells in rows[:MAX_ROWS]:
        line = _line((_code(facts.file_name(record.input)), *cells))
        left -= len(line.encode())
        if left < 0:
            break
        lines.append(line)
    text += f"{head}{''.join(lines[:_N_OPEN_ROWS])}\n"
    if folded := lines[_N_OPEN_ROWS:]:
        inside = f"{head}{''.join(folded)}"
        text += f"<details><summary>{len(folded):,} more</summary>\n\n{inside}\n</details>\n\n"
    if n_left := len(rows) - len(lines):
        text += f"{n_left:,} more are not shown here; they are in a report in .json or .csv.\n\n"
    return text


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |\n"


# Text without markup


def _code(text: str) -> str:
    # A tag, because a bar within backquotes would still end the cell.
    return f"<code>{_escape_markup(shorten_name(escape_for_display(text), _MAX_COMMAND))}</code>"


def _text(text: str) -> str:
    text = escape_for_display(text)
    return _escape_markup(text if len(text) <= _MAX_TEXT else f"{text[:_MAX_TEXT]} ...")


def _escape_markup(text: str) -> str:
    """One line of text as Markdown; a character reference by number is never markup."""
    return _MARKUP.sub(lambda found: f"&#{ord(found[0])};", text)


# Annotations

_IN_MESSAGE = str.maketrans({"%": "%25", "\r": "%0D", "\n": "%0A"})
_IN_PROPERTY = _IN_MESSAGE | str.maketrans({":": "%3A", ",": "%2C"})


def list_annotations(records: Sequence[MeshRecord], folder: str = "") -> list[str]:
    """The commands for the worst files that failed or broke a gate.

    ``folder`` is the folder that relative names start from, as a path from the root of the
    repository; empty if the program runs in that root.
    """
    commands = []
    for record in facts.worst_first(records):
        if not (texts := facts.problem_texts(record)):
            continue
        n_gates, name = len(texts) - 1, record.input
        title = "broken gate" if n_gates == 1 else f"{n_gates} broken gates"
        title = "failed" if record.error is not None else title
        properties = f"title={f'msal: {title}'.translate(_IN_PROPERTY)}"
        if name != "-" and "://" not in name:
            if folder and not name.startswith("/"):
                name = f"{folder.rstrip('/')}/{name}"
            # Control characters are escaped: better a name that leads nowhere.
            name = escape_for_display(name).translate(_IN_PROPERTY)
            properties = f"file={name},{properties}"
        message = "\n".join(texts).translate(_IN_MESSAGE)
        commands.append(f"::error {properties}::{message}")
    return commands[:MAX_ANNOTATIONS]


# JUnit

# Lone surrogates and two code points that are no characters: what else XML refuses.
_NO_CHARACTERS = re.compile("[\ud800-\udfff\ufffe\uffff]")

_TOP = "."
_STREAM = "standard input"


def render_junit(run: Run, records: Sequence[MeshRecord]) -> bytes:
    """The records as JUnit XML in UTF-8; folders in the order of the inputs."""
    folders: dict[str, list[MeshRecord]] = {}
    for record in records:
        folder = escape_for_display(os.path.dirname(record.input)) or _TOP
        folders.setdefault(_STREAM if record.input == "-" else folder, []).append(record)
    root = Xml.Element("testsuites")
    for at, (folder, inside) in enumerate(folders.items()):
        root.append(_suite(run, at, folder, inside))
    Xml.indent(root)
    text = Xml.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()


def _suite(run: Run, at: int, folder: str, records: Sequence[MeshRecord]) -> Xml.Element:
    cases = [_case(folder, record) for record in records]
    # Ant's schema allows neither fractions of seconds nor time zones.
    started = re.match(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d", run.started)
    suite = _element(
        "testsuite",
        id=str(at),
        package="msal",
        name=folder,
        timestamp=started[0] if started else "1970-01-01T00:00:00",
        hostname="localhost",
        tests=str(len(cases)),
        failures=str(sum(case.find("failure") is not None for case in cases)),
        errors=str(sum(case.find("error") is not None for case in cases)),
        skipped=str(sum(case.find("skipped") is not None for case in cases)),
        time=_seconds(*records),
    )
    values = (
        ("msal.version", run.version),
        ("msal.command", shlex.join(run.command)),
        *((f"msal.settings.{name}", text) for name, text in setting_texts(run.settings)),
    )
    properties = (_element("property", name=name, value=value) for name, value in values)
    Xml.SubElement(suite, "properties").extend(properties)
    suite.extend(cases)
    texts, warnings = [], []
    for record in records:
        parts = [
            f"{fact.word}: {fact.text}"
            for fact in facts.list_facts(record)
            if fact.level == facts.SHORT
        ]
        if parts and record.error is None:
            texts.append(f"{_name(record)}: {record.status}; {'; '.join(parts)}")
        warnings += [f"{_name(record)}: {escape_for_display(text)}" for text in record.warnings]
    Xml.SubElement(suite, "system-out").text = _to_xml_text("\n".join(texts))
    Xml.SubElement(suite, "system-err").text = _to_xml_text("\n".join(warnings))
    return suite


def _case(folder: str, record: MeshRecord) -> Xml.Element:
    case = _element("testcase", name=_name(record), classname=folder, time=_seconds(record))
    why = "\n".join(facts.problem_texts(record))
    if record.error is not None:
        message = facts.failure_text(record.error, with_code=False)
        case.append(_element("error", type=record.error.code, message=message))
    elif why:
        # Ant's schema allows one failure in a case.
        broken = "; ".join(map(facts.gate_values, facts.list_broken(record)))
        case.append(_element("failure", type="gate", message=broken))
    elif record.status == "planned":
        case.append(_element("skipped"))
    if why:
        case[0].text = _to_xml_text(why)
    return case


def _name(record: MeshRecord) -> str:
    name = record.input
    return _STREAM if name == "-" else escape_for_display(os.path.basename(name)) or _TOP


def _element(tag: str, **attributes: str) -> Xml.Element:
    return Xml.Element(
        tag, {name: _to_xml_text(escape_for_display(v)) for name, v in attributes.items()}
    )


def _to_xml_text(text: str) -> str:
    """``text`` with escapes for what XML 1.0 cannot contain."""
    return _NO_CHARACTERS.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def _seconds(*records: MeshRecord) -> str:
    """The sum of the seconds of files that this run processed."""
    known = (item.seconds for item in records if item.status in DONE)
    total = sum(max(0.0, seconds.total) for seconds in known if seconds is not None)
    return f"{min(total, 1e9):.3f}"
