"""What is known about one file after msal has dealt with it, and how it becomes plain data.

A record is made by ``pipeline`` (or, for a file whose worker died, by ``batch``) and only read
afterwards: every report is a reader of records.  Fields may be added; none is ever removed or
given another meaning while the schema is ``msal.report/1``.
"""

from __future__ import annotations

import dataclasses
import functools
import typing
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Any, Literal

SCHEMA = "msal.report/1"

Status = Literal["written", "unchanged", "up-to-date", "planned", "failed"]


@dataclass(frozen=True)
class Volume:
    """Signed volume in cubed file units; ``reason`` says why it is not ``valid`` (open, ...)."""

    before: float | None
    after: float | None
    change: float | None
    change_percent: float | None
    valid: bool
    reason: str


@dataclass(frozen=True)
class Area:
    """Surface area in squared file units."""

    before: float
    after: float
    change_percent: float | None


@dataclass(frozen=True)
class Displacement:
    """How far the vertices that faces use moved, in file units and in mean edge lengths."""

    mean: float
    rms: float
    p95: float
    max: float
    mean_edges: float
    rms_edges: float
    p95_edges: float
    max_edges: float
    moved_vertices: int


@dataclass(frozen=True)
class NormalChange:
    """Angle between each face's normal before and after, in degrees."""

    mean_deg: float
    max_deg: float


@dataclass(frozen=True)
class NoiseEstimate:
    """Estimated standard deviation of the noise along the normals."""

    mean_edges: float
    file_units: float


@dataclass(frozen=True)
class MethodUsed:
    """The method and every one of its parameters, defaults included."""

    name: str
    parameters: dict[str, Any]


@dataclass(frozen=True)
class Seconds:
    """Wall-clock seconds by stage, in the order in which the stages run."""

    read: float = 0.0
    connectivity: float = 0.0
    normals: float = 0.0
    sweeps: float = 0.0
    measure: float = 0.0
    write: float = 0.0
    total: float = 0.0


@dataclass(frozen=True)
class Failure:
    """Why a file was not written: a stable code, the reason, the place and what to do."""

    code: str
    message: str
    hint: str = ""
    where: str = ""


@dataclass(frozen=True)
class ObjectMark:
    """Size in bytes and entity tag of an object in a store; the tag is empty if none is given."""

    size: int
    tag: str


@dataclass(frozen=True)
class MeshRecord:
    """One row per file; fields that could not be determined are None.

    ``status`` is ``written``; ``unchanged`` (written, but no vertex moved, so the bytes are the
    input's); ``up-to-date`` (the output of an earlier run is current); ``planned`` (--dry-run, or
    the run ended before); or ``failed`` (see ``error``; if it is ``remembered`` the file failed in
    an earlier run, and was not tried again).  Lengths are in file units unless the name says
    otherwise.
    """

    input: str
    status: Status
    output: str | None = None
    schema: str = SCHEMA
    version: str = ""
    format: str | None = None
    encoding: str | None = None
    precision: str | None = None
    vertices: int | None = None
    faces: int | None = None
    triangles: int | None = None
    components: int | None = None
    boundary_edges: int | None = None
    non_manifold_edges: int | None = None
    inconsistent_edges: int | None = None
    degenerate_faces: int | None = None
    duplicate_faces: int | None = None
    unreferenced_vertices: int | None = None
    welded_vertices: int | None = None
    seam_gap: float | None = None
    mean_edge_length: float | None = None
    volume: Volume | None = None
    area: Area | None = None
    displacement: Displacement | None = None
    normal_change: NormalChange | None = None
    flipped_faces: int | None = None
    noise_estimate: NoiseEstimate | None = None
    method: MethodUsed | None = None
    seconds: Seconds | None = None
    vertices_per_second: float | None = None
    peak_memory_bytes: int | None = None
    input_sha256: str | None = None
    output_sha256: str | None = None
    input_object: ObjectMark | None = None
    output_object: ObjectMark | None = None
    sidecars: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    remembered: bool = False
    error: Failure | None = None


@dataclass(frozen=True)
class InfoRecord:
    """What ``msal info`` tells of one file; lengths are in file units."""

    input: str
    schema: str = "msal.info/1"
    format: str | None = None
    encoding: str | None = None
    precision: str | None = None
    compressed: bool = False
    bytes: int | None = None
    vertices: int | None = None
    faces: int | None = None
    triangles: int | None = None
    polygon_sizes: dict[str, int] = field(default_factory=dict)
    components: int | None = None
    closed: bool | None = None
    winding: str | None = None
    boundary_edges: int | None = None
    non_manifold_edges: int | None = None
    inconsistent_edges: int | None = None
    degenerate_faces: int | None = None
    duplicate_faces: int | None = None
    unreferenced_vertices: int | None = None
    welded_vertices: int | None = None
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    area: float | None = None
    volume: float | None = None
    volume_valid: bool | None = None
    volume_reason: str = ""
    mean_edge_length: float | None = None
    noise_estimate: NoiseEstimate | None = None
    properties: tuple[str, ...] = ()
    references: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    error: Failure | None = None


def as_data(record: Any) -> dict[str, Any]:
    """A record as plain dicts, lists, strings and numbers, ready for JSON."""
    data: dict[str, Any] = dataclasses.asdict(record)
    return data


@functools.cache
def _type_hints(kind: Hashable) -> dict[str, Any]:
    # Half a millisecond a call, and a manifest of 10,000 files makes 10,000.
    return typing.get_type_hints(kind)


def from_data(kind: type[Any], data: dict[str, Any]) -> Any:
    """The record that ``as_data`` made ``data`` from; fields that it does not know are dropped."""
    hints: dict[str, Any] = _type_hints(typing.cast(Hashable, kind))
    values: dict[str, Any] = {}
    for one in dataclasses.fields(kind):
        if one.name not in data:
            continue
        value = data[one.name]
        inner = [t for t in typing.get_args(hints[one.name]) if dataclasses.is_dataclass(t)]
        if isinstance(value, dict) and inner:
            value = from_data(typing.cast("type[Any]", inner[0]), value)
        elif isinstance(value, list):
            value = tuple(tuple(v) if isinstance(v, list) else v for v in value)
        values[one.name] = value
    return kind(**values)
