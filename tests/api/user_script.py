"""A program that uses the Python API, as type checkers see it: ``mypy --strict`` has to pass."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

import msal_cli as msal


class Mesh:
    """Stands for a class of a mesh library."""


def smooth(vertices: npt.NDArray[np.float32], faces: npt.NDArray[np.int64]) -> float:
    """Arrays in, a result with figures out."""
    mask = np.zeros(len(vertices), dtype=bool)
    result: msal.DenoiseResult = msal.denoise(
        vertices, faces, "msal", K=0.5, max_move="0.3e", lock=mask, weights=np.ones(len(vertices))
    )
    noise: msal.NoiseEstimate = msal.estimate_noise(result.vertices, faces)
    noisy = msal.add_noise(vertices, faces, level=0.1)
    record: msal.ComparisonRecord = msal.compare((noisy, faces), (result.vertices, faces))
    change = record.volume_change_percent
    return result.displacement.max_edges + noise.mean_edges + (0.0 if change is None else change)


def every_method(vertices: npt.NDArray[np.float32], faces: npt.NDArray[np.int64]) -> list[str]:
    """Names of methods are words of a set."""
    for one in msal.list_methods():
        msal.denoise(vertices, faces, one.name)
    msal.denoise_file("a.ply", "b.ply", "taubin", iterations=2, parameters={"lambda": 0.3})
    return [text for one in msal.list_methods() for text in one.parameters.values()]


def same_type(mesh: Mesh) -> Mesh:
    """A mesh object comes back as its own type."""
    return msal.denoise(mesh, method="auto", keep="edges")


def failures(folder: Path) -> Iterator[str]:
    """Files and folders give records."""
    try:
        first: msal.MeshRecord = msal.denoise_file("a.ply", folder / "a.ply", precision="float64")
    except msal.InputError as error:
        yield f"{error.code} {error.where} {error.hint}"
    else:
        yield first.status
    for record in msal.denoise_folder("scans", folder, jobs=4, fail_on="flipped_faces > 0"):
        if record.error is not None:
            yield record.error.code
        yield from (gate.reason for gate in record.gates if gate.broken)
