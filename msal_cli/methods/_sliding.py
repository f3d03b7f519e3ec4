"""Motion within the surface: that of a filter undone, and triangles evened out."""

import numpy as np

from msal_cli.analysis.measures import apply_umbrella
from msal_cli.arrays import Floats
from msal_cli.kernels import umbrellas
from msal_cli.kernels.geometry import face_normals
from msal_cli.kernels.quantiles import median
from msal_cli.kernels.vertex_update import update_vertices
from msal_cli.mesh import Mesh, cached_by_mesh
from msal_cli.methods._sweeps import free_vertices

FINAL_PASSES = 3
"""Passes that fit the vertices once more after their sliding is undone."""

SIDEWAYS = 0.55
"""Part of the noise along the normals up to which that within the surface is called none.

Over the machined and the organic meshes of benchmarks/ground_truth.py it is measured as 0.07 to
0.48 with noise along the normals, as 0.58 to 0.82 where noise of the same strength is in one more
direction as well, and as 0.86 to 1.06 where it is in every direction.  Scans that are
unevenly sampled (the dragon: 0.75 and more) are taken for the latter, and nothing is undone."""


def undo_sliding(
    mesh: Mesh, positions: Floats, sliding: str, boundary: str | None = None
) -> Floats:
    """The outcome (n, 3) of a filter, with its sliding kept or undone.

    Averages of neighbours and fits to normals also move vertices within the surface, a tenth of an
    edge and more under strong noise.  Where the noise was along the normals that is away from the
    truth.  To undo it, each vertex goes back sideways until it is on the line through its scanned
    position along the outcome's normal; after a fit to normals, which has a ``boundary``, a few
    passes fit it to the outcome's faces once more.
    """
    if sliding == "kept" or (sliding == "auto" and sideways_share(mesh) > SIDEWAYS):
        return positions
    outcome = mesh.with_vertices(positions)
    normals = outcome.vertex_normals()
    heights = np.einsum("ij,ij->i", positions - mesh.vertices, normals)
    has_normal = (normals != 0.0).any(axis=1)[:, None]
    on_lines = np.where(has_normal, mesh.vertices + heights[:, None] * normals, positions)
    if boundary is None:
        return on_lines
    return update_vertices(
        on_lines,
        face_normals(positions, mesh.faces),
        mesh.faces,
        mesh.topology,
        free_vertices(mesh, boundary),
        FINAL_PASSES,
    )


FACING = (0.3, 0.5)
"""Cosines to a line between which vertices are moved to it, by a rising share: what hardly faces it
would go far for little, and a neighbour that does must not be left behind at once.  From 0.2 on
angles are up to 10 % greater on 33 simulated scans, from 0.5 on they are not."""


def move_to_lines(mesh: Mesh, positions: Floats, line: Floats) -> Floats:
    """The outcome (n, 3) of a filter with each vertex on the line through its scanned position
    along the unit vector ``line`` (3,): where its tangent plane cuts that.

    Noise along the view of a scanner leaves vertices on such lines, and filters move them along
    normals, or anywhere.
    """
    normals = mesh.with_vertices(positions).vertex_normals()
    cosines = normals @ line
    heights = np.einsum("ij,ij->i", positions - mesh.vertices, normals)
    low, high = FACING
    shares = np.clip((np.abs(cosines) - low) / (high - low), 0.0, 1.0)
    ways = heights / np.where(shares > 0.0, cosines, 1.0)
    on_lines = mesh.vertices + ways[:, None] * line
    moved: Floats = positions + shares[:, None] * (on_lines - positions)
    return moved


def sideways_share(mesh: Mesh) -> float:
    """Noise within the surface over that along the normals, per direction; inf without the latter.

    Uneven sampling counts as noise within the surface.
    """
    heights, ways = measure_second_umbrella(mesh)
    return ways / heights if heights > 0.0 else np.inf


@cached_by_mesh
def measure_second_umbrella(mesh: Mesh) -> tuple[float, float]:
    """Standard deviations of what is left of the positions when the umbrella is applied twice,
    along the normals and in each direction within the surface, file units.

    Medians over the vertices within the surface decide; without any of these both are 0.  They are
    computed once for a mesh.
    """
    links = mesh.topology
    second = apply_umbrella(mesh, apply_umbrella(mesh, mesh.vertices))
    normals = mesh.vertex_normals("uniform", 1)
    along = np.einsum("ij,ij->i", second, normals)
    second -= along[:, None] * normals
    across = np.sqrt(np.einsum("ij,ij->i", second, second))
    inner = links.has_ring & ~links.boundary
    if not inner.any():
        return 0.0, 0.0
    # Medians of |x| and of the length of (x, y) for standard normal numbers.
    return median(np.abs(along[inner])) / 0.6745, median(across[inner]) / 1.1774


EVEN_STEP = 0.5
"""Share of the way to the mean of the neighbours, within the surface."""

EVEN_MOLLIFY = 3
"""Passes that average the normals of the tangent planes."""


def even_out(mesh: Mesh, passes: int) -> Mesh:
    """The mesh with each vertex ``passes`` times half of the way to the mean of its one-ring,
    within the tangent plane of its averaged normal.

    Noise in all directions makes jagged triangles, across which normals err whatever the heights
    are.  Heights along the normal stay as they are, and so do vertices at open edges.
    """
    return _even_out(mesh, passes) if passes else mesh


@cached_by_mesh
def _even_out(mesh: Mesh, passes: int) -> Mesh:
    links = mesh.topology
    normals = mesh.vertex_normals("uniform", EVEN_MOLLIFY)
    free = links.has_ring & ~links.boundary
    if mesh.fixed_vertices is not None:
        free &= ~mesh.fixed_vertices
    positions = mesh.vertices
    for _ in range(passes):
        positions = umbrellas.even_out(positions, normals, *links.one_ring, free, EVEN_STEP)
    return mesh.with_vertices(positions)
