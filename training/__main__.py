"""Train the filter ``learned``:

    python -m training -o msal_cli/weights/learned.json

The same seed, settings and versions of numpy on the same kind of processor give the same bytes.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from msal_cli.core.normal_descriptors import WIDE_FILTERED
from msal_cli.core.normal_regression import VECTORS, Network
from msal_cli.methods._cascade import write_networks
from training.regression import Schedule, train_network
from training.samples import NoisyMesh, collect_samples, draw_meshes


def build_parser() -> argparse.ArgumentParser:
    """The options."""
    parser = argparse.ArgumentParser(prog="python -m training", description=__doc__)
    add = parser.add_argument
    add("-o", "--output", type=Path, required=True, metavar="FILE.json")
    add("--seed", type=int, default=1)
    add("--clean", type=Path, metavar="FOLDER", help="clean meshes of your own, in addition")
    add("--stages", type=int, default=3)
    add("--hidden", type=int, default=96, help="numbers in each hidden layer")
    add("--copies", type=int, default=8, help="noisy meshes of every shape")
    add("--samples", type=int, default=1_500_000, help="faces that a stage learns from")
    add("--epochs", type=int, default=12)
    add("--shapes", type=Path, help="folder of .npz")
    return parser


def main(words: list[str] | None = None) -> int:
    """Make the meshes, train one stage after the other, and write the weights."""
    options = build_parser().parse_args(words)
    started = time.process_time()

    def report(text: str) -> None:
        print(f"{time.process_time() - started:7.1f} s  {text}", flush=True)

    generator = np.random.default_rng(options.seed)
    shapes = []
    for p in sorted(options.shapes.glob("*.npz")):
        z = np.load(p)
        shapes.append((p.stem, z["v"], z["f"]))
    meshes = draw_meshes(shapes, options.copies, generator)
    n_faces = sum(len(one.truth) for one in meshes)
    report(f"{len(meshes)} noisy meshes with {n_faces} faces")
    networks: list[Network] = []
    schedule = Schedule(epochs=options.epochs)
    for stage in range(options.stages):
        per_mesh = max(options.samples // len(meshes), 1)
        inputs, targets, weights, n_vectors = collect_samples(meshes, per_mesh, generator)
        report(f"stage {stage + 1}: {inputs.shape[0]} samples of {inputs.shape[1]} numbers")
        base = VECTORS + 1 if stage else WIDE_FILTERED
        networks.append(
            train_network(
                inputs,
                targets,
                weights,
                n_vectors,
                options.hidden,
                base,
                options.seed + stage,
                schedule,
                report,
            )
        )
        report_errors(meshes, networks[-1], report)
        about = {"trained_by": f"python -m training --seed {options.seed}"}
        write_networks(options.output, tuple(networks), about)
    return 0


def report_errors(meshes: list[NoisyMesh], network: Network, report: object) -> None:
    """Take the stage on all meshes and say how far the normals are off."""
    errors = []
    for one in meshes:
        one.advance(network)
        cosine = np.einsum("ij,ij->i", one.earlier, one.truth)
        errors.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())
    report(f"  mean error {np.mean(errors):.2f} degrees")


if __name__ == "__main__":
    sys.exit(main())
