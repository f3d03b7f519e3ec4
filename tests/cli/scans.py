"""Small scans on disk, and the program to run over them."""

import json
import os
import subprocess
import sys

from click.testing import CliRunner

from benchmarks.ground_truth import add_plain_noise
from msal_cli.cli.main import program
from msal_cli.mesh import prepare_mesh
from tests.ply_files import XYZ, to_ascii_ply
from tests.shapes import grid, noisy, torus

MSAL = (sys.executable, "-m", "msal_cli")


def ply_text(vertices, faces):
    """An ASCII PLY file as bytes."""
    rows = [" ".join(f"{x:.6f}" for x in vertex) for vertex in vertices]
    return to_ascii_ply(XYZ, rows, faces, "a scan")


def closed_scan(seed=0):
    """A noisy torus as PLY; 576 vertices, enough to tell noise from shape."""
    vertices, faces = torus(32, 18)
    return ply_text(noisy(vertices, seed, 0.4), faces)


def open_scan():
    """A noisy open grid as PLY; 30 vertices."""
    vertices, faces = grid()
    return ply_text(noisy(vertices, 1, 0.05), faces)


def torus_scan(level, spikes=(), height=0.0):
    """A torus of 1,800 vertices with noise along its normals, and some that stand out farther by
    a height, as PLY; both in mean edge lengths."""
    mesh = prepare_mesh(*torus(60, 30)).mesh
    vertices, spikes = add_plain_noise(mesh, "gaussian-normal", level, 1), list(spikes)
    vertices[spikes] += height * mesh.mean_edge_length * mesh.vertex_normals()[spikes]
    return ply_text(vertices, mesh.faces)


BAD_SCAN = closed_scan().replace(b"\n3 0", b"\n3 9999", 1)


def folder_of(path, **files):
    """A folder with files; ``a="x"`` becomes ``a.ply`` with these bytes."""
    path.mkdir(parents=True, exist_ok=True)
    for name, data in files.items():
        (path / f"{name}.ply").write_bytes(data)
    return path


def msal(*arguments):
    """Run a command line in this process; has .exit_code, .stdout, .stderr, .stdout_bytes."""
    return CliRunner().invoke(program, [str(word) for word in arguments])


def msal_on(data, *arguments):
    """Run a command line in this process with ``data`` on standard input."""
    return CliRunner().invoke(program, [str(word) for word in arguments], input=data)


def process(*arguments, **options):
    """Run the real command to its end."""
    options = {"capture_output": True, "timeout": 120} | options
    environment = {**os.environ, **options.pop("env", {})}
    # Unbuffered, errors of standard output would come earlier than users meet them.
    environment.pop("PYTHONUNBUFFERED", None)
    words = [word if isinstance(word, bytes) else str(word) for word in (*MSAL, *arguments)]
    return subprocess.run(words, env=environment, check=False, **options)


def record_of(made, code=0):
    """The only record that a command printed as JSON; it must have ended with status ``code``."""
    assert made.exit_code == code, made.stderr
    (record,) = json.loads(made.stdout)["records"]
    return record


def records_of(made):
    """The records that a command printed as JSON, by the names of their inputs."""
    return {r["input"].rpartition("/")[2]: r for r in json.loads(made.stdout)["records"]}
