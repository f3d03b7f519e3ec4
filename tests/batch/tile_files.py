"""Meshes cut into files that touch, and the outputs of a set read back."""

from pathlib import Path

import numpy as np

from msal_cli.codecs import open_mesh
from msal_cli.codecs.conversion import convert
from msal_cli.job.settings import Task
from tests.ply_files import to_ply
from tests.shapes import ball, grid, noisy

FORMATS = ("ply", "obj", "stl", "ply", "off", "ply", "obj", "stl", "ply")


def noisy_ball(single=True, level=0.01):
    """A noisy sphere: vertices, rounded to single precision, and faces."""
    vertices, faces = ball(30, 16)
    vertices = noisy(vertices, 3, level)
    return (vertices.astype(np.float32).astype(np.float64) if single else vertices), faces


def noisy_terrain(rows=25, columns=25):
    """A noisy open height field, in single precision."""
    vertices, faces = grid(rows, columns)
    x, y, _ = vertices.T
    noise = np.random.default_rng(5).normal(0, 0.06, len(x))
    vertices[:, 2] = np.sin(x / 4) + np.cos(y / 5) + noise
    return vertices.astype(np.float32).astype(np.float64), faces


def cut(vertices, faces, by):
    """Vertices and faces of each part; ``by`` (m,) is the part of each face."""
    parts = []
    for one in np.unique(by):
        own = faces[by == one]
        used = np.unique(own)
        parts.append((vertices[used], np.searchsorted(used, own).astype(np.int32)))
    return parts


def in_tiles(vertices, faces, side):
    """The parts of a mesh by a grid of ``side`` x ``side`` over x and y."""
    centres = vertices[faces].mean(axis=1)[:, :2]
    low, high = centres.min(axis=0), centres.max(axis=0)
    cells = np.minimum((centres - low) / (high - low) * side, side - 1).astype(int)
    return cut(vertices, faces, cells[:, 0] * side + cells[:, 1])


def joined(parts):
    """The parts behind one another: vertices that they share are there more than once."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = [own + start for (_, own), start in zip(parts, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def ply(vertices, faces, code="<f4"):
    """A binary PLY with positions of this type."""
    return to_ply(vertices.astype(code), faces)


def tasks_of(folder: Path, contents) -> list[Task]:
    """A task for each file of ``contents``, bytes by name, that it writes into ``folder``/in."""
    (folder / "in").mkdir(parents=True, exist_ok=True)
    (folder / "out").mkdir(exist_ok=True)
    tasks = []
    for name, data in contents.items():
        (folder / "in" / name).write_bytes(data)
        tasks.append(Task(str(folder / "in" / name), str(folder / "out" / name), name))
    return tasks


def mixed(parts):
    """Each part as a file in one of several formats, by name."""
    meshes = [open_mesh(ply(*part), "a.ply") for part in parts]
    return {
        f"{i}.{format}": bytes(convert(mesh, mesh.vertices, format)[0])
        for i, (mesh, format) in enumerate(zip(meshes, FORMATS, strict=False))
    }


def read(path):
    """The mesh file at a path."""
    return open_mesh(Path(path).read_bytes(), str(path))
