"""Changes so large that they are damage rather than denoising.

Two rules.  The volume of a closed surface changed by more than half.  Or more faces flipped (turned
by more than a right angle) than 2 % of all, and three for every two faces that were folded before:
strong noise across the normals folds faces over, and unfolding them flips them.  On six models with
Gaussian noise of 0.1 to 0.6 edges in each coordinate the true surface flips 0 to 30 % of the faces,
at most 1.2 for each folded one; along the normals it flips 1.7 % at most.  CAD meshes have no
folds, and where a filter collapses them half of the faces flip.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from msal_cli.analysis.measures import SurfaceChange, relative_volume_change
from msal_cli.arrays import Ints
from msal_cli.mesh import Mesh

FLIPPED_SHARE = 0.02
"""Share of the faces that may flip on a mesh without folds."""

FLIPS_PER_FOLD = 1.5
"""Faces more that may flip for each face that is folded before."""

VOLUME_SHARE = 0.5
"""Share of its volume that a closed surface may lose or gain."""

MOST_SAMPLED = 65_536
"""Faces that are looked at for folds."""

FLIPPED, VOLUME = "W_FLIPPED_FACES", "W_VOLUME_CHANGE"


@dataclass(frozen=True)
class Harm:
    """A harmful change: ``code`` is ``FLIPPED`` or ``VOLUME``, ``reason`` has the figures."""

    code: str
    reason: str


def harmful_change(
    before: Mesh, after: Mesh, change: SurfaceChange, *, has_volume: bool
) -> Harm | None:
    """The harm between two meshes with the same faces, None if there is none.

    Parameters
    ----------
    change : ``surface_change(before, after)``, best with the volumes that are enclosed
        (``Enclosure.change``): those of parts that are inside out would count against the others.
    has_volume : whether the volume means anything (``Defects.volume_objection`` is empty).
    """
    return judge_change(
        change, len(before.faces), lambda: folded_faces(before), has_volume=has_volume
    )


def judge_change(
    change: SurfaceChange, n_faces: int, count_folded: Callable[[], int], *, has_volume: bool
) -> Harm | None:
    """The same from figures: ``count_folded()`` gives how many of the ``n_faces`` faces are folded
    before, and is called only where that can matter."""
    if has_volume:
        share = relative_volume_change(
            change.volume_before, change.volume_after, change.area_before
        )
        if share is not None and abs(share) > VOLUME_SHARE:
            return Harm(VOLUME, f"the volume changed by {100.0 * share:+.1f} %")
    n_flipped = change.normals.flipped_faces
    if n_flipped > FLIPPED_SHARE * n_faces:
        allowed = FLIPPED_SHARE * n_faces + FLIPS_PER_FOLD * count_folded()
        if n_flipped > allowed:
            share = n_flipped / n_faces
            return Harm(
                FLIPPED, f"{n_flipped:,} of {n_faces:,} faces flipped ({100.0 * share:.1f} %)"
            )
    return None


def folded_faces(mesh: Mesh) -> int:
    """How many faces face away from the mollified normals at their corners.

    Of more than ``MOST_SAMPLED`` faces every k-th one is counted, and the count is scaled.
    """
    step = sampling_step(len(mesh.faces))
    return count_folds(mesh, np.ascontiguousarray(mesh.faces[::step])) * step


def sampling_step(n_faces: int) -> int:
    """k where of so many faces every k-th one is looked at for folds."""
    return max(n_faces // MOST_SAMPLED, 1)


def count_folds(mesh: Mesh, faces: Ints) -> int:
    """How many of ``faces`` (k, 3) face away from the mollified normals at their corners."""
    from msal_cli.kernels.geometry import face_normals

    # Most methods have computed these normals.
    at_vertices = mesh.vertex_normals("uniform", 1)
    around = at_vertices[faces].sum(axis=1)
    alike = np.einsum("ij,ij->i", face_normals(mesh.vertices, faces), around)
    return int(np.count_nonzero(alike < 0.0))
