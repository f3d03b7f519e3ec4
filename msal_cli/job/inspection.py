"""What is in one mesh file: counts, defects, extent, volume and noise.

Like ``pipeline`` it never raises for a file's fault: that becomes a record with an error.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from msal_cli.analysis import measures
from msal_cli.codecs import header
from msal_cli.job.changes import defect_fields, file_fields, noise_field
from msal_cli.job.records import Failure, InfoRecord
from msal_cli.job.room import open_mesh, prepare_mesh, room_for_files, to_known_error

if TYPE_CHECKING:
    from msal_cli.storage.regular import Buffer


def inspect_file(
    path: str,
    format: str | None = None,
    *,
    data: Buffer | None = None,
    with_intersections: bool = False,
) -> InfoRecord:
    """What is in a file, or in its ``data``; one that cannot be read gives a record with an error.

    ``with_intersections`` counts the faces that intersect each other, which takes longer than all
    the rest.
    """
    try:
        if data is not None:
            return _inspect(data, path, format, with_intersections)
        with room_for_files((path,), format):
            data = header.read_input(path, format)
            return _inspect(data, path, format, with_intersections)
    except Exception as error:
        return InfoRecord(input=path, error=Failure.of(to_known_error(error, path)))


def _inspect(data: Buffer, name: str, format: str | None, with_intersections: bool) -> InfoRecord:
    mesh_file, is_compressed = open_mesh(data, name, format)
    ready = prepare_mesh(mesh_file)
    defects = ready.defects
    area, volume = measures.area_and_volume(ready.mesh)
    enclosed = measures.enclosure_of(ready.mesh, defects, area, volume)
    low, high = mesh_file.vertices.min(axis=0), mesh_file.vertices.max(axis=0)
    polygons = mesh_file.polygons()
    if isinstance(polygons, np.ndarray) and polygons.ndim == 2:
        sizes = {str(polygons.shape[1]): len(polygons)}
    else:
        found, counts = np.unique([len(polygon) for polygon in polygons], return_counts=True)
        sizes = {str(size): int(count) for size, count in zip(found, counts, strict=True)}
    winding = "consistent"
    if defects.unorientable_parts:
        winding = "not orientable"
    elif defects.inconsistent_edges:
        winding = "inconsistent"
    return InfoRecord(
        input=name,
        **file_fields(mesh_file),
        compressed=is_compressed,
        bytes=len(data),
        polygon_sizes=sizes,
        closed=defects.boundary_edges == 0,
        winding=winding,
        **defect_fields(ready, mesh_file.merged_vertices),
        bounds=(tuple(low.tolist()), tuple(high.tolist())),
        area=area,
        inside_out=enclosed.is_inside_out,
        volume=None if defects.volume_objection else enclosed.volume(ready.mesh, volume),
        volume_valid=not defects.volume_objection,
        volume_reason=defects.volume_objection,
        self_intersections=measures.count_self_intersections(ready.mesh)
        if with_intersections
        else None,
        noise_estimate=noise_field(ready.mesh),
        properties=mesh_file.properties,
        references=mesh_file.references,
        warnings=mesh_file.warnings + ((enclosed.words,) if enclosed.is_inside_out else ()),
    )
