"""What is told of a file that is read in pieces, against what is told of it in memory."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.job import larger_than_memory
from msal_cli.job.inspection import inspect_file
from msal_cli.job.plain_data import as_data
from tests.job.large_files import in_pieces, write_ply, write_stl
from tests.shapes import grid, torus

__all__ = ["in_pieces"]

NOT_COUNTED = {
    "components",
    "non_manifold_edges",
    "duplicate_faces",
    "welded_vertices",
}


def noisy(vertices, faces):
    rng = np.random.default_rng(7)
    return vertices + rng.normal(0.0, 0.02, vertices.shape), rng.permutation(faces)


def with_strays(vertices, faces):
    stray = np.append(vertices, [[0.5, 0.25, 0.125]] * 3, axis=0)
    return stray, np.append(faces, [[0, 1, 1], [0, len(vertices), 200]], axis=0)


def turned(vertices, faces):
    return vertices, faces[:, ::-1]


def check_same(path, monkeypatch, *, but=()):
    in_memory_now = as_data(inspect_file(str(path)))
    monkeypatch.undo()
    known = as_data(inspect_file(str(path)))
    assert in_memory_now["read_in_pieces"]
    assert not known["read_in_pieces"]
    for name, value in known.items():
        told = in_memory_now[name]
        if name in NOT_COUNTED | set(but):
            assert told is None, name
        elif name == "noise_estimate":
            assert told["file_units"] == pytest.approx(value["file_units"], rel=0.05)
        elif isinstance(value, float):
            assert told == pytest.approx(value, rel=1e-9), name
        elif name != "read_in_pieces":
            assert told == value, name


@pytest.mark.parametrize("kind", ["f4", "f8"])
@pytest.mark.parametrize("change", [noisy, with_strays, turned])
@pytest.mark.parametrize("shape", [torus, grid])
def test_a_ply(tmp_path, in_pieces, monkeypatch, kind, change, shape):
    path = write_ply(tmp_path / "a.ply", *change(*shape(30, 20)), kind)
    check_same(path, monkeypatch)


@pytest.mark.parametrize("shape", [torus, grid])
def test_an_stl(tmp_path, in_pieces, monkeypatch, shape):
    path = write_stl(tmp_path / "a.stl", *noisy(*shape(30, 20)))
    check_same(path, monkeypatch, but=("vertices", "unreferenced_vertices"))


def test_faces_wound_against_each_other_have_no_volume(tmp_path, in_pieces):
    vertices, faces = torus(30, 20)
    faces[5:9] = faces[5:9, ::-1]
    record = inspect_file(str(write_ply(tmp_path / "a.ply", vertices, faces)))
    assert (record.winding, record.closed, record.volume) == ("inconsistent", True, None)
    assert record.inconsistent_edges > 0
    assert "wound inconsistently" in record.volume_reason


@pytest.mark.parametrize(
    ("spoil", "code", "where"),
    [
        (lambda v, f: f.__setitem__((700, 1), len(v)), "E_INDEX", "face 700"),
        (lambda v, f: v.__setitem__((301, 2), np.nan), "E_NONFINITE", "vertex 301"),
        (lambda v, f: f.__setitem__(slice(None), 3), "E_NO_FACES", ""),
        (lambda v, f: v.__imul__(1e70), "E_RANGE", ""),
    ],
)
def test_bad_input_is_named_with_its_place(tmp_path, in_pieces, spoil, code, where):
    vertices, faces = torus(30, 20)
    spoil(vertices, faces)
    record = inspect_file(str(write_ply(tmp_path / "a.ply", vertices, faces)))
    assert (record.error.code, record.error.where) == (code, where)


def test_a_file_cut_short(tmp_path, in_pieces):
    path = write_ply(tmp_path / "a.ply", *torus(30, 20))
    path.write_bytes(path.read_bytes()[:-5])
    record = inspect_file(str(path))
    assert record.error.code == "E_TRUNCATED"


def test_what_memory_decides(tmp_path, monkeypatch):
    path = write_ply(tmp_path / "a.ply", *torus(30, 20))
    for free, is_large in ((None, False), (10**12, False), (10**6, True)):
        monkeypatch.setattr(larger_than_memory.machine, "available_bytes", lambda f=free: f)
        with larger_than_memory.opened_in_pieces((str(path),)) as opened:
            assert (opened is not None) == is_large
        # Not all formats are read in pieces.
        other = tmp_path / "a.off"
        other.write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
        with larger_than_memory.opened_in_pieces((str(path), str(other))) as opened:
            assert opened is None


def test_intersections_are_not_counted_and_that_is_said(tmp_path, in_pieces):
    path = write_ply(tmp_path / "a.ply", *torus(30, 20))
    record = inspect_file(str(path), with_intersections=True)
    assert record.self_intersections is None
    assert "intersections are not counted" in record.warnings[-1]


def write_text(path, vertices, faces):
    head = f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\n"
    head += "".join(f"property double {axis}\n" for axis in "xyz")
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [" ".join(map(repr, row)) for row in vertices.tolist()]
    rows += [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
    path.write_text(head + "\n".join(rows) + "\n")
    return path


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(larger_than_memory.tempfile, "tempdir", str(folder))
    return folder


def test_the_numbers_of_a_text_are_kept_in_a_folder_for_a_while(
    tmp_path, in_pieces, monkeypatch, temporary
):
    path = write_text(tmp_path / "a.ply", *noisy(*torus(30, 20)))
    check_same(path, monkeypatch)
    assert list(temporary.iterdir()) == []


def test_a_text_without_space_for_its_numbers(tmp_path, in_pieces, monkeypatch, temporary):
    path = write_text(tmp_path / "a.ply", *torus(30, 20))
    usage = larger_than_memory.shutil.disk_usage(tmp_path)._replace(free=10)
    monkeypatch.setattr(larger_than_memory.shutil, "disk_usage", lambda _: usage)
    error = inspect_file(str(path)).error
    assert (error.code, list(temporary.iterdir())) == ("E_WRITE", [])
    assert "bytes more are needed" in error.message
    assert "TMPDIR" in error.hint


def test_a_text_with_a_fault_names_its_place(tmp_path, in_pieces, temporary):
    path = write_text(tmp_path / "a.ply", *torus(30, 20))
    path.write_text(path.read_text().replace("\n3 17 ", "\n3 9999 ", 1))
    error = inspect_file(str(path)).error
    assert error.code == "E_INDEX"
    assert "face" in error.where
    assert list(temporary.iterdir()) == []
