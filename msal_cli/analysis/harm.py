"""Changes so large that they are damage rather than denoising.

Two rules hold whatever the noise is.  The volume of a closed surface changed by more than half.  Or
more faces flipped (turned by more than a right angle) than 2 % of all, and three for every two
faces that were folded before: strong noise across the normals folds faces over, and unfolding them
flips them.  On six models with Gaussian noise of 0.1 to 0.6 edges in each coordinate the true
surface flips 0 to 30 % of the faces, at most 1.2 for each folded one; along the normals it flips
1.7 % at most.  CAD meshes have no folds, and where a filter collapses them half of the faces flip.

Three more hold where the noise is known: volume, area, and how far vertices moved, by what noise of
that level explains.  On seven models with noise of 0.05 to 0.7 edges along the normals and in each
coordinate the true surface has 0.02 times noise x area of the volume more or less at most, an area
that is less by 4 times the noise squared, and 95 % of the vertices within 2.8 times the noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from msal_cli.analysis.measures import SurfaceChange, relative_volume_change
from msal_cli.mesh import Mesh

FLIPPED_SHARE = 0.02
"""Share of the faces that may flip on a mesh without folds."""

FLIPS_PER_FOLD = 1.5
"""Faces more that may flip for each face that is folded before."""

VOLUME_SHARE = 0.5
"""Share of its volume that a closed surface may lose or gain."""

MIN_VOLUME, VOLUME_PER_NOISE = 0.01, 0.1
"""Share of its volume that a closed surface may lose or gain without noise, and what it may beyond,
in the volume of a layer over it that is as thick as the noise."""

MIN_AREA, AREA_PER_NOISE = 0.02, 6.0
"""Share of its area that a surface may lose or gain without noise, and what it may lose beyond for
each squared level."""

MIN_MOVE, MOVE_PER_NOISE = 0.02, 6.0
"""Mean edge lengths that one in 20 vertices may move without noise, and beyond, in its levels."""

NAMED_LEEWAY = 3.0
"""Times the bounds that a method may use which the user has named."""

MAX_NOISE = 0.7
"""Mean edge lengths of noise that bounds allow for; meshes that read more are no scans."""

MAX_SAMPLED = 65_536
"""Faces that are looked at for folds."""

FLIPPED, VOLUME = "W_FLIPPED_FACES", "W_VOLUME_CHANGE"
AREA, MOVES = "W_AREA_CHANGE", "W_LARGE_MOVES"


@dataclass(frozen=True)
class Harm:
    """A harmful change: its ``code``, ``FLIPPED``, ``VOLUME``, ``AREA`` or ``MOVES``, and the
    figures as ``reason``."""

    code: str
    reason: str


def harmful_change(
    before: Mesh, after: Mesh, change: SurfaceChange, *, has_volume: bool
) -> Harm | None:
    """The harm between two meshes with the same faces, None if there is none.

    Parameters
    ----------
    change : ``measure_surface_change(before, after)``, best with the volumes that are enclosed
        (``Enclosure.change``): those of parts that are inside out would count against the others.
    has_volume : whether the volume means anything (``Defects.volume_objection`` is empty).
    """
    share = _volume_share(change, has_volume)
    if share is not None and abs(share) > VOLUME_SHARE:
        return Harm(VOLUME, f"the volume changed by {100.0 * share:+.1f} %")
    n_flipped, n_faces = change.flipped_faces, len(before.faces)
    allowed = FLIPPED_SHARE * n_faces
    # Folds are counted only where that can matter.
    if n_flipped > allowed and n_flipped > allowed + FLIPS_PER_FOLD * folded_faces(before):
        percent = 100.0 * n_flipped / n_faces
        return Harm(FLIPPED, f"{n_flipped:,} of {n_faces:,} faces flipped ({percent:.1f} %)")
    return None


def _volume_share(change: SurfaceChange, has_volume: bool) -> float | None:
    """Relative change of the volume, None where it means nothing."""
    if not has_volume:
        return None
    return relative_volume_change(change.volume_before, change.volume_after, change.area_before)


def excessive_change(
    change: SurfaceChange,
    edge: float,
    noise_edges: float,
    p95_edges: float,
    *,
    has_volume: bool,
    leeway: float = 1.0,
) -> Harm | None:
    """A change that noise of ``noise_edges`` mean edge lengths does not explain, None if it does.

    Parameters
    ----------
    edge : mean edge length before, file units.
    p95_edges : 95th percentile of the displacements, mean edge lengths.
    leeway : factor of all bounds.
    """
    noise = min(noise_edges, MAX_NOISE)
    words = f"noise of {noise:.2g} e explains"
    share = _volume_share(change, has_volume)
    if share is not None:
        layer = noise * edge * change.area_before / abs(change.volume_before)
        bound = leeway * (MIN_VOLUME + VOLUME_PER_NOISE * layer)
        if abs(share) > bound:
            percent = f"{100.0 * share:+.1f} %, {words} {100.0 * bound:.1f} %"
            return Harm(VOLUME, f"the volume changed by {percent}")
    if change.area_before > 0.0:
        share = change.area_after / change.area_before - 1.0
        bound = leeway * (MIN_AREA + AREA_PER_NOISE * noise * noise)
        if share > leeway * MIN_AREA or -share > bound:
            return Harm(AREA, f"the area changed by {100.0 * share:+.1f} %, more than {words}")
    if p95_edges > leeway * (MIN_MOVE + MOVE_PER_NOISE * noise):
        return Harm(MOVES, f"one in 20 vertices moved by {p95_edges:.2g} e, more than {words}")
    return None


def folded_faces(mesh: Mesh) -> int:
    """How many faces face away from the mollified normals at their corners.

    Of more than ``MAX_SAMPLED`` faces every k-th one is counted, and the count is scaled.
    """
    from msal_cli.kernels.geometry import face_normals

    step = max(len(mesh.faces) // MAX_SAMPLED, 1)
    faces = np.ascontiguousarray(mesh.faces[::step])
    # Most methods have computed these normals.
    around = mesh.vertex_normals("uniform", 1)[faces].sum(axis=1)
    alike = np.einsum("ij,ij->i", face_normals(mesh.vertices, faces), around)
    return int(np.count_nonzero(alike < 0.0)) * step
