"""The reports of ``msal compare``: text for one pair of files, a table for many; and earlier
ones read as a baseline.

Figures of which less is better may exceed their baseline by a tolerance.  A larger excess is a
broken gate, as if a gate had been given for each file.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from msal_cli.errors import format_count
from msal_cli.job.display_names import figure
from msal_cli.job.records import (
    SCHEMA,
    ComparisonRecord,
    GateResult,
    Reference,
    SurfaceDistance,
    value_at,
)
from msal_cli.report import facts
from msal_cli.report.data import BASELINE, not_a, parse_json, read_json, read_record
from msal_cli.report.facts import Fact, Line, file_name
from msal_cli.report.text import table_lines

# Title, path in the record, format and unit.
_COLUMNS = (
    ("angle", "mean_angular_error_deg", ".2f", "°"),
    ("vertex error", "vertex_error_percent", ".2f", " %"),
    ("max move", "displacement.max_edges", ".3g", " e"),
    ("volume", "volume_change_percent", "+.3f", " %"),
    ("area", "area_change_percent", "+.3f", " %"),
    ("flipped", "flipped_faces", ",", ""),
    ("Hausdorff", "hausdorff_edges", ".3g", " e"),
    ("intersecting", "self_intersections.after", ",", ""),
)

BASELINE_FIGURES = (
    "mean_angular_error_deg",
    "vertex_error_percent",
    "displacement.rms_edges",
    "displacement.max_edges",
    "hausdorff_edges",
    "volume_change_percent",
    "area_change_percent",
    "flipped_faces",
)
"""The figures that are compared with the baseline; of changes the absolute values."""

SLACK = 1e-6
"""The excess that any figure may have, in its own unit: rounding differs between machines."""


def describe_comparison(record: ComparisonRecord) -> Iterator[Line]:
    """The lines for two files that were compared: their names, then one line per measure."""
    before = facts.vertices_text(record.vertices_before, record.corners_before)
    after = facts.vertices_text(record.vertices_after, record.corners_after)
    for side, path, vertices, n_faces in (
        ("before", record.before, before, record.faces_before),
        ("after", record.after, after, record.faces_after),
    ):
        text = f"{vertices}, {format_count(n_faces or 0, 'triangle')}"
        yield Line(f"{side:8}{file_name(path)}: {text}")
    yield from facts.fact_lines(list_facts(record), 18)


def comparison_table(records: Sequence[ComparisonRecord], *, width: int = 100) -> Iterator[Line]:
    """A row for every pair, then the failures; lengths in mean edge lengths."""
    compared = [record for record in records if record.error is None]
    if compared:
        is_counted = any(record.self_intersections for record in compared)
        columns = _COLUMNS if is_counted else _COLUMNS[:-1]
        rows = [
            [figure(value_at(record, path), form, unit, "-") for _, path, form, unit in columns]
            for record in compared
        ]
        heads = ("after", *(column[0] for column in columns))
        yield from table_lines(heads, [file_name(record.after) for record in compared], rows, width)
    for record in compared:
        for text in record.warnings:
            yield Line(f"warning: {_pair_name(record)}: {text}", "bad")
    for record in records:
        side = record.at_fault
        name = file_name(getattr(record, side)) if side is not None else _pair_name(record)
        yield from facts.failure_lines(name, record.error)
    n_failed = len(records) - len(compared)
    end = f"{len(compared):,} compared" + (f", {n_failed:,} not" if n_failed else "")
    yield Line(f"{end}; e: mean edge lengths before", "bad" if n_failed else "good")


def _pair_name(record: ComparisonRecord) -> str:
    return f"{file_name(record.before)} and {file_name(record.after)}"


def list_facts(record: ComparisonRecord) -> Iterator[Fact]:
    """The differences between two meshes as facts; warnings at the end."""
    angles = (record.mean_angular_error_deg, record.max_angular_error_deg)
    is_surface = record.correspondence == "surface"
    volume, pairs = record.volume, record.self_intersections
    change = "" if volume is None else f"- {volume.reason}"
    if volume is not None and volume.change is not None:
        change = f"{figure(volume.change_percent, '+.4g', ' %', '-')} ({volume.change:+.4g})"
    for word, text in (
        ("mean edge before", figure(record.mean_edge_length, ".6g", unknown="-")),
        ("compared", "surfaces only: the faces are not the same" if is_surface else ""),
        ("normal angle", _join("mean {:.4g}, max {:.4g} degrees", *angles)),
        ("vertex error", figure(record.vertex_error_percent, ".4g", " % of the mean edge")),
        ("displacement", _distance_text(record.displacement)),
        ("after to before", _distance_text(record.distance_to_before)),
        ("before to after", _distance_text(record.distance_to_after)),
        ("Hausdorff", _join("{:.4g} ({:.4g} e)", record.hausdorff, record.hausdorff_edges)),
        ("volume", change),
        ("area", figure(record.area_change_percent, "+.4g", " %", "-")),
        ("flipped faces", figure(record.flipped_faces, ",")),
        ("intersecting", "" if pairs is None else facts.self_intersections_text(pairs)),
    ):
        if text:
            yield Fact(word, text)
    yield from (Fact("warning", text, "bad") for text in record.warnings)


def _join(form: str, *values: float | None) -> str:
    return "" if None in values else form.format(*values)


def _distance_text(distance: SurfaceDistance | None) -> str:
    if distance is None:
        return ""
    parts = (
        f"{word} {getattr(distance, word):.4g} ({getattr(distance, f'{word}_edges'):.4g} e)"
        for word in ("mean", "rms", "p95", "max")
    )
    return ", ".join(parts)


# Baseline


def read_comparisons(data: bytes, name: str) -> dict[str, ComparisonRecord | Reference]:
    """Comparisons by the path of the measured mesh, without failures.

    ``data`` is the output of ``msal compare --json``, or a report of ``msal denoise --reference``;
    FormatError, with ``name``, if it is neither.
    """
    content = parse_json(data, name, BASELINE)
    schema = content.get("schema") if isinstance(content, dict) else None
    found: dict[str, ComparisonRecord | Reference] = {}
    if schema == SCHEMA:
        for record in read_json(data, name)[1]:
            reference = record.reference
            if record.output is not None and reference is not None and reference.error is None:
                found[record.output] = reference
        if not found:
            raise not_a(BASELINE, name, "no file in it was measured against a reference")
        return found
    if schema != ComparisonRecord.schema:
        wanted = ComparisonRecord.schema
        raise not_a(BASELINE, name, f"missing or unsupported schema (expected {wanted})")
    rows = content.get("records", [content])
    if not isinstance(rows, list):
        raise not_a(BASELINE, name, "it has no list of records")
    for at, row in enumerate(rows, 1):
        pair = read_record(ComparisonRecord, row, name, f"record {at}", BASELINE)
        if pair.error is None:
            found[pair.after] = pair
    return found


def find_partner(name: str, earlier: Mapping[str, Any]) -> Any | None:
    """The earlier record of a file by its path or by the end of its path, because folders often
    differ; None if there is none, or more than one."""
    if name in earlier:
        return earlier[name]
    end = "/" + name.replace("\\", "/")
    found = [record for path, record in earlier.items() if path.replace("\\", "/").endswith(end)]
    return found[0] if len(found) == 1 else None


def compare_with_baseline(
    record: Any, before: Any | None, tolerance: float
) -> tuple[GateResult, ...]:
    """The gates of a record whose figures were known ``before``.

    Parameters
    ----------
    record, before : a comparison now and then, or the reference part of a denoising; ``before`` is
        None for a new file, which has no gates.
    tolerance : the share of its old value by which a figure may be larger.
    """
    results = []
    for path in BASELINE_FIGURES:
        then, now = _baseline_figure(before, path), _baseline_figure(record, path)
        if then is None:
            continue
        limit = then * (1.0 + tolerance) + SLACK
        name = f"abs({path})" if path.endswith("_change_percent") else path
        value = f"{path} is not known" if now is None else f"{name} is {now:.6g}"
        result = GateResult(
            expression=f"{name} > {limit:.6g}",
            broken=now is None or now > limit,
            decided=now is not None,
            values={path: now},
            reason=f"{value}, {then:.6g} in the baseline, tolerance {100.0 * tolerance:g} %",
        )
        results.append(result)
    return tuple(results)


def _baseline_figure(record: Any, path: str) -> float | None:
    value = value_at(record, path)
    return None if value is None or value - value != 0.0 else abs(value)


def list_missing(names: Sequence[str], earlier: Mapping[str, Any]) -> list[str]:
    """Paths of the baseline that match none of ``names``."""
    found = {id(find_partner(name, earlier)) for name in names}
    return [path for path, record in earlier.items() if id(record) not in found]
