"""What is found out about a scan before the learned filter describes its faces.

Cheap filters that are good somewhere give a normal of every face each: ``wiener``, where relief is;
its sweeps alone, which smooth most; two windowed sincs, whose pass bands of 0.1 and 0.03 reach
farther than the neighbours that a face is described by.  Beside these normals each face gets
numbers of its surroundings, a dozen edges wide: the power of the ripples of the scan over that of
white noise of the level, which part of what the sweeps took is shape, and how strong that is.
"""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats, Floats32
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.geometry import face_normals, ring_means
from msal_cli.kernels.normal_regression import STATISTICS, Evidence, measure_ripples
from msal_cli.kernels.umbrellas import sinc_coefficients, smooth_by_windowed_sinc
from msal_cli.mesh import Mesh
from msal_cli.methods._restoration import (
    RestorationParameters,
    Restored,
    fit_to_normals,
    restore,
)
from msal_cli.methods._rings import ring_of
from msal_cli.methods._sliding import measure_second_umbrella
from msal_cli.methods._sweeps import anisotropic_laplacian

SINCS = ((20, 0.1), (30, 0.03))
"""Iterations and pass bands of the windowed sincs."""

MIN_LEVEL = 1e-3
"""Least level of the noise, mean edge lengths, that powers are compared with."""

WHITE_POWERS = (1.17, 1.85, 3.2)
"""Mean squares of ``measure_ripples`` for white noise of level 1 on the lattice of valence 6."""

AROUND, NEAR = 6, 2
"""Passes by which powers, and by which shares, are averaged around a vertex."""


def gather_evidence(mesh: Mesh, noise: float | None, is_white: bool) -> Evidence:
    """The evidence for ``mesh``; ``noise`` in mean edge lengths, None where it is not known."""
    level = max(_guess_level(mesh) if noise is None else noise, MIN_LEVEL)
    unit = level * mesh.mean_edge_length
    parameters = RestorationParameters()
    laplacian = anisotropic_laplacian(mesh, parameters)
    restored = restore(mesh, laplacian, parameters, unit, _ignore)
    outcomes = [fit_to_normals(mesh, parameters, restored.positions, unit), restored.smooth]
    rings = ring_of(mesh, "curve")
    terms = [sinc_coefficients(pass_band, iterations) for iterations, pass_band in SINCS]
    outcomes += smooth_by_windowed_sinc(mesh.vertices, *rings, terms)
    normals = np.empty((len(mesh.faces), 3 * len(outcomes)), dtype=np.float32)
    for place, outcome in enumerate(outcomes):
        normals[:, 3 * place : 3 * place + 3] = face_normals(outcome, mesh.faces)
    return Evidence(noise, is_white, normals, _measure_surroundings(mesh, restored, unit))


def _ignore(done: int, total: int) -> None:
    """Take no notice of progress."""


def _guess_level(mesh: Mesh) -> float:
    """The level that the umbrella of the umbrella speaks for, mean edge lengths."""
    heights, _ = measure_second_umbrella(mesh)
    return heights / (float(np.sqrt(WHITE_POWERS[1])) * (mesh.mean_edge_length or 1.0))


def _measure_surroundings(mesh: Mesh, restored: Restored, unit: float) -> Floats32:
    """Numbers from 0 to 1 of the surroundings of each face, (m, STATISTICS); ``unit`` is the noise
    in file units."""
    links = mesh.topology
    ripples = measure_ripples(mesh.vertices, mesh.vertex_normals(), links)
    columns = []
    for place, white in enumerate(WHITE_POWERS):
        columns.append(_compare(average_around(ripples[:, place] ** 2, links), white * unit**2))
    columns.append(average_around(restored.share, links, NEAR))
    columns.append(_compare(average_around(restored.returned**2, links), unit**2))
    statistics = np.empty((len(mesh.faces), STATISTICS), dtype=np.float32)
    for place, column in enumerate(columns):
        statistics[:, place] = column[mesh.faces].mean(axis=1)
    return statistics


def _compare(power: Floats, usual: float) -> Floats:
    return power / (power + usual)


def average_around(values: Floats, links: Connectivity, passes: int = AROUND) -> Floats:
    """Means (n,) of ``values`` (n,) over the surroundings of each vertex, in so many passes."""
    count = np.diff(links.ring_start)
    for _ in range(passes):
        values = (ring_means(values, *links.one_ring) * count + values) / (count + 1.0)
    return values
