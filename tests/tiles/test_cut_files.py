"""Files of the disk are cut; a fault inside one is named with its place."""

from __future__ import annotations

import pickle
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from msal_cli.errors import ContentError, TruncatedError
from msal_cli.job.settings import Settings, Task
from msal_cli.tiles.opening import open_run
from msal_cli.tiles.plan import TilePlan
from msal_cli.tiles.scratch import Scratch
from tests.tiles.fakes import FakeMesh, run_stages
from tests.tiles.test_cut import check, make_grid, make_soup


def write_ply(path: Path, mesh: FakeMesh) -> Path:
    """A binary PLY with lists of faces."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {mesh.n_vertices}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {mesh.n_polygons}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.zeros(mesh.n_polygons, dtype=[("n", "u1"), ("ids", "<i4", 3)])
    faces["n"], faces["ids"] = 3, mesh.faces
    path.write_bytes(header.encode() + mesh.vertices.astype("<f4").tobytes() + faces.tobytes())
    return path


def write_stl(path: Path, soup: FakeMesh) -> Path:
    """A binary STL of a mesh whose triangles have corners of their own."""
    facets = np.zeros(soup.n_polygons, dtype=[("n", "<f4", 3), ("corners", "<f4", 9), ("w", "<u2")])
    facets["corners"] = soup.vertices.reshape(-1, 9)
    path.write_bytes(bytes(80) + struct.pack("<I", soup.n_polygons) + facets.tobytes())
    return path


def open_file(path: Path, folder: Path) -> tuple[TilePlan, Scratch]:
    folder.mkdir()
    scratch = Scratch(folder)
    task = Task(str(path), str(path.with_name("out" + path.suffix)), path.name)
    plan = open_run(task, Settings("al"), scratch, tile_vertices=60, chunk_vertices=150)
    return plan, scratch


@pytest.mark.parametrize("suffix", ["ply", "stl"])
def test_a_file_is_cut(suffix, tmp_path):
    mesh = make_grid(25)
    if suffix == "stl":
        mesh = make_soup(mesh)
    write = write_ply if suffix == "ply" else write_stl
    path = write(tmp_path / f"mesh.{suffix}", mesh)
    plan, scratch = open_file(path, tmp_path / "scratch")
    assert plan.n_tiles == 16
    assert plan.identity["files"][0][:2] == [str(path), path.stat().st_size]
    run_stages(scratch)
    check(mesh, scratch, plan.n_tiles)
    assert len(scratch.results("faces")) > 1


def test_any_process_that_sees_the_folder_can_run_a_task(tmp_path):
    path = write_ply(tmp_path / "mesh.ply", make_grid(12))
    _, scratch = open_file(path, tmp_path / "scratch")
    code = (
        "import pickle, sys; from msal_cli.tiles.stages import run_task;"
        "print(run_task(pickle.loads(bytes.fromhex(sys.argv[1]))))"
    )
    ref = pickle.dumps((str(scratch.path), "count", 0)).hex()
    done = subprocess.run(
        [sys.executable, "-c", code, ref], capture_output=True, text=True, cwd="/", check=True
    )
    assert done.stdout.strip() == str(scratch.result("count", 0))


def test_a_face_that_names_a_vertex_which_is_not_there_is_named(tmp_path):
    mesh = make_grid(25)
    mesh.faces[700, 1] = 625
    _, scratch = open_file(write_ply(tmp_path / "mesh.ply", mesh), tmp_path / "scratch")
    with pytest.raises(ContentError) as caught:
        run_stages(scratch)
    assert caught.value.code == "E_INDEX"
    assert caught.value.where == "face 700"


def test_a_position_that_is_not_finite_is_named(tmp_path):
    mesh = make_grid(25)
    mesh.vertices[321, 2] = np.nan
    path = write_ply(tmp_path / "mesh.ply", mesh)
    with pytest.raises(ContentError) as caught:
        open_file(path, tmp_path / "scratch")
    assert caught.value.code == "E_NONFINITE"
    assert caught.value.where == "vertex 321"


def test_a_file_without_its_end_is_refused_before_work_begins(tmp_path):
    path = write_ply(tmp_path / "mesh.ply", make_grid(25))
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(TruncatedError):
        open_file(path, tmp_path / "scratch")
    assert not list((tmp_path / "scratch").iterdir())
