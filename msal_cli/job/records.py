"""What is known about one file after msal has dealt with it, and how it becomes plain data.

A record is made by ``pipeline`` (or, for a file whose worker died, by ``batch``) and only read
afterwards: every report is a reader of records.  Fields may be added; none is ever removed or
given another meaning while the schema is ``msal.report/1``.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import sys
import types
import typing
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

SCHEMA = "msal.report/1"

_LONGEST_WORD = 24

Status = Literal["written", "unchanged", "up-to-date", "planned", "failed"]

DONE = ("written", "unchanged")
"""Statuses of files that the run itself has done."""

WITH_OUTPUT = (*DONE, "up-to-date")
"""Statuses of files whose output is in place."""


@dataclass(frozen=True, slots=True)
class Volume:
    """Volume in cubed file units that a surface encloses, whichever side its normals point to;
    ``reason`` says why it is not ``valid`` (open, ...).

    A volume that is not valid has no figures, also in records of earlier versions that had some.
    """

    before: float | None
    after: float | None
    change: float | None
    change_percent: float | None
    valid: bool
    reason: str

    def __post_init__(self) -> None:
        if not self.valid:
            for name in ("before", "after", "change", "change_percent"):
                object.__setattr__(self, name, None)


@dataclass(frozen=True, slots=True)
class Area:
    """Surface area in squared file units."""

    before: float
    after: float
    change_percent: float | None


@dataclass(frozen=True, slots=True)
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


@dataclass(frozen=True, slots=True)
class NormalChange:
    """Angle between each face's normal before and after, in degrees."""

    mean_deg: float
    max_deg: float


@dataclass(frozen=True, slots=True)
class NoiseEstimate:
    """Estimated standard deviation of the noise along its direction, and what is behind it.

    Records of earlier versions have the first two fields only, or none from ``kind`` on.
    """

    mean_edges: float
    file_units: float
    low_edges: float | None = None
    high_edges: float | None = None
    clean_edges: float | None = None
    rms_edges: float | None = None
    tail: float | None = None
    negligible: bool | None = None
    lowest_edges: float | None = None
    highest_edges: float | None = None
    regions: int | None = None
    uneven: bool | None = None
    kind: str | None = None
    rings: int | None = None
    direction: str | None = None
    axis: tuple[float, float, float] | None = None
    step_edges: float | None = None
    outliers: float | None = None
    confidence: float | None = None
    basis: str | None = None
    words: str | None = None


@dataclass(frozen=True, slots=True)
class MethodUsed:
    """The method and every one of its parameters, defaults included."""

    name: str
    parameters: dict[str, Any]


@dataclass(frozen=True, slots=True)
class RunnerUp:
    """What was nearly chosen by --auto, and its estimated error."""

    label: str
    risk_edges: float


@dataclass(frozen=True, slots=True)
class ChoiceMade:
    """Why ``method`` was chosen; lengths are in mean edge lengths.

    ``method`` is ``none`` where the mesh stays as it is.  ``repeat`` are the options that do the
    same by hand.
    """

    reason: str
    surface: str | None
    noise_edges: float
    risk_edges: float | None
    tried: int
    runners_up: tuple[RunnerUp, ...]
    wishes: dict[str, Any]
    repeat: tuple[str, ...]
    among: str = "all"


@dataclass(frozen=True, slots=True)
class Seconds:
    """Wall-clock seconds by stage, in the order in which the stages run."""

    read: float = 0.0
    connectivity: float = 0.0
    choose: float = 0.0
    normals: float = 0.0
    sweeps: float = 0.0
    measure: float = 0.0
    write: float = 0.0
    total: float = 0.0


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a file was not written: a stable code, the reason, the place and what to do."""

    code: str
    message: str
    hint: str = ""
    where: str = ""


@dataclass(frozen=True, slots=True)
class GateResult:
    """What became of one gate (--fail-on) for one file.

    ``values`` are those of the names in the expression, in the units of their fields; one that is
    not known is None.  ``reason`` says them in words, and why a gate could not be decided; one that
    could not be counts as broken.
    """

    expression: str
    broken: bool
    decided: bool
    values: dict[str, float | None]
    reason: str


@dataclass(frozen=True, slots=True)
class ObjectMark:
    """Size in bytes and entity tag of an object in a store; the tag is empty if none is given."""

    size: int
    tag: str


@dataclass(frozen=True, slots=True)
class SurfaceDistance:
    """Distances from the vertices of one mesh to the surface of another, in file units and in
    mean edge lengths of the mesh before."""

    mean: float
    rms: float
    p95: float
    max: float
    mean_edges: float
    rms_edges: float
    p95_edges: float
    max_edges: float


@dataclass(frozen=True, slots=True)
class SelfIntersections:
    """Pairs of faces that intersect each other before and after, and how many of those after did
    not before; that is None where the faces are not the same."""

    before: int
    after: int
    created: int | None


@dataclass(frozen=True)
class ComparisonRecord:
    """A mesh ``after`` against a mesh ``before``, which is the reference: its mean edge length is
    the unit, its volume, area and normals are what changed.

    ``correspondence`` is ``vertices`` where both files have the same faces, and ``surface`` where
    not: then what needs corresponding vertices is None, and the vertex error is the mean distance
    of ``after``'s vertices to ``before``'s surface.
    """

    before: str
    after: str
    schema: str = "msal.compare/1"
    version: str = ""
    correspondence: Literal["vertices", "surface"] | None = None
    vertices_before: int | None = None
    vertices_after: int | None = None
    corners_before: int | None = None
    corners_after: int | None = None
    faces_before: int | None = None
    faces_after: int | None = None
    mean_edge_length: float | None = None
    mean_angular_error_deg: float | None = None
    max_angular_error_deg: float | None = None
    vertex_error_percent: float | None = None
    displacement: Displacement | None = None
    flipped_faces: int | None = None
    volume_change_percent: float | None = None
    area_change_percent: float | None = None
    inside_out_before: bool | None = None
    inside_out_after: bool | None = None
    volume: Volume | None = None
    area: Area | None = None
    hausdorff: float | None = None
    hausdorff_edges: float | None = None
    distance_to_before: SurfaceDistance | None = None
    distance_to_after: SurfaceDistance | None = None
    seam_gap: float | None = None
    self_intersections: SelfIntersections | None = None
    warnings: tuple[str, ...] = ()
    gates: tuple[GateResult, ...] = ()
    error: Failure | None = None


@dataclass(frozen=True, slots=True)
class Reference:
    """An output against its reference, the true mesh at ``path``: the figures of a
    ``ComparisonRecord`` whose ``before`` is the reference."""

    path: str
    correspondence: Literal["vertices", "surface"] | None = None
    mean_edge_length: float | None = None
    mean_angular_error_deg: float | None = None
    max_angular_error_deg: float | None = None
    vertex_error_percent: float | None = None
    displacement: Displacement | None = None
    flipped_faces: int | None = None
    volume_change_percent: float | None = None
    area_change_percent: float | None = None
    hausdorff: float | None = None
    hausdorff_edges: float | None = None
    warnings: tuple[str, ...] = ()
    error: Failure | None = None


@dataclass(frozen=True, slots=True)
class FieldsFile:
    """The PLY with fields beside an output: their names, and which one its colours show, by which
    map, from ``low`` to ``high``."""

    path: str
    names: tuple[str, ...]
    coloured: str
    map: str
    low: float
    high: float


@dataclass(frozen=True, slots=True)
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
    corners: int | None = None
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
    inside_out: bool | None = None
    volume: Volume | None = None
    area: Area | None = None
    displacement: Displacement | None = None
    normal_change: NormalChange | None = None
    flipped_faces: int | None = None
    clamped_vertices: int | None = None
    locked_vertices: int | None = None
    despiked: int | None = None
    self_intersections: SelfIntersections | None = None
    noise_estimate: NoiseEstimate | None = None
    left_alone: str | None = None
    method: MethodUsed | None = None
    choice: ChoiceMade | None = None
    seconds: Seconds | None = None
    vertices_per_second: float | None = None
    peak_memory_bytes: int | None = None
    input_sha256: str | None = None
    output_sha256: str | None = None
    input_object: ObjectMark | None = None
    output_object: ObjectMark | None = None
    sidecars: tuple[str, ...] = ()
    fields: FieldsFile | None = None
    reference: Reference | None = None
    warnings: tuple[str, ...] = ()
    warning_codes: tuple[str, ...] = ()
    gates: tuple[GateResult, ...] = ()
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
    corners: int | None = None
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
    inside_out: bool | None = None
    volume: float | None = None
    volume_valid: bool | None = None
    volume_reason: str = ""
    mean_edge_length: float | None = None
    self_intersections: int | None = None
    noise_estimate: NoiseEstimate | None = None
    properties: tuple[str, ...] = ()
    references: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    error: Failure | None = None


def as_data(record: Any) -> dict[str, Any]:
    """A record as plain dicts, lists, strings and numbers, ready for JSON."""
    data: dict[str, Any] = _as_data(record)
    return data


# What a record is made of in the end, and what needs no copy.
_PLAIN = frozenset({str, int, float, bool, type(None)})


def _as_data(value: Any) -> Any:
    """As ``dataclasses.asdict``, which copies every number too, in a fifth of the time."""
    kind = type(value)
    if kind in _PLAIN:
        return value
    if kind is tuple or kind is list:
        return kind(map(_as_data, value))
    if kind is dict:
        return {key: _as_data(one) for key, one in value.items()}
    names = _names(typing.cast(Hashable, kind))
    return {name: _as_data(getattr(value, name)) for name in names} if names else value


@functools.cache
def _names(kind: Hashable) -> tuple[str, ...]:
    """Names of a record's fields; none for what is no record."""
    if not dataclasses.is_dataclass(kind):
        return ()
    return tuple(one.name for one in dataclasses.fields(kind))


def from_data(kind: type[Any], data: Any) -> Any:
    """The record that ``as_data`` made ``data`` from; fields that it does not know are dropped.

    Raises TypeError if a field is missing, or holds something else than it should.
    """
    if not isinstance(data, dict):
        raise TypeError(f"{kind.__name__} cannot be {type(data).__name__}")
    values: dict[str, Any] = {}
    for name, read in _readers(typing.cast(Hashable, kind)):
        if name in data:
            try:
                values[name] = read(data[name])
            except TypeError as error:
                raise TypeError(f"{name}: {error}") from None
    return kind(**values)


@functools.cache
def _readers(kind: Hashable) -> tuple[tuple[str, Callable[[Any], Any]], ...]:
    # Half a millisecond a call, and a manifest of 10,000 files makes 10,000.
    hints = typing.get_type_hints(kind)
    fields = dataclasses.fields(typing.cast("type[Any]", kind))
    return tuple((one.name, _reader(hints[one.name])) for one in fields)


def _reader(hint: Any) -> Callable[[Any], Any]:
    """The function that gives a value of plain data back the type of its field."""
    inner = typing.get_args(hint)
    origin = typing.get_origin(hint)
    if hint is Any:
        return lambda value: value
    if dataclasses.is_dataclass(hint):
        return functools.partial(from_data, typing.cast("type[Any]", hint))
    if origin is Literal:
        return functools.partial(_one_of, inner)
    if origin in (typing.Union, types.UnionType):
        rest = [_reader(one) for one in inner if one is not types.NoneType]
        return functools.partial(_optional, rest[0])
    if origin is tuple and inner[-1] is Ellipsis:
        return functools.partial(_several, _reader(inner[0]))
    if origin is tuple:
        return functools.partial(_these, [_reader(one) for one in inner])
    if origin in (dict, Mapping):
        return functools.partial(_named, _reader(inner[1]))
    return functools.partial(_plain, hint)


def _plain(kind: type[Any], value: Any) -> Any:
    if kind is float:
        # Strict JSON has null for a number that is not finite.
        if value is None:
            return math.nan
        if type(value) is int:
            return value
    if type(value) is not kind:
        raise TypeError(f"it is {type(value).__name__}, not {kind.__name__}")
    # Words such as a format or a version are the same in thousands of records.
    return sys.intern(value) if kind is str and len(value) < _LONGEST_WORD else value


def _one_of(words: tuple[Any, ...], value: Any) -> Any:
    if value not in words:
        raise TypeError(f"it is none of {', '.join(words)}")
    return value


def _optional(read: Callable[[Any], Any], value: Any) -> Any:
    return None if value is None else read(value)


def _several(read: Callable[[Any], Any], value: Any) -> Any:
    if not isinstance(value, list | tuple):
        raise TypeError(f"it is {type(value).__name__}, not a list")
    return tuple(read(one) for one in value)


def _these(reads: list[Callable[[Any], Any]], value: Any) -> Any:
    if not isinstance(value, list | tuple) or len(value) != len(reads):
        raise TypeError(f"it is no list of {len(reads)}")
    return tuple(read(one) for read, one in zip(reads, value, strict=True))


def _named(read: Callable[[Any], Any], value: Any) -> Any:
    if not isinstance(value, dict):
        raise TypeError(f"it is {type(value).__name__}, not an object")
    return {sys.intern(str(name)): read(one) for name, one in value.items()}
