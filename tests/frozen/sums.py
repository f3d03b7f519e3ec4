"""SHA-256 sums of what every method makes of known meshes, made once and compared ever since.

    python -m tests.frozen.sums [--write] [NAME...]

Prints the cases whose bytes differ from those of ``sums.json``; ``--write`` replaces the sums.
Names select cases, such as ``toadstool`` or ``wiener``.  A change of the sums is a change of the
results: write them anew only where a commit is meant to change results, and say so in it.

The bytes depend on the system's libm and on numpy, so these are kept with the sums, and elsewhere
they say nothing.
"""

import gzip
import hashlib
import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from click.testing import CliRunner

from msal_cli import methods
from msal_cli.cli.main import program
from tests.frozen import kept
from tests.frozen.kept import ROOT

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


def outcomes(names: list[str]) -> Iterator[tuple[str, str]]:
    """The names of the cases that are chosen, or of all, and their sums."""
    with tempfile.TemporaryDirectory() as folder:
        for case in all_cases():
            path, name = locate(case[0]), key(case)
            if path is not None and (not names or any(part in name for part in names)):
                yield name, output_sum(path, case[1], Path(folder))


if __name__ == "__main__":
    given = kept.options(str(__doc__)).parse_args()
    kept.settle(KEPT, outcomes(given.names), kept.environment(), given)
