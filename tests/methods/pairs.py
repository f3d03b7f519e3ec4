"""Ground truth: pairs of a noisy and a clean mesh with the same vertices and faces."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from msal_cli import codecs
from msal_cli.mesh import Mesh, prepare_mesh
from msal_cli.storage.gzip_streams import expand, read_whole
from tests.methods.runs import denoise, error_deg

PAIRS = ("Fandisk0.3", "SharpSphere0.3", "Bunny0.2", "Julius0.2")


@functools.cache
def opened(noisy: Path, clean: Path) -> tuple[Mesh, Mesh]:
    """The noisy mesh, and the same with the positions of the clean one."""
    first, second = (
        codecs.open_mesh(expand(read_whole(str(path)), path.name)[0], path.name)
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
