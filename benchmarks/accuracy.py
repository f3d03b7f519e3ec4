"""Every method at its default setting on noisy meshes whose true shape is known.

    MSAL_DATA=FOLDER python benchmarks/accuracy.py

FOLDER holds pairs/NAME/{Noisy,Original}.obj; the number in a name is the noise in mean edge
lengths.  Prints the table of docs/accuracy.md: mean angle between corresponding face normals in
degrees / mean distance between corresponding vertices in % of the original's mean edge length.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np

from msal_cli import files, methods
from msal_cli.mesh import Mesh, prepared
from msal_cli.metrics.normals import normal_statistics


def pair(folder: Path) -> tuple[Mesh, Mesh]:
    """The noisy and the true mesh of a folder, about one origin."""
    opened = []
    for name in ("Noisy.obj", "Original.obj"):
        data = files.read_whole(str(folder / name))
        opened.append(files.open_mesh(data, name))
    noisy = prepared(opened[0].vertices, opened[0].faces)
    return noisy.mesh, noisy.mesh.moved(opened[1].vertices - noisy.origin)


def errors(true: Mesh, mesh: Mesh) -> str:
    """Mean angle in degrees / mean vertex error in % of the mean edge length."""
    angle = normal_statistics(true, mesh).mean_angular_error_deg
    distance = np.linalg.norm(mesh.vertices - true.vertices, axis=1).mean()
    return f"{angle:.2f} / {100 * distance / true.mean_edge_length:.1f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.parse_args()
    if "MSAL_DATA" not in os.environ:
        parser.error("set MSAL_DATA to the folder that holds pairs/")
    folders = sorted((Path(os.environ["MSAL_DATA"]) / "pairs").iterdir())
    pairs = [pair(folder) for folder in folders]
    print("| method | " + " | ".join(folder.name for folder in folders) + " |")
    print("|---" * (1 + len(folders)) + "|")
    print("| noisy | " + " | ".join(errors(true, noisy) for noisy, true in pairs) + " |")
    for name in methods.names():
        method = methods.find(name)
        settled = method.settled({})
        cells = [
            errors(true, noisy.moved(method.denoised(noisy, settled).vertices))
            for noisy, true in pairs
        ]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
