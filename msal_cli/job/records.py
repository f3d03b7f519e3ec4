"""Records: what is known of a file after msal has denoised, inspected or compared it, and of a run
over many files.

A record is made by ``pipeline`` (or, for a file whose worker died, by ``batch``) and only read
afterwards: every report is a reader of records.  Fields may be added; none is ever removed or
given another meaning while the schema is ``msal.report/1``.  The metadata of the fields describe
them in the JSON Schemas (docs/make_schemas.py).  ``as_data`` converts a record to plain data, as in
JSON, and ``from_data`` converts it back.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import sys
import types
import typing
from collections.abc import Callable, Hashable, Mapping
from typing import Any, Literal

from msal_cli.errors import MsalError
from msal_cli.light_dataclass import dataclass, field
from msal_cli.storage.urls import ObjectMark

SCHEMA = "msal.report/1"

Status = Literal["written", "unchanged", "up-to-date", "planned", "failed"]

DONE = ("written", "unchanged")
"""Statuses of files that the run itself has finished."""

WITH_OUTPUT = (*DONE, "up-to-date")
"""Statuses of files whose output is in place."""


# The fields of records


def required(description: str, **more: Any) -> Any:
    """A field with the description that the JSON Schema shows; ``more`` as of ``field``."""
    return field(metadata={"description": description}, **more)


def known(description: str, default: Any = None) -> Any:
    """A field with its description; None, or ``default``, if not known."""
    return required(description, default=default)


@dataclass(frozen=True, slots=True)
class Volume:
    """Volume in cubed file units that a surface encloses, whichever side its normals point to."""

    before: float | None = required("enclosed volume before, cubed file units; null if not valid")
    after: float | None = required("the same after; negative if the surface passed through itself")
    change: float | None = required("after - before")
    change_percent: float | None = required("change in % of |before|; null if nothing is enclosed")
    valid: bool = required("whether it means anything: the surface is closed and orientable")
    reason: str = required("why it does not; empty if it does")

    def __post_init__(self) -> None:
        if not self.valid:
            for name in ("before", "after", "change", "change_percent"):
                object.__setattr__(self, name, None)


@dataclass(frozen=True, slots=True)
class Area:
    """Surface area in squared file units."""

    before: float = required("area before, squared file units")
    after: float = required("area after, squared file units")
    change_percent: float | None = required("change in percent of the area before")


@dataclass(frozen=True, slots=True)
class SurfaceDistance:
    """Distances from the vertices of one mesh to the surface of another."""

    mean: float = required("mean distance, file units")
    rms: float = required("root mean square distance, file units")
    p95: float = required("distance that 95 % of the vertices stay below, file units")
    max: float = required("largest distance, file units")
    mean_edges: float = required("mean distance, mean edge lengths")
    rms_edges: float = required("root mean square distance, mean edge lengths")
    p95_edges: float = required("distance that 95 % stay below, mean edge lengths")
    max_edges: float = required("largest distance, mean edge lengths")


@dataclass(frozen=True, slots=True)
class Displacement(SurfaceDistance):
    """How far the vertices that faces use moved, in file units and in mean edge lengths."""

    moved_vertices: int = required("vertices that moved at all")


@dataclass(frozen=True, slots=True)
class NormalChange:
    """Angle between each face's normal before and after, in degrees."""

    mean_deg: float = required("mean angle, degrees")
    max_deg: float = required("largest angle, degrees")


@dataclass(frozen=True, slots=True)
class NoiseReading:
    """One way to explain the roughness of a mesh."""

    kind: str = required("noise or texture")
    level_edges: float = required("noise in that case, mean edge lengths; 0 if all is texture")
    probability: float = required("probability, 0 to 1")


@dataclass(frozen=True, slots=True)
class NoiseEstimate:
    """Estimated standard deviation of the noise along its direction, and its evidence."""

    mean_edges: float = required("standard deviation along its direction, mean edge lengths")
    file_units: float = required("the same in file units")
    low_edges: float = required("lower end of an interval for it, mean edge lengths")
    high_edges: float = required("upper end of the interval, mean edge lengths")
    rms_edges: float = required("root mean square with single spikes, mean edge lengths")
    tail: float = required(
        "share of the vertices, 0 to 1, that stand out from the others around them as one in 100 "
        "does with Gaussian noise; 0.02 and more is impulsive noise"
    )
    negligible: bool = required("whether there is no noise to speak of")
    lowest_edges: float = required("level of the least noisy region, mean edge lengths")
    highest_edges: float = required("level of the most noisy region, mean edge lengths")
    regions: int = required("number of regions that were distinguished")
    uneven: bool = required("whether the noise is not the same everywhere")
    kind: str = required(
        "none, white (independent at each vertex, along the normals), isotropic, correlated "
        "(neighbours share it), view (along an axis), quantised (depths in steps), uneven (by "
        "region), outliers, impulsive, staircase (terraces of voxels), or unknown"
    )
    rings: int = required("over how many rings neighbours share it, 0 (not at all) to 4")
    direction: str = required("normals, isotropic or axis")
    axis: tuple[float, float, float] | None = required(
        "its unit vector, up to the sign; null if the noise is along none"
    )
    step_edges: float = required("step of depths or terraces, mean edge lengths")
    outliers: float = required("share of the vertices that lie far off, 0 to 1")
    confidence: float = required("how sure the kind is, 0 to 1; below 0.5 a guess")
    basis: str = required("what the kind rests on, in words")
    words: str = required("what the noise is like, in words; empty for none")
    unsure: bool = required("whether neither noise nor texture has a probability of 0.9")
    readings: tuple[NoiseReading, ...] = required("the explanations, the most probable first")


@dataclass(frozen=True, slots=True)
class MethodUsed:
    """The method and every one of its parameters, defaults included."""

    name: str = required(
        "name of the method; none where the choice or --min-noise left the mesh as it is, "
        "adaptive or auto where it was not chosen yet"
    )
    parameters: dict[str, Any] = required("every parameter by name, defaults included")


@dataclass(frozen=True, slots=True)
class RunnerUp:
    """A method that --auto nearly chose, and its estimated error."""

    label: str = required("method and parameters in words")
    risk_edges: float = required("estimated error of its result, mean edge lengths")


@dataclass(frozen=True, slots=True)
class ChoiceMade:
    """Why ``method`` was chosen; lengths are in mean edge lengths."""

    reason: str = required("in one sentence: the noise, the surface, the method")
    surface: str | None = required("machined, organic, textured or clean; null if not looked at")
    noise_edges: float = required("noise that the choice was made for, mean edge lengths")
    risk_edges: float | None = required("estimated error, mean edge lengths; null if not estimated")
    tried: int = required("candidates that were looked at")
    runners_up: tuple[RunnerUp, ...] = required("at most three next best, best first")
    wishes: dict[str, Any] = required("what was wished for: all with --auto, else what was given")
    repeat: tuple[str, ...] = required("options of msal denoise that do the same without --auto")
    among: str = required(
        "what was chosen among: family, AL and MSAL with their schedules, by default; all, all "
        "methods and their mixtures, with --auto"
    )
    auto_seconds: float | None = known(
        "seconds of one core that --auto is expected to take, where it is expected to come much "
        "nearer to the truth: on machined parts and under strong noise; null elsewhere"
    )


@dataclass(frozen=True, slots=True)
class Seconds:
    """Wall-clock seconds by stage, in the order in which the stages run."""

    read: float = known("reading and parsing", 0.0)
    connectivity: float = known("welding, connectivity, defects and plain vertex normals", 0.0)
    choose: float = known("choosing, and deciding by --min-noise whether to denoise", 0.0)
    normals: float = known("mollified normals, and what else a method adds to them", 0.0)
    sweeps: float = known("the sweeps of the method", 0.0)
    measure: float = known("volume, displacement and the other measures", 0.0)
    write: float = known("encoding, checking and writing", 0.0)
    total: float = known("from start to end", 0.0)


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a file was not written: a stable code, the reason, the place and what to do."""

    code: str = required("stable code of the error, such as E_TRUNCATED")
    message: str = required("what is wrong, one sentence")
    hint: str = known("what to do about it; may be empty", "")
    where: str = known("place in the file, such as a vertex or a line; may be empty", "")

    @classmethod
    def of(cls, error: MsalError) -> Failure:
        """What a record says of an error."""
        return cls(error.code, error.message, error.hint, error.where)


@dataclass(frozen=True, slots=True)
class GateResult:
    """The result of one gate (--fail-on) for one file."""

    expression: str = required("what breaks the gate, as it was given")
    broken: bool = required("true if it is so for this file, or cannot be decided")
    decided: bool = required("false if a value is not known on which it depends")
    values: dict[str, float | None] = required("values of its names, in the units of their fields")
    reason: str = required("those values in words, or why the gate could not be decided")


@dataclass(frozen=True, slots=True)
class SelfIntersections:
    """Pairs of faces that intersect each other before and after."""

    before: int = required("pairs of faces that intersect before")
    after: int = required("pairs of faces that intersect after")
    created: int | None = required("pairs that intersect only after; null if faces differ")


_MEAN_ANGLE = (
    "mean angle between corresponding face normals, degrees (the MSAE of much of the literature); "
    "null if faces do not correspond"
)


@dataclass(frozen=True, slots=True)
class Reference:
    """The figures of a ComparisonRecord of an output and its reference, the true mesh."""

    path: str = required("path of the reference")
    correspondence: Literal["vertices", "surface"] | None = known("as in a ComparisonRecord")
    mean_edge_length: float | None = known("mean length of the edges of the reference, file units")
    mean_angular_error_deg: float | None = known(_MEAN_ANGLE)
    max_angular_error_deg: float | None = known("largest such angle, degrees")
    vertex_error_percent: float | None = known("as in a ComparisonRecord")
    displacement: Displacement | None = known("how far vertices are from the reference's")
    flipped_faces: int | None = known("faces whose normal is more than 90 degrees off")
    volume_change_percent: float | None = known("volume error, percent; null if it means nothing")
    area_change_percent: float | None = known("how much the area is off, in percent")
    hausdorff: float | None = known("Hausdorff distance as in a ComparisonRecord, file units")
    hausdorff_edges: float | None = known("the same in mean edge lengths")
    warnings: tuple[str, ...] = known("what a user should know although the two were compared", ())
    error: Failure | None = known("why they were not compared; null if they were")


@dataclass(frozen=True, slots=True)
class FieldsFile:
    """The PLY beside an output with fields as properties, and the one that its colours show."""

    path: str = required("where it is")
    names: tuple[str, ...] = required("the fields, which are properties of its vertices")
    coloured: str = required("the field that its vertex colours show")
    map: str = required("sequential: pale to dark; diverging: blue, pale, brown")
    low: float = required("value of the first colour, in the unit of the field")
    high: float = required("value of the last colour, in the unit of the field")
    sha256: str = known("SHA-256 of its bytes, hexadecimal", "")


@dataclass(frozen=True, slots=True)
class Planned:
    """Forecast for a file by its header and its size; null where these do not show it."""

    bytes: int | None = known("bytes of the input")
    vertices: int | None = known("vertices, of a text about")
    seconds: float | None = known("seconds of an idle core; null with methods but al and msal")
    memory_bytes: int | None = known("memory at the most, bytes")
    scratch_bytes: int | None = known("bytes in scratch files at the most; null where it fits")


@dataclass(frozen=True, slots=True)
class TileSetPart:
    """What a file shares with others of its tile set; border vertices at one place count once."""

    files: int = required("files of the set that could be read")
    neighbours: tuple[str, ...] = required("relative paths of files that share border vertices")
    shared_vertices: int = required("border vertices that other files have, too")
    welded_vertices: int = required("of these, those that took another file's position")
    largest_weld: float = required("largest distance before of those that are one, file units")
    unmatched_vertices: int = required("border vertices at the border of a file without them")
    fixed_border_vertices: int = required("border vertices held for a file that failed")
    low: tuple[float, float, float] | None = known("least coordinates of its border; null if none")
    high: tuple[float, float, float] | None = known("greatest coordinates of them")


@dataclass(frozen=True, slots=True)
class MeshRecord:
    """One row per file; fields that could not be determined are None.

    Lengths are in file units unless the name says otherwise.
    """

    input: str = required("path of the input as it was found, - for standard input")
    status: Status = required(
        "written; unchanged: written, but no vertex moved, so the bytes are the input's; "
        "up-to-date: the output of an earlier run is current, and the figures are that run's; "
        "planned: not dealt with; failed: see error"
    )
    output: str | None = known("path of the output, - for standard output; null if there is none")
    schema: str = known("name and version of this schema", SCHEMA)
    version: str = known("version of msal that made the record", "")
    format: str | None = known("format of the input")
    encoding: str | None = known("ascii, binary_little_endian, binary_big_endian or binary")
    precision: str | None = known("how the input stores positions: float32, float64 or text")
    vertices: int | None = known("vertices in the file, of an STL after welding")
    corners: int | None = known("corners that an STL stores, null for files that have vertices")
    faces: int | None = known("faces as the file counts them: a quad is one")
    triangles: int | None = known("faces after polygons and strips were cut into triangles")
    components: int | None = known("connected parts")
    boundary_edges: int | None = known("edges of one face; 0 for a closed surface")
    non_manifold_edges: int | None = known("edges of more than two faces")
    inconsistent_edges: int | None = known("edges whose two faces are wound in opposite senses")
    degenerate_faces: int | None = known("triangles without area; kept, not computed with")
    duplicate_faces: int | None = known("triangles that repeat another; kept, not computed with")
    unreferenced_vertices: int | None = known("vertices of no face; they stay where they are")
    welded_vertices: int | None = known("vertices merged with one at the same place to compute")
    seam_gap: float | None = known("largest distance after between vertices at one place before")
    tile_gap: float | None = known("largest distance between new positions of a border vertex")
    tile_set: TileSetPart | None = known("what it shares with others of its tile set")
    mean_edge_length: float | None = known("mean length of the edges before, file units")
    inside_out: bool | None = known("true if normals of a closed surface, or a part, point inwards")
    volume: Volume | None = known("enclosed volume")
    area: Area | None = known("surface area")
    displacement: Displacement | None = known("how far the vertices moved")
    normal_change: NormalChange | None = known("how far the face normals turned")
    flipped_faces: int | None = known("faces whose normal turned by more than 90 degrees")
    clamped_vertices: int | None = known("vertices that --max-move stopped; null without it")
    locked_vertices: int | None = known("vertices that --lock pinned; null without it")
    despiked: int | None = known("outliers brought back first; null where not looked for")
    self_intersections: SelfIntersections | None = known("intersecting faces; null if not counted")
    noise_estimate: NoiseEstimate | None = known("noise of the input without its outliers")
    left_alone: str | None = known("why --min-noise left the mesh as it is; null if it did not")
    method: MethodUsed | None = known("method and parameters, given or chosen")
    choice: ChoiceMade | None = known("why that method was chosen; null where it was given")
    seconds: Seconds | None = known("wall-clock seconds by stage")
    peak_memory_bytes: int | None = known("highest memory of the process so far")
    planned: Planned | None = known("of a dry run, what the file will take (below)")
    input_sha256: str | None = known("SHA-256 of the input's bytes, hexadecimal")
    output_sha256: str | None = known("SHA-256 of the output's bytes, hexadecimal")
    input_object: ObjectMark | None = known("size and entity tag of an input in a store")
    output_object: ObjectMark | None = known("size and entity tag of an output in a store")
    sidecars: tuple[str, ...] = known("what was done about files that the input refers to", ())
    fields: FieldsFile | None = known("the file of --fields beside the output")
    reference: Reference | None = known("the output against the mesh that --reference names")
    warnings: tuple[str, ...] = known("what a user should know although the file was written", ())
    warning_codes: tuple[str, ...] = known(
        "stable codes of the warnings that have one: W_INSIDE_OUT, W_FLIPPED_FACES, "
        "W_VOLUME_CHANGE, W_AREA_CHANGE, W_LARGE_MOVES",
        (),
    )
    gates: tuple[GateResult, ...] = known("what became of each gate, if there is an output", ())
    remembered: bool = known("true if it failed so before, and was not tried again", False)
    error: Failure | None = known("why the file failed; null if it did not")


@dataclass(frozen=True)
class InfoRecord:
    """What ``msal info`` reports of one file; lengths are in file units."""

    input: str
    schema: str = "msal.info/1"
    format: str | None = None
    encoding: str | None = None
    precision: str | None = None
    compressed: bool = known("whether the file is compressed with gzip", False)
    bytes: int | None = known("size of the file")
    vertices: int | None = None
    corners: int | None = None
    faces: int | None = None
    triangles: int | None = None
    polygon_sizes: dict[str, int] = required(
        "number of faces by number of corners", default_factory=dict
    )
    components: int | None = None
    closed: bool | None = known("true if there is no boundary edge")
    winding: str | None = known("consistent, inconsistent or not orientable")
    boundary_edges: int | None = None
    non_manifold_edges: int | None = None
    inconsistent_edges: int | None = None
    degenerate_faces: int | None = None
    duplicate_faces: int | None = None
    unreferenced_vertices: int | None = None
    welded_vertices: int | None = None
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]] | None = known(
        "lowest and highest x, y, z, file units"
    )
    area: float | None = known("surface area, squared file units")
    inside_out: bool | None = None
    volume: float | None = known("enclosed volume, cubed file units; null if not valid")
    volume_valid: bool | None = known("whether the volume means anything")
    volume_reason: str = known("why it does not; empty if it does", "")
    mean_edge_length: float | None = known("mean length of the edges, file units")
    self_intersections: int | None = known("pairs of faces that intersect; null if not counted")
    noise_estimate: NoiseEstimate | None = known("noise, estimated")
    properties: tuple[str, ...] = known("what else the file holds and denoising keeps", ())
    references: tuple[str, ...] = known("other files that this one names", ())
    warnings: tuple[str, ...] = known("what a user should know although the file could be read", ())
    error: Failure | None = known("why the file could not be read; null if it could")


@dataclass(frozen=True)
class ComparisonRecord:
    """A mesh ``after`` compared with ``before``, the reference.

    Figures in mean edge lengths refer to ``before``, changes of volume, area and normals, too.
    Where the files have other faces, what needs corresponding vertices is None.
    """

    before: str = required("path of the reference")
    after: str = required("path of the mesh that is compared with it")
    schema: str = "msal.compare/1"
    version: str = ""
    correspondence: Literal["vertices", "surface"] | None = known(
        "vertices: both have the same faces, and vertices are compared one by one; surface: they "
        "have not, and only the surfaces are compared"
    )
    vertices_before: int | None = known("vertices in the file before, of an STL after welding")
    vertices_after: int | None = known("vertices in the file after, of an STL after welding")
    corners_before: int | None = known("corners that an STL before stores, null for other files")
    corners_after: int | None = known("corners that an STL after stores, null for other files")
    faces_before: int | None = known("triangles before")
    faces_after: int | None = known("triangles after")
    mean_edge_length: float | None = known("mean length of the edges before, file units")
    mean_angular_error_deg: float | None = known(_MEAN_ANGLE)
    max_angular_error_deg: float | None = known("largest such angle, degrees")
    vertex_error_percent: float | None = known(
        "mean distance between corresponding vertices (where faces do not correspond, from the "
        "vertices after to the surface before) in percent of the mean edge length before"
    )
    displacement: Displacement | None = known("how far corresponding vertices are apart")
    flipped_faces: int | None = None
    volume_change_percent: float | None = known("change in % of |before|; null if it means nothing")
    area_change_percent: float | None = known("change of area in percent of the area before")
    inside_out_before: bool | None = known("whether the surface before is inside out")
    inside_out_after: bool | None = known("whether the surface after is inside out")
    volume: Volume | None = None
    area: Area | None = None
    hausdorff: float | None = known(
        "largest distance from a vertex or the centre of a face of one mesh to the surface of the "
        "other, whichever is further, file units"
    )
    hausdorff_edges: float | None = known("the same in mean edge lengths")
    distance_to_before: SurfaceDistance | None = known("vertices after to surface before")
    distance_to_after: SurfaceDistance | None = known("vertices before to surface after")
    seam_gap: float | None = known("largest distance after between vertices at one place before")
    self_intersections: SelfIntersections | None = known("intersecting faces; null if not counted")
    warnings: tuple[str, ...] = known("what a user should know although they were compared", ())
    gates: tuple[GateResult, ...] = known("what became of each gate; empty if there was none", ())
    at_fault: Literal["before", "after"] | None = known("which file the error is about, if one")
    error: Failure | None = known("why the files were not compared; null if they were")


@dataclass(frozen=True)
class Run:
    """One run of the program; times are to the millisecond."""

    version: str = required("version of msal")
    command: tuple[str, ...] = required("the command as it was given, program name first")
    settings: Mapping[str, Any] = required(
        "what decides the output beside the input: method, parameters, conversion"
    )
    started: str = required("when the run began, UTC, ISO 8601")
    finished: str = required("when it ended, UTC, ISO 8601")
    seconds: float = required("wall-clock seconds between the two")
    interrupted: bool = known("true if the run was ended before all files were dealt with", False)
    machine: Mapping[str, str] = required(
        "system, cores and libraries, by name; empty where they are not known", default_factory=dict
    )


# Records as plain data: dicts, lists, texts, numbers

_MAX_SHARED = 24
"""Characters up to which texts are shared: formats and versions repeat in thousands of records."""

_PLAIN = frozenset({str, int, float, bool, type(None)})
"""Types of values that ``as_data`` need not copy."""

Reader = Callable[[Any], Any]


def as_data(record: Any) -> Any:
    """A record as plain dicts, lists, texts and numbers, ready for JSON.

    As ``dataclasses.asdict``, which also copies every number, in a fifth of the time.
    """
    kind = type(record)
    if kind in _PLAIN:
        return record
    if kind is tuple or kind is list:
        return kind(map(as_data, record))
    if kind is dict:
        return {key: as_data(value) for key, value in record.items()}
    names = getattr(kind, "__dataclass_fields__", None)
    return {name: as_data(getattr(record, name)) for name in names} if names else record


def value_at(record: Any, path: str) -> Any:
    """The value of a field by its dotted path, such as ``volume.change_percent``; None if a part
    of the path is None."""
    for name in path.split("."):
        if record is None:
            return None
        record = getattr(record, name)
    return record


def from_data(kind: type[Any], data: Any) -> Any:
    """Rebuild the record from which ``as_data`` made ``data``; unknown fields are dropped.

    Raises TypeError if a field is missing, or has a value of another type.
    """
    if not isinstance(data, dict):
        raise TypeError(f"{kind.__name__} cannot be {type(data).__name__}")
    values: dict[str, Any] = {}
    for name, read in _field_readers(typing.cast(Hashable, kind)):
        if name in data:
            try:
                values[name] = read(data[name])
            except TypeError as error:
                raise TypeError(f"{name}: {error}") from None
    return kind(**values)


@functools.cache
def _field_readers(kind: Hashable) -> tuple[tuple[str, Reader], ...]:
    # Cached: it takes half a millisecond, and a manifest of 10,000 files calls it 10,000 times.
    hints = typing.get_type_hints(kind)
    fields = dataclasses.fields(typing.cast("type[Any]", kind))
    return tuple((field.name, _build_reader(hints[field.name])) for field in fields)


def _build_reader(hint: Any) -> Reader:
    """The function that reads plain data as a value of this type."""
    inner = typing.get_args(hint)
    origin = typing.get_origin(hint)
    if hint is Any:
        return lambda value: value
    if dataclasses.is_dataclass(hint):
        return functools.partial(from_data, typing.cast("type[Any]", hint))
    if origin is Literal:
        return functools.partial(_read_choice, inner)
    if origin in (typing.Union, types.UnionType):
        read = next(_build_reader(type_) for type_ in inner if type_ is not types.NoneType)
        return lambda value: None if value is None else read(value)
    if origin is tuple:
        reads = [_build_reader(type_) for type_ in inner if type_ is not Ellipsis]
        return functools.partial(_read_list, reads, inner[-1] is Ellipsis)
    if origin in (dict, Mapping):
        return functools.partial(_read_mapping, _build_reader(inner[1]))
    return functools.partial(_read_plain, hint)


def _read_plain(kind: type[Any], value: Any) -> Any:
    if kind is float:
        # Strict JSON has null for a number that is not finite.
        if value is None:
            return math.nan
        if type(value) is int:
            return value
    if type(value) is not kind:
        raise TypeError(f"it is {type(value).__name__}, not {kind.__name__}")
    return sys.intern(value) if kind is str and len(value) < _MAX_SHARED else value


def _read_choice(words: tuple[Any, ...], value: Any) -> Any:
    if value not in words:
        raise TypeError(f"it is none of {', '.join(words)}")
    return value


def _read_list(reads: list[Reader], is_any_length: bool, value: Any) -> Any:
    if not isinstance(value, list | tuple):
        raise TypeError(f"it is {type(value).__name__}, not a list")
    if is_any_length:
        return tuple(map(reads[0], value))
    if len(value) != len(reads):
        raise TypeError(f"it is no list of {len(reads)}")
    return tuple(read(item) for read, item in zip(reads, value, strict=True))


def _read_mapping(read: Reader, value: Any) -> Any:
    if not isinstance(value, dict):
        raise TypeError(f"it is {type(value).__name__}, not an object")
    return {sys.intern(str(name)): read(item) for name, item in value.items()}
