"""Text for people: the facts of a single file or a table of several, failures and totals of a run;
and for ``msal info`` what is in files."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from msal_cli.errors import format_count
from msal_cli.job.display_names import columns, escape_for_display, figure, pad_name, shorten_name
from msal_cli.job.records import DONE, InfoRecord, MeshRecord, Planned, Run
from msal_cli.machine import megabytes
from msal_cli.report import facts
from msal_cli.report.facts import Fact, Line, Tone, file_name

MAX_LINES = 8
"""Lines for a single file; -v shows all."""

MAX_ROWS = 40
"""Largest number of files in the table; reports have all rows."""

MAX_WARNINGS = 20
MAX_FAILURES = 200

_MIN_NAME_WIDTH = 16

_START_S = 0.9
"""Seconds until the first worker denoises."""

# The problems that a summary lists; it only counts files that may be noise or texture.
_PROBLEMS = ("Failed", "Broken gates", "Warnings", "No comparison with the reference")

_SHAPES = {"3": "triangle", "4": "quad"}

# Files are printed one by one, so only the first column, the name, can fit all its cells.
_INFO_LINE = "{}  {:7}  {:>10}  {:>10}  {:>6}  {:7}  {}"
_INFO_WIDTH = 64
"""Columns beside the name, of which 12 are for problems."""


def summary(
    run: Run,
    records: Sequence[MeshRecord],
    *,
    width: int = 100,
    verbose: bool = False,
    defaults: Mapping[str, Any] | None = None,
) -> list[Line]:
    """The lines for a run: for one file at most ``MAX_LINES``, for several a table.

    ``width`` is in columns and limits only the table: reasons are never cut.  ``verbose`` lists
    every file, warning and failure, and every fact of a single file.  ``defaults`` are parameters
    of the method of a single file that need not be shown.
    """
    if len(records) == 1:
        return list(_file_lines(run, records[0], verbose, defaults))
    return list(_batch_lines(run, records, width, verbose))


def listing(records: Sequence[MeshRecord]) -> Iterator[Line]:
    """The lines of a dry run: one per file, ``input -> output``."""
    for record in records:
        if record.status == "failed":
            yield from facts.failure_lines(file_name(record.input), record.error)
        elif record.status == "up-to-date":
            yield Line(f"{_output_name(record)} is up to date")
        else:
            planned, cost = record.planned or Planned(), []
            if planned.bytes is not None:
                cost.append(f"{planned.bytes / 1e3:,.1f} kB")
            if planned.vertices is not None:
                cost.append(f"about {format_count(planned.vertices, 'vertex')}")
            if planned.seconds is not None:
                cost.append(facts.seconds_text(planned.seconds))
            if planned.scratch_bytes is not None and planned.memory_bytes is not None:
                memory, scratch = megabytes(planned.memory_bytes), megabytes(planned.scratch_bytes)
                cost.append(f"with {memory} of memory and {scratch} of scratch space")
            arrow = f"{file_name(record.input)} -> {_output_name(record)}"
            yield Line(": ".join(filter(None, (arrow, ", ".join(filter(None, cost))))))
            if (part := record.tile_set) is not None:
                shared = format_count(part.shared_vertices, "vertex")
                touches = f"{', '.join(part.neighbours)}: {shared}"
                counts = facts.vertices_text(record.vertices, record.corners)
                yield Line(f"  {counts}, touches {touches if part.neighbours else 'no other file'}")


def outlook(records: Sequence[MeshRecord], n_cores: int) -> Line:
    """The totals of a dry run: number of files, their size, and the time on so many cores."""
    pending = [record for record in records if record.status == "planned"]
    todo = [record.planned for record in pending if record.planned is not None]
    parts = [f"{format_count(len(pending), 'file')} to denoise"]
    if todo or not pending:
        parts += [
            figure(sum(planned.bytes or 0 for planned in todo) / 1e6, ",.1f", " MB"),
            "about " + format_count(sum(planned.vertices or 0 for planned in todo), "vertex"),
        ]
    seconds = facts.known_values(todo, "seconds")
    if seconds:
        # One process does a file.
        total_s = max(max(seconds), sum(seconds) / min(n_cores, len(seconds))) + _START_S
        parts.append(f"about {facts.seconds_text(total_s)} on an idle machine")
    n_current = sum(record.status == "up-to-date" for record in records)
    parts += [f"{n_current:,} up to date"] if n_current else []
    return Line(", ".join(parts))


def file_text(record: MeshRecord) -> str:
    """The result for a file in one line: how far it moved, and what needs attention."""
    if record.error is not None:
        return escape_for_display(f"failed: {facts.failure_text(record.error)}")
    words = ("left as it is" if record.status == "unchanged" else "moved", "warning")
    parts = [
        f"{fact.word} {fact.text}" if fact.word == "moved" else f"{fact.word}: {fact.text}"
        for fact in facts.list_facts(record)
        if fact.word in words
    ]
    if record.method is not None and record.status != "unchanged":
        parts.insert(0, escape_for_display(record.method.name))
    seconds = [] if record.seconds is None else [facts.seconds_text(record.seconds.total)]
    return "; ".join(parts + seconds)


def list_problems(records: Sequence[MeshRecord], verbose: bool, *titles: str) -> Iterator[Line]:
    """Lines for what needs attention: all problems, or those with these titles."""
    for title, _, rows in facts.problem_tables(records):
        if title not in (titles or _PROBLEMS):
            continue
        tone: Tone = "plain" if title == "Warnings" else "bad"
        shown = rows if verbose else rows[: MAX_WARNINGS if title == "Warnings" else MAX_FAILURES]
        yield Line(f"{title.lower()}: {len(rows):,}", tone)
        for record, (why, *hint) in shown:
            yield Line(f"  {file_name(record.input)}: {why}", tone)
            yield from (Line(f"    hint: {text}") for text in hint if text)
        if n_left := len(rows) - len(shown):
            yield Line(f"  ... and {n_left:,} more (-v or --report)", tone)
        if title == "Failed" and (n_remembered := sum(record.remembered for record, _ in rows)):
            yield Line(f"  {n_remembered:,} of them {remembered_text(n_remembered)}")


def remembered_text(count: int = 1) -> str:
    """The remark in summaries on files that failed in an earlier run."""
    pronoun = "it" if count == 1 else "them"
    return f"failed in an earlier run and would fail again; --retry-failed tries {pronoun} anyway"


# One file


def _file_lines(
    run: Run, record: MeshRecord, verbose: bool, defaults: Mapping[str, Any] | None
) -> Iterator[Line]:
    name = file_name(record.input)
    if record.error is not None:
        yield from facts.failure_lines(name, record.error)
        if record.remembered:
            yield Line(f"it {remembered_text()}")
        return
    output = _output_name(record)
    if record.status == "planned":
        is_late = run.interrupted
        text = f"{name} was not finished" if is_late else f"{name} would be written to {output}"
        yield Line(text, "bad" if is_late else "plain")
        return
    if record.status == "up-to-date":
        yield Line(f"{output} is up to date", "good")
    else:
        why = record.left_alone or "no vertex moved"
        ending = f", byte for byte as it was: {why}" if record.status == "unchanged" else ""
        seconds = (
            "" if record.seconds is None else f" in {facts.seconds_text(record.seconds.total)}"
        )
        yield Line(f"{name} -> {output}{seconds}{ending}", "good")
    shown = facts.list_facts(record, None if verbose else defaults)
    if not verbose:
        shown = [fact for fact in shown if fact.level <= facts.SHORT]
        if rest := shown[MAX_LINES - 2 :] if len(shown) >= MAX_LINES else []:
            worst: Tone = "bad" if any(fact.tone == "bad" for fact in rest) else "faint"
            shown[MAX_LINES - 2 :] = [Fact("...", f"and {len(rest):,} more (-v shows them)", worst)]
    yield from facts.fact_lines(shown, 13)


def _output_name(record: MeshRecord) -> str:
    return "standard output" if record.output in (None, "-") else str(record.output)


# Several files


def _batch_lines(
    run: Run, records: Sequence[MeshRecord], width: int, verbose: bool
) -> Iterator[Line]:
    listed = [
        record
        for record in records
        if record.status in DONE or (verbose and record.status == "up-to-date")
    ]
    if listed and (verbose or len(listed) <= MAX_ROWS):
        figures = facts.list_figures(listed, facts.SHORT)
        heads = [column.title.lower() for column in figures]
        rows = [[column.text(record) or "-" for column in figures] for record in listed]
        names = [file_name(record.input) for record in listed]
        yield from table_lines(("file", *heads), names, rows, width, list(map(_note, listed)))
        yield Line("(moves in mean edge lengths, time in seconds)", "faint")
    elif listed:
        yield Line(f"({len(listed):,} files: -v lists them all, and so does --report)", "faint")
    yield from list_problems(records, verbose)
    sums = facts.totals(records)
    yield from (Line(f"{fact.word}: {fact.text}") for fact in facts.total_facts(records, sums))
    is_bad = sums.failed or sums.gate_broken or run.interrupted
    yield Line(
        "; ".join(filter(None, (facts.totals_text(sums), facts.speed_text(run, sums)))),
        "bad" if is_bad else "good",
    )


def table_lines(
    heads: Sequence[str],
    names: Sequence[str],
    rows: Sequence[Sequence[str]],
    width: int,
    notes: Sequence[str] = (),
) -> Iterator[Line]:
    """A table in ``width`` columns: names, which may be cut, right-aligned cells, and notes."""
    notes = notes or [""] * len(names)
    widths = [max(map(len, cells)) for cells in zip(heads[1:], *rows, strict=True)]
    longest_note = max(map(columns, notes))
    room = width - sum(widths) - 2 * len(widths) - (longest_note + 2 if longest_note else 0)
    longest_name = max(columns(name) for name in (*names, heads[0]))
    name_width = min(longest_name, max(_MIN_NAME_WIDTH, room))
    lines = zip((heads[0], *names), (heads[1:], *rows), ("", *notes), strict=True)
    for at, (name, row, note) in enumerate(lines):
        cells = [pad_name(shorten_name(name, name_width), name_width)]
        cells += [pad_name(cell, size, right=True) for cell, size in zip(row, widths, strict=True)]
        yield Line("  ".join([*cells, note]).rstrip(), "plain" if at else "faint")


def _note(record: MeshRecord) -> str:
    volume, is_unchanged = record.volume, record.status == "unchanged"
    notes = (
        record.method.name if record.choice is not None and record.method is not None else "",
        "noise or texture" if facts.unsure_text(record) else "",
        ("left as it is" if record.left_alone else "no vertex moved") if is_unchanged else "",
        "up to date" if record.status == "up-to-date" else "",
        volume.reason if volume is not None and not volume.valid else "",
        "inside out" if record.inside_out else "",
        format_count(record.corners, "corner"),
    )
    return escape_for_display(", ".join(filter(None, notes)))


# What is in files, for msal info


def describe_info(record: InfoRecord) -> list[Line]:
    """The lines for a file that could be read: its name, then one line per fact."""
    storage = (
        *(record.format, record.encoding, record.precision, "gzip" if record.compressed else ""),
        figure(record.bytes, ",", " bytes"),
    )
    sizes = sorted(record.polygon_sizes.items(), key=lambda item: (len(item[0]), item[0]))
    parts = [
        format_count(count, _SHAPES[size]) if size in _SHAPES else f"{count:,} with {size} corners"
        for size, count in sizes
    ]
    low, high = record.bounds or ((), ())
    extent = (f"{b - a:.6g}" for a, b in zip(low, high, strict=True))
    volume = record.volume if record.volume_valid else None
    noise = record.noise_estimate
    level, *details = [""] if noise is None else facts.noise_texts(noise, record)
    pairs = ("pair of faces", "pairs of faces")
    rows = (
        ("format", ", ".join(filter(None, storage))),
        ("vertices", figure(record.vertices, ",")),
        ("corners", figure(record.corners, ",")),
        ("faces", figure(record.faces, ",") + (f" ({', '.join(parts)})" if parts else "")),
        ("components", figure(record.components, ",")),
        ("surface", "closed" if record.closed else "open"),
        ("winding", record.winding),
        ("defects", facts.defects_text(record) or "none"),
        ("welded", format_count(record.welded_vertices, "vertex")),
        ("intersecting", format_count(record.self_intersections, *pairs)),
        ("from", ", ".join(f"{x:.9g}" for x in low)),
        ("to", ", ".join(f"{x:.9g}" for x in high)),
        ("size", " x ".join(extent)),
        ("area", figure(record.area, ".6g")),
        ("volume", figure(volume, ".6g", unknown=f"- {record.volume_reason}")),
        ("mean edge", figure(record.mean_edge_length, ".6g")),
        ("noise estimate", level),
        *(("", text) for text in details),
        ("carried along", ", ".join(record.properties) or "nothing else"),
        ("refers to", ", ".join(record.references)),
    )
    found = [Fact(word, text) for word, text in rows if text]
    found += [Fact("warning", text, "bad") for text in record.warnings]
    return [Line(file_name(record.input), "good"), *facts.fact_lines(found, 15)]


def info_table(records: Iterable[InfoRecord], paths: Sequence[str], width: int) -> Iterator[Line]:
    """The lines of a table of files that could be read, each as soon as its record is known.

    ``paths`` are known beforehand and limit the first column; ``width`` is in columns.
    """
    longest = max((columns(file_name(path)) for path in paths), default=0)
    name_width = max(4, min(longest, max(_MIN_NAME_WIDTH, width - _INFO_WIDTH)))

    def join(name: str, *cells: str) -> str:
        name = pad_name(shorten_name(name, name_width), name_width)
        return _INFO_LINE.format(name, *cells).rstrip()

    pairs = ("pair of faces that intersect", "pairs of faces that intersect")
    is_empty = True
    for record in records:
        if is_empty:
            heads = ("format", "vertices", "faces", "noise", "surface", "problems")
            yield Line(join("file", *heads), "faint")
        is_empty, noise = False, record.noise_estimate
        problems = (
            "noise or texture" if noise is not None and noise.unsure else "",
            facts.defects_text(record),
            format_count(record.self_intersections or None, *pairs),
            format_count(len(record.warnings) or None, "warning"),
        )
        cells = (
            (record.format or "-") + (".gz" if record.compressed else ""),
            figure(record.vertices, ",", unknown="-"),
            figure(record.faces, ",", unknown="-"),
            "-" if noise is None else "none" if noise.negligible else f"{noise.mean_edges:.2g}",
            "-" if record.closed is None else "closed" if record.closed else "open",
            ", ".join(filter(None, problems)),
        )
        yield Line(join(file_name(record.input), *cells))
    if not is_empty:
        yield Line("(noise in mean edge lengths; -v shows all that is known of each file)", "faint")
