"""Measure files without denoising them: inspect one, or compare two.

Like ``pipeline``, ``inspect_file`` and ``compare_files`` never raise for a bad file: its record has
an error.
"""

import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import fields, replace
from typing import Any, Literal

import numpy as np

from msal_cli.analysis import measures
from msal_cli.arrays import Floats
from msal_cli.codecs import header
from msal_cli.codecs.mesh_file import MeshFile, Surface
from msal_cli.errors import MsalError
from msal_cli.job import changes, room
from msal_cli.job.records import (
    WITH_OUTPUT,
    ComparisonRecord,
    Failure,
    InfoRecord,
    MeshRecord,
    Reference,
    SelfIntersections,
    SurfaceDistance,
)
from msal_cli.kernels.geometry import distances
from msal_cli.mesh import Mesh, PreparedMesh
from msal_cli.storage.gzip_streams import is_gzip
from msal_cli.storage.regular import Buffer
from msal_cli.version import __version__


def open_mesh_file(path: str, format: str | None = None, unit: str | None = None) -> MeshFile:
    """The mesh file at ``path``; MsalError, which names the path, if it cannot be read or states
    another ``unit``."""
    try:
        mesh_file = room.open_mesh(header.read_input(path, format), path, format)
        room.check_unit(mesh_file.unit, unit)
        return mesh_file
    except MsalError as error:
        error.path = error.path or path
        raise


def surface_of(mesh_file: MeshFile) -> Surface:
    names = ("vertices", "faces", "merged_vertices", "grid", "unit")
    return Surface(**{name: getattr(mesh_file, name) for name in names})


def inspect_file(
    path: str,
    format: str | None = None,
    *,
    data: Buffer | None = None,
    with_intersections: bool = False,
) -> InfoRecord:
    """Inspect a file, or its ``data``; a file that cannot be read gives a record with an error.

    ``with_intersections`` counts the faces that intersect each other, which takes longest.
    """
    try:
        extra = room.INTERSECTIONS_BYTES_PER_FACE if with_intersections else 0
        with ExitStack() as stack:
            if data is None:
                stack.enter_context(room.room_for_files((path,), format, bytes_per_face=extra))
            data = header.read_input(path, format) if data is None else data
            return _inspect(data, path, format, with_intersections)
    except Exception as error:
        return InfoRecord(input=path, error=Failure.of(room.to_known_error(error, path)))


def _inspect(data: Buffer, name: str, format: str | None, with_intersections: bool) -> InfoRecord:
    mesh_file = room.open_mesh(data, name, format)
    ready = room.prepare_mesh(mesh_file)
    defects = ready.defects
    area, volume = measures.area_and_volume(ready.mesh)
    enclosed = measures.enclosure_of(ready.mesh, defects, area, volume)
    low, high = mesh_file.vertices.min(axis=0), mesh_file.vertices.max(axis=0)
    counts = np.bincount(mesh_file.polygons()[1])
    sizes = {str(size): int(counts[size]) for size in np.flatnonzero(counts)}
    winding = "consistent"
    if defects.unorientable_parts:
        winding = "not orientable"
    elif defects.inconsistent_edges:
        winding = "inconsistent"
    return InfoRecord(
        input=name,
        **changes.file_fields(mesh_file),
        compressed=is_gzip(data),
        bytes=len(data),
        polygon_sizes=sizes,
        closed=defects.boundary_edges == 0,
        winding=winding,
        **changes.defect_fields(ready, mesh_file.merged_vertices),
        bounds=(tuple(low.tolist()), tuple(high.tolist())),
        area=area,
        inside_out=enclosed.is_inside_out,
        volume=None if defects.volume_objection else enclosed.volume(ready.mesh, volume),
        volume_valid=not defects.volume_objection,
        volume_reason=defects.volume_objection,
        self_intersections=measures.count_self_intersections(ready.mesh)
        if with_intersections
        else None,
        noise_estimate=changes.noise_field(ready.mesh),
        properties=mesh_file.properties,
        references=(
            *(os.path.relpath(path, os.path.dirname(name)) for path in mesh_file.sources),
            *mesh_file.references,
        ),
        warnings=mesh_file.warnings + ((enclosed.words,) if enclosed.is_inside_out else ()),
    )


# Two files


def compare_files(
    before: str, after: str, format: str | None = None, **options: Any
) -> ComparisonRecord:
    """As ``measure_files``, but files that cannot be read give a record with an error."""
    try:
        return measure_files(before, after, format, **options)
    except Exception as error:
        known = room.to_known_error(error, f"{before} and {after}")
        sides: dict[str, Literal["before", "after"]] = {before: "before", after: "after"}
        side, failure = sides.get(known.path), Failure.of(known)
        return ComparisonRecord(before, after, version=__version__, at_fault=side, error=failure)


def measure_files(
    before: str,
    after: str,
    format: str | None = None,
    with_intersections: bool = False,
    open_file: Callable[[str, str | None], MeshFile] = open_mesh_file,
) -> ComparisonRecord:
    """Compare a file with the reference ``before``; MsalError if one of them cannot be read.

    ``with_intersections`` counts the faces of each that intersect each other.
    """
    extra = room.DISTANCES_BYTES_PER_FACE
    extra = room.INTERSECTIONS_BYTES_PER_FACE if with_intersections else extra
    with room.room_for_files((before, after), format, bytes_per_face=extra):
        surfaces = surface_of(open_file(before, format)), surface_of(open_file(after, format))
        return compare_meshes(*surfaces, before, after, with_intersections=with_intersections)


def with_references(
    records: Sequence[MeshRecord], references: Sequence[str], format: str | None = None
) -> list[MeshRecord]:
    """Measure the outputs of records against ``references``, which has a path for each record.

    Returns new records; those without an output stay as they are.
    """
    shared = {field.name for field in fields(Reference)} - {"path"}
    measured = []
    for record, path in zip(records, references, strict=True):
        if record.output is not None and record.status in WITH_OUTPUT:
            made = compare_files(path, record.output, format)
            reference = Reference(path, **{name: getattr(made, name) for name in shared})
            record = replace(record, reference=reference)
        measured.append(record)
    return measured


def compare_meshes(
    before: Surface,
    after: Surface,
    before_name: str,
    after_name: str,
    *,
    to_surface: bool = True,
    with_intersections: bool = False,
) -> ComparisonRecord:
    """Compare ``after`` with ``before``, the reference.

    With ``to_surface`` the distances from surface to surface and the Hausdorff distance are
    measured too; ``with_intersections`` counts the faces of each that intersect each other.

    Raises ContentError if one of them cannot be computed with.
    """
    first = room.prepare_mesh(before, before_name)
    second = room.prepare_mesh(after, after_name)
    reference, edge = first.mesh, first.mesh.mean_edge_length
    figures: dict[str, Any] = {}
    if before.has_same_faces(after):
        moved = measures.at_other_positions(first, after.vertices)
        warnings = _add_changes(figures, first, moved)
        gap = figures["seam_gap"] = first.seam_gap(after.vertices)
        if gap > 0.0:
            warnings.append(
                f"vertices that coincide before are up to {gap:g} apart after; "
                "the first of them counts"
            )
        if with_intersections:
            counts = measures.self_intersection_change(reference, moved)
            figures["self_intersections"] = SelfIntersections(*counts)
    else:
        moved = second.mesh.with_vertices(second.mesh.vertices + (second.origin - first.origin))
        warnings = _add_changes(figures, first, second)
        if with_intersections:
            n_before, n_after = map(measures.count_self_intersections, (reference, moved))
            figures["self_intersections"] = SelfIntersections(n_before, n_after, None)
    if before.unit and after.unit and before.unit != after.unit:
        units = f"{before.unit} before, {after.unit} after"
        warnings.append(f"the files state other units ({units}), and only numbers are compared")
    if to_surface:
        step = max(map(measures.sampling_step, (reference, moved)))
        if step > 1:
            warnings.append(
                f"distances to the surfaces are measured at one in {step} vertices and faces; "
                "the Hausdorff distance may be greater"
            )
        to_before, to_after, hausdorff = measures.surface_distances(reference, moved)
        figures |= {
            "distance_to_before": SurfaceDistance(**changes.distance_fields(to_before, edge)),
            "distance_to_after": SurfaceDistance(**changes.distance_fields(to_after, edge)),
            "hausdorff": hausdorff,
            "hausdorff_edges": hausdorff / edge,
        }
        figures.setdefault("vertex_error_percent", 100.0 * to_before.mean / edge)
    return ComparisonRecord(
        before=before_name,
        after=after_name,
        version=__version__,
        vertices_before=len(before.vertices),
        vertices_after=len(after.vertices),
        corners_before=before.n_corners,
        corners_after=after.n_corners,
        faces_before=len(before.faces),
        faces_after=len(after.faces),
        mean_edge_length=edge,
        warnings=tuple(warnings),
        **figures,
    )


def _add_changes(
    figures: dict[str, Any], first: PreparedMesh, other: Mesh | PreparedMesh
) -> list[str]:
    """Add what changed to ``figures``, fields of a record, and return warnings; ``other`` is a mesh
    with the faces of ``first``, or a prepared one with its own."""
    before, defects = first.mesh, first.defects
    objection = defects.volume_objection
    if isinstance(other, PreparedMesh):
        after, defects_after = other.mesh, other.defects
        areas, volumes = zip(*map(measures.area_and_volume, (before, after)), strict=True)
        reasons = {"before": objection, "after": defects_after.volume_objection}
        objection = "; ".join(f"{word}: {reason}" for word, reason in reasons.items() if reason)
    else:
        after, defects_after = other, defects
        change = measures.measure_surface_change(before, after)
        areas, volumes = change.areas, change.volumes
        distances = measures.displacement(before, after)
        figures |= {
            "mean_angular_error_deg": change.mean_angular_error_deg,
            "max_angular_error_deg": change.max_angular_error_deg,
            "flipped_faces": change.flipped_faces,
            "vertex_error_percent": 100.0 * distances.mean / before.mean_edge_length,
            "displacement": changes.displacement_field(distances, before.mean_edge_length),
        }
    enclosed = measures.enclosure_of(before, defects, areas[0], volumes[0])
    enclosed_after = measures.enclosure_of(after, defects_after, areas[1], volumes[1])
    # With other faces, the outside may be on the other side.
    of_after = enclosed_after if isinstance(other, PreparedMesh) else enclosed
    volumes = enclosed.volume(before, volumes[0]), of_after.volume(after, volumes[1])
    sizes = changes.size_fields(areas, volumes, objection)
    figures |= {
        "correspondence": "surface" if isinstance(other, PreparedMesh) else "vertices",
        "inside_out_before": enclosed.is_inside_out,
        "inside_out_after": enclosed_after.is_inside_out,
        **sizes,
        **{f"{name}_change_percent": size.change_percent for name, size in sizes.items()},
    }
    both = {"before": enclosed, "after": enclosed_after}
    return [f"{word}: {each.words}" for word, each in both.items() if each.is_inside_out]


def deviations(before: Surface, after: Surface) -> Floats:
    """The distance of each vertex of ``after`` (n,) from ``before``, file units: from the vertex
    that corresponds to it or, where the faces are not the same, from the surface.

    Vertices that no face uses are included.
    """
    if before.has_same_faces(after):
        return distances(before.vertices, after.vertices)
    reference = room.prepare_mesh(before)
    return measures.nearest_on_surface(after.vertices - reference.origin, reference.mesh)[1]


def build_heatmap(
    before: MeshFile, after: MeshFile, before_name: str
) -> tuple[Buffer, float, float]:
    """``after`` as PLY with its deviations from ``before`` as property and colours, and the range
    of the colours, file units."""
    from msal_cli.job.fields import Kind, with_colours

    values = deviations(surface_of(before), surface_of(after))
    kind = Kind("distance to the reference, file units", "sequential", 0.99)
    comments = (f"msal {__version__}: deviation from {before_name}", f"deviation: {kind.meaning}")
    remark = f"; the largest is {float(values.max()):.6g}"
    return with_colours(after, after.vertices, {"deviation": values}, kind, comments, remark)
