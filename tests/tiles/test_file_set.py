"""A tile set through the stages of the tiles: the bytes of the joined mesh in memory."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.errors import InputError, InternalError
from msal_cli.job.pipeline import denoise_file
from msal_cli.job.settings import Settings, Task
from msal_cli.tiles import stages
from msal_cli.tiles.file_set import FIXED, SetFile, SetSource, build_table, open_set
from msal_cli.tiles.join import MOVED
from msal_cli.tiles.opening import open_run
from msal_cli.tiles.scratch import Scratch
from tests.tiles.tile_files import in_tiles, joined, mixed, noisy_terrain, ply, read, tasks_of

NO_VERTICES = np.empty(0, dtype=np.int64)
NO_TABLE = NO_VERTICES, np.empty((0, 3)), NO_VERTICES


def describe(tasks, folder, vertex_type="float32", table=NO_TABLE):
    files = []
    for task in tasks:
        opened = read(task.input) if not task.input.endswith(".gz") else None
        if opened is None:
            from msal_cli.codecs import open_mesh

            opened = open_mesh(gzip.decompress(Path(task.input).read_bytes()), "a.ply")
        size = Path(task.input).stat().st_size
        files.append(SetFile(task.input, len(opened.vertices), len(opened.faces), size))
    source = SetSource(files, None, vertex_type, build_table(*table))
    source.write(folder)
    return source.describe(folder)


def source_of(tmp_path, contents, **options):
    return open_set(describe(tasks_of(tmp_path, contents), tmp_path, **options))


def test_the_files_stand_behind_one_another(tmp_path):
    parts = in_tiles(*noisy_terrain(), 3)
    source = source_of(tmp_path, mixed(parts), vertex_type="float64")
    whole = [read(tmp_path / "in" / name) for name in mixed(parts)]
    vertices = np.concatenate([one.vertices for one in whole])
    assert source.n_vertices == len(vertices)
    for start, stop in ((0, len(vertices)), (5, 7), (60, 300), (len(vertices), len(vertices))):
        assert source.read_vertices(start, stop).tobytes() == vertices[start:stop].tobytes()
    starts = np.cumsum([0, *(len(one.vertices) for one in whole)])
    faces = [one.faces + at for one, at in zip(whole, starts, strict=False)]
    for most in (20, 10_000):
        chunks = source.face_chunks(most)
        first = np.cumsum([0, *(len(source.read_triangles(one)) for one in chunks)])
        assert [one.first_triangle for one in chunks] == first[:-1].tolist()
        read_faces = np.concatenate([source.read_triangles(one) for one in chunks])
        assert np.array_equal(read_faces, np.concatenate(faces))


def test_compressed_files_are_read_whole(tmp_path):
    parts = in_tiles(*noisy_terrain(), 2)
    contents = {f"{i}.ply.gz": gzip.compress(ply(*part)) for i, part in enumerate(parts)}
    source = source_of(tmp_path, contents)
    wanted = joined(parts)[0].astype(np.float32)
    assert source.read_vertices(0, source.n_vertices).tobytes() == wanted.tobytes()


def test_the_table_moves_vertices_and_names_fixed_ones(tmp_path):
    parts = in_tiles(*noisy_terrain(), 2)
    table = np.array([3, 200]), np.array([[1.0, 2, 3], [4, 5, 6]]), np.array([7, 201])
    contents = {f"{i}.ply": ply(*part) for i, part in enumerate(parts)}
    source = source_of(tmp_path, contents, table=table)
    assert source.read_vertices(2, 4)[1].tolist() == [1, 2, 3]
    assert source.read_vertices(199, 202)[1].tolist() == [4, 5, 6]
    assert source.read_property(FIXED, 0, 300).nonzero()[0].tolist() == [7, 201]


def test_a_file_that_changed_is_noticed(tmp_path):
    parts = in_tiles(*noisy_terrain(), 2)
    source = source_of(tmp_path, mixed(parts), vertex_type="float64")
    (tmp_path / "in/1.obj").write_bytes(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(InputError, match="changed"):
        source.read_vertices(0, source.n_vertices)


def test_a_set_is_only_read(tmp_path):
    source = source_of(tmp_path, mixed(in_tiles(*noisy_terrain(), 2)))
    assert source.output_pieces(100) == []
    with pytest.raises(InternalError):
        source.replace((0, 1), lambda start, stop: np.zeros((stop - start, 3)), None)
    with pytest.raises(InternalError):
        source.read_normals(0, 1)


@pytest.mark.parametrize("code", ["<f4", "<f8"])
@pytest.mark.parametrize("method", ["msal", "al", "bilateral_normal"])
def test_by_tiles_it_is_the_joined_mesh(tmp_path, code, method):
    vertices, faces = noisy_terrain()
    parts = in_tiles(vertices + (0.1 if code == "<f8" else 0.0), faces, 2)
    settings = Settings(method, methods.find(method).validate({}))
    tasks = tasks_of(tmp_path, {f"{i}.ply": ply(*part, code) for i, part in enumerate(parts)})
    description = describe(tasks, tmp_path, {"<f4": "float32", "<f8": "float64"}[code])
    scratch = Scratch(tmp_path / "scratch")
    scratch.path.mkdir()
    open_run(
        Task("set", "", "set"),
        settings,
        scratch,
        tile_vertices=90,
        chunk_vertices=100,
        source=description,
    )
    stages.run_here(scratch)
    moved = np.array(scratch.array(MOVED, np.float64, 3)[scratch.array("numbers.u4", np.uint32)])
    (task,) = tasks_of(tmp_path / "joined", {"a.ply": ply(*joined(parts), code)})
    whole = denoise_file(task, replace(settings, precision="float64"))
    assert moved.tobytes() == read(whole.output).vertices.tobytes()
