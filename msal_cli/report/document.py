"""What all reports of a run share: how it was started, its records, and totals over them."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from msal_cli.job.display_names import portable
from msal_cli.job.plain_data import about, as_data, known, reported_fields, value_at
from msal_cli.job.records import DONE, SCHEMA, MeshRecord


@dataclass(frozen=True)
class Run:
    """One call of the program; times are UTC, ISO 8601, to the millisecond.

    ``machine`` describes the system and the libraries; it is empty where that is not known.
    """

    version: str = field(metadata=about("version of msal"))
    command: tuple[str, ...] = field(
        metadata=about("the command as it was given, program name first")
    )
    settings: Mapping[str, Any] = field(
        metadata=about("what decides the output beside the input: method, parameters, conversion")
    )
    started: str = field(metadata=about("when the run began, UTC, ISO 8601"))
    finished: str = field(metadata=about("when it ended, UTC, ISO 8601"))
    seconds: float = field(metadata=about("wall-clock seconds between the two"))
    interrupted: bool = known("true if the run was ended before all files were dealt with", False)
    machine: Mapping[str, str] = field(
        default_factory=dict,
        metadata=about("system, cores and libraries, by name; empty where they are not known"),
    )


@dataclass(frozen=True)
class Spread:
    """The lowest, the median and the highest of a figure over ``files`` files."""

    files: int = field(metadata=about("files that the figure is over"))
    lowest: float = field(metadata=about("lowest value"))
    median: float = field(metadata=about("median"))
    highest: float = field(metadata=about("highest value"))


@dataclass(frozen=True)
class Totals:
    """Sums over the records of a run.

    ``chosen`` counts files by the method that was chosen for them.  ``vertices`` and
    ``work_seconds`` count the files that were denoised in this run, and ``volume_change_percent``
    those whose volume can be trusted, up-to-date ones included.
    """

    files: int = field(metadata=about("records in this report"))
    written: int = field(metadata=about("files written with some vertex moved, or in another form"))
    unchanged: int = field(
        metadata=about("files written byte for byte as they were, because no vertex moved")
    )
    up_to_date: int = field(metadata=about("files whose output of an earlier run is current"))
    planned: int = field(
        metadata=about("files not dealt with: by a dry run, or because the run ended before")
    )
    failed: int = field(metadata=about("files that failed"))
    gate_broken: int = field(metadata=about("files written or up to date that break a gate"))
    chosen: Mapping[str, int] = field(
        metadata=about(
            "files written, unchanged or up to date by the method that was chosen, the most "
            "frequent first; empty where the method was given"
        )
    )
    vertices: int = field(metadata=about("vertices of the files denoised in this run"))
    work_seconds: float = field(
        metadata=about("sum of the seconds of the files denoised in this run")
    )
    volume_change_percent: Spread | None = field(
        metadata=about("change of volume over the files whose volume is valid")
    )


def totals(records: Sequence[MeshRecord]) -> Totals:
    """The totals over ``records``."""
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
        gate_broken=sum(any(one.broken for one in record.gates) for record in records),
        chosen=dict(sorted(chosen.items(), key=lambda one: (-one[1], one[0]))),
        vertices=sum(record.vertices or 0 for record in fresh),
        work_seconds=sum(known_values(fresh, "seconds.total")),
        volume_change_percent=(
            Spread(len(changes), min(changes), statistics.median(changes), max(changes))
            if changes
            else None
        ),
    )


def known_values(records: Sequence[Any], path: str) -> list[Any]:
    """The values of a field, by its dotted path, of the records that have one."""
    values = (value_at(record, path) for record in records)
    return [value for value in values if value is not None]


def heading(run: Run, records: Sequence[MeshRecord]) -> dict[str, Any]:
    """All of the report that comes before its records, as plain data."""
    return {
        "schema": SCHEMA,
        **plain_fields(run),
        "totals": plain_fields(totals(records)),
    }


def plain_record(record: Any) -> dict[str, Any]:
    """A record as strict JSON data; see ``plain``."""
    data = as_data(record)
    return {one.name: plain(data[one.name]) for one in reported_fields(type(record))}


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
