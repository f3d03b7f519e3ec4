"""Every method, every format and --auto, by an installed msal in an environment without numba.

    python .ci/bare.py SAMPLE_MESHES OUT

Files in OUT are for a comparison with those of another environment or level of processor.  Exit
status 0 only if every command passed.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

from msal_cli import methods
from msal_cli.codecs.conversion import WRITABLE
from msal_cli.codecs.detection import READABLE


def run(*words: object) -> None:
    """Run the program; its first words are shown where it fails."""
    command = [sys.executable, "-m", "msal_cli", *map(str, words)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    if ran.returncode:
        raise SystemExit(f"{' '.join(command)}: exit status {ran.returncode}\n{ran.stderr}")


def main(samples: Path, out: Path) -> None:
    """Run everything."""
    for name in ("numba", "llvmlite"):
        if importlib.util.find_spec(name) is not None:
            raise SystemExit(f"{name} is installed: this environment is not bare")
    out.mkdir(parents=True)
    mesh = samples / "toadstool_noisy.ply"
    for name in methods.names():
        run("denoise", mesh, "-o", out / f"{name}.ply", "--method", name, "-q")
    run("denoise", mesh, "-o", out / "auto.ply", "--auto", "-q")
    for name in WRITABLE:
        made = out / f"mesh.{name}"
        run("denoise", mesh, "-o", made, "--to", name, "-q")
        if name in READABLE:
            run("denoise", made, "-o", out / f"again.{name}", "-q")
    for encoding in ("ascii", "binary"):
        for name in ("ply", "stl"):
            made = out / f"{encoding}.{name}"
            run("denoise", mesh, "-o", made, "--encoding", encoding, "-q")
            run("denoise", made, "-o", out / f"again-{encoding}.{name}", "-q")
    run("info", *sorted(samples.glob("*_clean.*")))
    run("compare", samples / "toadstool_clean.ply", mesh)
    run("noise", samples / "toadstool_clean.ply", "-o", out / "noise.ply", "--level", "0.2e")
    run("view", mesh, out / "auto.ply", "-o", out / "view.png")
    n_files = len(os.listdir(out))
    print(f"{len(methods.names())} methods, {len(WRITABLE)} formats: {n_files} files")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
