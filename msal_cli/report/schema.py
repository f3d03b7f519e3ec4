"""The JSON Schemas of the reports, made from the records themselves.

``python -m msal_cli.report.schema FOLDER`` writes them; a test holds docs/ against them.
"""

from __future__ import annotations

import dataclasses
import sys
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from msal_cli.job import records
from msal_cli.report.document import Run, Totals
from msal_cli.report.json_report import json_bytes

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_NULL_NOTE = (
    "A number that is not finite is null, and so is what could not be determined. Fields may be "
    "added, none is removed or given another meaning. A byte NN of a file name that is not UTF-8 "
    "is written as the six characters \\udcNN, and a backslash that begins such a sequence in the "
    "name itself as \\u005c."
)

DESCRIPTIONS: dict[str, str] = {
    # Run
    "Run.version": "version of msal",
    "Run.command": "the command as it was given, program name first",
    "Run.settings": "what decides the output beside the input: method, parameters, conversion",
    "Run.started": "when the run began, UTC, ISO 8601",
    "Run.finished": "when it ended, UTC, ISO 8601",
    "Run.seconds": "wall-clock seconds between the two",
    "Run.machine": "system, cores and libraries, by name; empty where they are not known",
    "Run.interrupted": "true if the run was ended before all files were dealt with",
    # Totals
    "Totals.files": "records in this report",
    "Totals.written": "files written with some vertex moved, or in another form",
    "Totals.unchanged": "files written byte for byte as they were, because no vertex moved",
    "Totals.up_to_date": "files whose output of an earlier run is current",
    "Totals.planned": "files not dealt with: by a dry run, or because the run ended before",
    "Totals.failed": "files that failed",
    "Totals.gate_broken": "files written or up to date that break a gate",
    "Totals.chosen": (
        "files written, unchanged or up to date by the method that was chosen, the most frequent "
        "first; empty where the method was given"
    ),
    "Totals.vertices": "vertices of the files denoised in this run",
    "Totals.work_seconds": "sum of the seconds of the files denoised in this run",
    "Totals.volume_change_percent": "change of volume over the files whose volume is valid",
    "Spread.files": "files that the figure is over",
    "Spread.lowest": "lowest value",
    "Spread.median": "median",
    "Spread.highest": "highest value",
    # MeshRecord
    "MeshRecord.input": "path of the input as it was found, - for standard input",
    "MeshRecord.status": (
        "written; unchanged: written, but no vertex moved, so the bytes are the input's; "
        "up-to-date: the output of an earlier run is current, and the figures are that run's; "
        "planned: not dealt with; failed: see error"
    ),
    "MeshRecord.output": "path of the output, - for standard output; null if there is none",
    "MeshRecord.schema": "name and version of this schema",
    "MeshRecord.version": "version of msal that made the record",
    "MeshRecord.format": "format of the input",
    "MeshRecord.encoding": "ascii, binary_little_endian, binary_big_endian or binary",
    "MeshRecord.precision": "how the input stores positions: float32, float64 or text",
    "MeshRecord.vertices": (
        "vertices in the file; of an STL, which stores corners of facets only, the vertices that "
        "they are after welding"
    ),
    "MeshRecord.corners": "corners that an STL stores, null for files that have vertices",
    "MeshRecord.faces": "faces as the file counts them: a quad is one",
    "MeshRecord.triangles": "faces after polygons and strips were cut into triangles",
    "MeshRecord.components": "connected parts",
    "MeshRecord.boundary_edges": "edges of one face; 0 for a closed surface",
    "MeshRecord.non_manifold_edges": "edges of more than two faces",
    "MeshRecord.inconsistent_edges": "edges whose two faces are wound in opposite senses",
    "MeshRecord.degenerate_faces": "triangles without area; kept in the file, not computed with",
    "MeshRecord.duplicate_faces": "triangles that repeat another; kept, not computed with",
    "MeshRecord.unreferenced_vertices": "vertices of no face; they stay where they are",
    "MeshRecord.welded_vertices": "vertices merged with one at the same place for the computation",
    "MeshRecord.seam_gap": "largest distance afterwards between vertices that were at one place",
    "MeshRecord.mean_edge_length": "mean length of the edges before, file units",
    "MeshRecord.inside_out": (
        "true if the surface is closed and its normals, or those of a part, point inwards; an open "
        "one has no inside"
    ),
    "MeshRecord.volume": "enclosed volume",
    "MeshRecord.area": "surface area",
    "MeshRecord.displacement": "how far the vertices moved",
    "MeshRecord.normal_change": "how far the face normals turned",
    "MeshRecord.flipped_faces": "faces whose normal turned by more than 90 degrees",
    "MeshRecord.clamped_vertices": (
        "vertices whose way --max-move cut; null without that option; vertices at one place are one"
    ),
    "MeshRecord.locked_vertices": (
        "vertices that --lock pinned; null without that option; vertices at one place are one"
    ),
    "MeshRecord.despiked": (
        "outlier vertices that were brought back to the surface before the method ran; null where "
        "they were not looked for"
    ),
    "MeshRecord.self_intersections": (
        "pairs of faces that intersect each other; null without --check or a gate that names them"
    ),
    "MeshRecord.noise_estimate": "noise of the input, estimated; without the outliers brought back",
    "MeshRecord.left_alone": "why --min-noise left the mesh as it is; null if it did not",
    "MeshRecord.method": "method and parameters, given or chosen",
    "MeshRecord.choice": "why that method was chosen; null where it was given",
    "MeshRecord.seconds": "wall-clock seconds by stage",
    "MeshRecord.vertices_per_second": "vertices (of an STL after welding) over total seconds",
    "MeshRecord.peak_memory_bytes": "highest memory of the process so far",
    "MeshRecord.input_sha256": "SHA-256 of the input's bytes, hexadecimal",
    "MeshRecord.output_sha256": "SHA-256 of the output's bytes, hexadecimal",
    "MeshRecord.input_object": "size and entity tag of an input that is an object in a store",
    "MeshRecord.output_object": "size and entity tag of an output that is an object in a store",
    "MeshRecord.sidecars": "what was done about files that the input refers to",
    "MeshRecord.warnings": "what a user should know although the file was written",
    "MeshRecord.warning_codes": (
        "stable codes of the warnings that have one: W_INSIDE_OUT, W_FLIPPED_FACES, W_VOLUME_CHANGE"
    ),
    "MeshRecord.gates": "what became of each gate; empty if there was none, or no output",
    "MeshRecord.fields": "the file of --fields beside the output",
    "MeshRecord.reference": "the output against the mesh that --reference names",
    "MeshRecord.error": "why the file failed; null if it did not",
    "MeshRecord.remembered": (
        "true if the file failed in an earlier run with the same content, settings and version, "
        "and was not tried again"
    ),
    # Parts of a MeshRecord
    "Volume.before": (
        "enclosed volume before, whichever side the normals point to, cubed file units; null if it "
        "is not valid, as the next three"
    ),
    "Volume.after": "enclosed volume after, negative if the surface passed through itself",
    "Volume.change": "after - before",
    "Volume.change_percent": "change in percent of |before|; null if nothing is enclosed before",
    "Volume.valid": "whether the volume means anything: the surface is closed and orientable",
    "Volume.reason": "why it does not; empty if it does",
    "Area.before": "area before, squared file units",
    "Area.after": "area after, squared file units",
    "Area.change_percent": "change in percent of the area before",
    "Displacement.mean": "mean distance, file units",
    "Displacement.rms": "root mean square distance, file units",
    "Displacement.p95": "distance that 95 % of the vertices stay below, file units",
    "Displacement.max": "largest distance, file units",
    "Displacement.mean_edges": "mean distance, mean edge lengths",
    "Displacement.rms_edges": "root mean square distance, mean edge lengths",
    "Displacement.p95_edges": "distance that 95 % stay below, mean edge lengths",
    "Displacement.max_edges": "largest distance, mean edge lengths",
    "Displacement.moved_vertices": "vertices that moved at all",
    "SelfIntersections.before": "pairs of faces that intersect before",
    "SelfIntersections.after": "pairs of faces that intersect after",
    "SelfIntersections.created": (
        "pairs that intersect after and did not before; null where the faces are not the same"
    ),
    "NormalChange.mean_deg": "mean angle, degrees",
    "NormalChange.max_deg": "largest angle, degrees",
    "NoiseEstimate.mean_edges": (
        "standard deviation along the direction: the normals, an axis, or each coordinate where it "
        "is isotropic; mean edge lengths"
    ),
    "NoiseEstimate.file_units": "the same in file units",
    "NoiseEstimate.low_edges": (
        "lower end of an interval for it, as if all that may be texture were, mean edge lengths"
    ),
    "NoiseEstimate.high_edges": "upper end of the interval, mean edge lengths",
    "NoiseEstimate.clean_edges": (
        "the level for the surface without the noise, whose edges are shorter, in mean edge lengths"
    ),
    "NoiseEstimate.rms_edges": (
        "root mean square with single spikes, which the level leaves out, mean edge lengths"
    ),
    "NoiseEstimate.tail": (
        "share of the vertices, 0 to 1, that stand out from the others around them as one in 100 "
        "does with Gaussian noise; 0.02 and more is impulsive noise"
    ),
    "NoiseEstimate.negligible": "whether there is no noise to speak of",
    "NoiseEstimate.lowest_edges": "level of the least noisy region, mean edge lengths",
    "NoiseEstimate.highest_edges": "level of the most noisy region, mean edge lengths",
    "NoiseEstimate.regions": "number of regions that were told apart",
    "NoiseEstimate.uneven": "whether the noise is not the same everywhere",
    "NoiseEstimate.kind": (
        "none, white (independent at each vertex, along the normals), isotropic, correlated "
        "(neighbours share it), view (along an axis), quantised (depths in steps), uneven (by "
        "region), outliers, impulsive, staircase (terraces of voxels), or unknown"
    ),
    "NoiseEstimate.rings": "over how many rings neighbours share it, 0 (not at all) to 4",
    "NoiseEstimate.direction": "normals, isotropic or axis",
    "NoiseEstimate.axis": "unit vector of the axis, up to its sign; null for none",
    "NoiseEstimate.step_edges": (
        "step of the depths or height of the terraces, 0 for none, mean edge lengths"
    ),
    "NoiseEstimate.outliers": "share of the vertices that lie far off, 0 to 1",
    "NoiseEstimate.confidence": "how sure the kind is, 0 to 1; below 0.5 a guess",
    "NoiseEstimate.basis": "what the kind rests on, in words",
    "NoiseEstimate.words": "what the noise is like, in words; empty for none",
    "MethodUsed.name": (
        "name of the method; none where the choice or --min-noise left the mesh as it is, adaptive "
        "or auto where it was not chosen yet"
    ),
    "MethodUsed.parameters": "every parameter by name, defaults included",
    "Seconds.read": "reading and parsing",
    "Seconds.connectivity": "welding, connectivity, defects and plain vertex normals",
    "ChoiceMade.reason": "in one sentence: the noise, the surface, the method",
    "ChoiceMade.surface": (
        "machined, organic, textured or clean; null where the choice does not depend on it"
    ),
    "ChoiceMade.noise_edges": "noise that the choice was made for, mean edge lengths",
    "ChoiceMade.risk_edges": (
        "estimated error of the result (null if none was estimated), mean edge lengths"
    ),
    "ChoiceMade.tried": "candidates that were looked at",
    "ChoiceMade.runners_up": "the next best candidates, best first, at most three",
    "ChoiceMade.wishes": (
        "what was wished for: prefer, keep, strength, budget; empty without --auto"
    ),
    "ChoiceMade.among": (
        "what was chosen among: family, AL and MSAL with their schedules, by default; all, all "
        "methods and their mixtures, with --auto"
    ),
    "ChoiceMade.repeat": "options of msal denoise that do the same without --auto",
    "RunnerUp.label": "method and parameters in words",
    "RunnerUp.risk_edges": "estimated error of its result, mean edge lengths",
    "Seconds.choose": "choosing method and parameters, with --auto; whether to, with --min-noise",
    "Seconds.normals": "mollified normals, and what else a method adds to them",
    "Seconds.sweeps": "the sweeps of the method",
    "Seconds.measure": "volume, displacement and the other measures",
    "Seconds.write": "encoding, checking and writing",
    "Seconds.total": "from start to end",
    "ComparisonRecord.gates": "what became of each gate; empty if there was none",
    "GateResult.expression": "what breaks the gate, as it was given",
    "GateResult.broken": "true if it is so for this file, or cannot be decided",
    "GateResult.decided": "false if a value is not known on which it depends",
    "GateResult.values": "values of the names in the expression, in the units of their fields",
    "GateResult.reason": "those values in words, or why the gate could not be decided",
    "ObjectMark.size": "bytes",
    "ObjectMark.tag": "entity tag, or what the store gives in its place; empty if it gives none",
    "Failure.code": "stable code of the error, such as E_TRUNCATED",
    "Failure.message": "what is wrong, one sentence",
    "Failure.hint": "what to do about it; may be empty",
    "Failure.where": "place in the file, such as a vertex or a line; may be empty",
    # ComparisonRecord, where it is not told above
    "ComparisonRecord.before": "path of the reference",
    "ComparisonRecord.after": "path of the mesh that is compared with it",
    "ComparisonRecord.correspondence": (
        "vertices: both have the same faces, and vertices are compared one by one; surface: they "
        "have not, and only the surfaces are compared"
    ),
    "ComparisonRecord.vertices_before": "vertices in the file before, of an STL after welding",
    "ComparisonRecord.vertices_after": "vertices in the file after, of an STL after welding",
    "ComparisonRecord.corners_before": "corners that an STL before stores, null for other files",
    "ComparisonRecord.corners_after": "corners that an STL after stores, null for other files",
    "ComparisonRecord.inside_out_before": (
        "true if the surface before is closed and its normals, or those of a part, point inwards; "
        "an open one has no inside"
    ),
    "ComparisonRecord.inside_out_after": "the same of the surface after",
    "ComparisonRecord.faces_before": "triangles before",
    "ComparisonRecord.faces_after": "triangles after",
    "ComparisonRecord.mean_edge_length": "mean length of the edges before, file units",
    "ComparisonRecord.mean_angular_error_deg": (
        "mean angle between corresponding face normals, degrees (the MSAE of much of the "
        "literature); null if faces do not correspond"
    ),
    "ComparisonRecord.max_angular_error_deg": "largest such angle, degrees",
    "ComparisonRecord.vertex_error_percent": (
        "mean distance between corresponding vertices (where faces do not correspond, from the "
        "vertices after to the surface before) in percent of the mean edge length before"
    ),
    "ComparisonRecord.displacement": "how far corresponding vertices are apart",
    "ComparisonRecord.volume_change_percent": (
        "change of the enclosed volume in percent of |before|; null if the volume means nothing, "
        "see volume"
    ),
    "ComparisonRecord.area_change_percent": "change of area in percent of the area before",
    "ComparisonRecord.hausdorff": (
        "largest distance from a vertex or the centre of a face of one mesh to the surface of the "
        "other, whichever is further, file units; null if fcpw is not installed"
    ),
    "ComparisonRecord.hausdorff_edges": "the same in mean edge lengths",
    "ComparisonRecord.distance_to_before": "from the vertices after to the surface before",
    "ComparisonRecord.distance_to_after": "from the vertices before to the surface after",
    "ComparisonRecord.seam_gap": (
        "largest distance after between vertices that are at one place before"
    ),
    "ComparisonRecord.self_intersections": (
        "pairs of faces that intersect each other; null without --check or a gate that names them"
    ),
    "ComparisonRecord.warnings": "what a user should know although the files were compared",
    "ComparisonRecord.error": "why the files were not compared; null if they were",
    "FieldsFile.path": "where it is",
    "FieldsFile.names": "the fields, which are properties of its vertices",
    "FieldsFile.coloured": "the field that its vertex colours show",
    "FieldsFile.map": "sequential: pale to dark; diverging: blue, pale, brown",
    "FieldsFile.low": "value of the first colour, in the unit of the field",
    "FieldsFile.high": "value of the last colour, in the unit of the field",
    "Reference.path": "path of the reference",
    "Reference.correspondence": "as in a ComparisonRecord: vertices or surface",
    "Reference.mean_edge_length": "mean length of the edges of the reference, file units",
    "Reference.mean_angular_error_deg": (
        "mean angle between corresponding face normals, degrees (the MSAE of much of the "
        "literature); null if faces do not correspond"
    ),
    "Reference.max_angular_error_deg": "largest such angle, degrees",
    "Reference.vertex_error_percent": (
        "mean distance from the reference's vertices (where faces do not correspond, from its "
        "surface) in percent of its mean edge length"
    ),
    "Reference.displacement": "how far vertices are from the reference's",
    "Reference.flipped_faces": "faces whose normal is more than 90 degrees off",
    "Reference.volume_change_percent": (
        "how much the volume is off, in percent; null if the volume means nothing"
    ),
    "Reference.area_change_percent": "how much the area is off, in percent",
    "Reference.hausdorff": (
        "Hausdorff distance as in a ComparisonRecord, null if fcpw is not installed, file units"
    ),
    "Reference.hausdorff_edges": "the same in mean edge lengths",
    "Reference.warnings": "what a user should know although the two were compared",
    "Reference.error": "why they were not compared; null if they were",
    "SurfaceDistance.mean": "mean distance, file units",
    "SurfaceDistance.rms": "root mean square distance, file units",
    "SurfaceDistance.p95": "distance that 95 % of the vertices stay below, file units",
    "SurfaceDistance.max": "largest distance, file units",
    "SurfaceDistance.mean_edges": "mean distance, mean edge lengths",
    "SurfaceDistance.rms_edges": "root mean square distance, mean edge lengths",
    "SurfaceDistance.p95_edges": "distance that 95 % stay below, mean edge lengths",
    "SurfaceDistance.max_edges": "largest distance, mean edge lengths",
    # InfoRecord, where it is not told above
    "InfoRecord.compressed": "whether the file is compressed with gzip",
    "InfoRecord.bytes": "size of the file",
    "InfoRecord.polygon_sizes": "number of faces by number of corners",
    "InfoRecord.closed": "true if there is no boundary edge",
    "InfoRecord.winding": "consistent, inconsistent or not orientable",
    "InfoRecord.bounds": "lowest and highest x, y, z, file units",
    "InfoRecord.area": "surface area, squared file units",
    "InfoRecord.volume": (
        "enclosed volume, whichever side the normals point to, cubed file units; null if it is not "
        "valid"
    ),
    "InfoRecord.volume_valid": "whether the volume means anything",
    "InfoRecord.volume_reason": "why it does not; empty if it does",
    "InfoRecord.mean_edge_length": "mean length of the edges, file units",
    "InfoRecord.self_intersections": (
        "pairs of faces that intersect each other; null without --check"
    ),
    "InfoRecord.noise_estimate": "noise, estimated",
    "InfoRecord.properties": "what else the file holds, which denoising carries along",
    "InfoRecord.references": "other files that this one names",
    "InfoRecord.warnings": "what a user should know although the file could be read",
    "InfoRecord.error": "why the file could not be read; null if it could",
}


def report_schema() -> dict[str, Any]:
    """The schema of a JSON report; a line of a JSON Lines report is ``#/$defs/MeshRecord``."""
    kinds: dict[str, dict[str, Any]] = {}
    run = _object(Run, kinds)
    properties = {
        "schema": {"const": records.SCHEMA, "description": "name and version of this schema"},
        **run["properties"],
        "totals": _typed(Totals, kinds) | {"description": "sums over the records"},
        "records": {
            "type": "array",
            "items": _typed(records.MeshRecord, kinds),
            "description": "one record per input file, in the order of the inputs",
        },
    }
    return _document("msal report", records.SCHEMA, properties, kinds)


def info_schema() -> dict[str, Any]:
    """The schema of what ``msal info --json`` prints."""
    kinds: dict[str, dict[str, Any]] = {}
    name = records.InfoRecord.schema
    properties = {
        "schema": {"const": name, "description": "name and version of this schema"},
        "version": {"type": "string", "description": "version of msal"},
        "records": {
            "type": "array",
            "items": _typed(records.InfoRecord, kinds),
            "description": "one record per input file, in the order of the inputs",
        },
    }
    return _document("msal info", name, properties, kinds)


def compare_schema() -> dict[str, Any]:
    """The schema of what ``msal compare --json`` prints for folders; for two files it prints what
    ``#/$defs/ComparisonRecord`` describes."""
    kinds: dict[str, dict[str, Any]] = {}
    name = records.ComparisonRecord.schema
    properties = {
        "schema": {"const": name, "description": "name and version of this schema"},
        "version": {"type": "string", "description": "version of msal"},
        "records": {
            "type": "array",
            "items": _typed(records.ComparisonRecord, kinds),
            "description": "one record per pair of files, by relative path",
        },
    }
    return _document("msal compare", name, properties, kinds)


SCHEMAS = {
    "report.schema.json": report_schema,
    "info.schema.json": info_schema,
    "compare.schema.json": compare_schema,
}


def _document(
    title: str, name: str, properties: dict[str, Any], kinds: dict[str, dict[str, Any]]
) -> dict[str, Any]:
    return {
        "$schema": _DIALECT,
        "$id": f"urn:{name.replace('/', ':')}",
        "title": f"{title} ({name})",
        "description": _NULL_NOTE,
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "$defs": {key: kinds[key] for key in sorted(kinds)},
    }


def _object(kind: type[Any], kinds: dict[str, dict[str, Any]]) -> dict[str, Any]:
    hints = typing.get_type_hints(kind)
    properties = {}
    for one in dataclasses.fields(kind):
        if one.name == "schema":
            typed: dict[str, Any] = {"const": one.default}
        else:
            typed = _typed(hints[one.name], kinds)
        properties[one.name] = typed | {"description": _description(kind, one.name)}
    return {"type": "object", "properties": properties, "required": list(properties)}


def _description(kind: type[Any], name: str) -> str:
    own = f"{kind.__name__}.{name}"
    return DESCRIPTIONS[own] if own in DESCRIPTIONS else DESCRIPTIONS[f"MeshRecord.{name}"]


def _typed(hint: Any, kinds: dict[str, dict[str, Any]]) -> dict[str, Any]:
    simple = {str: "string", int: "integer", bool: "boolean", types.NoneType: "null"}
    if hint is Any:
        return {}
    if hint in simple:
        return {"type": simple[hint]}
    if hint is float:
        return {"type": ["number", "null"]}
    if dataclasses.is_dataclass(hint):
        kind = typing.cast("type[Any]", hint)
        if kind.__name__ not in kinds:
            kinds[kind.__name__] = {}
            described = _object(kind, kinds)
            described["description"] = " ".join((kind.__doc__ or "").partition("\n")[0].split())
            kinds[kind.__name__] = described
        return {"$ref": f"#/$defs/{kind.__name__}"}
    return _composed(typing.get_origin(hint), typing.get_args(hint), kinds)


def _composed(
    origin: Any, inner: tuple[Any, ...], kinds: dict[str, dict[str, Any]]
) -> dict[str, Any]:
    if origin is Literal:
        return {"enum": list(inner)}
    if origin in (types.UnionType, typing.Union):
        options = [_typed(one, kinds) for one in inner]
        if all(set(option) == {"type"} for option in options):
            words = [option["type"] for option in options]
            flat = [one for word in words for one in ([word] if isinstance(word, str) else word)]
            return {"type": list(dict.fromkeys(flat))}
        return {"anyOf": options}
    if origin is tuple and inner[-1] is Ellipsis:
        return {"type": "array", "items": _typed(inner[0], kinds)}
    if origin is tuple:
        return {
            "type": "array",
            "prefixItems": [_typed(one, kinds) for one in inner],
            "minItems": len(inner),
            "maxItems": len(inner),
        }
    if origin in (dict, Mapping):
        return {"type": "object", "additionalProperties": _typed(inner[1], kinds)}
    raise TypeError(f"no schema for {origin}")


def main(folder: str) -> None:
    """Write all schemas into a folder."""
    for name, schema in SCHEMAS.items():
        Path(folder, name).write_bytes(json_bytes(schema()))


if __name__ == "__main__":
    main(sys.argv[1])
