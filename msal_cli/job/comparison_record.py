"""What ``msal compare`` knows of two files."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from msal_cli.job.plain_data import ScreenRepr, about, known
from msal_cli.job.records import (
    Area,
    Displacement,
    Failure,
    GateResult,
    SelfIntersections,
    SurfaceDistance,
    Volume,
)


@dataclass(frozen=True, repr=False)
class ComparisonRecord(ScreenRepr):
    """A mesh ``after`` against a mesh ``before``, which is the reference: its mean edge length is
    the unit, its volume, area and normals are what changed.

    ``correspondence`` is ``vertices`` where both files have the same faces, and ``surface`` where
    not: then what needs corresponding vertices is None, and the vertex error is the mean distance
    of ``after``'s vertices to ``before``'s surface.
    """

    before: str = field(metadata=about("path of the reference"))
    after: str = field(metadata=about("path of the mesh that is compared with it"))
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
    mean_angular_error_deg: float | None = known(
        "mean angle between corresponding face normals, degrees (the MSAE of much of the "
        "literature); null if faces do not correspond"
    )
    max_angular_error_deg: float | None = known("largest such angle, degrees")
    vertex_error_percent: float | None = known(
        "mean distance between corresponding vertices (where faces do not correspond, from the "
        "vertices after to the surface before) in percent of the mean edge length before"
    )
    displacement: Displacement | None = known("how far corresponding vertices are apart")
    flipped_faces: int | None = None
    volume_change_percent: float | None = known(
        "change of the enclosed volume in percent of |before|; null if the volume means nothing, "
        "see volume"
    )
    area_change_percent: float | None = known("change of area in percent of the area before")
    inside_out_before: bool | None = known(
        "true if the surface before is closed and its normals, or those of a part, point inwards; "
        "an open one has no inside"
    )
    inside_out_after: bool | None = known("the same of the surface after")
    volume: Volume | None = None
    area: Area | None = None
    hausdorff: float | None = known(
        "largest distance from a vertex or the centre of a face of one mesh to the surface of the "
        "other, whichever is further, file units; null if fcpw is not installed"
    )
    hausdorff_edges: float | None = known("the same in mean edge lengths")
    distance_to_before: SurfaceDistance | None = known(
        "from the vertices after to the surface before"
    )
    distance_to_after: SurfaceDistance | None = known(
        "from the vertices before to the surface after"
    )
    seam_gap: float | None = known(
        "largest distance after between vertices that are at one place before"
    )
    self_intersections: SelfIntersections | None = known(
        "pairs of faces that intersect each other; null without --check or a gate that names them"
    )
    warnings: tuple[str, ...] = known(
        "what a user should know although the files were compared", ()
    )
    gates: tuple[GateResult, ...] = known("what became of each gate; empty if there was none", ())
    error: Failure | None = known("why the files were not compared; null if they were")
