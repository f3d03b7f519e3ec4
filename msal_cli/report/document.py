"""What all reports of a run share: how it was started, its records, and totals over them."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from msal_cli.job.display_names import portable
from msal_cli.job.records import DONE, SCHEMA, MeshRecord, as_data


@dataclass(frozen=True)
class Run:
    """One call of the program; times are UTC, ISO 8601, to the millisecond.

    ``machine`` tells of the system and of the libraries; it is empty where that is not known.
    """

    version: str
    command: tuple[str, ...]
    settings: Mapping[str, Any]
    started: str
    finished: str
    seconds: float
    interrupted: bool = False
    machine: Mapping[str, str] = dataclasses.field(default_factory=dict)


@dataclass(frozen=True)
class Spread:
    """The lowest, the median and the highest of a figure over ``files`` files."""

    files: int
    lowest: float
    median: float
    highest: float


@dataclass(frozen=True)
class Totals:
    """Sums over the records of a run.

    ``chosen`` counts files by the method that --auto chose for them.  ``vertices`` and
    ``work_seconds`` count the files that were denoised in this run, and ``volume_change_percent``
    those whose volume can be trusted, up-to-date ones included.
    """

    files: int
    written: int
    unchanged: int
    up_to_date: int
    planned: int
    failed: int
    gate_broken: int
    chosen: Mapping[str, int]
    vertices: int
    work_seconds: float
    volume_change_percent: Spread | None


def totals(records: Sequence[MeshRecord]) -> Totals:
    """The totals over ``records``."""
    import statistics

    states = Counter(record.status for record in records)
    fresh = [record for record in records if record.status in DONE]
    changes = [
        record.volume.change_percent
        for record in records
        if record.volume is not None and record.volume.change_percent is not None
    ]
    return Totals(
        files=len(records),
        written=states["written"],
        unchanged=states["unchanged"],
        up_to_date=states["up-to-date"],
        planned=states["planned"],
        failed=states["failed"],
        gate_broken=sum(any(one.broken for one in record.gates) for record in records),
        chosen=_chosen(records),
        vertices=sum(record.vertices or 0 for record in fresh),
        work_seconds=sum(record.seconds.total for record in fresh if record.seconds is not None),
        volume_change_percent=(
            Spread(len(changes), min(changes), statistics.median(changes), max(changes))
            if changes
            else None
        ),
    )


def _chosen(records: Sequence[MeshRecord]) -> dict[str, int]:
    counts = Counter(
        record.method.name
        for record in records
        if record.choice is not None and record.method is not None and record.error is None
    )
    return dict(sorted(counts.items(), key=lambda one: (-one[1], one[0])))


def heading(run: Run, records: Sequence[MeshRecord]) -> dict[str, Any]:
    """All of the report that comes before its records, as plain data."""
    return {
        "schema": SCHEMA,
        **plain_fields(run),
        "totals": plain_fields(totals(records)),
    }


def plain_record(record: Any) -> dict[str, Any]:
    """A record as strict JSON data; see ``plain``."""
    data: dict[str, Any] = plain(as_data(record))
    return data


def plain_fields(value: Any) -> dict[str, Any]:
    """The fields of a dataclass, and of those in it, as strict JSON data; see ``plain``."""
    data: dict[str, Any] = plain(dataclasses.asdict(value))
    return data


def plain(value: Any) -> Any:
    """``value`` with nothing in it that strict JSON lacks.

    A number that is not finite becomes None, text becomes ``portable``, a tuple a list, and a
    number of another library a number.

    Raises
    ------
    TypeError
        for anything that is not data.
    """
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, str):
        return portable(value)
    if isinstance(value, float):
        return float(value) if value - value == 0.0 else None
    if isinstance(value, Mapping):
        return {portable(str(key)): plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    if hasattr(value, "item"):
        return plain(value.item())
    raise TypeError(f"a report cannot hold {type(value).__name__}")
