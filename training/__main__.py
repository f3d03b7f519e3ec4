"""Train the filter ``learned``:

    python -m training -o msal_cli/methods/weights/learned.json

The same seed, settings and versions of numpy on the same kind of processor give the same bytes.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from msal_cli import codecs
from msal_cli.codecs import detection
from msal_cli.kernels.normal_descriptors import WIDE_FILTERED
from msal_cli.kernels.normal_regression import EARLIER, Network, count_vectors
from msal_cli.storage import gzip_streams
from training.regression import Schedule, train_network, write_networks
from training.samples import NoisyMesh, Shape, collect_samples, draw_meshes
from training.shapes import build_shapes


def build_parser() -> argparse.ArgumentParser:
    """The options."""
    parser = argparse.ArgumentParser(prog="python -m training", description=__doc__)
    add = parser.add_argument
    where = "where the header goes; the numbers go beside it, to FILE.f32"
    add("-o", "--output", type=Path, required=True, metavar="FILE.json", help=where)
    add("--seed", type=int, default=1, help="other shapes, noise, samples and first weights")
    add("--clean", type=Path, metavar="FOLDER", help="clean meshes of your own, in addition")
    add("--stages", type=int, default=3, help="networks, one after the other")
    add("--hidden", type=int, default=96, help="numbers in each hidden layer: more is slower")
    add("--copies", type=int, default=18, help="noisy meshes of every shape")
    add("--samples", type=int, default=2_800_000, help="faces that each stage learns from")
    add("--epochs", type=int, default=15, help="passes over the samples")
    add("--quick", action="store_true", help="few and small shapes: to see that it works")
    return parser


def main(words: list[str] | None = None) -> int:
    """Make the meshes, train one stage after the other, and write the weights."""
    options = build_parser().parse_args(words)
    started = time.process_time()

    def report(text: str) -> None:
        print(f"{time.process_time() - started:7.1f} s  {text}", flush=True)

    generator = np.random.default_rng(options.seed)
    shapes = itertools.chain(
        build_shapes(options.seed, options.quick),
        read_meshes(options.clean) if options.clean else (),
    )
    meshes = draw_meshes(shapes, options.copies, generator)
    n_faces = sum(len(one.truth) for one in meshes)
    report(f"{len(meshes)} noisy meshes with {n_faces} faces")
    networks: list[Network] = []
    schedule = Schedule(epochs=options.epochs)
    for stage in range(options.stages):
        per_mesh = max(options.samples // len(meshes), 1)
        inputs, targets, weights, n_vectors = collect_samples(meshes, per_mesh, generator)
        report(f"stage {stage + 1}: {inputs.shape[0]} samples of {inputs.shape[1]} numbers")
        base = count_vectors(stage) - EARLIER + 1 if stage else WIDE_FILTERED
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


def read_meshes(folder: Path) -> Iterator[Shape]:
    """The meshes of a folder, those of a name with a suffix that msal reads, in their order."""
    for path in sorted(folder.iterdir()):
        if path.suffix.lower()[1:] in detection.READABLE:
            mesh_file = codecs.open_mesh(gzip_streams.read_whole(str(path)), path.name)
            yield path.name, mesh_file.vertices, mesh_file.faces


def report_errors(meshes: list[NoisyMesh], network: Network, report: Callable[[str], None]) -> None:
    """Take the stage on all meshes and say how far the normals are off."""
    errors = []
    for one in meshes:
        one.advance(network)
        assert one.earlier is not None
        errors.append(np.degrees(one.mean_angle(one.earlier)))
    report(f"  mean error {np.mean(errors):.2f} degrees")


if __name__ == "__main__":
    sys.exit(main())
