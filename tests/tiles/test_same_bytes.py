"""The output of a run by tiles has the very bytes of one in memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.job.pipeline import denoise_file
from msal_cli.job.settings import Settings, Task
from msal_cli.tiles import join, measures, stages
from msal_cli.tiles.opening import open_run
from msal_cli.tiles.scratch import Scratch
from tests.shapes import ball, grid, noisy


def write_ply(path: Path, faces: np.ndarray, columns: dict[str, np.ndarray], order: str) -> None:
    """A binary PLY of triangles with these properties of vertices, ``<`` or ``>`` first."""
    types = {"f4": "float", "f8": "double", "u1": "uchar"}
    encoding = {"<": "little", ">": "big"}[order]
    lines = ["ply", f"format binary_{encoding}_endian 1.0"]
    lines.append(f"element vertex {len(columns['x'])}")
    kinds = {name: values.dtype.str[1:] for name, values in columns.items()}
    lines += [f"property {types[kind]} {name}" for name, kind in kinds.items()]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    vertices = np.empty(len(columns["x"]), [(name, order + kind) for name, kind in kinds.items()])
    for name, values in columns.items():
        vertices[name] = values
    rows = np.empty(len(faces), [("count", "u1"), ("corners", order + "i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    path.write_bytes("\n".join(lines).encode() + b"\n" + vertices.tobytes() + rows.tobytes())


def to_columns(vertices: np.ndarray, kind: str) -> dict[str, np.ndarray]:
    return dict(zip("xyz", vertices.T.astype(kind), strict=True))


def check_bytes(tmp_path: Path, source: Path, settings: Settings, tile_vertices: int = 100) -> Any:
    folder, output, expected = (tmp_path / name for name in ("tiles", "tiles.out", "memory.out"))
    folder.mkdir()
    record = denoise_file(Task(str(source), str(expected), "x"), settings)
    assert record.error is None
    scratch = Scratch(folder)
    task = Task(str(source), str(output), "x")
    plan = open_run(task, settings, scratch, tile_vertices=tile_vertices, chunk_vertices=300)
    assert plan.n_tiles >= 8
    stages.run_here(scratch)
    join.finish_output(scratch)
    assert output.read_bytes() == expected.read_bytes()
    assert record.output_sha256 != record.input_sha256
    found = measures.changes_of(scratch).fields
    for name in ("locked_vertices", "clamped_vertices", "flipped_faces"):
        if name in found:
            assert found[name] == getattr(record, name)
    return record


def to_settings(method: str, given: dict[str, Any] | None = None, **more: Any) -> Settings:
    return Settings(method, methods.find(method).validate(given or {}), **more)


def seamed_grid() -> tuple[np.ndarray, np.ndarray]:
    """A noisy sheet with a hole, a seam, a strip that hangs on by a corner, and stray vertices."""
    vertices, faces = grid(20, 30)
    vertices = noisy(vertices, level=0.15)
    faces = np.delete(faces, np.arange(200, 220), axis=0)
    n = len(vertices)
    twins = np.arange(0, n, 17)
    vertices = np.concatenate([vertices, vertices[twins], [[3.0, 3.0, 9.0], [50.0, 0.0, 0.0]]])
    left = faces[::2]
    for k, twin in enumerate(twins):
        left[left == twin] = n + k
    faces[::2] = left
    useless = [[n, 0, 5], [1, 1, 2], [0, n, 18], faces[40], faces[41]]
    return vertices, np.concatenate([faces, np.array(useless, dtype=np.int32)])


@pytest.mark.parametrize("kind", ["f4", "f8"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_normals_follow(tmp_path, kind, order):
    vertices, faces = seamed_grid()
    rng = np.random.default_rng(4)
    normals = np.tile([0.0, 0.0, 1.0], (len(vertices), 1))
    # Creases, senses and lengths of their own, and some that are none.
    odd = rng.random(len(vertices)) < 0.3
    normals[odd] = rng.integers(-1, 2, (int(odd.sum()), 3)) * 2.0
    columns = to_columns(vertices, kind)
    columns |= dict(zip(("nx", "ny", "nz"), normals.T.astype(kind), strict=True))
    write_ply(tmp_path / "in.ply", faces, columns, order)
    check_bytes(tmp_path, tmp_path / "in.ply", to_settings("al", {"iterations": 2}))


@pytest.mark.parametrize(
    "options",
    [
        {"max_move": "0.05e"},
        {"max_move": "0.02", "lock": ("boundary",)},
        {"lock": ("confidence < 0.2", "group == 3")},
        {"weights": "confidence"},
        {"weights": "group", "lock": ("boundary", "confidence >= 0.9"), "max_move": "0.3e"},
    ],
)
def test_vertices_are_held(tmp_path, options):
    vertices, faces = seamed_grid()
    rng = np.random.default_rng(7)
    columns = to_columns(vertices, "f4")
    columns["confidence"] = rng.choice([0.1, 0.2, 0.5, 0.9, 1.0], len(vertices)).astype("f4")
    columns["group"] = rng.integers(0, 5, len(vertices)).astype("u1")
    write_ply(tmp_path / "in.ply", faces, columns, "<")
    check_bytes(tmp_path, tmp_path / "in.ply", to_settings("msal", **options))


def test_held_vertices_without_faces_count(tmp_path):
    vertices, faces = grid(20, 30)
    vertices = np.concatenate([noisy(vertices), np.random.default_rng(0).random((40, 3))])
    columns = to_columns(vertices, "f4")
    columns["q"] = np.arange(len(vertices)).astype("f4")
    write_ply(tmp_path / "in.ply", faces, columns, "<")
    record = check_bytes(tmp_path, tmp_path / "in.ply", to_settings("al", lock=("q > 590",)))
    assert record.locked_vertices == 49


@pytest.mark.parametrize(
    ("method", "given"),
    [
        ("al", {}),
        ("al", {"schedule": "robust", "boundary": "fixed"}),
        ("msal", {}),
    ],
)
def test_facets(tmp_path, method, given):
    vertices, faces = ball(24, 12)
    corners = noisy(vertices, level=0.04).astype("<f4")[faces]
    facets = np.zeros(
        len(faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("word", "<u2")]
    )
    facets["corners"] = corners
    data = b"facets".ljust(80) + np.uint32(len(faces)).tobytes() + facets.tobytes()
    (tmp_path / "in.stl").write_bytes(data)
    check_bytes(tmp_path, tmp_path / "in.stl", to_settings(method, given), tile_vertices=40)
