"""Facts and figures of records, and totals of a run; all reports for people are made of them.

``list_facts`` describes a file in words, ``FIGURES`` are the columns of tables, and ``worst_first``
is the order in which files are listed.  The texts of ``list_facts`` are escaped for display; others
are not: every writer escapes them for its format.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

from msal_cli.errors import MsalError, format_count
from msal_cli.job.display_names import escape_for_display, figure
from msal_cli.job.records import (
    DONE,
    ComparisonRecord,
    Failure,
    GateResult,
    InfoRecord,
    MeshRecord,
    NoiseEstimate,
    Run,
    SelfIntersections,
    required,
    value_at,
)
from msal_cli.light_dataclass import dataclass

Tone = Literal["plain", "good", "bad", "faint"]

ATTENTION, SHORT, DETAIL = 0, 1, 2
"""Levels of facts and figures: what needs attention, what a summary shows, everything else."""

IMPULSIVE_TAIL = 0.02
"""Share of outlying vertices from which noise is called impulsive; Gaussian noise has 0.01."""


class Fact(NamedTuple):
    """A text about a file, and the word that introduces it."""

    word: str
    text: str
    tone: Tone = "plain"
    level: int = SHORT


@dataclass(frozen=True)
class Line:
    """A line of text, escaped for display, and its tone, which may become a colour."""

    text: str
    tone: Tone = "plain"

    def __post_init__(self) -> None:
        object.__setattr__(self, "text", escape_for_display(self.text))


def known_values(records: Sequence[Any], path: str) -> list[Any]:
    """The values of a field, by its dotted path, of the records that have one."""
    values = (value_at(record, path) for record in records)
    return [value for value in values if value is not None]


def list_broken(record: MeshRecord | ComparisonRecord) -> list[GateResult]:
    return [gate for gate in record.gates if gate.broken]


# Facts of a file


def list_facts(record: MeshRecord, defaults: Mapping[str, Any] | None = None) -> list[Fact]:
    """What is known of a mesh and of what was done to it; of the method's parameters only those
    that differ from ``defaults``."""
    return [
        fact._replace(text=escape_for_display(fact.text))
        for source in (_facts(record, defaults or {}), _remarks(record))
        for fact in source
        if fact.text
    ]


def _facts(record: MeshRecord, defaults: Mapping[str, Any]) -> Iterator[Fact]:
    if record.error is not None:
        yield Fact("reason", failure_text(record.error), "bad", ATTENTION)
        yield Fact("what to do", record.error.hint)
    counts = (
        vertices_text(record.vertices, record.corners),
        format_count(record.faces, "face"),
        format_count(record.components, "component"),
        defects_text(record),
    )
    yield Fact("mesh", ", ".join(filter(None, counts)))
    stored = (record.format, record.encoding, record.precision)
    yield Fact("stored as", " ".join(filter(None, stored)), level=DETAIL)
    if record.noise_estimate is not None:
        noise, *estimate = noise_texts(record.noise_estimate, record)
        yield Fact("noise", noise)
        yield Fact("estimate", "; ".join(estimate), level=DETAIL)
    yield Fact("unsure", unsure_text(record))
    choice, method = record.choice, record.method
    if choice is not None:
        import shlex

        yield Fact("chosen", choice.reason)
        yield Fact("better", auto_text([record]))
        risks = (f"{item.label} (risk {item.risk_edges:.2g} e)" for item in choice.runners_up)
        yield Fact("next best", ", ".join(risks), level=DETAIL)
        yield Fact("by hand", shlex.join(choice.repeat), level=DETAIL)
    if method is not None:
        given = ", ".join(
            f"{name} {value}"
            for name, value in method.parameters.items()
            if value != "" and (name not in defaults or defaults[name] != value)
        )
        level = SHORT if choice is None else DETAIL
        yield Fact("method", method.name + (f" ({given})" if given else ""), level=level)
    is_unchanged = record.status == "unchanged"
    level = DETAIL if is_unchanged else SHORT
    why = record.left_alone or ("no vertex moved" if is_unchanged else "")
    yield Fact("left as it is", why, level=level)
    yield Fact("moved", "; ".join(_changes(record)), level=level)
    moved, volume = record.displacement, record.volume
    if moved is not None:
        text = f"95 % below {moved.p95_edges:.3g} mean edge lengths, most {moved.max:.3g}"
        yield Fact("displacement", f"{text} in file units", level=DETAIL)
    if volume is not None and not volume.valid:
        # The fact about the mesh already lists boundary edges, the reason.
        level = DETAIL if is_unchanged or record.boundary_edges else SHORT
        yield Fact("volume", f"no figure: {volume.reason}", level=level)
    elif volume is not None and volume.before is not None and volume.after is not None:
        yield Fact("volume", f"{volume.before:.6g} -> {volume.after:.6g}", level=DETAIL)
    yield Fact("tile set", tile_set_text([record]))
    if (seconds := record.seconds) is not None:
        stages = ["read", "connectivity", "normals", "sweeps", "measure", "write"]
        if choice is not None or seconds.choose:
            stages.insert(2, "choose")
        spent = ", ".join(f"{stage} {getattr(seconds, stage):.2f}" for stage in stages)
        yield Fact("time", f"{seconds_text(seconds.total)} ({spent})", level=DETAIL)


def _changes(record: MeshRecord) -> Iterator[str]:
    moved, volume = record.displacement, record.volume
    if moved is not None:
        yield f"mean {moved.mean_edges:.3g}, most {moved.max_edges:.3g} mean edge lengths"
    if volume is not None and volume.change_percent is not None:
        yield f"volume {percent_text(volume.change_percent)}"
    if record.flipped_faces:
        yield format_count(record.flipped_faces, "flipped face")
    if record.despiked:
        yield f"{format_count(record.despiked, 'outlier vertex')} brought back"
    for count, word in (
        (record.clamped_vertices, "cut to the longest move"),
        (record.locked_vertices, "locked"),
    ):
        if count is not None:
            yield f"{format_count(count, 'vertex')} {word}"


def _remarks(record: MeshRecord) -> Iterator[Fact]:
    for gate in list_broken(record):
        yield Fact("gate", gate_text(gate), "bad", ATTENTION)
    for warning in record.warnings:
        yield Fact("warning", warning, "bad", ATTENTION)
    reference = record.reference
    if reference is not None and reference.error is not None:
        text = f"{reference.path}: {failure_text(reference.error)}"
        yield Fact("reference", text, "bad", ATTENTION)
    elif reference is not None:
        parts = (
            ("normals", figure(reference.mean_angular_error_deg, ".2f", " degrees off (mean)")),
            ("vertices", figure(reference.vertex_error_percent, ".3g", " % of the mean edge")),
            ("Hausdorff", figure(reference.hausdorff_edges, ".3g", " mean edge lengths")),
        )
        text = ", ".join(f"{word} {text}" for word, text in parts if text) or "not known"
        text = f"other faces: {text}" if reference.correspondence == "surface" else text
        yield Fact("reference", f"{text} ({file_name(reference.path)})")
        for warning in reference.warnings:
            yield Fact("warning", warning, "bad", ATTENTION)
    for gate in record.gates:
        if not gate.broken:
            yield Fact("gate", gate_text(gate), "good")
    if record.self_intersections is not None:
        yield Fact("intersecting", self_intersections_text(record.self_intersections))
    for sidecar in record.sidecars if record.status in DONE else ():
        if not sidecar.startswith("warning: "):
            yield Fact("beside it", sidecar.split(" (SHA-256")[0])


def fact_lines(facts: Iterable[Fact], width: int) -> Iterator[Line]:
    """Facts as lines, with their words in ``width`` columns."""
    for fact in facts:
        yield Line(f"  {fact.word:<{width}} {fact.text}", fact.tone)


# Figures


class Figure(NamedTuple):
    """A column of a table: the ``path`` of its value in the record, and its format."""

    title: str
    unit: str
    path: str
    form: str
    level: int = SHORT

    def value(self, record: MeshRecord) -> Any:
        """The value; of several texts their number; None if it is not known."""
        if self.path == "seconds.total" and record.status not in DONE:
            return None  # of an earlier run
        value = value_at(record, self.path)
        return len(value) if isinstance(value, tuple) else value

    def text(self, record: MeshRecord) -> str:
        """The value as text; empty if it is not known."""
        value = self.value(record)
        return percent_text(value) if self.unit == "%" else figure(value, self.form)


FIGURES = (
    Figure("Vertices", "", "vertices", ","),
    Figure("Volume", "%", "volume.change_percent", "+.3f"),
    Figure("Mean move", "edges", "displacement.mean_edges", ".3f", DETAIL),
    Figure("Max move", "edges", "displacement.max_edges", ".3f"),
    Figure("Max move", "file units", "displacement.max", ".4g", DETAIL),
    Figure("Normals", "mean turn, °", "normal_change.mean_deg", ".3g", DETAIL),
    Figure("Flipped", "faces", "flipped_faces", ","),
    Figure("Intersecting", "new pairs", "self_intersections.created", ","),
    Figure("Outliers", "brought back", "despiked", ","),
    Figure("Warnings", "", "warnings", ","),
    Figure("To reference", "mean angle, °", "reference.mean_angular_error_deg", ".2f"),
    Figure("Time", "s", "seconds.total", ".2f"),
)


def list_figures(records: Sequence[MeshRecord], level: int) -> list[Figure]:
    """The figures up to a level; rare ones only if some record has a value other than 0."""
    rare = ("Flipped", "Intersecting", "Outliers", "Warnings", "To reference")
    return [
        column
        for column in FIGURES
        if column.level <= level
        and (column.title not in rare or any(column.value(record) for record in records))
    ]


# Which files to look at first

ORDER_TEXT = (
    "Worst first: what failed, then what broke a gate (the most gates first), then what was not "
    "finished, then the largest displacement in mean edge lengths, then the largest change of "
    "volume."
)


def worst_first(records: Sequence[MeshRecord]) -> list[MeshRecord]:
    """The records in the order that ``ORDER_TEXT`` describes; equal ones keep their order.

    A figure that is not finite counts as the largest, an unknown one as the smallest.
    """

    def rank(record: MeshRecord) -> tuple[int, int, float, float]:
        n_broken = len(list_broken(record))
        group = {"failed": 0, "planned": 2}.get(record.status, 3)
        moved = value_at(record, "displacement.max_edges")
        change = value_at(record, "volume.change_percent")
        return min(group, 1) if n_broken else group, -n_broken, -_size(moved), -_size(change)

    return sorted(records, key=rank)


def _size(value: float | None) -> float:
    if value is None:
        return -1.0
    return abs(value) if math.isfinite(value) else math.inf


class ProblemTable(NamedTuple):
    """Files that share a kind of problem, with the cells after their names."""

    title: str
    heads: tuple[str, ...]
    rows: list[tuple[MeshRecord, tuple[str, ...]]]


def problem_tables(worst: Sequence[MeshRecord]) -> list[ProblemTable]:
    """Tables of what needs attention, one per kind of problem; those without rows are left out."""
    failed, broken, warned, unmeasured, unsure = tables = (
        ProblemTable("Failed", ("reason", "what to do"), []),
        ProblemTable("Broken gates", ("gate",), []),
        ProblemTable("Warnings", ("warning",), []),
        ProblemTable("No comparison with the reference", ("reason",), []),
        ProblemTable("Look at these", ("noise or texture",), []),
    )
    for record in worst:
        if record.error is not None:
            failed.rows.append((record, (failure_text(record.error), record.error.hint)))
        broken.rows.extend((record, (gate_values(gate),)) for gate in list_broken(record))
        warned.rows.extend((record, (warning,)) for warning in record.warnings)
        if (truth := record.reference) is not None and truth.error is not None:
            unmeasured.rows.append((record, (f"{truth.path}: {failure_text(truth.error)}",)))
        if text := unsure_text(record):
            unsure.rows.append((record, (text,)))
    return [table for table in tables if table.rows]


def problem_texts(record: MeshRecord) -> list[str]:
    """Why a file failed or which gates it broke, one line each, escaped; empty if neither."""
    name, broken = file_name(record.input), [gate_values(gate) for gate in list_broken(record)]
    texts = [f"{name}:", *broken] if broken else []
    if record.error is not None:
        texts = [f"{name}: {failure_text(record.error)}"]
        texts += [f"hint: {record.error.hint}"] if record.error.hint else []
    return list(map(escape_for_display, texts))


# Totals of a run


@dataclass(frozen=True)
class Spread:
    """The lowest, the median and the highest value of a figure over ``files`` files."""

    files: int = required("files that the figure is over")
    lowest: float = required("lowest value")
    median: float = required("median")
    highest: float = required("highest value")


@dataclass(frozen=True)
class Totals:
    """Sums over the records of a run."""

    files: int = required("records in this report")
    written: int = required("files written with some vertex moved, or in another form")
    unchanged: int = required("files written byte for byte as they were, because no vertex moved")
    up_to_date: int = required("files whose output of an earlier run is current")
    planned: int = required("files not dealt with: by a dry run, or because the run ended before")
    failed: int = required("files that failed")
    gate_broken: int = required("files written or up to date that break a gate")
    chosen: Mapping[str, int] = required(
        "files written, unchanged or up to date by the method that was chosen, the most "
        "frequent first; empty where the method was given"
    )
    vertices: int = required("vertices of the files denoised in this run")
    work_seconds: float = required("sum of the seconds of the files denoised in this run")
    volume_change_percent: Spread | None = required(
        "change of volume over the files whose volume is valid"
    )


def totals(records: Sequence[MeshRecord]) -> Totals:
    import statistics

    states = Counter(record.status for record in records)
    fresh = [record for record in records if record.status in DONE]
    changes = known_values(records, "volume.change_percent")
    chosen = Counter(
        record.method.name
        for record in records
        if record.choice is not None and record.method is not None and record.error is None
    )
    return Totals(
        files=len(records),
        written=states["written"],
        unchanged=states["unchanged"],
        up_to_date=states["up-to-date"],
        planned=states["planned"],
        failed=states["failed"],
        gate_broken=sum(any(list_broken(record)) for record in records),
        chosen=dict(sorted(chosen.items(), key=lambda item: (-item[1], item[0]))),
        vertices=sum(record.vertices or 0 for record in fresh),
        work_seconds=sum(known_values(fresh, "seconds.total")),
        volume_change_percent=(
            Spread(len(changes), min(changes), statistics.median(changes), max(changes))
            if changes
            else None
        ),
    )


def count_states(sums: Totals) -> list[Fact]:
    """How many files have which status: a word and a number each."""
    counts: tuple[tuple[str, int, Tone], ...] = (
        ("written", sums.written, "plain"),
        ("unchanged", sums.unchanged, "plain"),
        ("up to date", sums.up_to_date, "plain"),
        ("not done", sums.planned, "faint"),
        ("failed", sums.failed, "bad"),
        ("broke a gate", sums.gate_broken, "bad"),
    )
    return [Fact(word, f"{count:,}", tone) for word, count, tone in counts if count]


def totals_text(sums: Totals) -> str:
    """``7 files: 6 written, 1 failed``."""
    states = ", ".join(f"{fact.text} {fact.word}" for fact in count_states(sums))
    return f"{format_count(sums.files, 'file')}: {states or 'nothing done'}"


def total_facts(records: Sequence[MeshRecord], sums: Totals) -> list[Fact]:
    """Facts about all files that did not fail."""
    # The import takes ten milliseconds.
    import statistics

    records = [record for record in records if record.error is None]
    fresh = [record for record in records if record.status in DONE]
    found = [Fact("better", auto_text(fresh))]
    if n_unsure := sum(bool(unsure_text(record)) for record in records):
        files = format_count(n_unsure, "file")
        found.append(
            Fact("noise or texture", f"unsure in {files}; --assume noise or texture decides")
        )
    for word, path, unit in (
        ("angle to the reference", "reference.mean_angular_error_deg", "degrees"),
        ("vertex error to the reference", "reference.vertex_error_percent", "% of the mean edge"),
    ):
        if values := known_values(records, path):
            middle, worst = statistics.median(values), max(values)
            found.append(Fact(word, f"median {middle:.3g}, most {worst:.3g} {unit}"))
    moves = [record for record in records if record.displacement is not None]
    if moves:
        far = max(moves, key=lambda record: _size(value_at(record, "displacement.max_edges")))
        most = value_at(far, "displacement.max_edges")
        found.append(Fact("largest move", f"{most:.3g} mean edge lengths ({file_name(far.input)})"))
    for word, path in (("flipped faces", "flipped_faces"), ("outliers brought back", "despiked")):
        counts = [count for count in known_values(records, path) if count]
        if counts:
            found.append(Fact(word, f"{sum(counts):,} in {format_count(len(counts), 'file')}"))
    spread = sums.volume_change_percent
    if spread is not None:
        text = percent_text(spread.median)
        if spread.files > 1:
            ends = f"from {percent_text(spread.lowest)} to {percent_text(spread.highest)}"
            text = f"median {text}, {ends}"
        files = format_count(spread.files, "closed file")
        found.append(Fact("volume change", f"{text} ({files})"))
    chosen = ", ".join(f"{name} {count:,}" for name, count in sums.chosen.items())
    found += [Fact("chosen", chosen), Fact("tile set", tile_set_text(records))]
    return [fact for fact in found if fact.text]


def speed_text(run: Run, sums: Totals) -> str:
    """``71,894 vertices in 10.0 s``; empty if nothing was denoised."""
    if not sums.vertices or run.seconds <= 0.0:
        return ""
    return f"{format_count(sums.vertices, 'vertex')} in {seconds_text(run.seconds)}"


# Phrases


def percent_text(percent: float | None) -> str:
    """``-0.266 %``, with its sign; empty for None."""
    if percent is None:
        return ""
    return f"{percent:+.3f} %" if abs(percent) < 10.0 else f"{percent:+.1f} %"


def seconds_text(seconds: float) -> str:
    """``0.42 s``, ``3 min 05 s`` or ``2 h 10 min``."""
    if not math.isfinite(seconds):
        return "unknown"
    if seconds < 99.95:
        return f"{seconds:.2f} s" if seconds < 10.0 else f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


def command_text(command: Sequence[str], max_length: int) -> str:
    """A command line quoted for a shell, cut to a length."""
    import shlex

    text = shlex.join(command)
    return text if len(text) <= max_length else f"{text[:max_length]} ..."


def file_name(name: str) -> str:
    """A file's name, escaped for display; ``-`` is standard input."""
    return "standard input" if name == "-" else escape_for_display(name)


def failure_text(failure: Failure | MsalError, *, with_code: bool = True) -> str:
    """Why something failed, as one line: ``vertex 17: position is not finite (E_NONFINITE)``."""
    where, message = failure.where, failure.message
    place = "" if not where or message.startswith(f"{where} ") else f"{where}: "
    return f"{place}{message}" + (f" ({failure.code})" if with_code else "")


def failure_lines(name: str, failure: Failure | None) -> list[Line]:
    """Why a file failed, and its hint; empty if it did not fail."""
    if failure is None:
        return []
    lines = [Line(f"{name}: {failure_text(failure)}", "bad")]
    return lines + ([Line(f"  hint: {failure.hint}")] if failure.hint else [])


def gate_values(gate: GateResult) -> str:
    """A gate with the values that decided it, or why it could not be decided."""
    text = f"{gate.expression} ({gate.reason})"
    return text if gate.decided else f"not decided: {text}"


def gate_text(gate: GateResult) -> str:
    """``broken: max_displacement > 0.5e (max_displacement is 0.0123 (0.62e))``."""
    word = "broken: " if gate.broken and gate.decided else "" if gate.broken else "passed: "
    return f"{word}{gate_values(gate)}"


def vertices_text(vertices: int | None, corners: int | None) -> str:
    """``6,720 vertices (of 40,320 corners)``: with corners where the file stores these (STL), and
    only corners where the vertices are not known."""
    if vertices is None:
        return format_count(corners, "corner")
    beside = f" (of {corners:,} corners)" if corners is not None else ""
    return format_count(vertices, "vertex") + beside


def defects_text(record: MeshRecord | InfoRecord) -> str:
    """The defects of a mesh with their numbers; empty if there are none."""
    winding = "between faces of opposite winding"
    counts = (
        (record.boundary_edges, "boundary edge", ""),
        (record.non_manifold_edges, "non-manifold edge", ""),
        (record.inconsistent_edges, f"edge {winding}", f"edges {winding}"),
        (record.degenerate_faces, "degenerate face", ""),
        (record.duplicate_faces, "duplicate face", ""),
        (record.unreferenced_vertices, "unreferenced vertex", ""),
    )
    texts = [format_count(count, *words) for count, *words in counts if count]
    return ", ".join(texts + ["inside out"] * bool(record.inside_out))


def self_intersections_text(pairs: SelfIntersections) -> str:
    """``164 -> 145 pairs of faces, 101 of them new``."""
    new = "" if pairs.created is None else f", {pairs.created:,} of them new"
    return f"{pairs.before:,} -> {pairs.after:,} pairs of faces{new}"


def noise_texts(noise: NoiseEstimate, record: MeshRecord | InfoRecord) -> list[str]:
    """The level of a mesh's noise and what it is like, then details of the estimate."""
    level = f"{noise.mean_edges:.3g} mean edge lengths"
    interval = f"{noise.low_edges:.2g} to {noise.high_edges:.2g}"
    texts = [f"{interval}; {noise.file_units:.3g} in file units"]
    if noise.unsure and isinstance(record, InfoRecord):
        texts.append(f"unsure: {readings_text(noise)}")
    if noise.negligible:
        is_wanted = isinstance(record, MeshRecord) and is_filtered(record)
        words = "it is unsure whether there is any" if noise.unsure else "none to speak of"
        if is_wanted:
            words = f"{words if noise.unsure else 'hardly any'}, filtered all the same"
        return [f"{level}: {words}", *texts]
    if noise.words:
        texts.append(f"{100.0 * noise.confidence:.0f} % sure: {noise.basis}")
    if noise.uneven and noise.kind != "uneven":
        texts.append(f"uneven: {noise.lowest_edges:.2g} to {noise.highest_edges:.2g} by region")
    if noise.tail >= IMPULSIVE_TAIL:
        texts.append(
            f"impulsive: {100.0 * noise.tail:.1f} % of the vertices stand out; with them "
            f"{noise.rms_edges:.3g} mean edge lengths"
        )
    return [", ".join(filter(None, (level, noise.words))), *texts]


def is_filtered(record: MeshRecord) -> bool:
    """Whether a method moved vertices; a mesh that is left as it is may still be converted."""
    if record.method is None or record.method.name == "none" or record.status == "unchanged":
        return False
    return record.method.parameters.get("iterations") != 0


def unsure_text(record: MeshRecord) -> str:
    """For a choice that could not tell noise from texture: ``noise of 0.08 e (60 %) or texture
    (40 %): filtered mildly, --assume noise or texture decides``; else empty."""
    noise, choice = record.noise_estimate, record.choice
    if noise is None or choice is None or not noise.unsure or choice.wishes.get("assume"):
        return ""
    done = "filtered mildly" if is_filtered(record) else "left as it is"
    return f"{readings_text(noise)}: {done}, --assume noise or texture decides"


def readings_text(noise: NoiseEstimate) -> str:
    """For example ``noise of 0.08 e (60 %) or texture (40 %)``."""
    return " or ".join(
        reading.kind
        + (f" of {reading.level_edges:.2g} e" if reading.level_edges else "")
        + f" ({100.0 * reading.probability:.0f} %)"
        for reading in noise.readings
    )


def auto_text(records: Sequence[MeshRecord]) -> str:
    """For files where --auto would probably come much nearer to the truth, one line; else empty."""
    seconds = known_values(records, "choice.auto_seconds")
    if not seconds:
        return ""
    where = "" if len(records) == 1 else f" on {len(seconds):,} of {len(records):,} files"
    about = f"{sum(seconds):.0f} s" if sum(seconds) < 100.0 else f"{sum(seconds) / 60.0:.0f} min"
    return (
        f"--auto would probably come much nearer to the true surface{where} (machined parts, "
        f"strong noise), in about {about} of one core"
    )


# Tiles


def tile_set_text(records: Sequence[MeshRecord]) -> str:
    """The results for the files of a tile set that are written; empty if there are none."""
    tiles = [record for record in records if record.tile_set is not None]
    if not tiles:
        return ""
    parts, gaps = known_values(tiles, "tile_set"), known_values(tiles, "tile_gap")
    gap = f"{max(gaps):.3g}" if len(gaps) == len(tiles) else "not known"
    texts = [f"{format_count(len(parts), 'file')} as one mesh"]
    texts.append(f"largest gap between shared vertices {gap}")
    if n_welded := sum(part.welded_vertices for part in parts):
        widest = max(part.largest_weld for part in parts)
        welded = format_count(n_welded, "border vertex")
        texts.append(f"{welded} welded, which closed gaps of up to {widest:.3g}")
    if n_fixed := sum(part.fixed_border_vertices for part in parts):
        texts.append(f"{format_count(n_fixed, 'border vertex')} held fixed")
    return "; ".join(texts)
