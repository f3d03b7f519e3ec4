"""Remake Table 1 of Huang and Ascher: volumes before and after AL and MSAL.

    MSAL_DATA=FOLDER python benchmarks/table1.py [--seeds 16]

FOLDER holds clean/fandisk.obj, the paper's Fandisk, and clean/stanford-bunny.obj.  The paper's
noise files are unknown ("about 10 %"): here every coordinate gets uniform noise of +-0.1 mean edge
lengths, for several seeds, and what is compared are differences from (Fandisk) and ratios to
(Bunny, whose scale is unknown) the noisy volume, which hardly depend on the noise.
Prints the tables of benchmarks/results/table1.txt.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np

from msal_cli import codecs, methods
from msal_cli.kernels.geometry import area_and_volume
from msal_cli.mesh import Mesh, prepare_mesh
from msal_cli.storage import gzip_streams

SWEEPS = 3
LEVEL = 0.1


def volumes(path: Path, seeds: int) -> tuple[float, np.ndarray]:
    """Volume of the clean mesh, and (seeds, 3) volumes: noisy, after AL, after MSAL.

    The volumes are about the file's origin, as the Bunny is open.
    """
    mesh_file = codecs.open_mesh(gzip_streams.read_whole(str(path)), path.name)
    clean = prepare_mesh(mesh_file.vertices, mesh_file.faces)
    amplitude = LEVEL * clean.mesh.mean_edge_length

    def volume(mesh: Mesh, vertices: np.ndarray, origin: np.ndarray) -> float:
        return area_and_volume(vertices + origin, mesh.faces)[1]

    rows = []
    for seed in range(seeds):
        noise = np.random.default_rng(seed).uniform(
            -amplitude, amplitude, clean.mesh.vertices.shape
        )
        noisy = prepare_mesh(mesh_file.vertices + noise, mesh_file.faces)
        row = [volume(noisy.mesh, noisy.mesh.vertices, noisy.origin)]
        for name in ("al", "msal"):
            method = methods.find(name)
            result = method.denoise(noisy.mesh, method.validate({"iterations": SWEEPS}))
            row.append(volume(noisy.mesh, result.vertices, noisy.origin))
        rows.append(row)
    return volume(clean.mesh, clean.mesh.vertices, clean.origin), np.array(rows)


def table(folder: Path, seeds: int) -> str:
    """The reproduced table as Markdown."""
    original, fandisk = volumes(folder / "clean" / "fandisk.obj", seeds)
    _, bunny = volumes(folder / "clean" / "stanford-bunny.obj", seeds)
    shift = fandisk[:, 1:] - fandisk[:, :1]
    ratio = bunny[:, 1:] / bunny[:, :1]

    def cell(values: np.ndarray, digits: int) -> str:
        return f"{values.mean():.{digits}f} ± {values.std(ddof=1):.{digits}f}"

    lines = [
        "| | the paper | msal | over the seeds |",
        "|---|---|---|---|",
        f"| Fandisk, original | 20.243 | {original:.3f} | |",
        f"| Fandisk, noisy | 20.246 | {fandisk[:, 0].mean():.3f} | {cell(fandisk[:, 0], 3)} |",
        f"| Fandisk, AL - noisy | -0.262 | {shift[:, 0].mean():.3f} | {cell(shift[:, 0], 4)} |",
        f"| Fandisk, MSAL - noisy | -0.066 | {shift[:, 1].mean():.3f} | {cell(shift[:, 1], 4)} |",
        f"| Bunny, AL / noisy | 0.9956 | {ratio[:, 0].mean():.4f} | {cell(ratio[:, 0], 5)} |",
        f"| Bunny, MSAL / noisy | 0.9972 | {ratio[:, 1].mean():.4f} | {cell(ratio[:, 1], 5)} |",
    ]
    return "\n".join(lines)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=16, help="noisy copies of each mesh")
    arguments = parser.parse_args()
    folder = os.environ.get("MSAL_DATA")
    if not folder:
        parser.error("set MSAL_DATA to the folder that holds clean/fandisk.obj")
    print(table(Path(folder), arguments.seeds))


if __name__ == "__main__":
    main()
