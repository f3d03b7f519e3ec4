"""The summary of a run for people: a table of the files, what failed and why, and the totals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from msal_cli.job.display_names import columns, padded, shortened, shown
from msal_cli.job.records import (
    DONE,
    ChoiceMade,
    Failure,
    GateResult,
    MeshRecord,
    NoiseEstimate,
    Reference,
    RunnerUp,
    SelfIntersections,
)
from msal_cli.report.document import Run, Totals, totals

Tone = Literal["plain", "good", "bad", "faint"]

MOST_ROWS = 40
"""Files in the table; a longer one is read by nobody, and every row is in a report."""

MOST_WARNINGS = 20
MOST_FAILURES = 200

IMPULSIVE_TAIL = 0.02
"""Share of vertices that stand out from which people are told so; Gaussian noise has 0.01."""

_NARROWEST_NAME = 16


@dataclass(frozen=True)
class Line:
    """A line of text and how it may be coloured."""

    text: str
    tone: Tone = "plain"


def summary(
    run: Run, records: Sequence[MeshRecord], *, width: int = 100, verbose: bool = False
) -> list[Line]:
    """The lines that tell of a run: of one file in some detail, of several as a table.

    ``width`` is in columns and bounds the table only: reasons are never cut.  ``verbose`` lists
    every file, warning and failure, however many there are.
    """
    if len(records) == 1:
        return list(_of_one(run, records[0]))
    return list(_of_many(run, records, width, verbose))


def listing(records: Sequence[MeshRecord]) -> Iterator[Line]:
    """What a dry run tells: one line per file, ``input -> output``."""
    for record in records:
        if record.status == "failed":
            yield from _failure(record, "")
        elif record.status == "up-to-date":
            yield Line(f"{_output_name(record)} is up to date")
        else:
            yield Line(f"{file_name(record.input)} -> {_output_name(record)}")


def reason(where: str, message: str, code: str) -> str:
    """Why something failed, in one line: ``vertex 17: position is not finite (E_NONFINITE)``."""
    place = f"{shown(where)}: " if where else ""
    return f"{place}{shown(message)}" + (f" ({shown(code)})" if code else "")


def file_name(name: str) -> str:
    """A file's name for people; ``-`` is where a stream comes from."""
    return "standard input" if name == "-" else shown(name)


# One file


def _of_one(run: Run, record: MeshRecord) -> Iterator[Line]:
    name = file_name(record.input)
    if record.error is not None:
        yield from _failure(record, "")
        if record.remembered:
            yield Line(f"it {remembered_words()}")
        return
    if record.status == "planned":
        if run.interrupted:
            yield Line(f"{name} was not finished", "bad")
        else:
            yield Line(f"{name} would be written to {_output_name(record)}")
        return
    if record.status == "up-to-date":
        yield Line(f"{_output_name(record)} is up to date", "good")
    else:
        why = shown(record.left_alone or "no vertex moved")
        ending = f", byte for byte as it was: {why}" if record.status == "unchanged" else ""
        yield Line(f"{name} -> {_output_name(record)}{ending}", "good")
    for word, text in _facts(record):
        yield Line(f"  {word:<13} {text}")
    if record.self_intersections is not None:
        text = self_intersections_text(record.self_intersections)
        yield Line(f"  {'intersecting':<13} {text}")
    if record.reference is not None:
        yield from _reference(record.reference)
    for gate in record.gates:
        yield Line(f"  {'gate':<13} {gate_text(gate)}", "bad" if gate.broken else "good")
    for sidecar in record.sidecars:
        yield Line(f"  {'beside it':<13} {shown(sidecar)}")
    for warning in record.warnings:
        yield Line(f"  {'warning':<13} {shown(warning)}", "bad")


def _reference(one: Reference) -> Iterator[Line]:
    if one.error is not None:
        why = reason(one.error.where, one.error.message, one.error.code)
        yield Line(f"  {'reference':<13} {why}", "bad")
        return
    yield Line(f"  {'reference':<13} {reference_text(one)} ({file_name(one.path)})")
    for warning in one.warnings:
        yield Line(f"  {'warning':<13} {shown(warning)}", "bad")


def reference_text(one: Reference) -> str:
    """How far an output is from its reference, in words."""
    parts = []
    if one.mean_angular_error_deg is not None:
        parts.append(f"normals {one.mean_angular_error_deg:.2f} degrees off in the mean")
    if one.vertex_error_percent is not None:
        parts.append(f"vertices {one.vertex_error_percent:.3g} % of the mean edge length")
    if one.hausdorff_edges is not None:
        parts.append(f"Hausdorff {one.hausdorff_edges:.3g} mean edge lengths")
    return ", ".join(parts) or "nothing can be told"


def self_intersections_text(one: SelfIntersections) -> str:
    """``164 -> 145 pairs of faces, 101 of them new``."""
    new = "" if one.created is None else f", {one.created:,} of them new"
    return f"{one.before:,} -> {one.after:,} pairs of faces{new}"


def _output_name(record: MeshRecord) -> str:
    return "standard output" if record.output in (None, "-") else shown(str(record.output))


def _facts(record: MeshRecord) -> Iterator[tuple[str, str]]:
    storage = " ".join(part for part in (record.format, record.encoding, record.precision) if part)
    counts = [
        vertices_text(record.vertices, record.corners),
        _counted(record.faces, "face"),
        _counted(record.components, "component"),
    ]
    yield "mesh", ", ".join([part for part in counts if part] + ([storage] if storage else []))
    if defects := defects_text(record):
        yield "defects", defects
    if record.noise_estimate is not None:
        yield "noise", "; ".join(noise_texts(record.noise_estimate))
    if record.despiked:
        yield "despiked", despiked_text(record.despiked)
    if record.choice is not None:
        yield "chosen", shown(record.choice.reason)
    if record.left_alone and record.status != "unchanged":
        yield "left as it is", shown(record.left_alone)
    if record.method is not None:
        parameters = ", ".join(
            f"{name} {shown(str(value))}" for name, value in record.method.parameters.items()
        )
        yield "method", record.method.name + (f" ({parameters})" if parameters else "")
    if record.choice is not None:
        if record.choice.runners_up:
            yield "next best", ", ".join(map(runner_up_text, record.choice.runners_up))
        yield "by hand", by_hand(record.choice)
    if record.volume is not None:
        yield "volume", _volume_in_full(record)
    if record.displacement is not None:
        moved = record.displacement
        yield (
            "displacement",
            f"mean {moved.mean_edges:.3g}, 95 % below {moved.p95_edges:.3g}, "
            f"most {moved.max_edges:.3g} mean edge lengths (most {moved.max:.3g} in file units)",
        )
    kept = [
        _counted(record.clamped_vertices, "vertex", "vertices") + " cut to the longest move",
        _counted(record.locked_vertices, "vertex", "vertices") + " locked",
    ]
    if told := ", ".join(one for one in kept if one[0] != " "):
        yield "constraints", told
    if record.seconds is not None:
        stages = ["read", "connectivity", "normals", "sweeps", "measure", "write"]
        if record.choice is not None or record.seconds.choose:
            stages.insert(2, "choose")
        spent = ", ".join(f"{one} {getattr(record.seconds, one):.2f}" for one in stages)
        rate = rate_text(record.vertices_per_second)
        speed = f"; {rate} vertices/s" if rate else ""
        yield "time", f"{seconds_text(record.seconds.total)} ({spent}){speed}"


def noise_texts(noise: NoiseEstimate) -> list[str]:
    """What is estimated of a mesh's noise: the level, then what is peculiar about it."""
    level = f"{noise.mean_edges:.3g} mean edge lengths"
    if noise.low_edges is not None and noise.high_edges is not None:
        level += f", {noise.low_edges:.2g} to {noise.high_edges:.2g}"
    level += f" ({noise.file_units:.3g} in file units)"
    if noise.negligible:
        return [f"{level}: none to speak of"]
    texts = [level]
    if noise.words and noise.confidence is not None:
        texts.append(f"{noise.words} ({100.0 * noise.confidence:.0f} % sure: {noise.basis})")
    is_uneven = noise.uneven and noise.kind != "uneven"
    if is_uneven and noise.lowest_edges is not None and noise.highest_edges is not None:
        texts.append(f"uneven: {noise.lowest_edges:.2g} to {noise.highest_edges:.2g} by region")
    stand_out, rms = noise.tail, noise.rms_edges
    if stand_out is not None and rms is not None and stand_out >= IMPULSIVE_TAIL:
        texts.append(
            f"impulsive: {100.0 * stand_out:.1f} % of the vertices stand out; with them "
            f"{rms:.3g} mean edge lengths"
        )
    return texts


def despiked_text(despiked: int) -> str:
    """``12 outlier vertices brought back``."""
    return _counted(despiked, "outlier vertex", "outlier vertices") + " brought back"


def by_hand(choice: ChoiceMade) -> str:
    """The options that repeat a choice, as a shell takes them."""
    import shlex

    return shown(shlex.join(choice.repeat))


def runner_up_text(one: RunnerUp) -> str:
    """What was nearly chosen: ``AL, 3 sweeps (risk 0.072 e)``."""
    return f"{shown(one.label)} (risk {one.risk_edges:.2g} e)"


def _volume_in_full(record: MeshRecord) -> str:
    volume = record.volume
    if volume is None or volume.before is None or volume.after is None:
        return "-" if volume is None else f"- {shown(volume.reason)}".rstrip()
    change = percent_text(volume.change_percent)
    return f"{volume.before:.6g} -> {volume.after:.6g}" + (f" ({change})" if change else "")


def vertices_text(vertices: int | None, corners: int | None) -> str:
    """``6,720 vertices (of 40,320 corners)``: corners where the file stores these (STL)."""
    beside = f" (of {corners:,} corners)" if corners is not None else ""
    return _counted(vertices, "vertex", "vertices") + beside


def defects_text(record: MeshRecord) -> str:
    """What is wrong with a mesh, as counts; empty if nothing is."""
    counts = (
        _counted(record.boundary_edges, "boundary edge"),
        _counted(record.non_manifold_edges, "non-manifold edge"),
        _counted(record.inconsistent_edges, "edge between faces of opposite winding",
                 "edges between faces of opposite winding"),
        _counted(record.degenerate_faces, "degenerate face"),
        _counted(record.duplicate_faces, "duplicate face"),
        _counted(record.unreferenced_vertices, "unreferenced vertex", "unreferenced vertices"),
    )  # fmt: skip
    words = [one for one in counts if one and not one.startswith("0 ")]
    return ", ".join([*words, *(["inside out"] if record.inside_out else [])])


# Several files


def _of_many(run: Run, records: Sequence[MeshRecord], width: int, verbose: bool) -> Iterator[Line]:
    listed = [
        record
        for record in records
        if record.status in DONE or (verbose and record.status == "up-to-date")
    ]
    if listed and (verbose or len(listed) <= MOST_ROWS):
        yield from _table(listed, width)
    elif listed:
        yield Line(f"({len(listed):,} files: -v lists them all, and so does --report)", "faint")
    yield from _warnings(records, verbose)
    yield from failures(records, verbose)
    yield from _references(records, verbose)
    yield from broken_gates(records, verbose)
    yield from _totals(run, totals(records))


def _table(records: Sequence[MeshRecord], width: int) -> Iterator[Line]:
    heads = ("vertices", "volume", "mean move", "max move", "vertices/s", "seconds")
    rows = [_figures(record) for record in records]
    widths = [max(len(row[at]) for row in (heads, *rows)) for at in range(len(heads))]
    notes = [_note(record) for record in records]
    names = [file_name(record.input) for record in records]
    taken = sum(widths) + 2 * len(widths)
    longest_note = max(map(columns, notes))
    room = width - taken - (longest_note + 2 if longest_note else 0)
    name_width = min(max(columns(name) for name in (*names, "file")), max(_NARROWEST_NAME, room))
    for name, row, note in zip(("file", *names), (heads, *rows), ("", *notes), strict=True):
        cells = [padded(shortened(name, name_width), name_width)]
        cells += [padded(cell, size, right=True) for cell, size in zip(row, widths, strict=True)]
        text = "  ".join([*cells, note]).rstrip()
        yield Line(text, "faint" if row is heads else "plain")
    yield Line("(moves in mean edge lengths)", "faint")


def _figures(record: MeshRecord) -> tuple[str, ...]:
    volume, moved = record.volume, record.displacement
    is_new = record.status != "up-to-date"
    return (
        f"{record.vertices:,}" if record.vertices is not None else "-",
        percent_text(volume.change_percent if volume is not None else None) or "-",
        f"{moved.mean_edges:.3f}" if moved is not None else "-",
        f"{moved.max_edges:.3f}" if moved is not None else "-",
        (rate_text(record.vertices_per_second) if is_new else "") or "-",
        f"{record.seconds.total:.2f}" if record.seconds is not None and is_new else "-",
    )


def _note(record: MeshRecord) -> str:
    notes = []
    if record.choice is not None and record.method is not None:
        notes.append(shown(record.method.name))
    if record.status == "unchanged":
        notes.append("no vertex moved" if record.left_alone is None else "left as it is")
    if record.status == "up-to-date":
        notes.append("up to date")
    if record.volume is not None and not record.volume.valid:
        notes.append(shown(record.volume.reason))
    if record.inside_out:
        notes.append("inside out")
    if record.corners is not None:
        notes.append(f"{record.corners:,} corners")
    return ", ".join(notes)


def _warnings(records: Sequence[MeshRecord], verbose: bool) -> Iterator[Line]:
    texts = [
        f"  {file_name(record.input)}: {shown(warning)}"
        for record in records
        if record.status in DONE
        for warning in record.warnings
    ]
    kept = texts if verbose else texts[:MOST_WARNINGS]
    if texts:
        yield Line(f"warnings: {len(texts):,}")
    yield from (Line(text) for text in kept)
    if len(texts) > len(kept):
        yield Line(f"  ... and {len(texts) - len(kept):,} more (-v or --report)", "faint")


def failures(records: Sequence[MeshRecord], verbose: bool) -> Iterator[Line]:
    """The lines on what failed and why; none if nothing did."""
    failed = [record for record in records if record.status == "failed"]
    kept = failed if verbose else failed[:MOST_FAILURES]
    if failed:
        yield Line(f"failed: {len(failed):,}", "bad")
    for record in kept:
        yield from _failure(record, "  ")
    if len(failed) > len(kept):
        yield Line(f"  ... and {len(failed) - len(kept):,} more (-v or --report)", "bad")
    if n_remembered := sum(record.remembered for record in failed):
        yield Line(f"  {n_remembered:,} of them {remembered_words(n_remembered)}")


def _references(records: Sequence[MeshRecord], verbose: bool) -> Iterator[Line]:
    """Over all files that have a reference, how far they are from it, and which could not be
    compared with it."""
    import statistics

    known = [record.reference for record in records if record.reference is not None]
    for word, name, unit in (
        ("angle between normals", "mean_angular_error_deg", "degrees"),
        ("vertex error", "vertex_error_percent", "% of the mean edge length"),
    ):
        values = [value for one in known if (value := getattr(one, name)) is not None]
        if values:
            middle, worst = statistics.median(values), max(values)
            yield Line(
                f"{word} against the reference: median {middle:.3g}, most {worst:.3g} {unit}"
            )
    texts = [
        f"  {_reference_failure(one.path, one.error)}" for one in known if one.error is not None
    ]
    if texts:
        yield Line(f"no comparison with the reference: {len(texts):,}", "bad")
    kept = texts if verbose else texts[:MOST_FAILURES]
    yield from (Line(text, "bad") for text in kept)
    if len(texts) > len(kept):
        yield Line(f"  ... and {len(texts) - len(kept):,} more (-v or --report)", "bad")


def _reference_failure(path: str, failure: Failure) -> str:
    """Why there is no comparison with the reference ``path``, which the place may name already."""
    why = reason(failure.where, failure.message, failure.code)
    is_named = failure.where == path or failure.where.startswith(f"{path}: ")
    return why if is_named else f"{file_name(path)}: {why}"


def broken_gates(records: Sequence[MeshRecord], verbose: bool) -> Iterator[Line]:
    """The lines on which file broke which gate, and with what value; none if none did."""
    texts = [
        f"  {file_name(record.input)}: {gate_text(gate)}"
        for record in records
        for gate in record.gates
        if gate.broken
    ]
    if texts:
        n_files = sum(any(gate.broken for gate in record.gates) for record in records)
        yield Line(f"broke a gate: {n_files:,}", "bad")
    kept = texts if verbose else texts[:MOST_FAILURES]
    yield from (Line(text, "bad") for text in kept)
    if len(texts) > len(kept):
        yield Line(f"  ... and {len(texts) - len(kept):,} more (-v or --report)", "bad")


def gate_text(gate: GateResult) -> str:
    """``broken: max_displacement > 0.5e (max_displacement is 0.0123 (0.62e))``."""
    word = "held" if not gate.broken else "broken" if gate.decided else "not decided"
    return f"{word}: {shown(gate.expression)} ({shown(gate.reason)})"


def remembered_words(count: int = 1) -> str:
    """What is said of files that failed in an earlier run."""
    pronoun = "it" if count == 1 else "them"
    return f"failed in an earlier run and would fail again; --retry-failed tries {pronoun} anyway"


def _failure(record: MeshRecord, indent: str) -> Iterator[Line]:
    failure = record.error
    if failure is None:
        return
    why = reason(failure.where, failure.message, failure.code)
    yield Line(f"{indent}{file_name(record.input)}: {why}", "bad")
    if failure.hint:
        yield Line(f"{indent}  hint: {shown(failure.hint)}")


def _totals(run: Run, sums: Totals) -> Iterator[Line]:
    spread = sums.volume_change_percent
    if spread is not None:
        yield Line(
            f"volume change: median {percent_text(spread.median)}, "
            f"from {percent_text(spread.lowest)} to {percent_text(spread.highest)} "
            f"({_counted(spread.files, 'closed file')})"
        )
    if sums.chosen:
        yield Line(f"chosen: {chosen_text(sums.chosen)}")
    counts = [
        (sums.written, "written"),
        (sums.unchanged, "unchanged"),
        (sums.up_to_date, "up to date"),
        (sums.planned, "not done" if run.interrupted else "to be written"),
        (sums.failed, "failed"),
        (sums.gate_broken, "of them broke a gate"),
    ]
    told = ", ".join(f"{count:,} {word}" for count, word in counts if count)
    text = f"{_counted(sums.files, 'file')}: {told or 'nothing done'}"
    if sums.vertices and run.seconds > 0.0:
        text += (
            f"; {sums.vertices:,} vertices in {seconds_text(run.seconds)}, "
            f"{rate_text(sums.vertices / run.seconds)} vertices/s"
        )
    yield Line(text, "bad" if sums.failed or sums.gate_broken or run.interrupted else "good")


def chosen_text(chosen: Mapping[str, int]) -> str:
    """What --auto chose, and how often: ``msal 12, bilateral_normal 5, none 3``."""
    return ", ".join(f"{shown(name)} {count:,}" for name, count in chosen.items())


# Figures


def _counted(number: int | None, one: str, several: str = "") -> str:
    if number is None:
        return ""
    return f"{number:,} {one if number == 1 else several or one + 's'}"


def percent_text(percent: float | None) -> str:
    """``-0.266 %``, with its sign; empty if it is not known."""
    if percent is None:
        return ""
    return f"{percent:+.3f} %" if abs(percent) < 10.0 else f"{percent:+.1f} %"


def rate_text(per_second: float | None) -> str:
    """A rate to three digits: ``1,230,000``; empty if it is not known."""
    if per_second is None:
        return ""
    return f"{float(f'{per_second:.3g}'):,.0f}"


def seconds_text(seconds: float) -> str:
    """``0.42 s``, ``3 min 05 s`` or ``2 h 10 min``."""
    if seconds < 99.95:
        return f"{seconds:.2f} s" if seconds < 10.0 else f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"
