"""SHA-256 sums of what every method makes of known meshes, made once and compared ever since.

    python -m tests.frozen.sums [--write] [NAME...]

Prints the cases whose bytes differ from those of ``sums.json``; ``--write`` replaces the sums.
Names select cases, such as ``toadstool`` or ``wiener``.  A change of the sums is a change of the
results: write them anew only where a commit is meant to change results, and say so in it.

The bytes depend on the system's libm and on the machine code that numpy chooses for a processor,
so ``environment`` is kept with the sums, and elsewhere they say nothing.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import json
import os
import platform
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from click.testing import CliRunner

from msal_cli import methods
from msal_cli.cli.main import program

ROOT = Path(__file__).resolve().parents[2]
KEPT = Path(__file__).with_name("sums.json")

AUTO = "auto"
FAST = ("sample_meshes/toadstool_noisy.ply", "sample_meshes/knot_noisy.stl")
"""Files of the default tests: of the first all methods and --auto, of the others the quick ones."""

QUICK = ("al", "msal", "bilateral", "hc", "normal_threshold", "taubin", "umbrella")
"""Methods for large files."""

REAL = (
    "scans/face000.ply",
    "scans/angel.obj",
    "scans/dragon_vrip_res2.ply.gz",
    "real/bunny_range/bun000.ply",
    "real/kinect_cone/Noisy.obj",
    "pairs/Fandisk0.3/Noisy.obj",
    "textured/bunny10k_textured.obj",
    "clean/igea.ply",
)
"""Files of the folder MSAL_DATA."""

Case = tuple[str, str]
"""A file and a method."""


def environment() -> dict[str, str]:
    """What the bytes depend on beside the code."""
    features = np.show_config(mode="dicts")["SIMD Extensions"]
    return {
        "numpy": np.__version__,
        "machine": platform.machine(),
        "libc": " ".join(platform.libc_ver()),
        "simd": " ".join(features["baseline"] + features["found"]),
    }


def all_cases() -> Iterator[Case]:
    """Every file with its methods."""
    names = list(methods.names())
    for path in sorted((ROOT / "sample_meshes").glob("*_noisy.*")):
        for name in [*names, AUTO]:
            yield f"sample_meshes/{path.name}", name
    for file in REAL:
        for name in [*QUICK, AUTO]:
            yield f"data/{file}", name


def fast_cases() -> Iterator[Case]:
    """The cases of the default tests."""
    for file, name in all_cases():
        if file == FAST[0] or (file in FAST and name in QUICK):
            yield file, name


def locate(file: str) -> Path | None:
    """The path of a file, None for one of MSAL_DATA where that is not set."""
    place, _, rest = file.partition("/")
    if place != "data":
        return ROOT / file
    folder = os.environ.get("MSAL_DATA", "")
    return Path(folder, rest) if folder else None


def output_sum(path: Path, method: str, folder: Path) -> str:
    """The SHA-256 of the file that a method writes, or the error's code where it fails."""
    target = folder / path.name
    words = ["denoise", str(path), "-o", str(target), "--force", "--fresh", "--json"]
    words += ["--auto"] if method == AUTO else ["--method", method]
    made = CliRunner().invoke(program, words)
    if made.exit_code:
        return str(json.loads(made.stdout.splitlines()[-1])["error"]["code"])
    data = target.read_bytes()
    # Compressed bytes depend on the system's zlib.
    return hashlib.sha256(gzip.decompress(data) if path.suffix == ".gz" else data).hexdigest()


def key(case: Case) -> str:
    """How a case is named in ``sums.json``."""
    return " ".join(case)


def main(words: list[str] | None = None) -> None:
    """Compare or write the sums."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true")
    parser.add_argument("names", nargs="*")
    arguments = parser.parse_args(words)
    kept = json.loads(KEPT.read_text()) if KEPT.exists() else {"sums": {}}
    sums, n_different, n_compared = dict(kept["sums"]), 0, 0
    with tempfile.TemporaryDirectory() as folder:
        for case in all_cases():
            path, name = locate(case[0]), key(case)
            if path is None or (arguments.names and not any(n in name for n in arguments.names)):
                continue
            n_compared += 1
            sums[name] = output_sum(path, case[1], Path(folder))
            if sums[name] != kept["sums"].get(name):
                n_different += 1
                print(f"different: {name}", flush=True)
    print(f"{n_compared} cases compared, {n_different} different")
    if arguments.write:
        written = {"environment": environment(), "sums": dict(sorted(sums.items()))}
        KEPT.write_text(json.dumps(written, indent=1) + "\n")
    elif n_different:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
