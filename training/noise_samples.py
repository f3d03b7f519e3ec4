"""Meshes with known noise for training the noise estimate: what was added, and how it looks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from msal_cli.analysis.added_noise import AddedNoise, add_noise
from msal_cli.analysis.noise_estimate.evidence import gather_evidence
from msal_cli.analysis.noise_estimate.fits import estimate_white
from msal_cli.arrays import Floats, Ints
from msal_cli.errors import ContentError, MsalError
from msal_cli.kernels.geometry import ring_means
from msal_cli.mesh import Mesh, prepare_mesh
from training.openings import cut_open
from training.samples import choose_patch
from training.scans import draw_scan_of
from training.surface import LabelledMesh

NOISY_SHARE = {
    "sampled": 30.0,
    "sculpture": 6.0,
    "textured": 6.0,
    "medal": 10.0,
    "reconstruction": 6.0,
    "low_polygon": 1.5,
    "coarse_field": 6.0,
    "turned": 8.0,
    "terrain": 6.0,
    "subdivided_cage": 2.0,
    "decimated_part": 2.0,
    "exported_part": 0.5,
    "assembly": 0.5,
    "blocks": 0.2,
    "drawing": 0.2,
}
"""Noisy copies of each mesh, on average, by its maker: what scanners see, more often."""

CLEAN_COPIES = 2
SCAN_SHARE = 0.3
ALIGNED = 0.4
"""Scans whose grid lies along the axes of the object, as those of parts often do."""

FEW_VERTICES = 1_000
"""Vertices below which a mesh is seldom a scan: it gets a tenth of the noisy copies."""

NEIGHBOUR_CORRELATIONS = np.array([0.0, 0.571, 0.777, 0.85, 0.886])
"""Correlation of neighbours by how many rings they share noise over, on regular triangles."""

MIN_FACES = 60


@dataclass(frozen=True, eq=False)
class NoiseSample:
    """One mesh as the classifier sees it.

    Attributes
    ----------
    maker : what made the clean mesh.
    kind : of ``noise_estimate.level.KINDS``.
    level : true standard deviation, mean edge lengths of the noisy mesh, along the direction of the
        kind; for impulses with those that have none.
    rings : over how many rings neighbours share it.
    is_scan : whether a simulated scanner made the mesh, whose level is a distance from the surface.
    numbers : (k,) see ``Evidence``.
    """

    maker: str
    kind: str
    level: float
    rings: int
    is_scan: bool
    numbers: Floats


def draw_samples(maker: str, vertices: Floats, faces: Ints, g: Generator) -> Iterator[NoiseSample]:
    """Clean and noisy copies of a clean mesh."""
    for _ in range(CLEAN_COPIES):
        copy = _draw_copy(vertices, faces, g)
        if copy is not None:
            yield _measure(maker, _round(copy, g), "none", 0.0, 0)
    share = NOISY_SHARE[maker] * (0.1 if len(vertices) < FEW_VERTICES else 1.0)
    for _ in range(int(g.poisson(share))):
        copy = _draw_copy(vertices, faces, g)
        if copy is None:
            continue
        if g.random() < SCAN_SHARE:
            scan = _draw_scan(maker, copy, g)
            if scan is not None:
                yield scan
        else:
            yield _add_noise(maker, copy, g)


def _draw_copy(vertices: Floats, faces: Ints, g: Generator) -> Mesh | None:
    """The mesh turned, perhaps stretched, cut open, or a part of it."""
    points = vertices
    if g.random() < 0.15:
        points = points * np.exp(0.4 * g.normal(size=3))
    if g.random() < 0.4:
        points = points @ np.linalg.qr(g.normal(size=(3, 3)))[0]
    some = faces
    form = g.random()
    if form < 0.12 and len(faces) > 3_000:
        some = faces[choose_patch(points, faces, g)]
    elif form < 0.22 and len(faces) > 2_000:
        labels = np.zeros(len(faces), dtype=np.int64)
        try:
            opened = cut_open(LabelledMesh(points, faces.astype(np.int64), labels), g)
        except ValueError:
            # It is not manifold.
            return None
        points, some = opened.vertices, opened.faces.astype(np.int32)
    if len(some) < MIN_FACES:
        return None
    try:
        return prepare_mesh(points, some.astype(np.int32)).mesh
    except ContentError:
        return None


def _round(mesh: Mesh, g: Generator) -> Mesh:
    """The mesh as a file has it: with 3 to 7 digits, or as single precision."""
    if g.random() < 0.4:
        return mesh.with_vertices(mesh.vertices.astype(np.float32).astype(np.float64))
    quantum = mesh.mean_edge_length * float(10.0 ** g.uniform(-6.0, -2.0))
    return mesh.with_vertices(np.round(mesh.vertices / quantum) * quantum)


def _measure(
    maker: str, mesh: Mesh, kind: str, level: float, rings: int, is_scan: bool = False
) -> NoiseSample:
    numbers = gather_evidence(mesh, estimate_white(mesh)).numbers
    return NoiseSample(maker, kind, level, rings, is_scan, numbers)


@dataclass(frozen=True)
class _Added:
    """Noise to draw: its kind for ``add_noise``, what it counts as, how often, and its levels."""

    name: str
    kind: str
    share: float
    low: float
    high: float
    rings: tuple[int, int] = (0, 0)


ADDED = (
    _Added("gaussian-normal", "none", 1.5, 0.0005, 0.012),
    _Added("correlated", "none", 2.0, 0.003, 0.05, (1, 6)),
    _Added("view", "none", 1.0, 0.003, 0.035, (0, 3)),
    _Added("gaussian-normal", "white", 9.0, 0.025, 0.7),
    _Added("gaussian", "isotropic", 5.0, 0.04, 0.5),
    _Added("correlated", "correlated", 16.0, 0.08, 0.5, (1, 4)),
    _Added("view", "view", 12.0, 0.06, 0.5, (0, 2)),
    _Added("grazing", "view", 2.0, 0.04, 0.2, (0, 1)),
    _Added("quantised", "quantised", 4.0, 0.01, 0.3, (0, 1)),
    _Added("half", "uneven", 3.0, 0.08, 0.5, (0, 1)),
    _Added("ramp", "uneven", 3.0, 0.1, 0.6, (0, 1)),
    _Added("impulsive", "impulsive", 4.0, 0.15, 0.8),
    _Added("outliers", "outliers", 4.0, 0.001, 0.25),
)
"""The mixture of noise that is added; scans have theirs from ``training.scans``.  What published
models have as a trace of their scans is no noise to speak of."""


def _add_noise(maker: str, clean: Mesh, g: Generator) -> NoiseSample:
    shares = np.array([added.share for added in ADDED])
    added = ADDED[int(g.choice(len(ADDED), p=shares / shares.sum()))]
    way = g.standard_normal(3) if g.random() < 0.5 else np.eye(3)[int(g.integers(3))]
    noise = AddedNoise(
        added.name,
        level=float(np.exp(g.uniform(np.log(added.low), np.log(added.high)))),
        seed=int(g.integers(2**31)),
        fraction=float(
            g.uniform(0.01, 0.08) if added.kind == "outliers" else g.choice([0.1, 0.2, 0.3, 0.5])
        ),
        rings=int(g.integers(added.rings[0], added.rings[1] + 1)),
        direction=(float(way[0]), float(way[1]), float(way[2])),
        step=float(g.uniform(0.15, 0.8)),
        border=float(g.choice([0.0, 0.2])),
    )
    noisy = clean.with_vertices(add_noise(clean, noise))
    moves = noisy.vertices - clean.vertices
    used = clean.topology.has_ring
    edge = noisy.mean_edge_length
    level = float(np.sqrt((moves[used] ** 2).sum(axis=1).mean())) / edge
    if added.kind == "isotropic":
        level /= np.sqrt(3.0)
    elif added.kind == "outliers":
        level = noise.level * clean.mean_edge_length / edge
    rings = noise.count_rings() if added.kind not in ("impulsive", "isotropic") else 0
    noisy = _round(noisy, g) if g.random() < 0.5 and added.kind != "quantised" else noisy
    return _measure(maker, noisy, added.kind, level, rings)


def _draw_scan(maker: str, clean: Mesh, g: Generator) -> NoiseSample | None:
    """A simulated scan; None where the scanner cannot see the mesh, or hardly any of it."""
    try:
        scanner, points, faces, truth = draw_scan_of(clean, g, is_aligned=g.random() < ALIGNED)
        ready = prepare_mesh(points, faces)
    except (MsalError, ValueError):
        return None
    mesh = ready.mesh
    if ready.vertex_map is not None or len(mesh.faces) < 400:
        return None
    moves = points - truth
    if scanner in ("voxels", "slices"):
        kind, rings = "staircase", 0
    else:
        heights = np.einsum("ij,ij->i", moves, mesh.vertex_normals())
        rings = _count_rings(mesh, heights)
        kind = "view" if scanner == "depth" else ("correlated" if rings else "white")
    squares = (moves**2).sum(axis=1)
    # What the scanner has not seen is far away.
    level = float(np.sqrt(np.minimum(squares, 9.0 * np.median(squares)).mean()))
    level /= mesh.mean_edge_length
    return _measure(maker, mesh, kind, level, rings, True) if level > 0.03 else None


def _count_rings(mesh: Mesh, heights: Floats) -> int:
    """Over how many rings true heights (n,) are shared, by the correlation of neighbours."""
    means = ring_means(heights, mesh.topology.ring_start, mesh.topology.ring)
    used = mesh.topology.has_ring
    correlation = float(
        (heights[used] * means[used]).sum() / max((heights[used] ** 2).sum(), 1e-30)
    )
    return int(np.abs(NEIGHBOUR_CORRELATIONS - correlation).argmin())
