"""Meshes for runs by tiles, and work for their workers to be slow at and to die of."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from msal_cli.batch import tile_claims, tile_scratch, tile_stages, tile_tasks
from msal_cli.codecs import open_mesh
from msal_cli.mesh import Mesh
from msal_cli.tiles import estimates
from tests.cli.scans import msal
from tests.shapes import noisy, torus

TILE_VERTICES = 300
SLOW_S = "MSAL_TEST_SLOW_S"
DEATH_MARK = "MSAL_TEST_DEATH_MARK"


def binary_ply(path, vertices, faces, comments=()):
    """A binary PLY file, float32 positions."""
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {one}" for one in comments)]
    header += [f"element vertex {len(vertices)}", "property float x", "property float y"]
    header += ["property float z", f"element face {len(faces)}"]
    header += ["property list uchar int vertex_indices", "end_header\n"]
    rows = np.zeros(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    path.write_bytes("\n".join(header).encode() + vertices.astype("<f4").tobytes() + rows.tobytes())
    return path


def scan(path, around=48, across=24, level=0.05, **more):
    """A torus with noise along its normals; 1,152 vertices, four tiles."""
    vertices, faces = torus(around, across)
    heights = level * np.random.default_rng(0).normal(size=(len(vertices), 1))
    return binary_ply(
        path, vertices + heights * Mesh(vertices, faces).vertex_normals(), faces, **more
    )


def binary_stl(path, around=48, across=24):
    """The same as STL."""
    vertices, faces = torus(around, across)
    facets = np.zeros(
        len(faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")]
    )
    facets["corners"] = noisy(vertices, 0, 0.05)[faces]
    path.write_bytes(bytes(80) + struct.pack("<I", len(faces)) + facets.tobytes())
    return path


def text(source, suffix):
    """The mesh of a binary PLY as the text of an OBJ, PLY or STL."""
    mesh = open_mesh(source.read_bytes(), source.name)
    points = [f"{x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.vertices.tolist()]
    faces = mesh.faces.tolist()
    if suffix == ".obj":
        lines = [f"v {one}" for one in points]
        lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    elif suffix == ".ply":
        lines = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
        lines += [f"property float {axis}" for axis in "xyz"]
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        lines += ["end_header", *points, *(f"3 {a} {b} {c}" for a, b, c in faces)]
    else:
        lines = ["solid scan"]
        for corners in faces:
            lines += ["facet normal 0 0 0", "outer loop"]
            lines += [f"vertex {points[one]}" for one in corners]
            lines += ["endloop", "endfacet"]
        lines += ["endsolid scan"]
    return "\n".join(lines) + "\n"


def use_small_tiles(patch, tile_vertices=TILE_VERTICES):
    """Cut meshes of tests into tiles, too."""
    patch.setattr(estimates, "TILE_VERTICES", tile_vertices)
    patch.setattr(estimates, "FEWEST_TILE_VERTICES", min(tile_vertices, 50))


def in_memory(source, *words):
    """The bytes that a run in memory makes."""
    target = source.with_name("in_memory" + source.suffix)
    made = msal("denoise", source, "-o", target, "-q", *words)
    assert made.exit_code == 0, made.stderr
    data = target.read_bytes()
    target.unlink()
    return data


def scratch_of(output):
    """The scratch folder of an output."""
    return tile_scratch.scratch_path(str(output), None)


def n_finished(output):
    """How many tasks are finished in the scratch folder of an output."""
    return len([*scratch_of(output).glob("done/*/[0-9]*.json")])


def do_slowly(task, common, on_progress):
    """A task that takes a while."""
    time.sleep(float(os.environ.get(SLOW_S, "0.05")))
    return tile_tasks.run_tile_task(task, common, on_progress)


def claim_slowly(task, common, on_progress):
    """The same where several processes share the tasks."""
    time.sleep(float(os.environ.get(SLOW_S, "0.05")))
    return tile_claims.run_claimed_task(task, common, on_progress)


def die_once(task, common, on_progress):
    """The third task of a stage kills its worker the first time."""
    mark = Path(os.environ[DEATH_MARK])
    if task.index == 2 and task.stage == "prepare" and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return tile_tasks.run_tile_task(task, common, on_progress)


def die_always(task, common, on_progress):
    """The first task of ``prepare`` always kills its worker."""
    if task.index == 0 and task.stage == "prepare":
        os.kill(os.getpid(), signal.SIGKILL)
    return tile_tasks.run_tile_task(task, common, on_progress)


def start_slowly(*words):
    """The command in a process of its own, with small tiles and slow tasks."""
    code = (
        "import sys; sys.path.insert(0, sys.argv.pop(1));"
        "from tests.batch import giants; giants.main()"
    )
    root = str(Path(__file__).parents[2])
    return subprocess.Popen(
        [sys.executable, "-c", code, root, *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def main():
    """What ``start_slowly`` runs."""
    from msal_cli.cli.main import main as run

    class Patch:
        setattr = staticmethod(setattr)

    use_small_tiles(Patch)
    tile_tasks.run_tile_task = do_slowly
    tile_stages.run_claimed_task = claim_slowly
    sys.exit(run())


def wait_for(condition, process, seconds=60.0):
    """Wait until something is so while a process runs."""
    end = time.monotonic() + seconds
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.01)
