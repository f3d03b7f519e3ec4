"""What ``msal info`` knows of one file."""

from __future__ import annotations

from dataclasses import dataclass, field

from msal_cli.job.plain_data import about, known
from msal_cli.job.records import Failure, NoiseEstimate


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
    polygon_sizes: dict[str, int] = field(
        default_factory=dict, metadata=about("number of faces by number of corners")
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
    volume: float | None = known(
        "enclosed volume, whichever side the normals point to, cubed file units; null if it is "
        "not valid"
    )
    volume_valid: bool | None = known("whether the volume means anything")
    volume_reason: str = known("why it does not; empty if it does", "")
    mean_edge_length: float | None = known("mean length of the edges, file units")
    self_intersections: int | None = known(
        "pairs of faces that intersect each other; null without --check"
    )
    noise_estimate: NoiseEstimate | None = known("noise, estimated")
    properties: tuple[str, ...] = known(
        "what else the file holds, which denoising carries along", ()
    )
    references: tuple[str, ...] = known("other files that this one names", ())
    warnings: tuple[str, ...] = known("what a user should know although the file could be read", ())
    error: Failure | None = known("why the file could not be read; null if it could")
