"""What the record of one file tells of its mesh: the defects found, and what denoising changed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from msal_cli.job.records import NormalChange, SelfIntersections

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from msal_cli.analysis.harm import Harm
    from msal_cli.analysis.noise_estimate import NoiseLevel
    from msal_cli.mesh import Defects, PreparedMesh

    Floats = NDArray[np.float64]

INSIDE_OUT = "W_INSIDE_OUT"
"""Code of the warning about a closed surface whose normals point inwards."""


_ADVICE = "try --auto, another method, fewer sweeps or --max-move"


@dataclass(frozen=True)
class Measured:
    """What changed: fields of the record, warnings, each with its code, and the harm, if any."""

    fields: dict[str, Any]
    warnings: tuple[tuple[str, str], ...]
    harm: Harm | None


def defects_told(ready: PreparedMesh, merged: int) -> dict[str, Any]:
    """Fields of the record: the defects; ``merged`` vertices were one before the mesh was made."""
    defects = ready.defects
    return {
        "components": defects.components,
        "boundary_edges": defects.boundary_edges,
        "non_manifold_edges": defects.non_manifold_edges,
        "inconsistent_edges": defects.inconsistent_edges,
        "degenerate_faces": defects.degenerate_faces,
        "duplicate_faces": defects.duplicate_faces,
        "unreferenced_vertices": defects.unreferenced_vertices,
        "welded_vertices": defects.welded_vertices + merged,
        "mean_edge_length": ready.mesh.mean_edge_length,
    }


def warnings_of(defects: Defects) -> tuple[str, ...]:
    """What the user should be told of the defects."""
    if not defects.inconsistent_edges:
        return ()
    return (
        f"inconsistent winding at {defects.inconsistent_edges} edges; "
        f"{defects.turned_faces} faces were turned for the computation only",
    )


def measured(ready: PreparedMesh, moved: Floats, noise: NoiseLevel | None) -> Measured:
    """What changed when the mesh's positions became ``moved`` (n, 3).

    ``noise`` is the noise of the mesh where it is known already.
    """
    from msal_cli.analysis.enclosure import enclosure_of
    from msal_cli.analysis.harm import harmful_change
    from msal_cli.analysis.measures import displacement_statistics, measure_surface_change
    from msal_cli.job.comparison import area_changed, displaced, volume_changed
    from msal_cli.job.inspection import noise_estimate

    before, after = ready.mesh, ready.mesh.with_vertices(moved)
    used = before.topology.has_ring
    one = displacement_statistics(before.vertices, after.vertices, used)
    surface = measure_surface_change(before, after)
    turned = surface.normals
    objection = ready.defects.volume_objection
    enclosed = enclosure_of(before, ready.defects, surface.area_before, surface.volume_before)
    surface = enclosed.change(before, after, surface)
    warnings = [(INSIDE_OUT, enclosed.words)] if enclosed.is_inside_out else []
    harm = harmful_change(before, after, surface, has_volume=not objection)
    if harm is not None:
        warnings.append((harm.code, f"this looks like damage: {harm.reason}; {_ADVICE}"))
    fields = {
        "displacement": displaced(one, before.mean_edge_length),
        "normal_change": NormalChange(turned.mean_angular_error_deg, turned.max_angular_error_deg),
        "flipped_faces": turned.flipped_faces,
        "noise_estimate": noise_estimate(before, noise),
        "inside_out": enclosed.is_inside_out,
        "volume": volume_changed(
            surface.volume_before, surface.volume_after, surface.area_before, objection
        ),
        "area": area_changed(surface.area_before, surface.area_after),
    }
    return Measured(fields, tuple(warnings), harm)


def self_intersections(ready: PreparedMesh, moved: Floats) -> SelfIntersections:
    """How many pairs of faces intersect, and how many of them since the mesh's positions became
    ``moved`` (n, 3)."""
    from msal_cli.analysis.self_intersections import self_intersection_change

    change = self_intersection_change(ready.mesh, ready.mesh.with_vertices(moved))
    return SelfIntersections(change.before, change.after, change.created)
