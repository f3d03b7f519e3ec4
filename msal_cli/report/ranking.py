"""Which files to look at first, in every report that puts some files before others."""

from __future__ import annotations

import math
from collections.abc import Sequence

from msal_cli.job.plain_data import value_at
from msal_cli.job.records import GateResult, MeshRecord

WORDS = (
    "Worst first: what failed, then what broke a gate (the most gates first), then what was not "
    "finished, then the largest displacement in mean edge lengths, then the largest change of "
    "volume."
)
"""The order, for the reader of a report."""


def worst_first(records: Sequence[MeshRecord]) -> list[MeshRecord]:
    """The records in the order that ``WORDS`` describes; equals stay in the order of the inputs.

    A figure that is not finite counts as the largest, one that is not known as the smallest.
    """
    return sorted(records, key=_rank)


def broken_gates(record: MeshRecord) -> tuple[str, ...]:
    """The gates that a file did not pass, in words; none if all were passed."""
    return tuple(gate_words(one) for one in record.gates if one.broken)


def gate_words(gate: GateResult) -> str:
    """A gate with the values that it was decided by, or why it could not be decided."""
    words = f"{gate.expression} ({gate.reason})"
    return words if gate.decided else f"not decided: {words}"


def _rank(record: MeshRecord) -> tuple[int, int, float, float]:
    broken = len(broken_gates(record))
    group = (
        0 if record.status == "failed" else 1 if broken else 2 if record.status == "planned" else 3
    )
    moved = value_at(record, "displacement.max_edges")
    return group, -broken, -_size(moved), -_size(value_at(record, "volume.change_percent"))


def _size(figure: float | None) -> float:
    if figure is None:
        return -1.0
    return abs(figure) if math.isfinite(figure) else math.inf
