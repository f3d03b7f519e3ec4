"""What is in a file that is larger than memory: counts, extent, area, volume, edges and noise.

The vertices are read once and the faces once, in pieces.  What would need the whole mesh at once
(parts, welded vertices, duplicate faces, edges with more than two faces) is not counted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from msal_cli.analysis.enclosure import INSIDE_OUT
from msal_cli.errors import ContentError
from msal_cli.job.changes import noise_field
from msal_cli.job.info_record import InfoRecord
from msal_cli.job.streamed_progress import Steps
from msal_cli.job.streamed_sample import RepresentativePart, SpreadSample
from msal_cli.job.streamed_totals import Totals, measure_bounds, measure_faces

if TYPE_CHECKING:
    from msal_cli.codecs.streamed_mesh import StreamedMesh
    from msal_cli.job.records import NoiseEstimate
    from msal_cli.job.streamed_progress import ReadingListener


def inspect_streamed(mesh: StreamedMesh, name: str, listener: ReadingListener | None) -> InfoRecord:
    """What is in an opened file; see ``inspection.inspect_file``."""
    steps = Steps(listener, (name,), (mesh,))
    sample = SpreadSample(mesh.n_vertices)
    bounds = measure_bounds(mesh, steps.add, sample.add)
    part = RepresentativePart(sample, mesh.n_vertices)
    totals = measure_faces(mesh, bounds, steps.add, part.add)
    edges = totals.edges
    is_inside_out = totals.is_inside_out
    objection = totals.volume_objection
    words = (INSIDE_OUT,) if is_inside_out else ()
    return InfoRecord(
        input=name,
        format=mesh.format,
        encoding=mesh.encoding,
        precision=mesh.precision,
        bytes=mesh.size,
        read_in_pieces=True,
        vertices=None if mesh.are_corners else mesh.n_vertices,
        corners=mesh.n_vertices if mesh.are_corners else None,
        faces=mesh.n_polygons,
        triangles=totals.n_triangles,
        polygon_sizes=({"3": mesh.n_polygons} if totals.n_triangles == mesh.n_polygons else {}),
        closed=edges.boundary_edges == 0 if edges is not None else None,
        winding=_winding(totals),
        boundary_edges=edges.boundary_edges if edges is not None else None,
        inconsistent_edges=edges.inconsistent_edges if edges is not None else None,
        degenerate_faces=totals.degenerate_faces,
        unreferenced_vertices=totals.unreferenced_vertices,
        mean_edge_length=totals.mean_edge_length,
        bounds=(tuple(bounds.low.tolist()), tuple(bounds.high.tolist())),
        area=totals.area,
        inside_out=is_inside_out,
        volume=None if objection else abs(totals.volume),
        volume_valid=not objection,
        volume_reason=objection,
        noise_estimate=_noise(part, totals),
        properties=mesh.properties,
        references=mesh.references,
        warnings=mesh.warnings + words,
    )


def _winding(totals: Totals) -> str | None:
    if totals.edges is None:
        return None
    return "inconsistent" if totals.edges.inconsistent_edges else "consistent"


def _noise(part: RepresentativePart, totals: Totals) -> NoiseEstimate | None:
    """The noise of a part, in mean edge lengths of the whole; None if the part is no mesh."""
    try:
        mesh = part.mesh()
    except ContentError:
        return None
    mesh.__dict__["mean_edge_length"] = totals.mean_edge_length
    return noise_field(mesh)
