"""The rows of the HTML report's table: one per file, as plain data for the page's script."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from msal_cli.job.display_names import escape_for_display, figure
from msal_cli.job.plain_data import value_at
from msal_cli.job.records import MeshRecord
from msal_cli.report.phrases import (
    by_hand,
    defects_text,
    despiked_text,
    failure_text,
    file_name,
    noise_texts,
    runners_up_text,
    self_intersections_text,
    storage_text,
)
from msal_cli.report.ranking import broken_gates, gate_words

Column = dict[str, str]
Row = dict[str, Any]

_NAME = {"title": "File", "unit": "", "kind": "name"}
_STATUS = {"title": "Status", "unit": "", "kind": "word"}
_CHOSEN = {"title": "Chosen", "unit": "", "kind": "word"}
_FIGURES = (
    ("Vertices", "", "vertices"),
    ("Volume", "%", "volume.change_percent"),
    ("Mean move", "edges", "displacement.mean_edges"),
    ("Max move", "edges", "displacement.max_edges"),
    ("Max move", "file units", "displacement.max"),
    ("Normals", "mean turn, °", "normal_change.mean_deg"),
    ("Flipped", "faces", "flipped_faces"),
    ("Outliers", "brought back", "despiked"),
    ("Time", "s", "seconds.total"),
)
_TO_REFERENCE = ("To reference", "mean angle, °", "reference.mean_angular_error_deg")
_STATUS_WORDS = {"planned": "not finished", "up-to-date": "up to date"}


def columns(records: Sequence[MeshRecord]) -> list[Column]:
    """What the table shows: title, unit, and ``kind``: ``name``, ``word`` or ``figure``."""
    figures = [
        {"title": title, "unit": unit, "kind": "figure"} for title, unit, _ in _figures(records)
    ]
    return [_NAME, _STATUS, *([_CHOSEN] if _has_choice(records) else []), *figures]


def _figures(records: Sequence[MeshRecord]) -> tuple[tuple[str, str, str], ...]:
    has_reference = any(record.reference is not None for record in records)
    return (*_FIGURES, *([_TO_REFERENCE] if has_reference else []))


def _has_choice(records: Sequence[MeshRecord]) -> bool:
    return any(record.choice is not None for record in records)


def rows(records: Sequence[MeshRecord]) -> list[Row]:
    """For each record its ``kind`` (``failed``, ``gate``, ``planned``, ``good``), ``values`` in the
    order of the columns (None: not known) and ``details``, pairs of a word and a text."""
    with_choice, paths = _has_choice(records), [path for _, _, path in _figures(records)]
    return [
        {
            "kind": _kind(record),
            "values": [
                file_name(record.input),
                "gate broken"
                if broken_gates(record)
                else _STATUS_WORDS.get(record.status, record.status),
                *([_choose(record)] if with_choice else []),
                *(_round(value_at(record, path)) for path in paths),
            ],
            "details": [
                [word, escape_for_display(text)] for word, text in _details(record) if text
            ],
        }
        for record in records
    ]


def _kind(record: MeshRecord) -> str:
    if record.status in ("failed", "planned"):
        return record.status
    return "gate" if broken_gates(record) else "good"


def _choose(record: MeshRecord) -> str:
    """The method that was chosen; empty where it was given."""
    return escape_for_display(record.method.name) if record.choice and record.method else ""


def _round(value: float | None) -> float | None:
    """Six digits: more would make a page of ten thousand files larger, and none is read."""
    if value is None or isinstance(value, int):
        return value
    return float(f"{value:.6g}") if math.isfinite(value) else None


def _details(record: MeshRecord) -> Iterator[tuple[str, str]]:
    if record.error is not None:
        yield "Reason", failure_text(record.error)
        yield "What to do", record.error.hint
    for gate in record.gates:
        yield ("Gate broken" if gate.broken else "Gate passed"), gate_words(gate)
    for warning in record.warnings:
        yield "Warning", warning
    if record.choice is not None:
        yield "Chosen", record.choice.reason
        yield "By hand", by_hand(record.choice)
        yield "Next best", runners_up_text(record.choice.runners_up)
    yield "Left as it is", record.left_alone or ""
    yield "Output", record.output or ""
    several = record.components is not None and record.components != 1
    mesh = (
        figure(record.corners, ",", " corners stored"),
        figure(record.faces, ",", " faces"),
        figure(record.components if several else None, ",", " parts"),
        storage_text(record),
    )
    yield "Mesh", ", ".join(filter(None, mesh))
    yield "Defects", defects_text(record)
    if record.noise_estimate is not None:
        yield "Noise", "; ".join(noise_texts(record.noise_estimate, record))
    yield "Despiked", despiked_text(record.despiked) if record.despiked else ""
    if record.volume is not None and not record.volume.valid:
        yield "Volume", f"no figure: {record.volume.reason}"
    if record.self_intersections is not None:
        yield "Intersecting", self_intersections_text(record.self_intersections)
    if record.reference is not None:
        failure = record.reference.error
        yield "Reference", record.reference.path
        yield "No figures", "" if failure is None else failure_text(failure, with_code=False)
    for sidecar in record.sidecars:
        yield "Beside it", sidecar
