"""Methods run on meshes, meshes that several tests run them on, and pairs of known truth."""

import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from msal_cli import codecs, methods
from msal_cli.analysis.measures import measure_surface_change
from msal_cli.mesh import Mesh, prepare_mesh
from msal_cli.storage.gzip_streams import expand, read_whole
from tests.shapes import cube, grid, noisy, torus

SHAPES = {
    "torus": (noisy(torus(16, 9)[0], 1, 0.15), torus(16, 9)[1]),
    "open grid": (noisy(grid(9, 8)[0], 2, 0.2), grid(9, 8)[1]),
    "cube": (noisy(cube()[0], 3, 0.1), cube()[1]),
    "tiny": (noisy(torus(16, 9)[0], 5) * 1e-6, torus(16, 9)[1]),
}
"""Vertices (n, 3) and faces (m, 3) with noise."""


def denoise(name: str, mesh: Mesh, on_sweep=None, **given) -> np.ndarray:
    """Positions (n, 3) of a mesh after a method."""
    method = methods.find(name)
    return method.denoise(mesh, method.validate(given), on_sweep).vertices


def run(name: str, vertices, faces, on_sweep=None, **given) -> tuple[Mesh, np.ndarray]:
    """The prepared mesh, and its positions after a method."""
    mesh = prepare_mesh(vertices, faces).mesh
    return mesh, denoise(name, mesh, on_sweep, **given)


def run_in_file(name: str, vertices, faces, **given) -> np.ndarray:
    """Positions in the coordinates of the file after a method."""
    ready = prepare_mesh(vertices, faces)
    return ready.to_file_vertices(denoise(name, ready.mesh, **given), vertices)


def scan(level=0.12, seed=3, shape=torus, **size) -> Mesh:
    vertices, faces = shape(**size)
    return prepare_mesh(noisy(vertices, seed, level), faces).mesh


def small_scan(shape: str, level=0.12, seed=3) -> Mesh:
    """A torus or an open grid that plain twins are quick for."""
    if shape == "torus":
        return scan(level, seed, torus, around=12, across=8)
    return scan(level, seed, grid, rows=9, columns=8)


def free_vertices(mesh: Mesh, boundary: str) -> np.ndarray:
    """Which vertices a rule at open edges lets move."""
    return ~mesh.topology.boundary if boundary == "fixed" else np.ones(len(mesh.vertices), bool)


def assert_twin(mesh: Mesh, out, expected, tolerance=1e-12, least=1e-3) -> None:
    """Positions (n, 3) are those of a plain twin, and not those of the mesh."""
    assert np.abs(out - expected).max() <= tolerance * np.ptp(mesh.vertices)
    assert np.abs(out - mesh.vertices).max() > least


def error_deg(true: Mesh, positions) -> float:
    """Mean angle between the face normals of positions (n, 3) and the true ones."""
    return measure_surface_change(true, true.with_vertices(positions)).mean_angular_error_deg


PAIRS = ("Fandisk0.3", "SharpSphere0.3", "Bunny0.2", "Julius0.2")


@functools.cache
def opened(noisy: Path, clean: Path) -> tuple[Mesh, Mesh]:
    """The noisy mesh, and the same with the positions of the clean one."""
    first, second = (
        codecs.open_mesh(expand(read_whole(str(path)), path.name), path.name)
        for path in (noisy, clean)
    )
    ready = prepare_mesh(first.vertices, first.faces)
    assert ready.vertex_map is None
    return ready.mesh, ready.mesh.with_vertices(second.vertices - ready.origin)


def errors(noisy: Mesh, clean: Mesh, name: str, **given: object) -> tuple[float, float]:
    """Mean angle between face normals in degrees, and mean vertex distance in % of the mean edge,
    after a method."""
    vertices = denoise(name, noisy, **given)
    distances = np.linalg.norm(vertices - clean.vertices, axis=1)
    return error_deg(clean, vertices), 100 * float(distances.mean()) / clean.mean_edge_length


def all_errors(
    data: Path, name: str, names: Sequence[str] = PAIRS, **given: object
) -> list[tuple[float, float]]:
    """The errors on the named pairs of the data folder, in their order."""
    folders = [data / "pairs" / pair for pair in names]
    return [
        errors(*opened(folder / "Noisy.obj", folder / "Original.obj"), name, **given)
        for folder in folders
    ]
