"""The summary of a run for people: a table of the files, what failed and why, and the totals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from msal_cli.job.border_marks import count_touching
from msal_cli.job.display_names import columns, escape_for_display, figure, pad_name, shorten_name
from msal_cli.job.plain_data import value_at
from msal_cli.job.records import DONE, WITH_OUTPUT, MeshRecord, Planned, Reference
from msal_cli.report import short_summary
from msal_cli.report.document import Run, Totals, known_values, totals
from msal_cli.report.phrases import (
    Line,
    Tone,
    auto_text,
    by_hand,
    chosen_text,
    defects_text,
    despiked_text,
    failure_lines,
    failure_text,
    file_name,
    format_count,
    gate_text,
    noise_texts,
    percent_text,
    reference_text,
    runners_up_text,
    seconds_text,
    self_intersections_text,
    storage_text,
    tile_set_text,
    tiles_text,
    touches_text,
    unsure_text,
    vertices_text,
)

MOST_ROWS = 40
"""Files in the table; a longer one is not read, and every row is in a report."""

MOST_WARNINGS = 20
MOST_FAILURES = 200

_NARROWEST_NAME = 16

_START_S = 0.9
"""Seconds until the first worker denoises."""


def summary(
    run: Run,
    records: Sequence[MeshRecord],
    *,
    width: int = 100,
    verbose: bool = False,
    defaults: Mapping[str, Any] | None = None,
) -> list[Line]:
    """The lines on a run: on one file in at most eight lines, on several as a table.

    ``width`` is in columns and bounds the table only: reasons are never cut.  ``verbose`` lists
    every file, warning and failure, however many there are, and of one file every figure.
    ``defaults`` are parameters of the method of one file that need not be shown.
    """
    if len(records) == 1:
        return list(_file_lines(run, records[0], None if verbose else defaults or {}))
    return list(_batch_lines(run, records, width, verbose))


def listing(records: Sequence[MeshRecord]) -> Iterator[Line]:
    """The lines of a dry run: one per file, ``input -> output``."""
    for record in records:
        if record.status == "failed":
            yield from failure_lines(file_name(record.input), record.error)
        elif record.status == "up-to-date":
            yield Line(f"{_output_name(record)} is up to date")
        else:
            tiles = record.tiles if record.tile_set is None else None
            ending = "" if tiles is None else f": {tiles_text(tiles)}"
            if tiles is None and record.planned is not None:
                ending = f": {_planned_text(record.planned)}"
            yield Line(f"{file_name(record.input)} -> {_output_name(record)}{ending}")
            if record.tile_set is not None:
                counts = vertices_text(record.vertices, record.corners)
                yield Line(f"  {counts}, {touches_text(record.tile_set)}")


def outlook(records: Sequence[MeshRecord], n_cores: int) -> Line:
    """What a dry run says of all files: how many, how large, how long on so many cores."""
    todo = [one.planned for one in records if one.status == "planned" and one.planned is not None]
    parts = [
        f"{format_count(len(todo), 'file')} to denoise",
        figure(sum(one.bytes or 0 for one in todo) / 1e6, ",.1f", " MB"),
        "about " + format_count(sum(one.vertices or 0 for one in todo), "vertex", "vertices"),
    ]
    seconds = [one.seconds for one in todo if one.seconds is not None]
    if seconds:
        # A file is not shared among processes.
        total_s = max(max(seconds), sum(seconds) / min(n_cores, len(seconds))) + _START_S
        parts.append(f"about {seconds_text(total_s)} on an idle machine")
    n_current = sum(one.status == "up-to-date" for one in records)
    n_failed = sum(one.status == "failed" for one in records)
    parts += [f"{n_current:,} up to date"] if n_current else []
    parts += [f"{n_failed:,} will fail"] if n_failed else []
    return Line(", ".join(parts), "bad" if n_failed else "plain")


def _planned_text(planned: Planned) -> str:
    parts = (
        "" if planned.bytes is None else f"{planned.bytes / 1e3:,.1f} kB",
        format_count(planned.vertices, "vertex", "vertices"),
        "" if planned.seconds is None else f"about {seconds_text(planned.seconds)}",
    )
    return ", ".join(filter(None, parts))


# One file


def _file_lines(run: Run, record: MeshRecord, defaults: Mapping[str, Any] | None) -> Iterator[Line]:
    """The short form, or the long one without ``defaults``."""
    name = file_name(record.input)
    if record.error is not None:
        yield from failure_lines(name, record.error)
        if record.remembered:
            yield Line(f"it {remembered_words()}")
        return
    if record.status == "planned":
        if run.interrupted:
            yield Line(f"{name} was not finished", "bad")
        else:
            yield Line(f"{name} would be written to {_output_name(record)}")
            if record.tiles is not None:
                yield Line(f"  {'tiles':<13} {tiles_text(record.tiles)}")
        return
    if record.status == "up-to-date":
        yield Line(f"{_output_name(record)} is up to date", "good")
    else:
        why = escape_for_display(record.left_alone or "no vertex moved")
        ending = f", byte for byte as it was: {why}" if record.status == "unchanged" else ""
        seconds = "" if defaults is None else short_summary.ending(record)
        yield Line(f"{name} -> {_output_name(record)}{seconds}{ending}", "good")
    facts = (
        [*_facts(record), *_remarks(record)]
        if defaults is None
        else short_summary.short_facts(record, defaults)
    )
    for word, text, tone in facts:
        yield Line(f"  {word:<13} {text}", tone)


def _remarks(record: MeshRecord) -> Iterator[tuple[str, str, Tone]]:
    if record.reference is not None:
        yield from _reference_facts(record.reference)
    for gate in record.gates:
        yield "gate", gate_text(gate), "bad" if gate.broken else "good"
    for sidecar in record.sidecars:
        yield "beside it", escape_for_display(sidecar), "plain"
    for warning in record.warnings:
        yield "warning", escape_for_display(warning), "bad"


def _reference_facts(one: Reference) -> Iterator[tuple[str, str, Tone]]:
    if one.error is not None:
        yield "reference", failure_text(one.error), "bad"
        return
    yield "reference", f"{reference_text(one)} ({file_name(one.path)})", "plain"
    for warning in one.warnings:
        yield "warning", escape_for_display(warning), "bad"


def _output_name(record: MeshRecord) -> str:
    return (
        "standard output"
        if record.output in (None, "-")
        else escape_for_display(str(record.output))
    )


def _facts(record: MeshRecord) -> Iterator[tuple[str, str, Tone]]:
    """What is known of a mesh and of what was done to it: a word and a text for each."""
    choice, moved, volume = record.choice, record.displacement, record.volume
    counts = (
        vertices_text(record.vertices, record.corners),
        format_count(record.faces, "face"),
        format_count(record.components, "component"),
        storage_text(record),
    )
    facts = [("mesh", ", ".join(filter(None, counts))), ("defects", defects_text(record))]
    if record.noise_estimate is not None:
        facts.append(("noise", "; ".join(noise_texts(record.noise_estimate, record))))
    if record.despiked:
        facts.append(("despiked", despiked_text(record.despiked)))
    if unsure := unsure_text(record):
        facts.append(("unsure", unsure))
    if choice is not None:
        facts.append(("chosen", escape_for_display(choice.reason)))
        facts += [("better", advice)] if (advice := auto_text([record])) else []
    if record.status != "unchanged":
        facts.append(("left as it is", escape_for_display(record.left_alone or "")))
    if record.method is not None:
        named = ", ".join(
            f"{k} {escape_for_display(str(v))}" for k, v in record.method.parameters.items()
        )
        facts.append(("method", record.method.name + (f" ({named})" if named else "")))
    if choice is not None:
        facts += [("next best", runners_up_text(choice.runners_up)), ("by hand", by_hand(choice))]
    if volume is not None:
        change = percent_text(volume.change_percent)
        text = f"- {escape_for_display(volume.reason)}".rstrip()
        if volume.before is not None and volume.after is not None:
            text = f"{volume.before:.6g} -> {volume.after:.6g}" + (f" ({change})" if change else "")
        facts.append(("volume", text))
    if moved is not None:
        text = f"mean {moved.mean_edges:.3g}, 95 % below {moved.p95_edges:.3g}, most "
        text += f"{moved.max_edges:.3g} mean edge lengths (most {moved.max:.3g} in file units)"
        facts.append(("displacement", text))
    kept = (
        (record.clamped_vertices, "cut to the longest move"),
        (record.locked_vertices, "locked"),
    )
    texts = [f"{format_count(n, 'vertex', 'vertices')} {word}" for n, word in kept if n is not None]
    facts.append(("constraints", ", ".join(texts)))
    if record.tiles is not None:
        facts.append(("tiles", tiles_text(record.tiles)))
    facts.append(("tile set", tile_set_text([record])))
    if record.seconds is not None:
        facts.append(("time", _time_text(record)))
    if record.self_intersections is not None:
        facts.append(("intersecting", self_intersections_text(record.self_intersections)))
    return ((word, text, "plain") for word, text in facts if text or word == "mesh")


def _time_text(record: MeshRecord) -> str:
    seconds = record.seconds
    assert seconds is not None
    stages = ["read", "connectivity", "normals", "sweeps", "measure", "write"]
    if record.choice is not None or seconds.choose:
        stages.insert(2, "choose")
    spent = ", ".join(f"{one} {getattr(seconds, one):.2f}" for one in stages)
    return f"{seconds_text(seconds.total)} ({spent})"


# Several files


def _batch_lines(
    run: Run, records: Sequence[MeshRecord], width: int, verbose: bool
) -> Iterator[Line]:
    listed = [
        record
        for record in records
        if record.status in DONE or (verbose and record.status == "up-to-date")
    ]
    if listed and (verbose or len(listed) <= MOST_ROWS):
        yield from _table(listed, width)
    elif listed:
        yield Line(f"({len(listed):,} files: -v lists them all, and so does --report)", "faint")
    warnings = [
        [Line(f"  {file_name(record.input)}: {escape_for_display(warning)}")]
        for record in records
        if record.status in DONE
        for warning in record.warnings
    ]
    yield from _section("warnings", warnings, None if verbose else MOST_WARNINGS, tone="plain")
    yield from failures(records, verbose)
    yield from _references(records, verbose)
    yield from broken_gates(records, verbose)
    done = [record for record in records if record.status in WITH_OUTPUT]
    yield from _attention(done)
    if advice := auto_text([record for record in done if record.status != "up-to-date"]):
        yield Line(advice)
    unsure = [record.status for record in done if unsure_text(record)]
    if unsure:
        n_filtered = len(unsure) - unsure.count("unchanged")
        yield Line(
            f"noise or texture: {format_count(len(unsure), 'file')}, {n_filtered} filtered mildly, "
            "the others left as they are; --assume noise or --assume texture decides "
            "(-v or --report lists them)"
        )
    yield from _total_lines(run, totals(records), tile_set_text(done), count_touching(done))


def _section(
    title: str,
    items: Sequence[Sequence[Line]],
    most: int | None,
    *,
    count: int | None = None,
    tone: Tone = "bad",
) -> Iterator[Line]:
    """A title with a ``count`` (of the items by default), and at most ``most`` of the items."""
    if not items:
        return
    yield Line(f"{title}: {len(items) if count is None else count:,}", tone)
    for lines in items[:most]:
        yield from lines
    if n_left := len(items) - len(items[:most]):
        last: Tone = "bad" if tone == "bad" else "faint"
        yield Line(f"  ... and {n_left:,} more (-v or --report)", last)


def _table(records: Sequence[MeshRecord], width: int) -> Iterator[Line]:
    titles = ("vertices", "volume", "max move", "flipped", "outliers", "warnings", "seconds")
    figures = [_figures(record) for record in records]
    # A column of zeros would take room from the names.
    shown = [at for at in range(len(titles)) if any(row[at] not in ("", "0") for row in figures)]
    heads, *rows = [tuple(row[at] or "-" for at in shown) for row in (titles, *figures)]
    widths = [max(len(row[at]) for row in (heads, *rows)) for at in range(len(heads))]
    notes = [_note(record) for record in records]
    names = [file_name(record.input) for record in records]
    taken = sum(widths) + 2 * len(widths)
    longest_note = max(map(columns, notes))
    room = width - taken - (longest_note + 2 if longest_note else 0)
    name_width = min(max(columns(name) for name in (*names, "file")), max(_NARROWEST_NAME, room))
    for name, row, note in zip(("file", *names), (heads, *rows), ("", *notes), strict=True):
        cells = [pad_name(shorten_name(name, name_width), name_width)]
        cells += [pad_name(cell, size, right=True) for cell, size in zip(row, widths, strict=True)]
        text = "  ".join([*cells, note]).rstrip()
        yield Line(text, "faint" if row is heads else "plain")
    yield Line("(moves in mean edge lengths)", "faint")


def _figures(record: MeshRecord) -> tuple[str, ...]:
    """A cell for each column; empty for what is not known."""
    is_new = record.status != "up-to-date"
    return (
        figure(record.vertices, ","),
        percent_text(value_at(record, "volume.change_percent")),
        figure(value_at(record, "displacement.max_edges"), ".3f"),
        figure(record.flipped_faces, ","),
        figure(record.despiked, ","),
        f"{len(record.warnings):,}",
        figure(value_at(record, "seconds.total") if is_new else None, ".2f"),
    )


def _note(record: MeshRecord) -> str:
    notes = []
    if record.choice is not None and record.method is not None:
        notes.append(escape_for_display(record.method.name))
    if unsure_text(record):
        notes.append("noise or texture")
    if record.status == "unchanged":
        notes.append("no vertex moved" if record.left_alone is None else "left as it is")
    if record.status == "up-to-date":
        notes.append("up to date")
    if record.volume is not None and not record.volume.valid:
        notes.append(escape_for_display(record.volume.reason))
    if record.inside_out:
        notes.append("inside out")
    if record.corners is not None:
        notes.append(f"{record.corners:,} corners")
    return ", ".join(notes)


def failures(records: Sequence[MeshRecord], verbose: bool) -> Iterator[Line]:
    """The lines on what failed and why; none if nothing did."""
    failed = [record for record in records if record.status == "failed"]
    items = [failure_lines(file_name(one.input), one.error, "  ") for one in failed]
    yield from _section("failed", items, None if verbose else MOST_FAILURES)
    if n_remembered := sum(record.remembered for record in failed):
        yield Line(f"  {n_remembered:,} of them {remembered_words(n_remembered)}")


def remembered_words(count: int = 1) -> str:
    """What is said of files that failed in an earlier run."""
    pronoun = "it" if count == 1 else "them"
    return f"failed in an earlier run and would fail again; --retry-failed tries {pronoun} anyway"


def _references(records: Sequence[MeshRecord], verbose: bool) -> Iterator[Line]:
    """Over all files that have a reference, how far they are from it, and which could not be
    compared with it."""
    import statistics

    for word, path, unit in (
        ("angle between normals", "reference.mean_angular_error_deg", "degrees"),
        ("vertex error", "reference.vertex_error_percent", "% of the mean edge length"),
    ):
        if values := known_values(records, path):
            middle, worst = statistics.median(values), max(values)
            figures = f"median {middle:.3g}, most {worst:.3g} {unit}"
            yield Line(f"{word} against the reference: {figures}")
    items = []
    for one in known_values(records, "reference"):
        if one.error is not None:
            # The place may name the reference already.
            is_named = one.error.where == one.path or one.error.where.startswith(f"{one.path}: ")
            name = "" if is_named else f"{file_name(one.path)}: "
            items.append([Line(f"  {name}{failure_text(one.error)}", "bad")])
    most = None if verbose else MOST_FAILURES
    yield from _section("no comparison with the reference", items, most)


def broken_gates(records: Sequence[MeshRecord], verbose: bool) -> Iterator[Line]:
    """The lines on which file broke which gate, and with what value; none if none did."""
    items = [
        [Line(f"  {file_name(record.input)}: {gate_text(gate)}", "bad")]
        for record in records
        for gate in record.gates
        if gate.broken
    ]
    n_files = sum(any(gate.broken for gate in record.gates) for record in records)
    yield from _section("broke a gate", items, None if verbose else MOST_FAILURES, count=n_files)


def _attention(done: Sequence[MeshRecord]) -> Iterator[Line]:
    """What a reader looks at first over all files: the largest move, flipped faces, outliers."""
    moved = [record for record in done if record.displacement is not None]
    if not moved:
        return
    farthest = max(moved, key=lambda record: value_at(record, "displacement.max_edges"))
    most = value_at(farthest, "displacement.max_edges")
    texts = [f"largest move: {most:.3g} mean edge lengths ({file_name(farthest.input)})"]
    for path, word, several in (
        ("flipped_faces", "flipped face", "flipped faces"),
        ("despiked", "outlier brought back", "outliers brought back"),
    ):
        counts = [count for count in known_values(done, path) if count]
        if counts:
            files = format_count(len(counts), "file")
            texts.append(f"{format_count(sum(counts), word, several)} in {files}")
    yield Line("; ".join(texts))


def _total_lines(run: Run, sums: Totals, tile_set: str, n_touching: int) -> Iterator[Line]:
    spread = sums.volume_change_percent
    if spread is not None:
        yield Line(
            f"volume change: median {percent_text(spread.median)}, "
            f"from {percent_text(spread.lowest)} to {percent_text(spread.highest)} "
            f"({format_count(spread.files, 'closed file')})"
        )
    if tile_set:
        yield Line(f"tile set: {tile_set}")
    elif n_touching:
        yield Line(f"{n_touching:,} files share border vertices: --tile-set denoises them as one")
    if sums.chosen:
        yield Line(f"chosen: {chosen_text(sums.chosen)}")
    counts = (
        (sums.written, "written"),
        (sums.unchanged, "unchanged"),
        (sums.up_to_date, "up to date"),
        (sums.planned, "not done" if run.interrupted else "to be written"),
        (sums.failed, "failed"),
        (sums.gate_broken, "of them broke a gate"),
    )
    states = ", ".join(f"{count:,} {word}" for count, word in counts if count)
    text = f"{format_count(sums.files, 'file')}: {states or 'nothing done'}"
    if sums.vertices and run.seconds > 0.0:
        text += f"; {sums.vertices:,} vertices in {seconds_text(run.seconds)}"
    yield Line(text, "bad" if sums.failed or sums.gate_broken or run.interrupted else "good")
