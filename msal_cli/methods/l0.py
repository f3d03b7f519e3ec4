"""L0 minimisation: as few bent edges as possible, for surfaces made of flat pieces.

An edge with two faces is bent where the four corners p1 ... p4 of its flap do not lie in a plane.
The operator D = c1 p1 + c2 p2 + c3 p3 + c4 p4, its coefficients made from the areas of the two
faces, measures this as a length that is zero where the flap is flat.  The method looks for
positions p near the scanned ones p* with few D that are not zero,

    min  |p - p*|^2 + alpha |R|^2 + lambda (number of edges with D not 0),  R = p1 - p2 + p3 - p4

by an auxiliary delta for each edge, in steps between which beta grows from 0.001 to 1000:

    delta = D(p) where |D|^2 >= lambda / beta, else 0
    p = argmin |p - p*|^2 + alpha |R|^2 + beta |D - delta|^2
    alpha <- alpha / (growth of beta)^2

The positions come from a sparse linear system, solved by conjugate gradients to residuals of 1e-5
mean edge lengths.  D is updated before each step.  lambda = ``sparsity`` gamma e^2 and alpha =
``regularity`` gamma, with the mean edge length e and the mean dihedral angle gamma of the input in
radians, so that both follow the noise; angles count without their sign.

It gives the sharpest edges and corners of all where the object is a polyhedron, and turns every
curved part into facets; for these and for texture use another method.  Under heavy noise thin parts
fold.

Open edges, and edges with more than two faces, are not measured.  A needle's coefficients are
scaled down to 100.  The cost is that of 40 linear systems, about 1000 passes over the edges; the
memory about 1 kB a vertex.

Source: L. He and S. Schaefer, Mesh denoising via L0 minimization, ACM TOG 32 (4), 2013, 64:1-64:8.
"""

from functools import partial

from msal_cli.kernels.faces import dihedral_angles, flaps
from msal_cli.kernels.linear_systems import conjugate_gradients, edge_sparsity
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._contract import OnSweep, Result, Timer
from msal_cli.methods._sliding import undo_sliding
from msal_cli.methods._sweeps import free_vertices

FIRST_BETA = 1e-3
LAST_BETA = 1e3

TOLERANCE = 1e-5
"""Accuracy of solutions, mean edge lengths; 1e-8 has the same results at three times the cost."""

MAX_ITERATIONS = 100
"""Largest number of conjugate gradient iterations in a step; noise of 0.3 needs up to 84."""

BYTES_PER_FACE = 455


@dataclass(frozen=True)
class Parameters:
    iterations: int = fields.iterations(
        40,
        "steps in which beta grows from 0.001 to 1000; 40 are a factor of the square root of 2",
        "a slower, more careful search for the edges to keep",
    )
    sparsity: float = fields.parameter(
        0.2,
        "price of a bent edge",
        symbol="lambda",
        low=0.0,
        high=1000.0,
        unit="squared mean edge lengths times the mean dihedral angle in radians",
        more="fewer edges: larger flat pieces, less detail; far too much rounds everything",
    )
    regularity: float = fields.parameter(
        0.1,
        "weight of the parallelogram term at the first step",
        symbol="alpha",
        low=0.0,
        high=1000.0,
        unit="mean dihedral angles in radians",
        more="from 10 on: more even triangles, fewer folds, rounder edges",
    )
    boundary: str = fields.boundary("free", "moved like the others by the edges that they have")
    sliding: str = fields.sliding()


def denoise(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep) -> Result:
    timer = Timer()
    corners = flaps(mesh.faces, mesh.topology)
    edges = edge_sparsity(len(mesh.vertices), corners)
    gamma = float(dihedral_angles(mesh.vertices, corners).mean()) if len(corners) else 0.0
    edge_length = mesh.mean_edge_length
    price = parameters.sparsity * gamma * edge_length**2
    fixed = ~free_vertices(mesh, parameters.boundary)
    timer.start_sweeps()

    positions = mesh.vertices.copy()
    for step in range(parameters.iterations):
        growth = (LAST_BETA / FIRST_BETA) ** (step / parameters.iterations)
        beta = FIRST_BETA * growth
        # Called within a long solve too, where the caller may raise an exception to end the run.
        on_step = partial(on_sweep, step, parameters.iterations)
        alpha = parameters.regularity * gamma / growth**2
        coefficients, deltas = edges.bent(positions, price / beta)
        matrix, pulls = edges.system(coefficients, deltas, alpha, beta)
        positions = conjugate_gradients(
            matrix.diagonal,
            matrix.times,
            mesh.vertices + pulls,
            positions,
            tolerance=TOLERANCE * edge_length,
            most_iterations=MAX_ITERATIONS,
            held=fixed,
            on_iteration=on_step,
        )
        on_sweep(step + 1, parameters.iterations)
    if parameters.iterations:
        positions = undo_sliding(mesh, positions, parameters.sliding, parameters.boundary)
    return timer.finish(positions)
