"""What is in one file, denoised or not: counts, defects, extent, volume and noise.

Like ``pipeline`` it never raises for a file's fault: that becomes a record with an error.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from msal_cli.errors import InternalError, MsalError, ResourceError
from msal_cli.job.records import Failure, InfoRecord, NoiseEstimate

if TYPE_CHECKING:
    from msal_cli.analysis.noise_estimate import NoiseLevel
    from msal_cli.codecs.mesh_file import MeshFile
    from msal_cli.mesh import Mesh
    from msal_cli.storage.buffers import Buffer

log = logging.getLogger("msal")


def inspect_file(
    path: str, format: str | None = None, *, with_intersections: bool = False
) -> InfoRecord:
    """What is in a file; a file that cannot be read gives a record with an error.

    ``with_intersections`` counts the faces that intersect each other, which takes longer than all
    the rest.
    """
    from msal_cli import codecs as files

    try:
        data = files.read_input(path, format)
        return inspect_bytes(data, path, format, with_intersections=with_intersections)
    except MsalError as error:
        return _inspection_failure(path, error)


def inspect_bytes(
    data: Buffer, name: str, format: str | None = None, *, with_intersections: bool = False
) -> InfoRecord:
    """What is in the bytes of a file; see ``inspect_file``."""
    try:
        return _inspected(data, name, format, with_intersections)
    except MsalError as error:
        return _inspection_failure(name, error)
    except MemoryError:
        return _inspection_failure(name, ResourceError("not enough memory", code="E_MEMORY"))
    except Exception as error:
        log.exception("internal error at %r", name)
        return _inspection_failure(name, InternalError(f"{type(error).__name__}: {error}"))


def _inspection_failure(name: str, error: MsalError) -> InfoRecord:
    return InfoRecord(input=name, error=Failure(error.code, error.message, error.hint, error.where))


def _inspected(data: Buffer, name: str, format: str | None, with_intersections: bool) -> InfoRecord:
    from msal_cli import codecs as files
    from msal_cli.analysis.enclosure import enclosure_of
    from msal_cli.analysis.measures import area_and_volume
    from msal_cli.mesh import prepare_mesh

    plain, is_compressed = files.expanded(data, name)
    mesh_file = files.open_mesh(plain, name, format)
    ready = prepare_mesh(
        mesh_file.vertices,
        mesh_file.faces,
        are_distinct=mesh_file.merged_vertices > 0,
    )
    defects = ready.defects
    area, volume = area_and_volume(ready.mesh)
    enclosed = enclosure_of(ready.mesh, defects, area, volume)
    low, high = mesh_file.vertices.min(axis=0), mesh_file.vertices.max(axis=0)
    n_intersections = None
    if with_intersections:
        from msal_cli.analysis.self_intersections import count_self_intersections

        n_intersections = count_self_intersections(ready.mesh)
    winding = "consistent"
    if defects.unorientable_parts:
        winding = "not orientable"
    elif defects.inconsistent_edges:
        winding = "inconsistent"
    return InfoRecord(
        input=name,
        format=mesh_file.format,
        encoding=mesh_file.encoding,
        precision=mesh_file.precision,
        compressed=is_compressed,
        bytes=len(data),
        vertices=len(mesh_file.vertices),
        corners=files.corner_count(mesh_file),
        faces=mesh_file.n_polygons,
        triangles=len(mesh_file.faces),
        polygon_sizes=_polygon_sizes(mesh_file),
        components=defects.components,
        closed=defects.boundary_edges == 0,
        winding=winding,
        boundary_edges=defects.boundary_edges,
        non_manifold_edges=defects.non_manifold_edges,
        inconsistent_edges=defects.inconsistent_edges,
        degenerate_faces=defects.degenerate_faces,
        duplicate_faces=defects.duplicate_faces,
        unreferenced_vertices=defects.unreferenced_vertices,
        welded_vertices=defects.welded_vertices + mesh_file.merged_vertices,
        bounds=(
            (float(low[0]), float(low[1]), float(low[2])),
            (float(high[0]), float(high[1]), float(high[2])),
        ),
        area=area,
        inside_out=enclosed.is_inside_out,
        volume=None if defects.volume_objection else enclosed.volume(ready.mesh, volume),
        volume_valid=not defects.volume_objection,
        volume_reason=defects.volume_objection,
        mean_edge_length=ready.mesh.mean_edge_length,
        self_intersections=n_intersections,
        noise_estimate=noise_estimate(ready.mesh),
        properties=mesh_file.properties,
        references=mesh_file.references,
        warnings=mesh_file.warnings + ((enclosed.words,) if enclosed.is_inside_out else ()),
    )


def _polygon_sizes(mesh_file: MeshFile) -> dict[str, int]:
    """How many faces have 3, 4, ... corners, keyed by that number as text (for JSON)."""
    import numpy as np

    polygons = mesh_file.polygons()
    if isinstance(polygons, np.ndarray) and polygons.ndim == 2:
        return {str(polygons.shape[1]): len(polygons)}
    sizes, counts = np.unique([len(polygon) for polygon in polygons], return_counts=True)
    return {str(size): int(count) for size, count in zip(sizes, counts, strict=True)}


def noise_estimate(mesh: Mesh, known: NoiseLevel | None = None) -> NoiseEstimate:
    """The noise, as records tell it (see ``noise_estimate``); ``known`` is what
    was estimated of this mesh before."""
    from msal_cli.analysis.noise_estimate import estimate_noise

    level = known or estimate_noise(mesh)
    return NoiseEstimate(
        mean_edges=level.mean_edges,
        file_units=level.file_units,
        low_edges=level.low,
        high_edges=level.high,
        clean_edges=level.clean_edges,
        rms_edges=level.rms_edges,
        tail=level.tail,
        negligible=level.is_negligible,
        lowest_edges=level.lowest,
        highest_edges=level.highest,
        regions=level.regions,
        uneven=level.is_uneven,
        kind=level.character.kind,
        rings=level.character.rings,
        direction=level.character.direction,
        axis=level.character.axis,
        step_edges=level.character.step,
        outliers=level.character.outliers,
        confidence=level.character.confidence,
        basis=level.character.basis,
        words=level.character.words,
    )
