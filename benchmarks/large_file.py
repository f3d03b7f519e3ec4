"""One large file, from the start of the command to its end, beside other tools.

    python -m benchmarks.large_file [--peers-python PATH] [--repeats 5] [--folder FOLDER]
        [--forms ply ply-ascii stl obj] [--cores one|all|both] [--peers NAME ...] [--around 1414]

The mesh is a noisy torus of AROUND * AROUND / 2 vertices in scan order; 1,001,112 by default, and
twice as many triangles.  ``msal denoise`` and the script of every peer that PATH has (see
``benchmarks/peers``) run in turn, each in a process of its own, on one core and on all.  Printed
are, per kind of file: median and least seconds from fork to exit, processor time, the peak of
resident memory, the ratio to the fastest peer, and how far the vertices moved on average, in mean
edge lengths, which shows that a tool did something.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from benchmarks import contest, scans


def main(words: list[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    contest.add_options(parser, repeats=5, forms=("ply", "ply-ascii", "stl", "obj"))
    parser.add_argument("--around", type=int, default=1414)
    arguments = parser.parse_args(words)
    scan = scans.large_torus(arguments.around)
    print(f"A torus of {len(scan.vertices):,} vertices and {len(scan.faces):,} faces.")
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.folder or Path(scratch)
        name = f"torus-{len(scan.vertices)}"
        sources = {
            form: scans.file_of(folder, name, form, lambda: scan) for form in arguments.forms
        }
        contest.hold(arguments, folder, sources, scan)


if __name__ == "__main__":
    main()
