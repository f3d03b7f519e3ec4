"""What ``msal compare`` prints for people: two files in detail, folders as a table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from msal_cli.job.comparison_record import ComparisonRecord
from msal_cli.job.display_names import escape_for_display, figure, pad_name, shorten_name
from msal_cli.job.plain_data import value_at
from msal_cli.job.records import SurfaceDistance
from msal_cli.report.phrases import (
    Line,
    failure_lines,
    file_name,
    gate_text,
    self_intersections_text,
    vertices_text,
)

_COLUMNS = ("angle", "vertex error", "max move", "volume", "area", "flipped", "Hausdorff")
_NARROWEST_NAME = 16


def describe_comparison(record: ComparisonRecord) -> list[Line]:
    """The lines on two files: their names, then one line per measure."""
    if record.error is not None:
        return failure_lines(_pair(record), record.error)
    before = _counts(record.vertices_before, record.corners_before, record.faces_before)
    after = _counts(record.vertices_after, record.corners_after, record.faces_after)
    lines = [
        Line(f"before  {file_name(record.before)}: {before}"),
        Line(f"after   {file_name(record.after)}: {after}"),
    ]
    lines += [Line(f"  {word:<18} {text}") for word, text in _facts(record)]
    return lines + [
        Line(f"  {'warning':<18} {escape_for_display(text)}", "bad") for text in record.warnings
    ]


def table(records: Sequence[ComparisonRecord], *, width: int = 100) -> Iterator[Line]:
    """A row for every pair, then what could not be compared and why; lengths in mean edges."""
    compared = [record for record in records if record.error is None]
    rows = [_row(record) for record in compared]
    widths = [
        max(len(head), *(len(row[at]) for row in rows)) if rows else len(head)
        for at, head in enumerate(_COLUMNS)
    ]
    room = max(_NARROWEST_NAME, width - sum(widths) - 2 * len(widths))
    names = [shorten_name(file_name(record.after), room) for record in compared]
    room = min(room, max((len(name) for name in (*names, "after")), default=0))
    if rows:
        heads = (
            pad_name(head, wide, right=True) for head, wide in zip(_COLUMNS, widths, strict=True)
        )
        yield Line("  ".join((pad_name("after", room), *heads)), "faint")
    for name, row in zip(names, rows, strict=True):
        cells = (pad_name(cell, wide, right=True) for cell, wide in zip(row, widths, strict=True))
        yield Line("  ".join((pad_name(name, room), *cells)))
    for warning in dict.fromkeys(text for record in compared for text in record.warnings):
        yield Line(f"warning: {escape_for_display(warning)}", "bad")
    for record in records:
        yield from failure_lines(_pair(record), record.error)
    n_failed = len(records) - len(compared)
    end = f"{len(compared):,} compared" + (f", {n_failed:,} not" if n_failed else "")
    yield Line(f"{end}; e: mean edge lengths before", "bad" if n_failed else "good")


def broken_gates(records: Sequence[ComparisonRecord]) -> Iterator[Line]:
    """A line for every gate that a pair breaks, with the value."""
    for record in records:
        for gate in record.gates:
            if gate.broken:
                yield Line(f"{file_name(record.after)}: {gate_text(gate)}", "bad")


def _pair(record: ComparisonRecord) -> str:
    return f"{file_name(record.before)} and {file_name(record.after)}"


def _counts(vertices: int | None, corners: int | None, faces: int | None) -> str:
    return f"{vertices_text(vertices, corners)}, {faces or 0:,} triangles"


def _facts(record: ComparisonRecord) -> Iterator[tuple[str, str]]:
    yield "mean edge before", figure(record.mean_edge_length, ".6g", unknown="-")
    if record.correspondence == "surface":
        yield "compared", "surfaces only: the faces are not the same"
    if record.mean_angular_error_deg is not None:
        largest = record.max_angular_error_deg or 0.0
        yield "normal angle", f"mean {record.mean_angular_error_deg:.4g}, max {largest:.4g} degrees"
    if record.vertex_error_percent is not None:
        yield "vertex error", f"{record.vertex_error_percent:.4g} % of the mean edge"
    for word, lengths in (
        ("displacement", record.displacement),
        ("after to before", record.distance_to_before),
        ("before to after", record.distance_to_after),
    ):
        if lengths is not None:
            yield word, _lengths(lengths)
    if record.hausdorff is not None and record.hausdorff_edges is not None:
        yield "Hausdorff", f"{record.hausdorff:.4g} ({record.hausdorff_edges:.4g} e)"
    volume = record.volume
    if volume is not None:
        change = figure(volume.change_percent, "+.4g", " %", "-")
        unknown = f"- {escape_for_display(volume.reason)}"
        yield "volume", unknown if volume.change is None else f"{change} ({volume.change:+.4g})"
    yield "area", figure(record.area_change_percent, "+.4g", " %", "-")
    if record.flipped_faces is not None:
        yield "flipped faces", f"{record.flipped_faces:,}"
    if record.self_intersections is not None:
        yield "intersecting", self_intersections_text(record.self_intersections)


def _lengths(one: SurfaceDistance) -> str:
    parts = (
        ("mean", one.mean, one.mean_edges),
        ("rms", one.rms, one.rms_edges),
        ("p95", one.p95, one.p95_edges),
        ("max", one.max, one.max_edges),
    )
    return ", ".join(f"{word} {length:.4g} ({edges:.4g} e)" for word, length, edges in parts)


def _row(record: ComparisonRecord) -> tuple[str, ...]:
    return (
        figure(record.mean_angular_error_deg, ".2f", "°", "-"),
        figure(record.vertex_error_percent, ".2f", " %", "-"),
        figure(value_at(record, "displacement.max_edges"), ".3g", " e", "-"),
        figure(record.volume_change_percent, "+.3f", " %", "-"),
        figure(record.area_change_percent, "+.3f", " %", "-"),
        figure(record.flipped_faces, ",", "", "-"),
        figure(record.hausdorff_edges, ".3g", " e", "-"),
    )
