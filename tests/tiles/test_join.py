"""The output in pieces: the bytes that the whole file's codec writes, and its way to its place."""

from __future__ import annotations

import errno
import gzip
import hashlib
import os
import stat
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from msal_cli.codecs import open_mesh
from msal_cli.codecs.streamed import line_blocks
from msal_cli.errors import InputError, OutputError
from msal_cli.job.settings import Settings, Task
from msal_cli.storage import atomic, gzip_streams
from msal_cli.tiles import join, opening
from msal_cli.tiles.opening import open_run
from msal_cli.tiles.plan import TilePlan
from msal_cli.tiles.scratch import Scratch
from tests.codecs import plain_ply, plain_stl
from tests.codecs.plain_ply import Element, Ply
from tests.codecs.streamed.pieces import new_normals
from tests.tiles.fakes import run_stages


@dataclass
class Run:
    """A run whose vertices are numbered, ready for new positions."""

    scratch: Scratch
    plan: TilePlan
    data: bytes
    output: Path

    @property
    def numbers(self) -> np.ndarray:
        return np.array(self.scratch.array("numbers.u4", np.uint32))

    def write_rows(self, name: str, values: np.ndarray) -> None:
        """An array (n, 3) in the order of the file as ``name`` in the order of tiles."""
        rows = np.empty_like(values)
        rows[self.numbers] = values
        self.scratch.create(name, np.float64, rows.shape)
        self.scratch.write_range(name, 0, rows)

    def join(self) -> None:
        """All pieces, the last one first."""
        for piece in reversed(range(len(self.plan.pieces))):
            self.scratch.finish("join", piece, join.run_join(self.scratch, piece))


def open_file(tmp_path: Path, data: bytes, suffix: str) -> Run:
    path, output = tmp_path / f"a.{suffix}", tmp_path / f"out.{suffix}"
    path.write_bytes(data)
    scratch = Scratch(tmp_path / "scratch")
    scratch.path.mkdir()
    task = Task(str(path), str(output), path.name)
    plan = open_run(task, Settings("al"), scratch, tile_vertices=10, chunk_vertices=7)
    run_stages(scratch, ("count", "number"))
    return Run(scratch, plan, data, output)


def scan(encoding: str = "binary_little_endian", normals: bool = False) -> bytes:
    """A rough sheet in shuffled order."""
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(np.arange(9.0), np.arange(8.0), indexing="ij")
    positions = np.stack([x, y, rng.normal(0, 0.2, x.shape)], axis=2).reshape(-1, 3)
    names = ["x", "y", "z"] + ["nx", "ny", "nz"] * normals
    order = rng.permutation(len(positions))
    rows = [[*positions[i].tolist(), *[0.0, 0.0, 1.0] * normals] for i in order]
    place = np.argsort(order)
    faces = [
        [place[[8 * i + j, 8 * i + j + 8, 8 * i + j + 1]].tolist()]
        for i in range(8)
        for j in range(7)
    ]
    vertex = Element("vertex", [(name, "float", "") for name in names], rows)
    face = Element("face", [("vertex_indices", "int", "uchar")], faces)
    return plain_ply.written(Ply(encoding, [vertex, face], trailing=b"rest"))


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch):
    monkeypatch.setattr(opening, "_BYTES_PER_VERTEX", 12)
    monkeypatch.setattr(line_blocks, "BLOCK_BYTES", 100)


def move(vertices: np.ndarray) -> np.ndarray:
    """New positions of all vertices but every third."""
    moved = vertices + np.random.default_rng(1).normal(0, 0.1, vertices.shape)
    moved[::3] = vertices[::3]
    return moved


@pytest.mark.parametrize("normals", [False, True])
@pytest.mark.parametrize("encoding", plain_ply.ENCODINGS)
def test_a_joined_ply_is_what_the_whole_file_becomes(tmp_path, encoding, normals):
    run = open_file(tmp_path, scan(encoding, normals), "ply")
    whole = open_mesh(run.data, "a.ply")
    new = move(whole.vertices)
    run.write_rows(join.MOVED, new)
    if normals:
        run.write_rows(join.NORMALS, new_normals(whole, new))
    run.join()
    assert not run.output.exists()
    finished = join.finish_output(run.scratch)
    assert run.output.read_bytes() == bytes(whole.replaced(new))
    assert finished.is_changed
    assert finished.size == run.output.stat().st_size
    assert not run.scratch.has(join.OUTPUT) and not run.scratch.has(join.PIECES)
    assert join.finish_output(run.scratch) == finished


@pytest.mark.parametrize("is_moved", [False, True])
@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize(("before", "after"), [(".gz", ".gz"), (".gz", ""), ("", ".gz")])
def test_compressed_files_are_what_they_are_in_memory(tmp_path, before, after, encoding, is_moved):
    data = scan(encoding)
    whole = open_mesh(data, "a.ply")
    new = move(whole.vertices) if is_moved else whole.vertices
    # Compressed in another way than msal does, to see what is copied.
    source = gzip.compress(data, 1) if before else data
    run = open_file(tmp_path, source, "ply" + before)
    run.write_rows(join.MOVED, new)
    run.join()
    output = str(run.output.with_name("other.ply" + after))
    finished = join.finish_output(run.scratch, path=output)
    made = bytes(whole.replaced(new))
    expected = gzip_streams.compress(made) if after else made
    if before == after and not is_moved:
        expected = source
    assert Path(output).read_bytes() == expected
    assert finished.is_changed == (expected != source)
    assert finished.output_sha256 == hashlib.sha256(expected).hexdigest()
    assert finished.input_sha256 == hashlib.sha256(source).hexdigest()
    assert finished.size == len(expected)
    assert not run.scratch.has(join.OUTPUT)
    assert join.finish_output(run.scratch, path=output) == finished


def test_a_joined_stl_is_what_the_whole_file_becomes(tmp_path):
    corners = np.random.default_rng(0).normal(size=(40, 9)).astype(np.float32)
    run = open_file(tmp_path, plain_stl.binary(corners), "stl")
    whole = open_mesh(run.data, "a.stl")
    new = move(whole.vertices)
    run.write_rows(join.MOVED, new[whole.faces.reshape(-1)])
    run.join()
    join.finish_output(run.scratch)
    assert run.output.read_bytes() == bytes(whole.replaced(new))


def test_where_nothing_moved_the_output_is_the_input(tmp_path):
    run = open_file(tmp_path, scan(), "ply")
    run.join()
    finished = join.finish_output(run.scratch)
    assert run.output.read_bytes() == run.data
    assert not finished.is_changed
    assert finished.input_sha256 == finished.output_sha256


def test_finishing_twice_is_finishing_once(tmp_path):
    run = open_file(tmp_path, scan(), "ply")
    run.join()
    finished = join.finish_output(run.scratch)
    time = run.output.stat().st_mtime_ns
    assert join.finish_output(run.scratch) == finished
    assert run.output.stat().st_mtime_ns == time


def test_a_piece_that_got_lost_is_noticed(tmp_path):
    run = open_file(tmp_path, scan(), "ply")
    run.join()
    start, stop = run.plan.pieces[4]
    run.scratch.write_range(join.OUTPUT, start, np.zeros(stop - start, dtype=np.uint8))
    with pytest.raises(OutputError, match=f"bytes {start} to {stop}"):
        join.finish_output(run.scratch)
    assert not run.output.exists()
    join.run_join(run.scratch, 4)
    os.truncate(run.scratch.path / join.OUTPUT, len(run.data) - 2)
    with pytest.raises(OutputError):
        join.finish_output(run.scratch)
    assert not run.output.exists()


def test_a_piece_of_a_text_that_got_lost_is_noticed(tmp_path):
    run = open_file(tmp_path, scan("ascii"), "ply")
    run.join()
    lost = run.scratch.path / join.PIECES / "1.bin"
    data = lost.read_bytes()
    lost.write_bytes(data[::-1])
    with pytest.raises(OutputError, match="piece 1"):
        join.finish_output(run.scratch)
    assert sorted(os.listdir(tmp_path)) == ["a.ply", "scratch"]
    lost.write_bytes(data)
    assert not join.finish_output(run.scratch).is_changed
    assert run.output.read_bytes() == run.data


def test_an_input_that_changed_is_refused(tmp_path):
    run = open_file(tmp_path, scan(), "ply")
    run.join()
    os.utime(tmp_path / "a.ply", (1, 1))
    with pytest.raises(InputError, match="changed"):
        join.finish_output(run.scratch)
    assert not run.output.exists()


def test_an_output_on_another_file_system_is_copied(tmp_path, monkeypatch):
    run = open_file(tmp_path, scan(), "ply")
    run.join()
    original = atomic._move

    def refuse(temporary, target):
        if temporary.parent != target.parent:
            raise OSError(errno.EXDEV, "another file system")
        original(temporary, target)

    monkeypatch.setattr(atomic, "_move", refuse)
    join.finish_output(run.scratch)
    assert run.output.read_bytes() == run.data
    assert not run.scratch.has(join.OUTPUT)
    assert sorted(os.listdir(tmp_path)) == ["a.ply", "out.ply", "scratch"]


@pytest.mark.skipif(os.name != "posix", reason="permission bits of POSIX")
def test_an_output_that_is_replaced_hands_down_its_permissions(tmp_path):
    run = open_file(tmp_path, scan(), "ply")
    run.output.write_bytes(b"old")
    run.output.chmod(0o640)
    run.join()
    join.finish_output(run.scratch)
    assert run.output.read_bytes() == run.data
    assert stat.S_IMODE(run.output.stat().st_mode) == 0o640


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path):
    run = open_file(tmp_path, scan(), "ply")
    run.join()
    with pytest.raises(OutputError):
        join.finish_output(run.scratch, path=str(tmp_path / "missing" / "out.ply"))
    assert run.scratch.has(join.OUTPUT)
    assert join.finish_output(run.scratch).size == len(run.data)
