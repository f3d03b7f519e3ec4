"""The rows of the HTML report's table: one per file, as plain data for the page's script."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from msal_cli.job.display_names import shown
from msal_cli.job.records import MeshRecord
from msal_cli.report.ranking import broken_gates, gate_words
from msal_cli.report.text import (
    by_hand,
    defects_text,
    despiked_text,
    noise_texts,
    reason,
    runner_up_text,
    self_intersections_text,
)

Column = dict[str, str]
Row = dict[str, Any]

_NAME = {"title": "File", "unit": "", "kind": "name"}
_STATUS = {"title": "Status", "unit": "", "kind": "word"}
_CHOSEN = {"title": "Chosen", "unit": "", "kind": "word"}
_FIGURES = (
    ("Vertices", ""),
    ("Volume", "%"),
    ("Mean move", "edges"),
    ("Max move", "edges"),
    ("Max move", "file units"),
    ("Normals", "mean turn, °"),
    ("Flipped", "faces"),
    ("Time", "s"),
)
_TO_REFERENCE = ("To reference", "mean angle, °")


def columns(records: Sequence[MeshRecord]) -> list[Column]:
    """What the table shows: title, unit, and ``kind``: ``name``, ``word`` or ``figure``."""
    titles = [*_FIGURES, *([_TO_REFERENCE] if _has_reference(records) else [])]
    figures = [{"title": title, "unit": unit, "kind": "figure"} for title, unit in titles]
    return [_NAME, _STATUS, *([_CHOSEN] if _has_choice(records) else []), *figures]


def rows(records: Sequence[MeshRecord]) -> list[Row]:
    """For each record its ``kind`` (``failed``, ``gate``, ``planned``, ``good``), ``values`` in the
    order of the columns (None: not known) and ``details``, pairs of a word and a text."""
    with_reference, with_choice = _has_reference(records), _has_choice(records)
    return [
        {
            "kind": _kind(record),
            "values": [
                _name(record),
                _status(record),
                *([_chosen(record)] if with_choice else []),
                *_figures(record, with_reference),
            ],
            "details": [[word, shown(text)] for word, text in _details(record) if text],
        }
        for record in records
    ]


def _kind(record: MeshRecord) -> str:
    if record.status in ("failed", "planned"):
        return record.status
    return "gate" if broken_gates(record) else "good"


def _status(record: MeshRecord) -> str:
    words = {"planned": "not finished", "up-to-date": "up to date"}
    return "gate broken" if broken_gates(record) else words.get(record.status, record.status)


def _chosen(record: MeshRecord) -> str:
    """The method that --auto chose; empty where it did not."""
    chose = record.choice is not None and record.method is not None
    return shown(record.method.name) if chose and record.method is not None else ""


def _name(record: MeshRecord) -> str:
    return "standard input" if record.input == "-" else shown(record.input)


def _figures(record: MeshRecord, with_reference: bool) -> list[float | None]:
    volume, moved, turned = record.volume, record.displacement, record.normal_change
    figures = [
        record.vertices,
        volume.change_percent if volume is not None else None,
        moved.mean_edges if moved is not None else None,
        moved.max_edges if moved is not None else None,
        moved.max if moved is not None else None,
        turned.mean_deg if turned is not None else None,
        record.flipped_faces,
        record.seconds.total if record.seconds is not None else None,
    ]
    if with_reference:
        reference = record.reference
        figures.append(None if reference is None else reference.mean_angular_error_deg)
    return [_rounded(one) for one in figures]


def _rounded(figure: float | None) -> float | None:
    """Six digits: what nobody reads must not be paid for ten thousand times."""
    if figure is None or isinstance(figure, int):
        return figure
    return float(f"{figure:.6g}") if math.isfinite(figure) else None


def _details(record: MeshRecord) -> Iterator[tuple[str, str]]:
    failure = record.error
    if failure is not None:
        yield "Reason", reason(failure.where, failure.message, failure.code)
        yield "What to do", failure.hint
    for gate in record.gates:
        yield ("Gate broken" if gate.broken else "Gate held"), gate_words(gate)
    for warning in record.warnings:
        yield "Warning", warning
    if record.choice is not None:
        yield "Chosen", record.choice.reason
        yield "By hand", by_hand(record.choice)
        yield "Next best", ", ".join(map(runner_up_text, record.choice.runners_up))
    yield "Left as it is", record.left_alone or ""
    yield "Output", record.output or ""
    yield "Mesh", _mesh(record)
    yield "Defects", defects_text(record)
    if record.noise_estimate is not None:
        yield "Noise", "; ".join(noise_texts(record.noise_estimate))
    yield "Despiked", despiked_text(record.despiked) if record.despiked else ""
    if record.volume is not None and not record.volume.valid:
        yield "Volume", f"no figure: {record.volume.reason}"
    if record.self_intersections is not None:
        yield "Intersecting", self_intersections_text(record.self_intersections)
    if record.reference is not None:
        failure = record.reference.error
        yield "Reference", record.reference.path
        yield "No figures", "" if failure is None else reason(failure.where, failure.message, "")
    for sidecar in record.sidecars:
        yield "Beside it", sidecar


def _mesh(record: MeshRecord) -> str:
    counts = (
        f"{record.corners:,} corners stored" if record.corners is not None else "",
        f"{record.faces:,} faces" if record.faces is not None else "",
        f"{record.components:,} parts" if record.components not in (None, 1) else "",
        " ".join(one for one in (record.format, record.encoding, record.precision) if one),
    )
    return ", ".join(one for one in counts if one)


def _has_choice(records: Sequence[MeshRecord]) -> bool:
    return any(record.choice is not None for record in records)


def _has_reference(records: Sequence[MeshRecord]) -> bool:
    return any(record.reference is not None for record in records)
