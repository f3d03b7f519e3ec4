"""Peak memory of denoising one file, by format and by method, beside the forecast.

    python benchmarks/peak_memory.py [--around 1000] [--formats | --methods] [WORD ...]

The mesh is a noisy torus of AROUND * AROUND / 2 vertices and twice as many faces.  Every case
runs in a fresh process, kernels compiled before; ``auto`` among the methods is --auto.  Printed are
megabytes (10^6 bytes) of resident memory at the peak.  The figures in ``codecs/header.py`` come
from this program: the rows ``empty`` give what a process needs before it reads anything.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from msal_cli import codecs, methods
from msal_cli.codecs import conversion
from msal_cli.job.room import forecast
from msal_cli.job.settings import AUTO, Settings, Task
from msal_cli.storage import gzip_streams

_CHILD = """
import sys
from dataclasses import asdict
from msal_cli import methods
from msal_cli.auto import Wishes
from msal_cli.job.pipeline import denoise_file
from msal_cli.job.settings import AUTO, Settings, Task
source, target, name = sys.argv[1:]
given = asdict(Wishes()) if name == AUTO else methods.find(name).validate({})
record = denoise_file(Task(source, target, "x"), Settings(name, given))
assert record.error is None, record.error
for line in open("/proc/self/status"):
    if line.startswith("VmHWM"):
        print(int(line.split()[1]) * 1024)
"""

_TARGETS = {
    "ply-ascii": ("ply", "ascii", "same"),
    "ply-float64": ("ply", "same", "float64"),
    "obj": ("obj", "same", "same"),
    "stl": ("stl", "same", "same"),
    "stl-ascii": ("stl", "ascii", "same"),
    "glb": ("glb", "same", "same"),
    "off": ("off", "same", "same"),
    "vtk": ("vtk", "same", "same"),
    "vtu": ("vtu", "same", "same"),
}


def torus(around: int, across: int) -> bytes:
    """A noisy torus as binary PLY."""
    u, v = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    alpha, beta = 2 * np.pi * u / around, 2 * np.pi * v / across
    ring = 3.0 + np.cos(beta)
    points = np.stack([ring * np.cos(alpha), ring * np.sin(alpha), np.sin(beta)], axis=-1)
    points = points.reshape(-1, 3)
    points += np.random.default_rng(0).uniform(-1.0, 1.0, points.shape) * 1.5 / around

    def at(i: np.ndarray, j: np.ndarray) -> np.ndarray:
        return (i % around) * across + j % across

    lower = np.stack([at(u, v), at(u + 1, v), at(u + 1, v + 1)], axis=-1)
    upper = np.stack([at(u, v), at(u + 1, v + 1), at(u, v + 1)], axis=-1)
    corners = np.stack([lower, upper], axis=2).reshape(-1, 3)
    rows = np.empty(len(corners), dtype=[("n", "u1"), ("corners", "<i4", 3)])
    rows["n"], rows["corners"] = 3, corners
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(rows)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return header.encode() + points.astype("<f4").tobytes() + rows.tobytes()


def cases(folder: Path, around: int, words: list[str]) -> dict[str, Path]:
    """One file per format, all of the same mesh."""
    made = {"ply": folder / "ply.ply"}
    data = torus(around, around // 2)
    made["ply"].write_bytes(data)
    opened = codecs.open_mesh(data, "torus.ply")
    for name, (to, encoding, precision) in _TARGETS.items():
        if words and name not in words and f"{name}-gz" not in words:
            continue
        try:
            if to == "ply":
                output = opened.encoded(opened.vertices, encoding, precision)
            else:
                output, _ = conversion.convert(opened, opened.vertices, to, encoding, precision)
        except Exception as error:
            print(f"{name}: {error}", file=sys.stderr)
            continue
        made[name] = folder / f"{name}.{to}"
        made[name].write_bytes(output)
    for name in ("ply", "obj"):
        if name in made and (not words or f"{name}-gz" in words):
            made[f"{name}-gz"] = made[name].with_suffix(f".{name}.gz")
            made[f"{name}-gz"].write_bytes(gzip_streams.compress(made[name].read_bytes()))
    return {name: path for name, path in made.items() if not words or name in words}


def peak(path: Path, method: str) -> int:
    """Bytes of resident memory at the peak of denoising ``path`` in a fresh process."""
    target = path.with_name("out" + "".join(path.suffixes))
    ran = subprocess.run(
        [sys.executable, "-c", _CHILD, str(path), str(target), method],
        capture_output=True,
        text=True,
        check=False,
    )
    if ran.returncode:
        raise RuntimeError(ran.stderr.strip().splitlines()[-1])
    return int(ran.stdout)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--around", type=int, default=1000)
    parser.add_argument("--formats", action="store_true")
    parser.add_argument("--methods", action="store_true")
    parser.add_argument("words", nargs="*")
    arguments = parser.parse_args()
    everything = not (arguments.formats or arguments.methods)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rows: list[tuple[str, Path, str]] = []
        if arguments.formats or everything:
            some = cases(folder, arguments.around, arguments.words)
            rows += [(one, path, "msal") for one, path in some.items()]
        if arguments.methods or everything:
            (path,) = cases(folder, arguments.around, ["ply"]).values()
            known = (*methods.names(), AUTO)
            wanted = [one for one in known if one in (arguments.words or known)]
            rows += [(one, path, one) for one in wanted]
        small = folder / "small.ply"
        small.write_bytes(torus(24, 12))
        print("| case | bytes | peak MB | empty MB | forecast MB | forecast / peak |")
        print("|---|--:|--:|--:|--:|--:|")
        for word, path, method in rows:
            tiny = small
            if method == "msal" and path.suffix != ".ply":
                (tiny,) = cases(folder, 24, [word]).values()
                tiny = tiny.rename(tiny.with_name(f"small-{tiny.name}"))
                cases(folder, arguments.around, [word])
            try:
                peak(tiny, method)  # compiles the kernels
                empty, full = peak(tiny, method), peak(path, method)
            except RuntimeError as error:
                print(f"| {word} | {path.stat().st_size} | {error} |", flush=True)
                continue
            foreseen_bytes = forecast(
                Task(str(path), str(path), path.name), Settings(method)
            ).memory_bytes
            size = path.stat().st_size
            print(
                f"| {word} | {size} | {full / 1e6:.0f} | {empty / 1e6:.0f} | "
                f"{foreseen_bytes / 1e6:.0f} | {foreseen_bytes / full:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
