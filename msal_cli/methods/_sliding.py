"""Tangential displacements: those of a filter are undone, and triangles are relaxed."""

import numpy as np

from msal_cli.analysis.measures import apply_umbrella
from msal_cli.arrays import Floats
from msal_cli.kernels import umbrellas
from msal_cli.kernels.geometry import face_normals
from msal_cli.kernels.quantiles import median
from msal_cli.kernels.vertex_update import update_vertices
from msal_cli.mesh import Mesh, cached_by_mesh
from msal_cli.methods._sweeps import free_vertices

FINAL_PASSES = 3  # passes that fit the vertices again after their sliding is undone

SIDEWAYS = 0.55
"""Largest ratio of tangential to normal noise at which noise counts as along the normals.

On the machined and the organic meshes of benchmarks/ground_truth.py it is measured as 0.07 to 0.48
for noise along the normals, as 0.58 to 0.82 if noise of the same strength has one more direction,
and as 0.86 to 1.06 for isotropic noise.  Unevenly sampled scans (the dragon: 0.75 and more) look
like the latter, and nothing is undone.
"""


def undo_sliding(
    mesh: Mesh, positions: Floats, sliding: str, boundary: str | None = None
) -> Floats:
    """The result (n, 3) of a filter, with its sliding kept or undone.

    Averages of neighbours and fits to normals also displace vertices tangentially (sliding), by a
    tenth of an edge and more under strong noise.  If the noise was along the normals this is an
    error.  To undo it, each vertex is moved tangentially to the line through its scanned position
    along the normal of the result.  After a fit to normals, which has a ``boundary``, a few passes
    then fit the vertices to the faces of the result again.
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
"""Absolute cosines of normals to the line at which vertices begin to move to it, and from which
they do so fully.  Vertices of steep faces would move far for little, and a sharp limit would
separate neighbours.  With 0.2 angles are up to 10 % greater on 33 simulated scans, with 0.5 not."""


def move_to_lines(mesh: Mesh, positions: Floats, line: Floats) -> Floats:
    """The result (n, 3) of a filter with each vertex moved within its tangent plane to the line
    through its scanned position along the unit vector ``line`` (3,).

    Noise along the view of a scanner leaves vertices on such lines, and filters move them off.
    """
    normals = mesh.with_vertices(positions).vertex_normals()
    cosines = normals @ line
    heights = np.einsum("ij,ij->i", positions - mesh.vertices, normals)
    low, high = FACING
    shares = np.clip((np.abs(cosines) - low) / (high - low), 0.0, 1.0)
    distances = heights / np.where(shares > 0.0, cosines, 1.0)
    on_lines = mesh.vertices + distances[:, None] * line
    moved: Floats = positions + shares[:, None] * (on_lines - positions)
    return moved


def sideways_share(mesh: Mesh) -> float:
    """Tangential noise over normal noise, per direction; infinite without the latter.

    Uneven sampling counts as tangential noise.
    """
    heights, across = measure_second_umbrella(mesh)
    return across / heights if heights > 0.0 else np.inf


@cached_by_mesh
def measure_second_umbrella(mesh: Mesh) -> tuple[float, float]:
    """Standard deviations of the umbrella operator applied twice to the positions, along the
    normals and in each tangential direction, file units; cached by mesh.

    They are estimated by medians over the interior vertices; both are 0 if there are none.
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
"""Share of the tangential distance to the mean of the neighbours that one pass moves a vertex."""

EVEN_REACH = 1.0
"""Mean edge lengths up to which that distance can be noise; beyond, the triangles are uneven by
themselves (slivers at the hull of scattered points), and the vertex stays."""

EVEN_MOLLIFY = 3  # passes that average the vertex normals, which define the tangent planes


def even_out(mesh: Mesh, passes: int) -> Mesh:
    """The mesh with relaxed triangles: each vertex moves ``passes`` times half of the way to the
    mean of its one-ring, within the tangent plane of its averaged normal.

    Isotropic noise makes triangles jagged, and their normals have errors whatever the heights are.
    Heights along the normals do not change, and boundary vertices do not move.
    """
    return _even_out(mesh, passes) if passes else mesh


@cached_by_mesh
def _even_out(mesh: Mesh, passes: int) -> Mesh:
    links = mesh.topology
    normals = mesh.vertex_normals("uniform", EVEN_MOLLIFY)
    free = links.has_ring & ~links.boundary
    if mesh.fixed_vertices is not None:
        free &= ~mesh.fixed_vertices
    positions, edge = mesh.vertices, mesh.mean_edge_length
    for _ in range(passes):
        positions = umbrellas.even_out(
            positions, normals, *links.one_ring, free, EVEN_STEP, EVEN_REACH * edge
        )
    # Methods run on the result, whose normals are others.
    mesh.release_normals()
    return mesh.with_vertices(positions)
